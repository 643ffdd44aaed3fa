"""Commands of the command line: exit status, words, files and their values; 100 wrong inputs."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
from pathlib import Path

import click
from cases import ALL, COMM, DEMOS, ONE, VOLATILE, Values, add, flat, placeless, plain

from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.errors import ObstacleError

# times and memory
TIMES = re.compile(r"\d[\d.]*(?:e[-+]?\d+)? ?(s|ms|min|h|MB|GB|minutes|seconds|Poisson solves)\b")
KRYLOV = re.compile(r"\d+ linear steps")
INPUTS = {
    "one": '[mesh]\nshape = "rectangle"\ncells = 8\n[effects]\ntension = 1\nload = -4\n[obstacle]\n'
           'lower = "c - 0.1*x"\n[define]\nc = -0.1\n[[boundary]]\nvalue = 0\n[report]\n'
           'force = "integral(p)"\nmiddle = "at(u, 0.4, 0.4)"\n'
           '[profile.middle]\nfrom = [0, 0.5]\nto = [1, 0.5]\n',
    "time": '[mesh]\nshape = "interval"\ncells = 16\n[effects]\ntension = 1\nrate = 1\nload = -4\n[obstacle]\n'
            'lower = -0.2\n[[boundary]]\nvalue = 0\n[time]\nend = 1\nsteps = 5\nstart = 0\n',
    "body": '[mesh]\nshape = "rectangle"\nx = [0, 2]\ny = [-2, 0]\ncells = 6\n[effects]\n'
            'elasticity = {young = 10, poisson = 0.3, plane = "strain"}\n[[boundary]]\non = "bottom"\nvalue = [0, 0]\n'
            '[[boundary]]\non = "top"\nobstacle = {cylinder = 4, centre = [0.5, 3.98]}\n',
}  # fmt: skip


def invoke(arguments: list[str], folder: Path) -> Values:
    """Run a command in this process on all ranks: status and what it prints (collective)."""
    said, complaint, status = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complaint):
        try:
            result = commands.main(arguments, prog_name="fenicsx-obstacle", standalone_mode=False)
            status = result if isinstance(result, int) else 0
        except ObstacleError as error:
            status = error.exit_status
            complaint.write(f"Error: {error}\n")
        except click.ClickException as error:
            status = 2
            complaint.write(f"Error: {error.format_message()}\n")
    COMM.Barrier()
    lines = said.getvalue().splitlines()
    records = [flat(json.loads(line)) for line in lines if line.startswith("{")]
    told = "\n".join(line for line in lines if not line.startswith("{"))
    values = {"status": status, "out": words(told, folder), "err": words(complaint.getvalue(), folder)}
    return values | {f"json.{number}.{key}": value for number, one in enumerate(records) for key, value in one.items()}


def words(text: str, folder: Path) -> list[str]:
    """Lines without times and places."""
    text = TIMES.sub(r"# \1", placeless(text, folder))
    if COMM.size > 1:
        text = KRYLOV.sub("# linear steps", text)
    return [re.sub(r" {2,}", "  ", line.rstrip()) for line in text.splitlines() if line.strip()]


def place(folder: Path) -> None:
    """The scenes of `INPUTS` as files (collective)."""
    if COMM.rank == 0:
        for name, text in INPUTS.items():
            (folder / f"{name}.toml").write_text(text)
    COMM.Barrier()


def files(folder: Path) -> Values:
    """What stands in a folder: names, JSON values, the tables (collective)."""
    values: Values = {}
    if COMM.rank == 0 and folder.is_dir():
        names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
        values["files"] = names
        for name in names:
            path = folder / name
            if name.endswith("answer.json"):
                values |= flat(json.loads(path.read_text()), f"{name}.")
            elif name.endswith(".csv"):
                values |= {f"{name}.{key}": value for key, value in table(path).items()}
            elif name.endswith(".html"):
                values[f"{name}.tables"] = path.read_text().count("<table")
    return COMM.bcast(values)


def table(path: Path) -> Values:
    """Number of rows, and the sum of each column of a CSV file."""
    rows = list(csv.reader(path.read_text().splitlines()))
    values: Values = {"rows": len(rows)}
    for number, head in enumerate(rows[0] if rows else ()):
        if not VOLATILE.isdisjoint(head.split(".")) or any(
            word in head for word in ("second", "memory", "time_", "krylov", "poisson", "round_off")
        ):
            continue
        column = []
        for row in rows[1:]:
            with contextlib.suppress(ValueError, IndexError):
                column.append(float(row[number]))
        values[head] = plain(sum(column))
    return values


def command(
    name: str, line: str, *, ranks: tuple[int, ...] = ALL, then: tuple[str, ...] = (), look: bool = True
) -> None:
    """A case that runs commands; FOLDER stands for a folder of its own, in which `INPUTS` are."""

    def run(folder: Path) -> Values:
        place(folder)
        values: Values = {}
        for number, text in enumerate((line, *then)):
            arguments = [word.replace("FOLDER", str(folder)).replace("DEMOS", str(DEMOS)).replace("~", " ")
                         for word in text.split()]  # fmt: skip
            found = invoke(arguments, folder)
            values |= found if number == 0 else {f"{number}.{key}": value for key, value in found.items()}
        return values | (files(folder / "out") if look else {})

    add(f"command/{name}", run, ranks)


def right() -> None:
    out = "--output FOLDER/out"
    command("solve", f"solve FOLDER/one.toml {out}")
    command("solve-json", f"solve FOLDER/one.toml {out} --json - --method vi")
    command("solve-quiet", f"solve FOLDER/one.toml {out} --quiet --eps 1e-7")
    command("solve-bound", f"solve FOLDER/one.toml {out} --bound")
    command("solve-tol", f"solve FOLDER/one.toml {out} --tol 0.3")
    command("solve-tol-budget", f"solve FOLDER/one.toml {out} --tol 0.001 --budget 300~unknowns")
    command("solve-goal", f"solve FOLDER/one.toml {out} --tol 0.05 --of force")
    command("solve-uncertainty", f"solve FOLDER/one.toml {out} --uncertainty")
    command("solve-set", f"solve FOLDER/one.toml {out} --set define.c=-0.05 --set effects.load=-9 --cells 6 --refine 1")
    command("solve-element", f"solve FOLDER/one.toml {out} --element P2 --start cold")
    command("solve-catalogue", f"solve ball {out} --cells 12")
    command("solve-time", f"solve FOLDER/time.toml {out}", then=(f"solve FOLDER/time.toml {out} --restart FOLDER/out",))
    command("solve-body", f"solve FOLDER/body.toml {out}")
    command("solve-plot", f"solve FOLDER/one.toml {out} --plot", ranks=ONE)
    command("solve-newton", f"solve FOLDER/one.toml {out} --newton", ranks=ONE)
    command("solve-time-plot", f"solve FOLDER/time.toml {out} --plot", ranks=ONE)
    command("plot", f"solve FOLDER/one.toml {out} --quiet", then=("plot FOLDER/out",), ranks=ONE)
    command("plot-body", f"solve FOLDER/body.toml {out} --quiet", then=("plot FOLDER/out",), ranks=ONE)
    command("plot-file", f"solve FOLDER/one.toml {out} --quiet", then=("plot FOLDER/out --output FOLDER/out/p.svg",),
            ranks=ONE)  # fmt: skip
    command("plot-along", f"solve FOLDER/one.toml {out} --quiet",
            then=("plot FOLDER/out --along 0,0.5:1,0.5 --compare u=-0.1*x",), ranks=ONE)  # fmt: skip
    command("compare", "solve FOLDER/one.toml --output FOLDER/a --quiet",
            then=("solve FOLDER/one.toml --cells 12 --output FOLDER/b --quiet", "compare FOLDER/a FOLDER/b"),
            ranks=ALL)  # fmt: skip
    cells = f"study FOLDER/one.toml --vary cells=4,8 {out} --quiet"  # without it the table has times
    command("study", cells, then=(cells,), ranks=ONE)
    command(
        "study-eps",
        f"study disk_flat --vary eps=1e-1..1e-4 --cells 8 {out} --latex FOLDER/out/t.tex --quiet",
        ranks=ONE,
    )
    command(
        "study-grid", f"study FOLDER/one.toml --vary cells=4,8 --vary method=vi,penalty {out} --quiet", ranks=(1, 2)
    )
    command("find", f"find FOLDER/one.toml --vary define.c=-0.2..-0.02 --target force=1 {out} --quiet", ranks=(1, 2))
    command("cost", f"cost disk_flat --budget 400~unknowns {out} --quiet", ranks=ONE, look=False)
    command("scenes", "scenes", ranks=ONE, look=False)
    command("scenes-ball", "scenes ball", ranks=ONE, look=False)
    for number in ("3.27", "3.6", "2.10", "3.36"):
        command(f"theory-{number}", f"theory {number} {out} --json -", ranks=ONE, look=False)
    command("theory", f"theory 3.32 {out}", ranks=ONE, look=False)
    command("hard", f"hard lake {out} --quiet", ranks=ONE, look=False)
    for name in ("one", "time", "body"):
        command(f"explain-{name}", f"explain FOLDER/{name}.toml", ranks=ONE, look=False)
    command("explain-tol", "explain FOLDER/one.toml --tol 0.2", ranks=ONE, look=False)
    for demo in ("awning", "put", "pollutant", "cloth", "creep", "wall", "foam", "bounce", "lift_off", "hertz_sphere"):
        command(f"explain-{demo}", f"explain DEMOS/{demo}.toml", ranks=ONE, look=False)
    for name in ("", *commands.commands):
        command(f"help-{name}", f"{name} --help", ranks=ONE, look=False)


for subject in (right,):
    subject()

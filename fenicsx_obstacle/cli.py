"""The command line. Nothing heavy is imported until a command needs it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from fenicsx_obstacle.cli_options import CHANGES, Place, along_text, interval, named, options, typed, varied
from fenicsx_obstacle.console import STARTED, check_places, progress, rows_of, tell, tolerance_status, write_json
from fenicsx_obstacle.errors import WRONG, InputError

ASKED = ("bound", "tol", "tol_absolute", "goal", "budget", "uncertainty", "restart", "yardstick")  # of solve()


class _Ordered(click.Group):
    """Commands in the order of their definition."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(cls=_Ordered, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="fenicsx_obstacle")
def commands() -> None:
    """Obstacle problems by the penalty finite element method, on FEniCSx and PETSc.

    Options take precedence over the scene; brackets show defaults. All commands but hard run under mpirun, as 'mpirun
    -n N fenicsx-obstacle COMMAND'; in a clone './obstacle --ranks N COMMAND' starts it. PETSc options follow --.
    """


@commands.command()
@click.argument("scene_file", metavar="SCENE")
@click.option("--plot", "picture", is_flag=True, help="Draw answer.png as well; the command plot does it later.")
@click.option("--newton", is_flag=True, help="Draw newton.gif: contact sets of the Newton steps and of (3.4)*.")
@click.option("--bound", is_flag=True, help="Compute an upper bound of the energy error, with the means of the load.")
@click.option("--tol", type=float, metavar="R", help="Refine until the relative energy error is below R, or status 4.")
@click.option("--tol-absolute", type=float, metavar="E", help="The same in the unit of the energy norm.")
@click.option("--of", "goal", metavar="NAME", help="The tolerance is for this: energy, force, or a name of [report].")
@click.option("--budget", metavar="LIMIT", help="With a tolerance: a limit such as 60s, 8GB or '1e6 unknowns'.")
@click.option("--uncertainty", is_flag=True, help="Estimate the error of each value from two coarser meshes.")
@click.option("--verify", is_flag=True, help="Check the solution against its discrete problem; status 3 if it fails.")
@click.option("--restart", type=Place(), metavar="DIR", help="With [time]: continue from the state in this folder.")
@options(*CHANGES, "yardstick", "plugin", "output", "json", "quiet", "log")
def solve(
    scene_file: str,
    picture: bool,
    newton: bool,
    verify: bool,
    output: Path | None,
    json_file: str | None,
    quiet: bool,
    **given: Any,
) -> int:
    """Solve a scene: u, contact pressure p, contact set.

    SCENE is a file, or a name that 'scenes' lists. Writes answer.json, scene.toml, history.csv, fields.xdmf (ParaView),
    free_boundary.csv and report.html into out/SCENE; with [time] frames.xdmf, history.png, a state for --restart too.
    """
    asked = {key: given.pop(key) for key in ASKED}
    scene = _read(scene_file, typed(given))  # a mistake in it is told before finite elements are loaded
    if newton:
        scene.only_scalar("--newton")
    from fenicsx_obstacle.answers.solve import solve
    from fenicsx_obstacle.show.report import PAGE, report_answer

    if verify and scene.time is not None:
        raise InputError(f"{scene.source}: [time]: --verify checks equilibria, not steps in time")
    folder = output or Path("out") / scene.name
    check_places(folder, json_file)
    with progress(scene.name, quiet=quiet):
        answer = solve(scene, keep=folder if scene.time is not None else None, **asked)
        answer.save(folder)
        checked = answer.verify() if verify else None
        answer, drawn = report_answer(answer, folder, picture=picture, newton=newton, started=STARTED)
    if json_file is not None:
        write_json(json_file, [answer.record])
    spoken = not quiet and json_file != "-"
    if spoken:
        tell(answer.summary() + f"\n  {drawn}\n  saved in {folder}, {PAGE} has all results")
    if checked is not None and (spoken or not checked):
        tell(str(checked), error=not spoken)
    if checked is not None and not checked:
        return WRONG
    return tolerance_status(answer.record, folder)


@commands.command()
@click.argument("scene_file", metavar="SCENE")
@click.option("--tol", type=float, metavar="R", help="Also forecast the cost of 'solve --tol R'; takes some seconds.")
@click.option("--tol-absolute", type=float, metavar="E", help="The same for 'solve --tol-absolute E'.")
@click.option("--of", "goal", metavar="NAME", help="The tolerance is for this: energy, force, or a name of [report].")
@options(*CHANGES, "plugin")
def explain(scene_file: str, tol: float | None, tol_absolute: float | None, goal: str | None, **given: Any) -> None:
    """Print the equation, the solver, and what is not included."""
    if goal is not None and tol is None and tol_absolute is None:
        raise InputError("--of needs a tolerance: add --tol")
    scene = _read(scene_file, typed(given))
    from fenicsx_obstacle.show.explain import explain, forecast_text

    tell(explain(scene))
    if tol is not None or tol_absolute is not None:
        from fenicsx_obstacle.answers.solve import adaptation

        tell(forecast_text(adaptation(scene, tol, tol_absolute, goal=goal)))


@commands.command()
@click.argument("scene_file", metavar="SCENE")
@click.option("--vary", "vary", multiple=True, metavar="KEY=LIST", required=True,
              help="A,B,C or A..B (by factors of 2; eps: 10) or A..B:N (N values); several make a grid.")  # fmt: skip
@click.option("--uncertainty", is_flag=True, help="Estimate the error of each value from two coarser meshes.")
@click.option("--fresh", is_flag=True, help="Discard saved rows instead of continuing from them.")
@click.option("--latex", type=Place(), metavar="FILE", help="The table as LaTeX.")
@options(*CHANGES, "plugin", "output", "json", "quiet", "log")
def study(
    scene_file: str,
    vary: tuple[str, ...],
    output: Path | None,
    json_file: str | None,
    quiet: bool,
    uncertainty: bool,
    fresh: bool,
    latex: Path | None,
    **given: Any,
) -> None:
    """Solve a scene for each value of a key: errors, orders, time.

    Writes rows, pictures and a page into out/SCENE/KEY. An interrupted run continues from its rows.

    \b
    study disk.toml --vary eps=1e-1..1e-8             against the SNES VI solution
    study ball.toml --vary cells=16..128 --eps "h^2"  against the exact solution
    """
    values, fixed = dict(varied(item) for item in vary), typed(given)
    if len(values) < len(vary):
        raise InputError("--vary: the same key twice; give all its values in one list")
    scene = _read(scene_file, {**fixed, **{key: some[0] for key, some in values.items()}})
    from fenicsx_obstacle.show.study import report_study
    from fenicsx_obstacle.studies.convergence import Study

    folder = output or Path("out") / scene.name / "-".join(values)
    run = partial(report_study, Study(scene, values, fixed, uncertainty=uncertainty), folder, fresh=fresh, latex=latex)
    rows_of(run, scene.name, folder, json_file, latex, quiet=quiet)


@commands.command()
@click.argument("scene_file", metavar="SCENE")
@click.option("--vary", metavar="KEY=A..B", required=True, help="The key, and the interval to search.")
@click.option("--target", metavar="'NAME = VALUE'", required=True,
              help="Quantity and value; energy, area, penetration, force, or a name of [report].")  # fmt: skip
@click.option("--within", type=float, metavar="R", help="Accuracy of the value, relative to the interval.  [1e-4]")
@click.option("--fresh", is_flag=True, help="Discard saved rows instead of continuing from them.")
@options(*CHANGES, "plugin", "output", "json", "quiet", "log")
def find(
    scene_file: str,
    vary: str,
    target: str,
    within: float | None,
    output: Path | None,
    json_file: str | None,
    quiet: bool,
    fresh: bool,
    **given: Any,
) -> None:
    """Find the value of a key for which a quantity reaches a target.

    Solves at both ends of the interval, then at points of Brent's method. Writes rows, a picture, a page and the
    answer found into out/SCENE/find-KEY; the last row is the one found. An interrupted run continues from its rows.

    \b
    find bearing.toml --vary define.ecc=0.3..0.9 --target "sommerfeld = 0.1212"
    """
    (key, ends), fixed = interval(vary), typed(given)
    scene = _read(scene_file, {**fixed, key: ends[0]})
    from fenicsx_obstacle.show.study import report_study
    from fenicsx_obstacle.studies.find import WITHIN, Find

    folder = output or Path("out") / scene.name / f"find-{key}"
    search = Find(scene, {key: ends}, target, fixed, within=WITHIN if within is None else within)
    rows_of(partial(report_study, search, folder, fresh=fresh), scene.name, folder, json_file, quiet=quiet)


@commands.command()
@click.argument("scene_file", metavar="SCENE")
@click.option("--budget", metavar="LIMIT", help="Limit of each row: 60s, 8GB, '1e6 unknowns'.  [10s, 1.2e6 unknowns]")
@click.option("--fresh", is_flag=True, help="Discard saved rows instead of continuing from them.")
@options("set", "element", "plugin", "output", "json", "quiet", "log")
def cost(
    scene_file: str,
    budget: str | None,
    output: Path | None,
    json_file: str | None,
    quiet: bool,
    fresh: bool,
    **given: Any,
) -> None:
    """Cost of accuracy: error against time for several methods.

    Also the time for one more digit. Writes rows, pictures and a page into out/SCENE/cost. Meshes become
    finer until a row would exceed the budget; an interrupted run continues from its rows.
    """
    fixed = typed(given)
    scene = _read(scene_file, fixed)
    from fenicsx_obstacle.show.cost import report_cost
    from fenicsx_obstacle.studies.cost import CostStudy

    folder = output or Path("out") / scene.name / "cost"
    study = CostStudy(scene, fixed, budget, folder)
    rows_of(partial(report_cost, study, fresh=fresh), scene.name, folder, json_file, quiet=quiet)


@commands.command()
@click.argument("first", type=Place(), metavar="A")
@click.argument("second", type=Place(), metavar="B")
@options("plugin", "json")
def compare(first: Path, second: Path, json_file: str | None) -> None:
    """Compare two saved results: norms, contact sets, forces.

    A and B are folders of 'solve'. Meshes may differ: the difference is taken at the nodes of the finer one.
    """
    from fenicsx_obstacle.answers.difference import compare
    from fenicsx_obstacle.show.tables import difference

    found = compare(first, second)
    if json_file is not None:
        write_json(json_file, [found])
    if json_file != "-":
        tell(difference(found, str(first), str(second)))


@commands.command()
@click.argument("result", type=Place())
@click.option("--output", type=Place(), metavar="FILE", help="Another file.  [RESULT/answer.png]")
@click.option("--along", metavar="A:B", help="Instead: u and p along a line, such as 0,0.5:1,0.5; a table, too.")
@click.option("--compare", multiple=True, metavar="NAME=FORMULA", help="With --along: a formula over this quantity.")
@options("plugin")
def plot(result: Path, output: Path | None, along: str | None, compare: tuple[str, ...]) -> None:
    """Draw a saved result: u, contact set and pressure.

    RESULT is a folder of 'solve'; its page then shows the picture, unless --output (.png, .pdf, .svg) is given. It may
    also be a folder that Solution.save wrote in Python. With --along it writes RESULT/along.png and along.csv.
    """
    if compare and along is None:
        raise InputError("--compare: needs --along")
    from fenicsx_obstacle.answers.answer import Answer

    if along is not None:
        from fenicsx_obstacle.show.profiles import draw_line

        ends = along_text(along)
        formulas = dict(named(one, "--compare", "a quantity and a formula, such as 'p = 1 - x^2'") for one in compare)
        tell(draw_line(Answer.read(result), *ends, output or result / "along.png", formulas))
        return
    from fenicsx_obstacle.answers.difference import read
    from fenicsx_obstacle.show.report import report_answer

    found = read(result)
    if output is None and isinstance(found, Answer):
        tell(report_answer(found, result, picture=True)[1])
    else:
        tell(found.plot(output or result / "answer.png").said)


@commands.command()
@click.argument("name", metavar="[NAME]", required=False)
def scenes(name: str | None) -> None:
    """List the scenes with exact solutions, or print one.

    \b
    scenes ball > mine.toml    a copy as a start
    solve ball                 commands take their names as well
    """
    from fenicsx_obstacle.scenes import catalogue
    from fenicsx_obstacle.show.tables import list_scenes

    tell(list_scenes() if name is None else catalogue.text(name).removesuffix("\n"))


@commands.command()
@click.argument("number", metavar="[NO]", required=False)
@click.option("--output", type=Place(), default=Path("out/theory"), metavar="DIR",
              help="Folder for pictures and JSON lines.  [out/theory]")  # fmt: skip
@options("json", "quiet", "log")
def theory(number: str | None, output: Path, json_file: str | None, quiet: bool) -> int:
    """In a clone: check Kikuchi's statements: claimed, observed, and a verdict.

    NO is the number of a theorem, example or equation, such as 3.3 or 5.5. Without it all are checked. The verdict
    FAILS means exit status 3.
    """
    from fenicsx_obstacle.checkout import add_tests

    add_tests("theory")
    from tests.theory.show import show_theory

    rows = rows_of(partial(show_theory, number, output), "theory", output, json_file, quiet=quiet)
    return 3 if any(row["verdict"] == "FAILS" for row in rows) else 0


@commands.command()
@click.argument("name", metavar="[NAME]", required=False)
@click.option("--random", "count", type=click.IntRange(1), metavar="N", help="Instead: N random scenes.")
@click.option("--truths", is_flag=True, help="With --random: only scenes whose true error is known; a table of bounds.")
@click.option("--broken", is_flag=True, help="Instead: invalid input of every kind, and its messages.")
@click.option("--faults", is_flag=True, help="Instead: killed processes, full disks, problems without solution.")
@click.option("--output", type=Place(), default=Path("out/hard"), metavar="DIR",
              help="Folder for JSON lines and tables.  [out/hard]")  # fmt: skip
@options("seed", "json", "quiet", "log")
def hard(
    name: str | None, count: int | None, truths: bool, seed: int | None, broken: bool, faults: bool, output: Path,
    json_file: str | None, quiet: bool,
) -> int:  # fmt: skip
    """In a clone: solve hard scenes, and check every result against the theory.

    NAME is a scene or a family; without it all are solved. With --random it is a family of random scenes. Verdicts:
    right, rejected or FAILED; the last one means exit status 3. Random scenes that are finished are kept: the same
    command continues.
    """
    from fenicsx_obstacle.checkout import add_tests

    add_tests("hard")
    from tests.cli.show import show_broken, show_faults
    from tests.hard.show import show_hard
    from tests.random.show import show_random

    if (name is not None or count is not None) + broken + faults > 1 or (
        count is None and (truths or seed is not None)
    ):
        raise InputError("hard: --broken and --faults exclude NAME, --random and each other; --seed and --truths go "
                         "with --random")  # fmt: skip
    if broken or faults:
        run = partial(show_broken if broken else show_faults, output)
    elif count is not None:
        run = partial(show_random, count, output, seed=seed, truths=truths, family=name)
    else:
        run = partial(show_hard, name, output)
    rows = rows_of(run, "hard", output, json_file, quiet=quiet)
    return 3 if any(row["verdict"] == "FAILED" for row in rows) else 0


@commands.command()
@click.option("--output", type=Place(), default=Path("out/demo"), metavar="DIR",
              help="Folder for results.  [out/demo]")  # fmt: skip
def demo(output: Path) -> None:
    """In a clone: solve scenes of demos/ and draw studies in eps and h."""
    from fenicsx_obstacle.checkout import DEMOS, require

    require("demo")
    from fenicsx_obstacle.answers.solve import solve
    from fenicsx_obstacle.show.report import report_answer
    from fenicsx_obstacle.show.study import report_study
    from fenicsx_obstacle.studies.convergence import Study
    from fenicsx_obstacle.text import title_of

    studies: list[tuple[str, str, dict[str, Any], dict[str, Any]]] = [
        ("disk", "h fixed: u_eps tends to the solution of the variational inequality with order eps",
         {"eps": [10.0**-k for k in range(1, 11)]}, {"cells": 64}),
        ("disk", "eps = h^2: order 1 in H1, and at least 1 for the pressure in the dual norm",
         {"cells": [16, 32, 64, 128]}, {"eps": "h^2"}),
        ("ball", "eps = h^2 again, on Bueler's ball", {"cells": [16, 32, 64, 128]}, {"eps": "h^2"}),
    ]  # fmt: skip
    with progress("demo", quiet=False):
        for name in ("string", "disk", "ball", "two_sided"):
            answer = solve(DEMOS / f"{name}.toml")
            answer.save(output / name)
            _, drawn = report_answer(answer, output / name, picture=True)
            tell(f"{answer.summary()}\n  {drawn}\n")
        for name, headline, vary, options in studies:
            scene = _read(str(DEMOS / f"{name}.toml"), {})
            tell(f"{title_of(scene.tables.title, scene.name)}. {headline}")
            report_study(Study(scene, vary, options), output / name / "-".join(vary), tell)
            tell("")


def _read(place: str, options: dict[str, Any]) -> Any:
    from fenicsx_obstacle.scenes.catalogue import changed

    return changed(place, options)

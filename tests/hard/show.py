"""Output of `hard`: a line for each finished scene, counts of verdicts, tables."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.safe_writing import write_lines, write_text
from fenicsx_obstacle.text import counted
from tests.hard.cases import Case, cases, named
from tests.hard.judge import EPS, METHODS
from tests.hard.row import FAILED, REJECTED, RIGHT, Row
from tests.hard.suite import one_rank, run

LINES, TABLES = "hard.jsonl", "tables.md"
HEADS = ("scene", "difficulty", "unknowns", "maximum principle", "steps: VI, penalty, (3.4)*", "penetration",
         "energy", "p at 1e-14", "p from u", "meshes", "verdicts")  # fmt: skip
LEGEND = (
    "maximum principle: whether it holds on the finer mesh; steps: most Newton steps on the finest level; penetration\n"
    "over eps max|p_h|, energy a(e, e) over eps/4 ||p_h||_I^2: at most 1 by theory; p: its error over max|p_h|;\n"
    "meshes: change of the contact force from the coarser mesh to the finer one."
)
RESOLVED = 0.1  # change of the contact force from one mesh to the next


class Summary(NamedTuple):
    """Of one scene.

    Attributes:
        case: The scene.
        verdicts: How often each was given.
        moved: Largest relative change of the contact force between the meshes, by SNES VI; None without force.
        cells: Of its row of the table.
    """

    case: Case
    verdicts: Counter[str]
    moved: float | None
    cells: list[str]


def show_hard(name: str | None, folder: Path, say: Callable[[str], None]) -> list[Row]:
    """Run the suite, or a part of it, on one rank; its children have ranks of their own.

    Args:
        name: Of a scene or a family; None for all.
        folder: Where JSON lines and tables go.
        say: Takes text.

    Returns:
        The rows.

    Raises:
        InputError: If there is neither, or on several ranks.
    """
    one_rank()
    start, comm = time.perf_counter(), MPI.COMM_WORLD
    summaries: list[Summary] = []
    found: list[Row] = []
    wanted = cases() if name is None else named(name)
    width = max(len(one.name) for one in wanted)
    say(_line(HEADS, width))
    for one, rows in run(wanted):
        summaries.append(summary_of(one, rows))
        found += rows
        on_root(comm, write_lines, folder / LINES, found)
        say(_line(summaries[-1].cells, width))
        for row in rows:
            if row["verdict"] == FAILED:
                which = [f"{key} {row[key]}" for key in ("method", "asked", "trial", "mesh") if row.get(key)]
                say(f"    {', '.join(which)} FAILED: {row['message']}")
    on_root(comm, write_text, folder / TABLES, markdown(summaries))
    say(f"\n{LEGEND}\n\n{counts(summaries, time.perf_counter() - start)}")
    say(f"  {folder}: {LINES}, {TABLES}")
    return found


def counts(summaries: Sequence[Summary], seconds: float) -> str:
    """The verdicts, counted, and what the meshes do not resolve."""
    count = sum((one.verdicts for one in summaries), Counter[str]())
    parts = ", ".join(f"{count[verdict]} {verdict}" for verdict in (RIGHT, REJECTED, FAILED))
    lines = [f"{counted(len(summaries), 'scene')}, {counted(count.total(), 'answer')}: {parts}; {seconds / 60:.1f} min"]
    coarse = [f"{one.case.name} ({one.moved:.0%})" for one in summaries if (one.moved or 0.0) > RESOLVED]
    if coarse:
        lines.append(f"right for their meshes, which do not resolve the contact force: {', '.join(coarse)}")
    return "\n".join(lines)


def markdown(summaries: Sequence[Summary]) -> str:
    """One table for each family, as docs/tables/hard_scenes.md has them."""
    lines = []
    for family in dict.fromkeys(one.case.family for one in summaries):
        lines += ["", f"### {family[0].upper()}{family[1:]}", "", _row(HEADS), _row(["---"] * len(HEADS))]
        lines += [_row(one.cells) for one in summaries if one.case.family == family]
    return "\n".join(lines[1:]) + "\n"


def summary_of(case: Case, rows: Sequence[Row]) -> Summary:
    """The summary of one scene from its rows."""
    count = Counter(row["verdict"] for row in rows)
    few = [f"{count[verdict]} {verdict}" for verdict in (REJECTED, FAILED) if count[verdict]]
    verdicts = ", ".join(["right", *few]) if count[RIGHT] else ", ".join(few) if count[FAILED] else REJECTED
    solved = [row for row in rows if row.get("dofs") and not row["trial"]]
    fine = [row for row in solved if row["mesh"] == case.meshes[1]]
    if not fine:
        return Summary(case, count, None, [case.name, case.hard, *[""] * (len(HEADS) - 3), verdicts])
    steps = [
        str(max((row["newton_iterations"] for row in solved if row["method"] == method), default="-"))
        for method in ("vi", *METHODS)
    ]
    work = _most(_ratios(solved, "penalty and inequality: energy norm"))
    small = [row["digits"] for row in solved if row["asked"] == EPS[-2] and row.get("digits")]
    numbers = [
        _most(_ratios(solved, "penetration")), None if work is None else work**2,
        *(_most(digits.get(key) for digits in small) for key in ("off", "from_heights")),
    ]  # fmt: skip
    moved = _moved(case, solved)
    return Summary(case, count, moved, [
        case.name, case.hard, str(fine[0]["dofs"]), "holds" if fine[0]["monotone"] else "-", ", ".join(steps),
        *("" if value is None else f"{value:.2g}" for value in numbers), "" if moved is None else f"{moved:.1%}",
        verdicts,
    ])  # fmt: skip


def _ratios(rows: Sequence[Row], name: str) -> list[float]:
    """Observed over limit where eps is so large that solvers' accuracy is no part of the limit."""
    found = [one for row in rows if (row["eps"] or 0.0) >= 1e-7 for one in row["findings"] if one["name"] == name]
    return [one["observed"] / one["limit"] for one in found if one["observed"] is not None and one["limit"]]


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _moved(case: Case, rows: Sequence[Row]) -> float | None:
    """Contact forces of the two meshes, by the inequality."""
    forces: list[dict[str, float]] = []
    for mesh in case.meshes:
        for row in rows:
            if row["mesh"] == mesh and row["method"] == "vi":
                contact = row["contact"]
                forces.append({side: contact[side]["force"] for side in ("lower", "upper") if side in contact})
    if len(forces) < 2 or max(forces[1].values(), default=0.0) <= 0.0:
        return None
    size = max(forces[1].values())
    return max(abs(forces[0][side] - forces[1][side]) for side in forces[1]) / size


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def _line(cells: Sequence[str], width: int) -> str:
    """Without the difficulty; as wide as the heads."""
    name, _, *others = cells
    return "  ".join([name.ljust(width), *map(str.rjust, others, map(len, HEADS[2:]))]).rstrip()

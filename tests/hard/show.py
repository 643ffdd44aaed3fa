"""Output of `hard`: a line for each finished scene, counts of verdicts, tables."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.safe_writing import write_lines, write_text
from fenicsx_obstacle.text import counted
from tests.hard.cases import cases, named
from tests.hard.judge import METHODS
from tests.hard.row import FAILED, REJECTED, RIGHT, Row
from tests.hard.suite import one_rank, run
from tests.hard.summary import RESOLVED, Summary, figures_of

LINES, TABLES = "hard.jsonl", "tables.md"
HEADS = ("scene", "family", "right", "rejected", "FAILED", "VI", "penalty", "(3.4)*", "maximum", "meshes", "s")
LEGEND = (
    "VI, penalty, (3.4)*: most Newton steps on the finest level; maximum: whether its principle holds for the matrix;\n"
    "meshes: change of the contact force from the coarser mesh to the finer one; s: seconds of all its processes."
)
MARKDOWN = ("scene", "difficulty", "unknowns", "maximum principle", "steps: VI, penalty, (3.4)*", "penetration",
            "energy", "p at 1e-14", "p from u", "meshes", "verdicts")  # fmt: skip


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
    all_figures: list[Summary] = []
    found: list[Row] = []
    wanted = cases() if name is None else named(name)
    widths = [max(len(getattr(one, key)) for one in wanted) for key in ("name", "family")]
    say(_line(HEADS, widths))
    for one, rows in run(wanted):
        all_figures.append(figures_of(one, rows))
        found += rows
        on_root(comm, write_lines, folder / LINES, found)
        say(_line(_cells(all_figures[-1]), widths))
        for row in rows:
            if row["verdict"] == FAILED:
                say(f"    {_which(row)} FAILED: {row['message']}")
    on_root(comm, write_text, folder / TABLES, markdown(all_figures))
    say(f"\n{LEGEND}\n\n{summary(all_figures, time.perf_counter() - start)}")
    say(f"  {folder}: {LINES}, {TABLES}")
    return found


def summary(all_figures: Sequence[Summary], seconds: float) -> str:
    """The verdicts, counted, what waits, and what the meshes do not resolve."""
    count: Counter[str] = Counter()
    for figures in all_figures:
        count += figures.verdicts
    parts = ", ".join(f"{count[verdict]} {verdict}" for verdict in (RIGHT, REJECTED, FAILED))
    lines = [
        f"{counted(len(all_figures), 'scene')}, {counted(count.total(), 'answer')}: {parts}; {seconds / 60:.1f} min"
    ]
    coarse = [figures for figures in all_figures if (figures.moved or 0.0) > RESOLVED]
    if coarse:
        names = ", ".join(f"{figures.case.name} ({figures.moved:.0%})" for figures in coarse)
        lines.append(f"right for their meshes, which do not resolve the contact force: {names}")
    return "\n".join(lines)


def markdown(all_figures: Sequence[Summary]) -> str:
    """One table for each family, as docs/tables/hard_scenes.md has them."""
    lines = []
    for family in dict.fromkeys(figures.case.family for figures in all_figures):
        lines += ["", f"### {family[0].upper()}{family[1:]}", "", _row(MARKDOWN), _row(["---"] * len(MARKDOWN))]
        lines += [_row(_described(figures)) for figures in all_figures if figures.case.family == family]
    return "\n".join(lines[1:]) + "\n"


def _described(figures: Summary) -> list[str]:
    one = figures.case
    verdicts = _verdicts(figures)
    if figures.unknowns is None:
        return [one.name, one.hard, *[""] * (len(MARKDOWN) - 3), verdicts]
    steps = ", ".join(str(figures.steps.get(method, "-")) for method in ("vi", *METHODS))
    numbers = [_number(value) for value in (figures.penetration, figures.work, figures.off, figures.plain)]
    return [one.name, one.hard, str(figures.unknowns), "holds" if figures.monotone else "-", steps, *numbers,
            _share(figures.moved), verdicts]  # fmt: skip


def _verdicts(figures: Summary) -> str:
    """Whether all have the same result, or how many were rejected or have failed."""
    count = figures.verdicts
    few = [f"{count[verdict]} {verdict}" for verdict in (REJECTED, FAILED) if count[verdict]]
    if not count[RIGHT]:
        return ", ".join(few) if count[FAILED] else REJECTED
    return ", ".join(["right", *few])


def _cells(figures: Summary) -> tuple[Any, ...]:
    one, count = figures.case, figures.verdicts
    steps = [figures.steps.get(method) or "" for method in ("vi", *METHODS)]
    maximum = {True: "yes", False: "no", None: ""}[figures.monotone]
    counts = [count[verdict] for verdict in (RIGHT, REJECTED, FAILED)]
    return one.name, one.family, *counts, *steps, maximum, _share(figures.moved), f"{figures.seconds:.1f}"


def _which(row: Row) -> str:
    eps = row.get("asked")
    parts = (row.get("method"), None if eps is None else f"eps = {eps}", row.get("trial"), f"mesh {row.get('mesh')}")
    return ", ".join(part for part in parts if part)


def _share(value: float | None) -> str:
    return "" if value is None else f"{value:.1%}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def _line(cells: Sequence[Any], widths: Sequence[int]) -> str:
    texts = [str(cell).ljust(width) for cell, width in zip(cells[:2], widths, strict=True)]
    return "  ".join([*texts, *(str(cell).rjust(7) for cell in cells[2:])]).rstrip()

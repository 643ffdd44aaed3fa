"""What `hard` shows: a line for each scene as it is finished, the verdicts counted, JSON lines."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import on_root, write_text
from fenicsx_obstacle.scenes.hard import Case, case, cases
from fenicsx_obstacle.studies.hard.judge import FAILED, REFUSED, RIGHT, Row
from fenicsx_obstacle.studies.hard.suite import run
from fenicsx_obstacle.words import counted

LINES = "hard.jsonl"
HEADS = ("scene", "family", "answers", "right", "refused", "FAILED", "Newton", "s")


def show_hard(name: str | None, folder: Path, say: Callable[[str], None]) -> list[Row]:
    """Run the suite, or one of its scenes, on one rank; its children have ranks of their own.

    Args:
        name: Of the scene; None for all.
        folder: Where JSON lines and pictures go.
        say: Takes text.

    Returns:
        The rows.

    Raises:
        InputError: If there is no such scene, or on several ranks.
    """
    if MPI.COMM_WORLD.size > 1:
        raise InputError("hard starts processes of its own, also on several ranks: run it on one")
    start, rows = time.perf_counter(), []
    wanted = cases() if name is None else (case(name),)
    widths = [max(len(getattr(one, key)) for one in wanted) for key in ("name", "family")]
    say(_line(HEADS, widths))
    for one, found in run(wanted):
        rows += found
        say(_line(_cells(one, found), widths))
        for row in found:
            if row["verdict"] == FAILED:
                say(f"    {row.get('method', '')} {row.get('asked', '')} FAILED: {row['message']}")
    on_root(MPI.COMM_WORLD, write_text, folder / LINES, "".join(json.dumps(row) + "\n" for row in rows))
    say(summary(wanted, rows, time.perf_counter() - start))
    return rows


def summary(wanted: Sequence[Case], rows: Sequence[Row], seconds: float) -> str:
    """The verdicts, counted."""
    count, later = Counter(row["verdict"] for row in rows), [one for one in wanted if one.awaits]
    parts = ", ".join(f"{count[verdict]} {verdict}" for verdict in (RIGHT, REFUSED, FAILED))
    lines = [f"\n{counted(len(wanted) - len(later), 'scene')}, {counted(len(rows), 'row')}: {parts}; {seconds:.0f} s"]
    lines += [f"not solved: {one.name} awaits {one.awaits}" for one in later]
    return "\n".join(lines)


def _cells(one: Case, rows: Sequence[Row]) -> tuple[Any, ...]:
    if one.awaits:
        return one.name, one.family, "", "", "", "", "", ""
    count = Counter(row["verdict"] for row in rows)
    newton = max((row.get("newton_iterations", 0) for row in rows), default=0)
    seconds = sum(row.get("seconds", 0.0) for row in rows)
    return one.name, one.family, len(rows), count[RIGHT], count[REFUSED], count[FAILED], newton, f"{seconds:.1f}"


def _line(cells: Sequence[Any], widths: Sequence[int]) -> str:
    texts = [str(cell).ljust(width) for cell, width in zip(cells[:2], widths, strict=True)]
    return "  ".join([*texts, *(str(cell).rjust(7) for cell in cells[2:])]).rstrip()

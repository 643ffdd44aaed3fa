"""What `hard --random` shows: scenes that did not hold, and how many were tried and held."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

from fenicsx_obstacle.parallel import on_root, write_lines
from fenicsx_obstacle.studies.hard.draw import SEED, run
from fenicsx_obstacle.studies.hard.row import FAILED, Row
from fenicsx_obstacle.studies.hard.suite import one_rank
from fenicsx_obstacle.studies.processes import clean

LINES = "random.jsonl"


def show_random(count: int, folder: Path, say: Callable[[str], None], seed: int | None = None) -> list[Row]:
    """Judge so many random scenes, on one rank.

    Args:
        count: How many.
        folder: Where JSON lines go: each scene with what was found.
        say: Takes text.
        seed: Of the drawing; by default the same scenes every time.

    Returns:
        The rows.

    Raises:
        InputError: On several ranks, or without Hypothesis.
    """
    one_rank()
    seed = SEED if seed is None else seed
    start, rows = time.perf_counter(), []
    for row in run(count, clean(), seed):
        rows.append(row)
        if row["verdict"] == FAILED:
            again = row["text"].strip().replace("\n", "\n    ")
            say(f"  FAILED: {row['family']}: {row['message']}\n    {again}")
    on_root(MPI.COMM_WORLD, write_lines, folder / LINES, rows)
    failed = sum(row["verdict"] == FAILED for row in rows)
    kinds = Counter(row["family"] for row in rows)
    lost = Counter(row["family"] for row in rows if row["verdict"] == FAILED)
    say("scenes: " + ", ".join(f"{number} {kind}" + (f" ({lost[kind]} FAILED)" if lost[kind] else "")
                               for kind, number in kinds.most_common()))  # fmt: skip
    answers, refused = (sum(row[key] for row in rows) for key in ("answers", "refused"))
    say(f"random scenes: {len(rows)} tried, {len(rows) - failed} held; {answers} answers, {refused} rejections; "
        f"seed {seed}; {time.perf_counter() - start:.0f} s; scenes in {folder / LINES}")  # fmt: skip
    return rows

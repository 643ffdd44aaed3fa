"""Output of `hard --random`: failed scenes, counts, and bounds with true errors."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from statistics import median

from mpi4py import MPI

from fenicsx_obstacle.launcher import environment
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.safe_writing import write_lines
from fenicsx_obstacle.studies.rows import RowStore
from fenicsx_obstacle.text import columns
from tests.hard.row import FAILED, Row
from tests.hard.suite import one_rank
from tests.random.draw import SEED, run, shares

LINES = "random.jsonl"
RESOLVED = 1e-9  # of the norm of u: smaller errors are round-off
HEADS = ("family", "scenes", "certified", "polygon", "sampled", "indicator", "no bound", "false", "below", "median",
         "largest")  # fmt: skip
LEGEND = (
    "certified; on the polygon of the mesh; for sampled data; an indicator: words of the bounds\n"
    "false: of the first two those below the true error; below: of the others\n"
    f"median, largest: bound over true error, where this is above {RESOLVED:g} of the norm of u"
)


def show_random(
    count: int, folder: Path, say: Callable[[str], None], seed: int | None = None, *, truths: bool = False,
    family: str | None = None,
) -> list[Row]:  # fmt: skip
    """Judge so many random scenes, on one rank.

    Args:
        count: How many.
        folder: Where JSON lines go: each scene with what was found.
        say: Takes text.
        seed: Of the drawing; by default the same scenes every time.
        truths: Whether only scenes whose true error is known; then a table shows the bounds of each family.
        family: Whether only scenes of this one.

    Returns:
        The rows.

    Raises:
        InputError: On several ranks, or without Hypothesis.
    """
    one_rank()
    seed = SEED if seed is None else seed
    start, rows = time.perf_counter(), []
    counts = shares(count, truths=truths, family=family)
    with closing(RowStore(folder)) as store:
        for row in run(counts, environment(), seed, store):
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
    if truths:
        say(table(rows))
    answers, rejected = (sum(row[key] for row in rows) for key in ("answers", "rejected"))
    say(f"random scenes: {len(rows)} tried, {len(rows) - failed} held; {answers} answers, {rejected} rejections; "
        f"seed {seed}; {time.perf_counter() - start:.0f} s; scenes in {folder / LINES}")  # fmt: skip
    return rows


def table(rows: Sequence[Row]) -> str:
    """The bounds of each family and their true errors."""
    families = dict.fromkeys(row["family"] for row in rows)
    lines = [_line(name, [row for row in rows if row["family"] == name]) for name in families]
    return "\n".join([*columns([HEADS, *lines, _line("all", rows)]), LEGEND])


def _line(name: str, rows: Sequence[Row]) -> tuple[str, ...]:
    bounds = [bound for row in rows for bound in row["bounds"]]
    kinds = Counter(_kind(bound["words"]) for bound in bounds)
    false, below = (
        sum(bound["below"] and bound["claimed"] == claimed for bound in bounds) for claimed in (True, False)
    )
    ratios = [bound["total"] / bound["error"] for bound in bounds if bound["error"] > RESOLVED * bound["norm"]]
    effectivity = (f"{median(ratios):.2f}", f"{max(ratios):.3g}") if ratios else ("", "")
    none = sum(not row["bounds"] for row in rows)
    counts = (len(rows), *(kinds[kind] for kind in HEADS[2:6]), none, false, below)
    return name, *map(str, counts), *effectivity


def _kind(words: str) -> str:
    """The column that the words of a bound go into."""
    if words.startswith("an indicator"):
        return "indicator"
    if "sampled" in words:
        return "sampled"
    return "certified" if words == "certified" else "polygon"

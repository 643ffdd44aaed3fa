"""Output of `hard --broken`: failed cases, the slowest ones, and counts."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.launcher import environment
from fenicsx_obstacle.parallel import on_root, write_lines
from tests.cli.broken.run import run
from tests.hard.suite import one_rank

LINES = "broken.jsonl"


def show_broken(folder: Path, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Try all broken input, on one rank; its children have ranks of their own.

    Args:
        folder: Where JSON lines go: each case with its message.
        say: Takes text.

    Returns:
        The cases, with the verdict `held` or FAILED.

    Raises:
        InputError: On several ranks.
    """
    one_rank()
    start, rows = time.perf_counter(), []
    tried, held, slowest = Counter[tuple[int, bool]](), Counter[tuple[int, bool]](), 0.0
    with tempfile.TemporaryDirectory(prefix="broken-") as root:
        for one in run(Path(root), environment()):
            group = one.ranks, one.alone
            tried[group] += 1
            held[group] += one.complaint is None
            slowest = max(slowest, one.seconds)
            rows.append({"case": one.case.name, "command": one.case.command(), "ranks": one.ranks, "alone": one.alone,
                         "seconds": one.seconds, "verdict": "held" if one.complaint is None else "FAILED",
                         "message": one.said, "complaint": one.complaint})  # fmt: skip
            if one.complaint is not None:
                say(f"  {one.case.name}, on {one.ranks}: FAILED: {one.complaint}: {one.said.strip()[-300:]}")
    on_root(MPI.COMM_WORLD, write_lines, folder / LINES, rows)
    for (ranks, alone), count in sorted(tried.items()):
        how = "each in a process of its own" if alone else "one after another in one process"
        say(f"on {ranks} rank{'s' if ranks > 1 else ''}, {how}: {count} tried, {held[ranks, alone]} held")
    say(f"broken input: {tried.total()} tried, {held.total()} held; the slowest refusal took {slowest:.1f} s; "
        f"{time.perf_counter() - start:.0f} s; messages in {folder / LINES}")  # fmt: skip
    return rows

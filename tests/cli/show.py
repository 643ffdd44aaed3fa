"""Output of `hard --broken` and `hard --faults`: what failed, and counts."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.launcher import environment
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.safe_writing import write_lines
from tests.cli.broken.run import run
from tests.cli.faults.disk import disks
from tests.cli.faults.kill import Fault, interrupts, kills
from tests.hard.suite import one_rank
from tests.processes import launch_module, records

BROKEN, FAULTS = "broken.jsonl", "faults.jsonl"
ROUNDS = {1: 8, 2: 6, 3: 4}  # how often studies are killed, by ranks


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
    with tempfile.TemporaryDirectory(prefix="broken-") as root:
        for row in run(Path(root), environment()):
            rows.append(row)
            if row["complaint"] is not None:
                say(f"  {row['case']}, on {row['ranks']}: FAILED: {row['complaint']}: {row['message'].strip()[-300:]}")
    on_root(MPI.COMM_WORLD, write_lines, folder / BROKEN, rows)
    tried = Counter((row["ranks"], row["alone"]) for row in rows)
    held = Counter((row["ranks"], row["alone"]) for row in rows if row["verdict"] == "held")
    slowest = max((row["seconds"] for row in rows), default=0.0)
    for (ranks, alone), count in sorted(tried.items()):
        how = "each in a process of its own" if alone else "one after another in one process"
        say(f"on {ranks} rank{'s' if ranks > 1 else ''}, {how}: {count} tried, {held[ranks, alone]} held")
    say(f"broken input: {tried.total()} tried, {held.total()} held; the slowest refusal took {slowest:.1f} s; "
        f"{time.perf_counter() - start:.0f} s; messages in {folder / BROKEN}")  # fmt: skip
    return rows


def show_faults(folder: Path, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Break what can be broken, on one rank; its children have ranks of their own.

    Args:
        folder: Where JSON lines go.
        say: Takes text.

    Returns:
        The faults, with the verdict `held` or FAILED.

    Raises:
        InputError: On several ranks.
    """
    one_rank()
    start, rows = time.perf_counter(), []
    with tempfile.TemporaryDirectory(prefix="faults-") as root:
        for family, faults in _families(Path(root)):
            count, held = 0, 0
            for fault in faults:
                count, held = count + 1, held + (not fault.wrong)
                rows.append({"family": family, "fault": fault.name, "seconds": fault.seconds, "message": fault.wrong,
                             "verdict": "FAILED" if fault.wrong else "held"})  # fmt: skip
                if fault.wrong:
                    say(f"  {fault.name}: FAILED: {fault.wrong}")
            say(f"{family}: {count} tried, {held} held")
    on_root(MPI.COMM_WORLD, write_lines, folder / FAULTS, rows)
    failed = sum(row["verdict"] == "FAILED" for row in rows)
    say(f"faults: {len(rows)} tried, {len(rows) - failed} held; {time.perf_counter() - start:.0f} s; "
        f"all in {folder / FAULTS}")  # fmt: skip
    return rows


def _families(root: Path) -> Iterator[tuple[str, Iterator[Fault]]]:
    yield "solvers that cannot succeed", _silent()
    yield "full and locked disks", disks(root / "disks", environment())
    yield "Ctrl-C", interrupts(root / "interrupts", environment(), 3)
    yield "kills", kills(root / "kills", environment(), ROUNDS)


def _silent() -> Iterator[Fault]:
    """Traps for solvers, on one rank and on three."""
    for ranks in (1, 3):
        command = launch_module(ranks, "tests.hard.unsolvable")
        last, record = time.perf_counter(), dict[str, Any]()
        for record in records(command, environment(), 60.0):
            wrong = "" if record["held"] else record["said"]
            yield Fault(f"{record['name']}, on {ranks}", wrong, time.perf_counter() - last)
            last = time.perf_counter()
        if not record.get("last"):
            yield Fault(f"after {record.get('name')}, on {ranks}", "took the process down, or did not end", 0.0)

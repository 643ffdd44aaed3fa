"""Output of `hard --broken` and `hard --faults`: what failed, and counts."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.launcher import environment
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.safe_writing import write_lines
from tests.cli.broken.run import run
from tests.cli.faults.disk import disks
from tests.cli.faults.kill import Fault, interrupts, kills
from tests.hard.row import FAILED, Row
from tests.hard.suite import one_rank
from tests.processes import launch_module, records

BROKEN, FAULTS = "broken.jsonl", "faults.jsonl"
ROUNDS = {1: 8, 2: 6, 3: 4}  # how often studies are killed, by ranks


def show_broken(folder: Path, say: Callable[[str], None]) -> list[Row]:
    """Try all broken input, on one rank; its children have ranks of their own.

    Args:
        folder: Where JSON lines go: each case with its message.
        say: Takes text.

    Returns:
        The cases, with the verdict `held` or FAILED.

    Raises:
        InputError: On several ranks.
    """
    return _shown("broken input", run, folder / BROKEN, say)


def show_faults(folder: Path, say: Callable[[str], None]) -> list[Row]:
    """Break what can be broken: as `show_broken`."""
    return _shown("faults", _faults, folder / FAULTS, say)


def _shown(
    what: str, tried: Callable[[Path, dict[str, str]], Iterator[Row]], file: Path, say: Callable[[str], None]
) -> list[Row]:
    """Each that failed, counts of each group, and the sum of all."""
    one_rank()
    start, rows = time.perf_counter(), []
    with tempfile.TemporaryDirectory(prefix="broken-") as root:
        for row in tried(Path(root), environment()):
            rows.append(row)
            if row["verdict"] == FAILED:
                say(f"  {row['group']}: {row['case']}: FAILED: {row['complaint']}: {row['message'].strip()[-300:]}")
    on_root(MPI.COMM_WORLD, write_lines, file, rows)
    groups = Counter(row["group"] for row in rows)
    failed = Counter(row["group"] for row in rows if row["verdict"] == FAILED)
    for group, count in groups.items():
        say(f"{group}: {count} tried, {count - failed[group]} held")
    slowest = max((row["seconds"] for row in rows), default=0.0)
    say(f"{what}: {len(rows)} tried, {len(rows) - failed.total()} held; the slowest took {slowest:.1f} s; "
        f"{time.perf_counter() - start:.0f} s; all in {file}")  # fmt: skip
    return rows


def _faults(root: Path, environment: Mapping[str, str]) -> Iterator[Row]:
    for family, faults in _families(root, environment):
        for fault in faults:
            yield {"group": family, "case": fault.name, "seconds": fault.seconds, "complaint": fault.wrong,
                   "message": "", "verdict": FAILED if fault.wrong else "held"}  # fmt: skip


def _families(root: Path, environment: Mapping[str, str]) -> Iterator[tuple[str, Iterator[Fault]]]:
    yield "solvers that cannot succeed", _silent(environment)
    yield "full and locked disks", disks(root / "disks", environment)
    yield "Ctrl-C", interrupts(root / "interrupts", environment, 3)
    yield "kills", kills(root / "kills", environment, ROUNDS)


def _silent(environment: Mapping[str, str]) -> Iterator[Fault]:
    """Traps for solvers, on one rank and on three."""
    for ranks in (1, 3):
        command = launch_module(ranks, "tests.hard.unsolvable")
        last, record = time.perf_counter(), dict[str, Any]()
        for record in records(command, environment, 60.0):
            wrong = "" if record["held"] else record["said"]
            yield Fault(f"{record['name']}, on {ranks}", wrong, time.perf_counter() - last)
            last = time.perf_counter()
        if not record.get("last"):
            yield Fault(f"after {record.get('name')}, on {ranks}", "took the process down, or did not end", 0.0)

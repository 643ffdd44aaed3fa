"""The suite: each hard scene in separate processes, two scenes at a time.

Such a process is `[mpirun -n N] python -m tests.hard.suite NAME FILE`: on one rank rows go to standard output as JSON
lines; on any number of ranks the fields to compare go into the file.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.launcher import environment
from fenicsx_obstacle.parallel import abort_on_uncaught_errors
from tests.hard.cases import Case, case
from tests.hard.judge import METHODS, TRIAL, judge
from tests.hard.ranks import agree_on, fields_of
from tests.hard.row import FAILED, Row, judged_row
from tests.processes import end, launch_module, start, tell

AT_ONCE = 2
RANKS = (2, 3)
PATIENCE = 900.0  # seconds for one process; alone it takes some ten
LONGEST = 300  # characters of what a process has said


def one_rank() -> None:
    """Refuse to start processes of their own from each of several ranks.

    Raises:
        InputError: On several ranks.
    """
    if MPI.COMM_WORLD.size > 1:
        raise InputError("hard starts processes of its own, also on several ranks: run it on one")


def run(cases: Sequence[Case]) -> Iterator[tuple[Case, list[Row]]]:
    """Rows of each case, in the order of the list, as they are there (one rank)."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield from zip(cases, pool.map(rows_of, cases), strict=True)


def rows_of(one: Case) -> list[Row]:
    """The rows of a case: those its process wrote, and one for each number of ranks."""
    with tempfile.TemporaryDirectory(prefix="obstacle-") as folder:
        file = Path(folder) / "1.npz"
        text, trouble = _process(launch_module(1, "tests.hard.suite", one.name, str(file)))
        rows = [json.loads(line) for line in text.splitlines() if line.startswith("{")]
        if trouble:
            return [*rows, _lost(one, trouble)]
        return [*rows, *_on_ranks(one, file, Path(folder))] if one.compared else rows


def _on_ranks(one: Case, alone: Path, folder: Path) -> Iterator[Row]:
    for ranks in RANKS:
        began, file = time.perf_counter(), folder / f"{ranks}.npz"
        _, trouble = _process(launch_module(ranks, "tests.hard.suite", one.name, str(file)))
        if trouble:
            yield _lost(one, f"on {ranks} ranks {trouble}")
            continue
        with np.load(alone, allow_pickle=False) as first, np.load(file, allow_pickle=False) as second:
            for method in (name for name in ("vi", *METHODS) if f"{name}.p" in first):
                findings = agree_on(dict(first), dict(second), method)
                row = judged_row(one.base, method, None if method == "vi" else TRIAL, began, None, findings,
                                 f"{ranks} ranks")  # fmt: skip
                yield {"case": one.name, "family": one.family, "mesh": one.meshes[0], **row,
                       "seconds": row["seconds"] / (1 + len(METHODS))}  # fmt: skip


def _process(command: Sequence[str]) -> tuple[str, str]:
    """What a process wrote, and in words what went wrong with it."""
    try:
        process = start(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    except OSError as error:
        return "", f"its process could not be started: {error.strerror}"
    try:
        text, said = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        end(process)
        return process.communicate()[0], f"its process took more than {PATIENCE:.0f} s"
    finally:
        end(process)
    return text, f"its process ended with status {process.returncode}: {reason(said)}" if process.returncode else ""


def reason(said: str) -> str:
    """What a process has said of its end: the last line that names an error, or else the first words."""
    lines = [line.strip() for line in said.splitlines()]
    named = [line for line in lines if "Error" in line or "rror:" in line]
    return (named[-1] if named else " ".join(line for line in lines if line.strip("-")))[:LONGEST]


def _lost(one: Case, message: str) -> Row:
    return {
        "case": one.name, "family": one.family, "mesh": None, "method": "", "asked": None, "trial": "",
        "verdict": FAILED, "message": message, "findings": [],
    }  # fmt: skip


def main() -> None:
    """Judge both meshes of the case named on the command line, and write the fields of its coarse mesh (collective)."""
    comm, one = MPI.COMM_WORLD, case(sys.argv[1])
    abort_on_uncaught_errors(comm)
    for mesh, value in enumerate(one.meshes if comm.size == 1 else ()):
        units = mesh == 0 and not one.refuse
        for row in judge(one.on(mesh), refuse=one.refuse, known=one.known, starts=True, units=units):
            tell({"case": one.name, "family": one.family, "mesh": value, **row})
    if one.compared:
        found = fields_of(one.on(0), comm)
        if comm.rank == 0:
            np.savez(Path(sys.argv[2]), **found)


if __name__ == "__main__":
    main()

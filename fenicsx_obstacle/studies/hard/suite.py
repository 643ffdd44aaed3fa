"""The suite: each hard scene in processes of its own, two scenes at a time, so that none takes another down with it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.accuracy.invariants import violated
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.hard import Case
from fenicsx_obstacle.studies.hard.judge import METHODS, TRIAL
from fenicsx_obstacle.studies.hard.ranks import agree_on
from fenicsx_obstacle.studies.hard.row import FAILED, RIGHT, Row

AT_ONCE = 2
RANKS = (2, 3)
PATIENCE = 900.0  # seconds for one process; alone it takes some ten
MODULES = "fenicsx_obstacle.studies.hard"
# what our own MPI has put into the environment would confuse the MPI of a child
_MPI = ("OMPI_COMM", "OMPI_ARGV", "OMPI_APP", "OMPI_COMMAND", "PMIX", "PRTE", "PMI_")


def clean() -> dict[str, str]:
    """The environment without what an MPI process finds in it; choices for MPI itself stay."""
    return {key: value for key, value in os.environ.items() if not key.startswith(_MPI)}


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
        text, trouble = _process([sys.executable, "-m", f"{MODULES}.one", one.name, str(file)])
        rows = [json.loads(line) for line in text.splitlines() if line.startswith("{")]
        if trouble:
            return [*rows, _lost(one, trouble)]
        return [*rows, *_on_ranks(one, file, Path(folder))] if one.compared else rows


def _on_ranks(one: Case, alone: Path, folder: Path) -> Iterator[Row]:
    for ranks in RANKS:
        start, file = time.perf_counter(), folder / f"{ranks}.npz"
        mpirun = ["mpirun", "-n", str(ranks), "--oversubscribe", "--bind-to", "none"]
        _, trouble = _process([*mpirun, sys.executable, "-m", f"{MODULES}.ranks", one.name, str(file)])
        if trouble:
            yield _lost(one, f"on {ranks} ranks {trouble}")
            continue
        with np.load(alone) as first, np.load(file) as second:
            for method in ("vi", *METHODS):
                findings = agree_on(dict(first), dict(second), method)
                wrong = violated(findings)
                yield {
                    "case": one.name, "family": one.family, "mesh": one.meshes[0], "scene": one.name, "method": method,
                    "asked": None if method == "vi" else TRIAL, "trial": f"{ranks} ranks",
                    "verdict": FAILED if wrong else RIGHT, "message": "; ".join(map(str, wrong)),
                    "seconds": (time.perf_counter() - start) / (1 + len(METHODS)),
                    "findings": [finding.record for finding in findings],
                }  # fmt: skip


def _process(command: Sequence[str]) -> tuple[str, str]:
    """What a process wrote, and in words what went wrong with it."""
    try:
        done = subprocess.run(command, env=clean(), capture_output=True, text=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired as late:
        text = late.stdout.decode() if isinstance(late.stdout, bytes) else late.stdout or ""
        return text, f"its process took more than {PATIENCE:.0f} s"
    except OSError as error:
        return "", f"its process could not be started: {error.strerror}"
    last = [line for line in done.stderr.strip().splitlines() if "Error" in line or "rror:" in line][-1:]
    return done.stdout, f"its process ended with status {done.returncode}: {''.join(last)}" if done.returncode else ""


def _lost(one: Case, message: str) -> Row:
    return {
        "case": one.name, "family": one.family, "mesh": None, "method": "", "asked": None, "trial": "",
        "verdict": FAILED, "message": message, "findings": [],
    }  # fmt: skip

"""The suite: each hard scene in a process of its own, two at a time, so that none takes another down with it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

from fenicsx_obstacle.scenes.hard import Case
from fenicsx_obstacle.studies.hard.judge import FAILED, Row

AT_ONCE = 2
PATIENCE = 300.0  # seconds for one scene
WORKER = (sys.executable, "-m", "fenicsx_obstacle.studies.hard.one")
# what our own MPI has put into the environment would confuse the MPI of a child
_MPI = ("OMPI_COMM", "OMPI_ARGV", "OMPI_APP", "OMPI_COMMAND", "PMIX", "PRTE", "PMI_")


def clean() -> dict[str, str]:
    """The environment without what an MPI process finds in it; choices for MPI itself stay."""
    return {key: value for key, value in os.environ.items() if not key.startswith(_MPI)}


def run(cases: Sequence[Case]) -> Iterator[tuple[Case, list[Row]]]:
    """Rows of each case, in the order of the list, as they are there (one rank)."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield from zip(cases, pool.map(rows_of, cases), strict=True)


def rows_of(one: Case) -> list[Row]:
    """The rows that the process of a case wrote, and one more if it did not end well; none for what is awaited."""
    if one.awaits:
        return []
    try:
        done = subprocess.run([*WORKER, one.name], env=clean(), capture_output=True, text=True, timeout=PATIENCE,
                              check=False)  # fmt: skip
    except subprocess.TimeoutExpired as late:
        text = late.stdout.decode() if isinstance(late.stdout, bytes) else late.stdout or ""
        return [*_lines(text), _lost(one, f"took more than {PATIENCE:.0f} s")]
    rows = _lines(done.stdout)
    if done.returncode != 0:
        last = "".join(done.stderr.strip().splitlines()[-1:])
        rows.append(_lost(one, f"its process ended with status {done.returncode}: {last}"))
    return rows


def _lines(text: str) -> list[Row]:
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


def _lost(one: Case, message: str) -> Row:
    return {"case": one.name, "family": one.family, "verdict": FAILED, "message": message, "findings": []}

"""Runs all cases on one rank and on three: some in separate processes, all of them in one process."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fenicsx_obstacle.text import counted
from tests.cli.broken.case import LIMIT, Broken, complaint, time_limit
from tests.cli.broken.collection import collect, prepare
from tests.hard.row import FAILED, Row
from tests.processes import end, launch, launch_module, records, start

EVERY = {1: 8, 3: 24}  # which cases have processes of their own: each so manyth, and what only a process can show
AT_ONCE = {1: 2, 3: 1}
PATIENCE = 12 * LIMIT  # seconds after which a process is ended


def run(root: Path, environment: Mapping[str, str], ranks: Sequence[int] = (1, 3)) -> Iterator[Row]:
    """All cases on each number of ranks, a row for each (one rank).

    Args:
        root: An empty folder.
        environment: Of the processes.
        ranks: Numbers of ranks.
    """
    prepare(root, environment)
    cases = collect(root)
    for count in ranks:
        apart = [k for k, case in enumerate(cases) if case.petsc or k % EVERY[count] == 0]
        with ThreadPoolExecutor(AT_ONCE[count]) as pool:
            started = [pool.submit(_alone, root, cases[k], k, count, environment) for k in apart]
            yield from (one.result() for one in started)
        within = [k for k, case in enumerate(cases) if not case.petsc]
        while within:
            for row, number in _within(root, cases, within, count, environment):
                yield row
                within = within[within.index(number) + 1 :]


def _alone(root: Path, case: Broken, number: int, ranks: int, environment: Mapping[str, str]) -> Row:
    folder = root / f"alone-{ranks}" / str(number)
    case.lay_out(folder)
    command = launch(ranks, "-m", "fenicsx_obstacle", *case.command())
    began = time.perf_counter()
    process = start(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        said, status = process.communicate(timeout=PATIENCE)[1], process.returncode
    except subprocess.TimeoutExpired:
        said, status = "", None
    finally:
        end(process)
    seconds, limit = time.perf_counter() - began, time_limit(ranks * AT_ONCE[ranks] + 1)
    return _row(case, ranks, True, said, seconds, complaint(case, status, said, seconds, folder, limit))


def _within(
    root: Path, cases: Sequence[Broken], numbers: Sequence[int], ranks: int, environment: Mapping[str, str]
) -> Iterator[tuple[Row, int]]:
    """Cases in one process, until one of them ends it."""
    command = launch_module(ranks, "tests.cli.broken.inside", str(root))
    started: int | None = numbers[0]
    for record in records(command, environment, PATIENCE, json.dumps(list(numbers)) + "\n"):
        if "begins" in record:
            started = record["begins"]
            continue
        number, started = record["number"], None
        case, folder = cases[number], root / f"inside-{ranks}" / str(number)
        limit = time_limit(ranks + 1)
        wrong = complaint(case, record["status"], record["said"], record["seconds"], folder, limit)
        yield _row(case, ranks, False, record["said"], record["seconds"], wrong), number
    if started is not None:
        yield _row(cases[started], ranks, False, "", PATIENCE, "took the process down, or did not end"), started


def _row(case: Broken, ranks: int, alone: bool, said: str, seconds: float, wrong: str | None) -> Row:
    """A case that was tried: how, what the user saw, and what was wrong with the refusal; None if it held."""
    how = "each in a process of its own" if alone else "one after another in one process"
    return {"group": f"on {counted(ranks, 'rank')}, {how}", "case": case.name, "command": case.command(),
            "seconds": seconds, "verdict": "held" if wrong is None else FAILED, "message": said,
            "complaint": wrong}  # fmt: skip

"""Random scenes, judged: `python -m fenicsx_obstacle.studies.hard.draw COUNT SEED` prints JSON lines."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from importlib.util import find_spec
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.errors import InputError, ObstacleError
from fenicsx_obstacle.studies.hard.row import FAILED, REFUSED, RIGHT, Row
from fenicsx_obstacle.studies.processes import launch, records, tell

AT_ONCE = 2
PATIENCE = 60.0  # seconds for one scene
SEED = 1  # the same scenes every time


def try_all(
    count: int, seed: int, comm: MPI.Comm, done: Callable[[Row], None], begins: Callable[[Any], None] | None = None
) -> None:
    """Draw scenes and judge them (collective).

    Args:
        count: How many.
        seed: Of the drawing.
        comm: Communicator.
        done: Called with a row for each scene.
        begins: Called with each scene before it is solved, on rank 0.

    Raises:
        InputError: Without Hypothesis.
    """
    if find_spec("hypothesis") is None:
        raise InputError("random scenes are drawn by Hypothesis, which is not there: pip install hypothesis")
    if comm.rank != 0:
        while (scene := comm.bcast(None)) is not None:
            done(_judged(scene, comm))
        return
    import hypothesis

    from fenicsx_obstacle.studies.hard.chance import Drawn, drawn

    # one rank draws: what Hypothesis draws depends on the modules that are loaded, and not all ranks load the same
    @hypothesis.seed(seed)
    @hypothesis.settings(max_examples=count, deadline=None, database=None, phases=[hypothesis.Phase.generate],
                         suppress_health_check=list(hypothesis.HealthCheck))  # fmt: skip
    @hypothesis.given(drawn())
    def one(scene: Drawn) -> None:
        if begins is not None:
            begins(scene)
        done(_judged(comm.bcast(scene), comm))

    try:
        one()
    finally:
        comm.bcast(None)


def _judged(drawn: Any, comm: MPI.Comm) -> Row:
    """One row: FAILED if anything has, refused if nothing was answered, and what was said."""
    from fenicsx_obstacle.studies.hard.judge import judge

    start = time.perf_counter()
    try:
        rows = list(judge(drawn.scene(comm), comm, drawn.epsilons()))
    except ObstacleError as error:
        rows = [{"verdict": FAILED, "method": "", "asked": None, "message": str(error)}]
    wrong = [f"{row['method']} {row['asked']}: {row['message']}" for row in rows if row["verdict"] == FAILED]
    answers = sum(row["verdict"] == RIGHT for row in rows)
    verdict = FAILED if wrong else (RIGHT if answers else REFUSED)
    return {"scene": asdict(drawn), "verdict": verdict, "answers": answers, "refused": len(rows) - answers - len(wrong),
            "message": "; ".join(wrong), "seconds": time.perf_counter() - start}  # fmt: skip


def run(count: int, environment: Mapping[str, str]) -> Iterator[Row]:
    """A row for each of so many scenes, in processes (one rank)."""
    shares = [count // AT_ONCE + (k < count % AT_ONCE) for k in range(AT_ONCE)]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for rows in pool.map(lambda k: list(_share(shares[k], SEED + k, environment)), range(AT_ONCE)):
            yield from rows


def _share(count: int, seed: int, environment: Mapping[str, str]) -> Iterator[Row]:
    """The rows of one process; should it be lost with a scene, another goes on with others."""
    while count > 0:
        command = launch(1, "-m", "fenicsx_obstacle.studies.hard.draw", str(count), str(seed))
        begun: Any = None
        before = count
        for record in records(command, environment, PATIENCE):
            if "begins" in record:
                begun = record["begins"]
                continue
            begun, count = None, count - 1
            yield record
        if begun is not None:
            count -= 1
            yield {"scene": begun, "verdict": FAILED, "answers": 0, "refused": 0, "seconds": PATIENCE,
                   "message": "took the process down, or did not end"}  # fmt: skip
        if count == before:
            raise InputError("no random scene could be drawn")
        seed += AT_ONCE


def main() -> None:
    """Scenes and rows, a line each."""
    try_all(int(sys.argv[1]), int(sys.argv[2]), MPI.COMM_WORLD, tell, lambda scene: tell({"begins": asdict(scene)}))


if __name__ == "__main__":
    main()

"""A process of its own for one hard scene: `python -m fenicsx_obstacle.studies.hard.one NAME`, rows as JSON lines."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

from mpi4py import MPI

from fenicsx_obstacle.parallel import abort_on_uncaught_errors
from fenicsx_obstacle.scenes.hard import Case, case
from fenicsx_obstacle.studies.hard.judge import Row, judge


def rows_of(one: Case) -> Iterator[Row]:
    """Both meshes of a case (collective)."""
    for mesh, value in enumerate(one.meshes):
        for row in judge(one.on(mesh), refuse=one.refuse):
            yield {"case": one.name, "family": one.family, "mesh": value, **row}


def main() -> None:
    """Rows of the case named on the command line, to standard output as they come."""
    abort_on_uncaught_errors(MPI.COMM_WORLD)
    for row in rows_of(case(sys.argv[1])):
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()

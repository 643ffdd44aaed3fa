"""One hard scene in a separate process: `[mpirun -n N] python -m tests.hard.run_case NAME FILE`.

On one rank rows go to standard output as JSON lines; on any number of ranks the fields to compare go into the file.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.parallel import abort_on_uncaught_errors
from tests.hard.cases import Case, case
from tests.hard.judge import judge
from tests.hard.ranks import fields_of
from tests.hard.row import Row
from tests.processes import tell


def rows_of(one: Case) -> Iterator[Row]:
    """Both meshes of a case (collective)."""
    for mesh, value in enumerate(one.meshes):
        coarse = mesh == 0
        units = coarse and not one.refuse
        for row in judge(one.on(mesh), refuse=one.refuse, known=one.known, starts=True, units=units):
            yield {"case": one.name, "family": one.family, "mesh": value, **row}


def main() -> None:
    """Judge the case named on the command line, and write the fields of its coarse mesh."""
    comm, one = MPI.COMM_WORLD, case(sys.argv[1])
    abort_on_uncaught_errors(comm)
    if comm.size == 1:
        for row in rows_of(one):
            tell(row)
    if one.compared:
        found = fields_of(one.on(0), comm)
        if comm.rank == 0:
            np.savez(Path(sys.argv[2]), **found)


if __name__ == "__main__":
    main()

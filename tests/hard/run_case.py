"""One hard scene in a separate process: `python -m tests.hard.run_case NAME FILE`.

Rows go to standard output as JSON lines, the fields to compare with those on several ranks into the file.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

from tests.hard.cases import Case, case
from tests.hard.judge import judge
from tests.hard.ranks import write
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
    """Judge the case named on the command line."""
    one = case(sys.argv[1])
    for row in rows_of(one):
        tell(row)
    if one.compared:
        write(one.on(0), Path(sys.argv[2]), MPI.COMM_WORLD)


if __name__ == "__main__":
    main()

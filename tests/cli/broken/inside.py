"""Many cases in one process, or on the ranks of one mpirun.

Called as `python -m tests.cli.broken.inside FOLDER`.

Each runs through the entry point of the command line, in a folder of its own. One JSON line says which begins, the
next how it ended: should one take the process down, it is known which.
"""

from __future__ import annotations

import io
import json
import os
import runpy
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from mpi4py import MPI

from fenicsx_obstacle.parallel import on_root
from tests.cli.broken.case import Broken
from tests.cli.broken.collection import collect
from tests.processes import tell


def attempt(case: Broken, folder: Path) -> tuple[int, str, float]:
    """Run a case in a folder (collective).

    Returns:
        Exit status, -1 if ranks differ; what rank 0 said to the user; seconds.
    """
    comm, said, here, given = MPI.COMM_WORLD, io.StringIO(), Path.cwd(), sys.argv
    os.chdir(folder)
    sys.argv = ["fenicsx-obstacle", *case.arguments]
    start = time.perf_counter()
    try:
        with redirect_stderr(said), redirect_stdout(io.StringIO()):
            runpy.run_module("fenicsx_obstacle", run_name="__main__")
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    finally:
        sys.argv = given
        os.chdir(here)
    statuses = set(comm.allgather(status))
    return (status if len(statuses) == 1 else -1), said.getvalue(), time.perf_counter() - start


def main() -> None:
    """The cases whose numbers stand on standard input's first line, as JSON."""
    root, comm = Path(sys.argv[1]), MPI.COMM_WORLD
    cases = collect(root)
    for number in comm.bcast(json.loads(sys.stdin.readline()) if comm.rank == 0 else None):
        case, folder = cases[number], root / f"inside-{comm.size}" / str(number)
        on_root(comm, case.lay_out, folder)
        _say({"begins": number})
        status, said, seconds = attempt(case, folder)
        _say({"number": number, "status": status, "said": said, "seconds": seconds})


def _say(record: dict[str, object]) -> None:
    if MPI.COMM_WORLD.rank == 0:
        tell(record)


if __name__ == "__main__":
    main()

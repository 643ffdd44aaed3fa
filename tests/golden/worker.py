"""Runs the cases on the ranks of this process, and prints a JSON line for each: worker.py FOLDER PATTERN.

Standard input has the names of cases to leave out.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import traceback
import warnings
from fnmatch import fnmatch
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))


def main() -> None:
    os.chdir(sys.argv[1])  # before PETSc looks for its options there

    import petsc4py

    petsc4py.init(["golden"])
    import cases
    import commands  # noqa: F401  (each of these registers its cases)
    import hidden  # noqa: F401
    import problems  # noqa: F401
    import scenes  # noqa: F401
    import wrong  # noqa: F401
    from mpi4py import MPI
    from petsc4py import PETSc

    comm, scratch, only = MPI.COMM_WORLD.Dup(), Path.cwd(), sys.argv[2]

    def tell(record: cases.Values) -> None:
        if comm.rank == 0:
            print(json.dumps(record), file=sys.__stdout__, flush=True)

    done = comm.bcast(json.loads(sys.stdin.read() or "[]") if comm.rank == 0 else None)
    warnings.simplefilter("ignore")
    for one in cases.CASES.values():
        if comm.size not in one.ranks or one.name in done or not fnmatch(one.name, only):
            continue
        folder = scratch / f"{one.name.replace('/', '-')}"
        tell({"begins": one.name})
        if comm.rank == 0:
            folder.mkdir(exist_ok=True)
        comm.Barrier()
        values: cases.Values
        try:
            values = dict(one.run(folder))
        except Exception as error:
            values = {"error": f"{type(error).__name__}: {error}"}
            if not type(error).__module__.startswith("fenicsx_obstacle"):
                traceback.print_exc()
        every = comm.gather({field: cases.placeless(value, folder) for field, value in values.items()})
        if every is not None:
            failed = [values["error"] for values in every if "error" in values]
            if failed and len(failed) < comm.size:
                values = {"error": failed[0], "ranks_failed": len(failed)}
            tell({"name": one.name, "values": values})
        gc.collect()
        PETSc.garbage_cleanup(comm)
    tell({"last": True})


if __name__ == "__main__":
    main()

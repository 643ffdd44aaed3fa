"""Runs the cases on the ranks of this process: worker.py RESULTS SKIP PATTERN."""

from __future__ import annotations

import gc
import json
import os
import sys
import threading
import traceback
import warnings
from fnmatch import fnmatch
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

PATIENCE = 900.0  # seconds for one case, on a busy machine


def main() -> None:
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

    comm, out, only = MPI.COMM_WORLD.Dup(), Path(sys.argv[1]), sys.argv[3]
    done = set(Path(sys.argv[2]).read_text().splitlines())
    warnings.simplefilter("ignore")
    scratch = Path.cwd()
    for one in cases.CASES.values():
        if comm.size not in one.ranks or one.name in done or not fnmatch(one.name, only):
            continue
        folder = scratch / f"{one.name.replace('/', '-')}"
        if comm.rank == 0:
            (scratch / "started").write_text(one.name)
            folder.mkdir(exist_ok=True)
        comm.Barrier()
        watch = threading.Timer(PATIENCE, lambda: os._exit(86))
        watch.daemon = True
        watch.start()
        values: cases.Values
        try:
            values = dict(one.run(folder))
        except Exception as error:
            values = {"error": f"{type(error).__name__}: {error}"}
            if not type(error).__module__.startswith("fenicsx_obstacle"):
                traceback.print_exc()
        watch.cancel()
        every = comm.gather({field: cases.placeless(value, folder) for field, value in values.items()})
        if every is not None:
            failed = [values["error"] for values in every if "error" in values]
            if failed and len(failed) < comm.size:
                values = {"error": failed[0], "ranks_failed": len(failed)}
            with open(out, "a") as file:
                file.write(json.dumps({"name": one.name, "values": values}) + "\n")
        gc.collect()
        PETSc.garbage_cleanup(comm)


if __name__ == "__main__":
    main()

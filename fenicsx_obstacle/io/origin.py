"""Origin of results: the command and the versions."""

from __future__ import annotations

import shlex
import sys

import dolfinx
from petsc4py import PETSc


def command(ranks: int) -> str:
    """The command line of this process."""
    program, *arguments = sys.argv
    if program.endswith(("__main__.py", "fenicsx-obstacle")):
        words = ["./obstacle", *(["--ranks", str(ranks)] if ranks > 1 else []), *arguments]
    else:
        words = [*(["mpirun", "-n", str(ranks)] if ranks > 1 else []), "python3", program, *arguments]
    return shlex.join(words)


def versions() -> dict[str, str]:
    """Versions on which results depend."""
    from importlib.metadata import version

    petsc = ".".join(str(part) for part in PETSc.Sys.getVersion())
    return {"fenicsx_obstacle": version("fenicsx_obstacle"), "dolfinx": dolfinx.__version__, "petsc": petsc}

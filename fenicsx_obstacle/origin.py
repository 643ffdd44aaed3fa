"""Origin of results: the command and the versions."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import dolfinx
from petsc4py import PETSc

from fenicsx_obstacle.checkout import is_clone


def program() -> str:
    """What starts the commands on one rank: the launcher in a clone, the program that pip installs, or the module."""
    if is_clone():
        return "./obstacle"
    return "fenicsx-obstacle" if Path(sys.argv[0]).name == "fenicsx-obstacle" else "python3 -m fenicsx_obstacle"


def command(ranks: int) -> str:
    """The command line of this process."""
    file, *arguments = sys.argv
    of_package = Path(file).name in ("__main__.py", "fenicsx-obstacle")
    words = program().split() if of_package else ["python3", file]
    if words == ["./obstacle"]:
        words += ["--ranks", str(ranks)] if ranks > 1 else []
    elif ranks > 1:
        words = ["mpirun", "-n", str(ranks), *words]
    return shlex.join([*words, *arguments])


def versions() -> dict[str, str]:
    """Versions on which results depend."""
    from importlib.metadata import version

    petsc = ".".join(str(part) for part in PETSc.Sys.getVersion())
    return {"fenicsx_obstacle": version("fenicsx_obstacle"), "dolfinx": dolfinx.__version__, "petsc": petsc}

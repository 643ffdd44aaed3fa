"""Origin of results: the command and the versions; and the clone of the project, which a wheel is without."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import dolfinx
from petsc4py import PETSc

from fenicsx_obstacle.errors import InputError

CLONE = Path(__file__).parents[2]


def in_clone(name: str, needed_by: str) -> Path:
    """A file or folder of the clone that the package is in.

    Args:
        name: Of the file.
        needed_by: The command that needs it.

    Raises:
        InputError: If the package was installed from a wheel.
    """
    if not (_is_clone() and (CLONE / name).exists()):
        raise InputError(
            f"{needed_by} runs in a clone of the project, where {name}/ is; this package is installed alone"
        )
    return CLONE / name


def _is_clone() -> bool:
    return (CLONE / "obstacle").is_file()


def program() -> str:
    """What starts the commands on one rank: the launcher in a clone, the program that pip installs, or the module."""
    if _is_clone():
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

"""Obstacle problems on FEniCSx and PETSc: Kikuchi's penalty finite element method with its contact pressure.

Names are loaded when they are first used: importing the package costs nothing but MPI, where pip has installed DOLFINx.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

# compiled for one another: pip brings them together or not at all
_COMPILED = ("dolfinx", "ufl", "petsc4py", "mpi4py", "h5py")


def require(*needed: str) -> None:
    """Check that libraries are installed.

    Args:
        *needed: Their names; by default all that scenes and forms need. `fenicsx_obstacle.algebra` needs petsc4py and
            mpi4py alone.

    Raises:
        ImportError: If one is missing, with all that are missing and how to install them.
    """
    missing = [name for name in _COMPILED if find_spec(name) is None]
    if not set(missing) & set(needed or _COMPILED):
        return
    raise ImportError(
        f"fenicsx_obstacle needs FEniCSx, PETSc and MPI, and {sys.executable} does not find {', '.join(missing)}. "
        "On Debian take apt-get install python3-dolfinx python3-h5py and an environment made by "
        "/usr/bin/python3 -m venv --system-site-packages; elsewhere fenics-dolfinx and h5py of conda-forge, or "
        "pip install 'fenicsx_obstacle[dolfinx]' (Linux on x86_64, Python 3.12 or newer)"
    )


require("petsc4py", "mpi4py")
if find_spec("dolfinx_solver") is not None:  # DOLFINx as pip installs it, which this must load
    import_module("dolfinx_solver")

_HOME = {
    "Answer": "answers.answer",
    "Elasticity": "forms.elasticity",
    "InputError": "errors",
    "NotConverged": "errors",
    "ObstacleError": "errors",
    "PenetrationWarning": "errors",
    "ObstacleProblem": "problems.obstacle_problem",
    "Scene": "scenes.scene",
    "Table": "data.measured.surface",
    "Solution": "problems.solution",
    "SystemSolution": "algebra.solve_system",
    "contact_pressure": "forms.penalty",
    "find": "studies.find",
    "nodal_rule": "forms.rules",
    "plane_gap": "forms.elasticity",
    "penalty": "forms.penalty",
    "ball_gap": "forms.elasticity",
    "compare": "answers.difference",
    "solve": "answers.solve",
    "solve_system": "algebra.solve_system",
    "study": "studies.convergence",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return version(__name__)
    if name not in _HOME:
        raise AttributeError(f"module 'fenicsx_obstacle' has no attribute '{name}'")
    if not _HOME[name].startswith("algebra."):
        require()
    return getattr(import_module(f"fenicsx_obstacle.{_HOME[name]}"), name)

"""Linear solvers: default PETSc options, which the user's options override."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra import releases
from fenicsx_obstacle.algebra.truncated_multigrid import SMOOTHER
from fenicsx_obstacle.parallel import total

TINY = float(np.finfo(float).tiny)
IN_LIBRARY = 76  # PETSC_ERR_LIB
LARGEST = 200_000  # unknowns for a direct solver
LINEAR = {
    "ksp_type": "cg",
    "ksp_norm_type": "natural",  # the energy norm: independent of eps and of units
    "ksp_rtol": 1e-10,
    "ksp_atol": 0.0,  # PETSc's 1e-50 is a force or an energy in somebody's units
    "ksp_max_it": 500,
    "pc_type": releases.AMG,
    "pc_hypre_type": "boomeramg",
}
DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
SADDLE = {**DIRECT, "mat_mumps_icntl_14": 300}  # per cent more memory: zeros on the diagonal delay pivots
# without symmetry: with strong drift the preconditioned norm is far from that of the residual
GENERAL = {**LINEAR, "ksp_type": "gmres", "ksp_pc_side": "right", "ksp_norm_type": "unpreconditioned"}
# Gaussian elimination on the coarsest level raises an error where its matrix is singular, as far from a solution
# it may be, and only on the ranks with rows there: the others would wait for them. Many sweeps over the few rows do
# nearly the same
COARSEST = {
    "pc_hypre_boomeramg_relax_type_coarse": "symmetric-SOR/Jacobi",
    "pc_hypre_boomeramg_grid_sweeps_coarse": 20,
}
INEXACT = {
    "ksp_type": "cg",
    "ksp_norm_type": "unpreconditioned",  # the others apply the cycle once more
    "ksp_max_it": 500,
    **SMOOTHER,
}


def direct_first(unknowns: int) -> bool:
    """Whether systems with so many unknowns are solved by a direct solver first.

    True without hypre, since GAMG stops far from the solution with a large penalty diagonal or strong drift.
    """
    return releases.AMG != "hypre" and unknowns <= LARGEST


class Collapsed(ArithmeticError):
    """A diagonal that is 0 or not finite, of a problem that is not linear: on all ranks.

    BoomerAMG would raise an error on the rank of that row alone, and the others would wait for it.
    """


def check_diagonal(A: PETSc.Mat, comm: MPI.Comm) -> None:
    """Check a matrix that BoomerAMG is to get (collective).

    Raises:
        Collapsed: On all ranks.
    """
    diagonal = A.getDiagonal()
    bad = ~(np.abs(diagonal.array_r) >= TINY) | ~np.isfinite(diagonal.array_r)
    diagonal.destroy()
    if total(comm, np.count_nonzero(bad)) > 0:
        raise Collapsed


def attempt(solve: Callable[[], object], *used: PETSc.Object) -> bool:
    """Call a PETSc solver; returns whether it finished without an error of hypre, on all ranks (collective).

    BoomerAMG raises where its matrix or vectors overflow, and from then on at every call in this process, since its
    error flag stays. Without the flag the next solve is as good as the first.

    Args:
        solve: What calls PETSc.
        used: Its objects. What PETSc was using when it gave up is locked for ever, and must not be destroyed.

    Raises:
        PETSc.Error: Any other error of PETSc.
        BaseException: That of a callback.
    """
    try:
        _call(solve)
    except Collapsed:
        for one in used:
            one.incRef()
        return False
    except PETSc.Error as error:
        hypre = ctypes.CDLL(PETSc.__file__)  # with all libraries that PETSc is linked to
        if error.ierr != IN_LIBRARY or not hasattr(hypre, "HYPRE_ClearAllErrors"):
            raise
        hypre.HYPRE_ClearAllErrors()
        for one in used:
            one.incRef()
        return False
    return True


def _call(solve: Callable[[], object]) -> None:
    """Call it. What a callback raises, and newer releases of petsc4py keep as the cause of an error, is raised."""
    raised: BaseException | None = None
    try:
        solve()
    except PETSc.Error as error:
        raised = error
        while isinstance(raised, PETSc.Error) and raised.__cause__ is not None:
            raised = raised.__cause__
    if raised is not None:
        raise raised


@contextmanager
def overriding(options: Mapping[str, Any]) -> Iterator[None]:
    """Options that hold whatever the user has set on the command line, which returns afterwards.

    Args:
        options: With their prefix; None or "" for one without a value.
    """
    database = PETSc.Options()
    before = {key: database.getString(key) for key in options if database.hasName(key)}
    for key, value in options.items():
        database[key] = value
    try:
        yield
    finally:
        for key in options:
            database.delValue(key)
        for key, value in before.items():
            database[key] = value


def defaults(prefix: str, options: Mapping[str, Any]) -> AbstractContextManager[None]:
    """Options that hold unless the user has set them, and are gone afterwards."""
    return overriding({prefix + key: value for key, value in options.items() if not user_has_set(prefix + key)})


def user_has_set(option: str) -> bool:
    """Whether the user's PETSc options name this one."""
    return bool(PETSc.Options().hasName(option))


def unread(options: Iterable[str]) -> list[str]:
    """The options with a prefix that are set, and that no PETSc object has read."""
    library, found = ctypes.CDLL(PETSc.__file__), []
    for option in options:
        used = ctypes.c_int(1)  # PetscBool, in newer releases one byte, of which the first counts
        library.PetscOptionsUsed(None, option.encode(), ctypes.byref(used))
        if PETSc.Options().hasName(option) and not used.value & 1:
            found.append(option)
    return found

"""The problem of a solution, solved once more by the solver: in other units, and on one rank with its rows reversed.

Factors of units are powers of two, with which floating-point numbers scale exactly: any other count of steps, any other
contact and any other digit comes from a constant of the program that has a unit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI
from scipy.sparse.linalg import SuperLU

from fenicsx_obstacle.algebra.data_scales import EPSILON, ROUNDOFF_MARGIN
from fenicsx_obstacle.algebra.linear_solvers import DIRECT, defaults
from fenicsx_obstacle.algebra.newton import penalty_pressure, solve_penalty
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.solve_system import MatrixSystem, matrix_of
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.vi import residual_pressure, solve_vi
from fenicsx_obstacle.check.reference import FreeRows, energy_norm, energy_norm_of
from fenicsx_obstacle.errors import ObstacleError

FORCE, LENGTH = 2.0**33, 2.0**-21  # about 1e10 and 5e-7
PREFIX = "verify_"  # of PETSc's options


class Again(NamedTuple):
    """A solution of the solver.

    Attributes:
        w: In the order of the rows.
        steps: Newton steps.
        contact: -1 at rows that press against the lower obstacle, 1 at the upper one, 0 elsewhere.
        unbalanced: Its unbalanced forces.
    """

    w: np.ndarray
    steps: int
    contact: np.ndarray
    unbalanced: np.ndarray


def in_units(p: FreeRows, force: float, length: float) -> FreeRows:
    """The problem with forces and lengths in other units; areas stay."""
    return p._replace(
        A=p.A * (force / length), load=p.load * force, lower=p.lower * length, upper=p.upper * length,
        eps=None if p.eps is None else p.eps * (length / force),
    )  # fmt: skip


def in_reverse(p: FreeRows) -> FreeRows:
    """The problem with its rows in the reverse order."""
    arrays: dict[str, Any] = {name: v[::-1] for name, v in p._asdict().items() if isinstance(v, np.ndarray)}
    return p._replace(A=p.A[::-1][:, ::-1], **arrays)


def solved(p: FreeRows) -> Again | None:
    """The solution from a cold start, on this rank alone; None where the solver finds none."""
    try:
        system = system_of(p)
        with defaults(PREFIX, DIRECT if p.of_body else {}):  # algebraic multigrid for scalar problems is slow there
            outcome, pressure = _solved(system, p.eps)
    except ObstacleError:
        return None
    push = p.weights * pressure
    return Again(system.u, outcome.iterations, np.sign(-push), p.A @ system.u - p.load - push)


def system_of(p: FreeRows) -> System:
    """The problem as a `System` on this rank."""
    A = matrix_of(p.A, MPI.COMM_SELF)
    lower, upper = (np.array(side) if np.isfinite(side).any() else None for side in (p.lower, p.upper))
    none = np.zeros(len(p.load))
    system = MatrixSystem(
        A, np.array(p.load), lower=lower, upper=upper, weights=np.array(p.weights), fixed=none > 0, given=none
    )
    system.prefix = PREFIX
    return system


def _solved(system: System, eps: float | None) -> tuple[Outcome, np.ndarray]:
    if eps is None and system.constrained:
        return solve_vi(system), residual_pressure(system)
    return solve_penalty(system, 1.0 if eps is None else eps), penalty_pressure(system)


def other_units(p: FreeRows, one: Again) -> tuple[int, float]:
    """The number of steps and of rows in contact that are not the same in other units, and the largest difference of
    w, as a share of the largest w; infinite where the solver finds none."""
    other = solved(in_units(p, FORCE, LENGTH))
    if other is None:
        return 0, np.inf
    counts = abs(other.steps - one.steps) + int(np.count_nonzero(other.contact != one.contact))
    apart = np.abs(other.w / LENGTH - one.w).max()
    return counts, float(apart / max(np.abs(one.w).max(), np.finfo(float).tiny))


def reversed_rows(p: FreeRows, factors: SuperLU) -> tuple[float, float] | None:
    """The distance of the checked state from the solution with the rows reversed, in the energy norm, and what the
    unbalanced forces of both explain; None where the solver finds none.

    Args:
        p: The problem and the state.
        factors: Those of the symmetric part of A.
    """
    other = solved(in_reverse(p))
    if other is None:
        return None
    w, left = other.w[::-1], other.unbalanced[::-1]
    noise = p.noise + ROUNDOFF_MARGIN * EPSILON * (np.abs(p.A) @ np.abs(w))
    reach = sum(energy_norm_of(forces, factors) for forces in (p.unbalanced, left, noise))
    return energy_norm(p.w - w, p.A), reach

"""Checks that a state in balance is a solution: contact forces, maximum principle, sensitivity to round-off."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra.data_scales import (
    EPSILON,
    ROUNDOFF_MARGIN,
    forces_of_data,
    range_of_data,
    stiffness_of,
)
from fenicsx_obstacle.algebra.linear_solvers import DIRECT, GENERAL, LARGEST, SADDLE, attempt, defaults, direct_first
from fenicsx_obstacle.algebra.m_matrix import is_m_matrix, sums_nowhere_negative
from fenicsx_obstacle.algebra.system import LIMIT, PRESCRIBE, System
from fenicsx_obstacle.parallel import largest, smallest, total

NEAR = 1e-8  # of the values of the data: not beyond them
SUM = EPSILON / LIMIT  # of A_ii: a smaller sum of rows is their round-off
NO_SOLUTION = "which no solution does"  # part of the message
BY_RESIDUAL = {"ksp_type": "gmres", "ksp_pc_side": "right", "ksp_norm_type": "unpreconditioned", "ksp_rtol": 1e-4}


def violation(problem: System, active: np.ndarray) -> str | None:
    """The reason why a state in balance is not a solution; None if there is none (collective).

    Args:
        problem: In that state.
        active: Which obstacle holds each owned point of I: -1 lower, 1 upper, 0 none.
    """
    if not problem.at_rest:
        return None
    for check in (_not_borne, _shifts, _beyond_range, _sensitive, *problem.checks):
        found = check(problem, active)
        if found is not None:
            return found
    return None


def _not_borne(problem: System, active: np.ndarray) -> str | None:
    """Parts of the mesh that contact alone holds: the contact forces balance the load.

    Without contact A is singular there, and u may be so large that the load is below the round-off of the residual.
    """
    if problem.borne is None or problem.parts is None:
        return None
    count, component = problem.parts
    problem.law.elastic(problem.elastic)
    contact = np.where(problem.active_dofs(active != 0), problem.elastic.array_r, 0.0)

    def sums(values: np.ndarray) -> np.ndarray:
        return np.asarray(problem.comm.allreduce(np.bincount(component, values, count)))

    load = -sums(problem.law.forces_at(0.0))  # the estimator's load may have replaced that of the first check
    wrong = problem.borne & (np.abs(sums(contact) + load) > LIMIT * np.abs(load))
    if not wrong.any():
        return None
    force = load[np.flatnonzero(wrong)[0]]
    return (
        f"contact alone holds u, and the contact forces differ by more than 1 % from the load, {force:.3g} in all: "
        "round-off determines u"
    )


def _shifts(problem: System, active: np.ndarray) -> str | None:
    """Parts of the mesh that nothing holds, and on which no contact force acts.

    If a constant that is added to u there changes the sum of the forces by less than round-off, A has no inverse, and u
    may move until it reaches an obstacle. With contact forces, or where the obstacles do not let u move, it is
    determined.
    """
    if problem.unheld is None or problem.parts is None:
        return None
    comm, u = problem.comm, problem.u
    size = largest(comm, np.abs(u))
    shift = size or 1.0
    stiffness = stiffness_of(problem, exact_bounds=True)
    problem.law.elastic(problem.elastic)
    count, component = problem.parts
    contact = np.where(problem.active_dofs(active != 0), np.abs(problem.elastic.array_r), 0.0)
    # a force that a solver with its default tolerance may leave, or round-off of exact balance
    noise = NEAR * np.abs(problem.law.forces_at(0.0)) + ROUNDOFF_MARGIN * EPSILON * stiffness * np.abs(u)
    moved = problem.law.forces_at(u + shift) - problem.elastic.array_r
    columns = np.array([np.bincount(component, values, count) for values in (contact, noise, moved, stiffness)])
    forces, negligible, held, stiff = comm.allreduce(columns)
    least = np.full((2, count), np.inf)
    gaps = problem.gaps()
    if not problem.nodal:
        lower, upper = problem.obstacles()
        gaps = np.broadcast_to(u - lower, len(u)), np.broadcast_to(upper - u, len(u))
    for row, gap in zip(least, gaps, strict=True):
        np.minimum.at(row, component, gap)
    comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
    singular = np.abs(held) <= SUM * stiff * shift
    if not (problem.unheld & singular & (forces <= negligible) & (least.sum(axis=0) > NEAR * size)).any():
        return None
    return (
        "u is given nowhere, no support is above round-off and no contact force acts, so that u is determined only up "
        f"to a constant; {PRESCRIBE}"
    )


def _beyond_range(problem: System, active: np.ndarray) -> str | None:
    """The maximum principle: with f >= 0 no u is below all boundary values, obstacles and levels of supports.

    It holds for the differential equation with each effect that says what it `push`es. A discrete solution obeys it to
    round-off where A is an M-matrix; elsewhere it may overshoot, but by less than it differs from these values on the
    other side: an error as large as the solution is none.
    """
    comm = problem.comm
    if total(comm, np.count_nonzero(active)) > 0 and not problem.all_points:
        return None  # u is not between the obstacles where it is free of them, at vertices of P2
    low, high = range_of_data(problem, active)
    u = problem.u
    least, most = smallest(comm, u), largest(comm, u)
    beyond = {-1: low - least, 1: most - high}
    margin = NEAR * max(abs(low), abs(high))
    if low > high or max(beyond.values()) <= margin:
        return None
    pushes = problem.pushes()
    if pushes is None or forces_of_data(problem) == 0:  # without forces u is round-off
        return None
    lowest, highest = pushes
    for side, applies, allowed in ((-1, lowest >= 0, most - low), (1, highest <= 0, high - least)):
        if not applies or beyond[side] <= max(margin, LIMIT * allowed):
            continue
        if problem.affine and problem.nodal and problem.matrices.leans(side):
            continue  # by a load that samples miss
        if beyond[side] > allowed or _monotone(problem):
            word, bound, sign = ("below", low, "negative") if side < 0 else ("above", high, "positive")
            return (
                f"u reaches {least if side < 0 else most:.4g}, {word} {bound:.4g}, {NO_SOLUTION} with a load "
                f"that is nowhere {sign}: the equation is nearly singular, or the mesh too coarse for it"
            )
    return None


def _monotone(problem: System) -> bool:
    """Whether A satisfies the maximum principle: no positive off-diagonal entry, no negative row sum."""
    if not (problem.affine and problem.nodal):
        return False
    state = problem.vector()
    problem.jacobian(state, penalised=False)
    state.destroy()
    diagonal, comm = problem.matrices.diagonal, problem.comm
    return is_m_matrix(problem.A, diagonal, comm) and sums_nowhere_negative(problem.A, diagonal, comm)


def _sensitive(problem: System, active: np.ndarray) -> str | None:
    """Sensitivity of u to round-off: a nonsymmetric A may be nearly singular although u looks regular.

    One step of inverse iteration, from the round-off of the residual with one sign: where A is an M-matrix no other
    signs move u farther.
    """
    if problem.fields is not None or problem.symmetric or not (problem.affine and problem.nodal):
        return None
    comm, u = problem.comm, problem.u
    spread = largest(comm, u) - smallest(comm, u)
    middle = (largest(comm, u) + smallest(comm, u)) / 2
    moved = moved_by(problem, active, EPSILON * problem.matrices.diagonal * np.abs(u - middle))
    if moved is not None and not moved <= LIMIT * spread:
        return "round-off changes u by more than 1 % of its range: the equation is nearly singular"
    return None


def moved_by(problem: System, active: np.ndarray, forces: np.ndarray) -> float | None:
    """The largest displacement by forces at owned dofs, with contact nodes fixed (collective).

    Infinite where even a direct solver finds none: A is singular to round-off. None where no direct solver was tried.
    """
    moved = displacements(problem, active, forces)
    return None if moved is None else largest(problem.comm, np.abs(moved))


def displacements(problem: System, active: np.ndarray, forces: np.ndarray) -> np.ndarray | None:
    """The same at owned dofs (collective)."""
    diagonal = problem.A.getDiagonal()
    problem.matrices.add_penalty_diagonal(problem.A, np.where(active != 0, np.inf, 0.0))
    x, b = problem.A.createVecs()
    b.array[:] = np.where(problem.fixed | (active != 0), 0.0, forces)
    done, moved = solved(problem.dofs, problem.A, b, x, direct=problem.direct), x.array.copy()
    problem.A.setDiagonal(diagonal)  # the stopping test of the next solve reads it
    for vector in (x, b, diagonal):
        vector.destroy()
    if done:
        return moved
    return np.full(len(moved), np.inf) if problem.direct or problem.dofs <= LARGEST else None


def solved(dofs: int, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, *, direct: bool = False) -> bool:
    """Solve A x = b; whether that was possible (collective).

    Judged by b - A x itself: a preconditioner hardly sees a direction that A is nearly singular in, and the factors
    of such an A have pivots of pure round-off, so that one solve with them may miss x by a factor of 1000.
    """
    ways: list[Mapping[str, Any]] = [GENERAL, DIRECT] if dofs <= LARGEST else [GENERAL]
    for options in [SADDLE] if direct else reversed(ways) if direct_first(dofs) else ways:
        ksp = PETSc.KSP().create(A.comm)
        ksp.setOperators(A)
        ksp.setOptionsPrefix("sensitivity_")
        with defaults("sensitivity_", {**options, **BY_RESIDUAL}):
            ksp.setFromOptions()
        done = attempt(partial(ksp.solve, b, x), ksp, b, x) and ksp.getConvergedReason() > 0
        ksp.destroy()
        if done:
            return True
    return False

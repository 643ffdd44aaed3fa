"""Checks that a state in balance is a solution: contact forces, maximum principle, sensitivity to round-off, limit
load, trapped drift."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.m_matrix import is_m_matrix, sums_nowhere_negative
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.solvability import LIMIT, PRESCRIBE
from fenicsx_obstacle.discrete.time_discretization import EQUILIBRIA
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.solvers.data_scales import EPSILON, ROUNDOFF_MARGIN, forces_of_data, range_of_data, stiffness_of
from fenicsx_obstacle.solvers.linear import DIRECT, GENERAL, LARGEST, attempt, defaults, direct_first

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.residence import Drift

NEAR = 1e-8  # of the values of the data: not beyond them
NO_SOLUTION = "which no solution does"  # part of the message
TRAPPED = 50.0  # so many times the time in which drift crosses the domain: with a way out it is a logarithm of Pe
NO_WAY_OUT = 1e4  # times the same: without one it is an exponential of Pe; in circles a multiple of Pe
BY_RESIDUAL = {"ksp_type": "gmres", "ksp_pc_side": "right", "ksp_norm_type": "unpreconditioned", "ksp_rtol": 1e-4}
FINE = 8  # cells across the domain from which a slope in one cell is no slope of the film


def violation(problem: Problem, active: np.ndarray) -> str | None:
    """The reason why a state in balance is not a solution; None if there is none (collective).

    Args:
        problem: In that state.
        active: Which obstacle holds each owned point of I: -1 lower, 1 upper, 0 none.
    """
    time = problem.model.time
    if time is not None and time.order != EQUILIBRIA:
        return None
    for check in (_not_borne, _shifts, _beyond_range, _torn, _sensitive, _trapped):
        found = check(problem, active)
        if found is not None:
            return found
    return None


def _not_borne(problem: Problem, active: np.ndarray) -> str | None:
    """Parts of the mesh that contact alone holds: the contact forces balance the load.

    Without contact A is singular there, and u may be so large that the load is below the round-off of the residual.
    """
    if problem.borne is None:
        return None
    count, component = problem.level.parts
    problem.forms.elastic(problem.elastic)
    contact = np.where(problem.active_dofs(active != 0), problem.elastic.array_r, 0.0)

    def sums(values: np.ndarray) -> np.ndarray:
        return np.asarray(problem.level.comm.allreduce(np.bincount(component[: len(values)], values, count)))

    load = -sums(problem.forms.forces_at(0.0))  # the estimator's load may have replaced that of the first check
    wrong = problem.borne & (np.abs(sums(contact) + load) > LIMIT * np.abs(load))
    if not wrong.any():
        return None
    force = load[np.flatnonzero(wrong)[0]]
    return (
        f"contact alone holds u, and the contact forces differ by more than 1 % from the load, {force:.3g} in all: "
        "round-off determines u"
    )


def _shifts(problem: Problem, active: np.ndarray) -> str | None:
    """Parts of the mesh that nothing holds, and on which no contact force acts; bodies that contact forces do not hold.

    A constant may be added to u there until u reaches an obstacle. With contact forces, or where the obstacles do not
    let u move, the constant is determined.
    """
    if problem.loose is None and problem.balanced is None:
        return None
    comm, own = problem.level.comm, problem.level.owned
    u = (problem.w.x.array + problem.reference.x.array)[:own]
    round_off = ROUNDOFF_MARGIN * EPSILON * stiffness_of(problem, exact_bounds=True) * np.abs(u)
    problem.forms.elastic(problem.elastic)
    if problem.loose is not None:
        from fenicsx_obstacle.discrete.rigid import moves  # only where there is an elastic body

        if not moves(problem, active, total(comm, round_off)):
            return None
        return (
            "only contact supports the body, and a rigid body motion is resisted by no contact force, so that u is "
            "determined only up to this motion; prescribe more components of u"
        )
    count, component = problem.level.parts
    component = component[:own]
    contact = np.where(problem.active_dofs(active != 0), np.abs(problem.elastic.array_r), 0.0)
    # a force that a solver with its default tolerance may leave, or round-off of exact balance
    noise = NEAR * np.abs(problem.forms.forces_at(0.0)) + round_off
    columns = np.array([np.bincount(component, values, count) for values in (contact, noise)])
    forces, negligible = comm.allreduce(columns)
    least = np.full((2, count), np.inf)
    gaps = problem.gaps()
    if not problem.level.pair.nodal:
        lower, upper = (np.broadcast_to(one, len(problem.w.x.array))[:own] for one in problem.obstacles())
        gaps = u - lower, upper - u
    for row, gap in zip(least, gaps, strict=True):
        np.minimum.at(row, component, gap)
    comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
    size = largest(comm, np.abs(u))
    if not (problem.balanced & (forces <= negligible) & (least.sum(axis=0) > NEAR * size)).any():
        return None
    return "u is given nowhere, and no contact force acts, so that u is determined only up to a constant; " + PRESCRIBE


def _beyond_range(problem: Problem, active: np.ndarray) -> str | None:
    """The maximum principle: with f >= 0 no u is below all boundary values, obstacles and levels of supports.

    It holds for the differential equation with each effect that says what it `push`es. A discrete solution obeys it to
    round-off where A is an M-matrix; elsewhere it may overshoot, but by less than it differs from these values on the
    other side: an error as large as the solution is none.
    """
    comm, pair = problem.level.comm, problem.level.pair
    if total(comm, np.count_nonzero(active)) > 0 and not pair.at_vertices:
        return None  # u is not between the obstacles where it is free of them, at vertices of P2
    low, high = range_of_data(problem, active)
    u = problem.w.x.array + problem.reference.x.array
    least, most = smallest(comm, u), largest(comm, u)
    beyond = {-1: low - least, 1: most - high}
    margin = NEAR * max(abs(low), abs(high))
    if low > high or max(beyond.values()) <= margin:
        return None
    pushes = [effect.push(problem.data) for effect in problem.model.effects]
    if not pushes or None in pushes or forces_of_data(problem) == 0:  # without forces u is round-off
        return None
    lowest = sum(smallest(comm, push[0]) for push in pushes if push is not None)
    highest = sum(largest(comm, push[1]) for push in pushes if push is not None)
    for side, applies, allowed in ((-1, lowest >= 0, most - low), (1, highest <= 0, high - least)):
        if not applies or beyond[side] <= max(margin, LIMIT * allowed):
            continue
        if problem.affine and problem.level.pair.nodal and problem.nodal.pushes(side):
            continue  # by a load that samples miss
        if beyond[side] > allowed or _monotone(problem):
            word, bound, sign = ("below", low, "negative") if side < 0 else ("above", high, "positive")
            return (
                f"u reaches {least if side < 0 else most:.4g}, {word} {bound:.4g}, {NO_SOLUTION} with a load "
                f"that is nowhere {sign}: the equation is nearly singular, or the mesh too coarse for it"
            )
    return None


def _monotone(problem: Problem) -> bool:
    """Whether A satisfies the maximum principle: no positive off-diagonal entry, no negative row sum."""
    if not problem.affine or not problem.level.pair.nodal:
        return False
    state = problem.state()
    problem.jacobian(state, penalised=False)
    state.destroy()
    diagonal, comm = problem.nodal.diagonal, problem.level.comm
    return is_m_matrix(problem.A, diagonal, comm) and sums_nowhere_negative(problem.A, diagonal, comm)


def _torn(problem: Problem, active: np.ndarray) -> str | None:
    """A film beyond its limit load that falls on an obstacle: u jumps within one cell at the boundary.

    Where a film is vertical at the boundary, and its radius of curvature there is R, it falls by (2 R h)^(1/2) within
    a cell of size h, and by less in the next. With R up to half of the domain that is less than the limit here.
    Concentrated loads make a film steep that is not curved, but then it falls as far in its other cells.
    """
    comm, level, data = problem.level.comm, problem.level, problem.data
    if not any(effect.greatest(data) is not None for effect in problem.model.effects):
        return None
    across = 2 * largest(comm, level.points[0]) if data.axial else data.extent
    if level.h * FINE > across:
        return None
    dofs, values = data.fixed
    given, u = values.x.array[dofs], problem.w.x.array + problem.reference.x.array
    low, high = smallest(comm, given), largest(comm, given)
    fixed = np.zeros(len(u), dtype=bool)
    fixed[dofs] = True
    cells = releases.cell_dofs(level.V)
    outer = fixed[cells].any(axis=1)
    for side, fall in ((-1, low - u), (1, u - high)):
        if total(comm, np.count_nonzero(active == side)) == 0:
            continue
        fallen = np.maximum(fall, 0.0)
        falls = np.ptp(fallen[cells], axis=1)
        jump, others = largest(comm, falls[outer]), largest(comm, falls[~outer])
        if jump > sqrt(across * level.h) and jump > min(2 * others, largest(comm, fallen) / 2):
            return (
                f"u falls by {jump:.4g} within one cell where it is given, farther than a film can: the load is beyond "
                "its limit, and no solution has these boundary values; take a smaller load"
            )
    return None


def _sensitive(problem: Problem, active: np.ndarray) -> str | None:
    """Sensitivity of u to round-off: a nonsymmetric A may be nearly singular although u looks regular.

    One step of inverse iteration, from the round-off of the residual with one sign: where A is an M-matrix no other
    signs move u farther.
    """
    if problem.symmetric or not (problem.affine and problem.level.pair.nodal):
        return None
    comm, own, nodal = problem.level.comm, problem.level.owned, problem.nodal
    u = (problem.w.x.array + problem.reference.x.array)[:own]
    spread = largest(comm, u) - smallest(comm, u)
    middle = (largest(comm, u) + smallest(comm, u)) / 2
    moved = _moved_by(problem, active, EPSILON * nodal.diagonal * np.abs(u - middle))
    if moved is not None and not moved <= LIMIT * spread:
        return "round-off changes u by more than 1 % of its range: the equation is nearly singular"
    return None


def check_drift_in_time(problem: Problem) -> None:
    """Reject drift that is trapped for longer than the scene lasts, on cells that do not resolve it (collective).

    The discrete drift then leaves after all, so that u stops growing. In circles it is diffusion that takes long.

    Raises:
        InputError: With the Peclet number of the cells.
    """
    drift = problem.drift
    if drift is None or drift.number <= 1:
        return
    assert problem.model.time is not None
    longest = _longest_stay(problem, drift, problem.fixed)
    if longest > NO_WAY_OUT and _crossings(problem, drift, problem.model.time.end) > TRAPPED:
        raise InputError(f"{problem.model.source}: {_in_words(drift.number)}")


def _trapped(problem: Problem, active: np.ndarray) -> str | None:
    """Trapped drift on a mesh that does not resolve the diffusion against it, so that u is arbitrary there.

    Where drift flows away from some places on all sides, or in circles, the time that a particle stays in the domain is
    the exponential of the work of the drift over the tension, and so is u. Cells with Pe > 1 do not resolve it.
    """
    drift = problem.drift
    if drift is None or drift.number <= 1:
        return None
    held = problem.fixed | problem.active_dofs(active != 0)
    known = problem.affine and drift.held is not None  # otherwise u is in the stiffness
    if not known or total(problem.level.comm, np.count_nonzero(drift.held != held)) > 0:
        longest = _longest_stay(problem, drift, held)
        if 0 < longest <= TRAPPED and problem.affine and problem.level.pair.nodal:
            # in circles the matrix of the problem has less artificial diffusion
            moved = _moved_by(problem, active, problem.nodal.unit_load())
            longest = max(longest, _crossings(problem, drift, moved))
        drift.held, drift.time = held, longest
    return _in_words(drift.number) if drift.time > TRAPPED else None


def _in_words(number: float) -> str:
    return (
        "the drift flows away from some places on all sides, or in circles, so that u is large there, and the cells "
        f"are too coarse to say how large: their Peclet number |drift| h/(2 tension) reaches {number:.3g}, and must be "
        "below 1 here"
    )


def _longest_stay(problem: Problem, drift: Drift, held: np.ndarray) -> float:
    """The longest time that the drift stays in the domain, over that in which it crosses it (collective)."""
    from fenicsx_obstacle.discrete.residence import residence_time  # only where a model has drift

    if drift.reaction is None or not problem.affine:
        drift.reaction = problem.forms.row_sums()
    solve = partial(_solve, problem.level.dofs)
    time = residence_time(problem.data, drift.velocity, held, drift.reaction, problem.A, solve)
    return _crossings(problem, drift, time)


def _crossings(problem: Problem, drift: Drift, time: float | None) -> float:
    """A time over that in which the drift crosses the domain; infinite, or unknown and 0, if its system was not solved
    (collective)."""
    from fenicsx_obstacle.discrete.peclet import speed

    if time is None:
        return np.inf if problem.level.dofs <= LARGEST else 0.0
    return time * speed(problem.data, drift.velocity) / problem.data.extent


def _moved_by(problem: Problem, active: np.ndarray, forces: np.ndarray) -> float | None:
    """The largest displacement by forces at owned dofs, with contact nodes fixed (collective).

    Infinite where even a direct solver finds none: A is singular to round-off. None where no direct solver was tried.
    """
    problem.nodal.add_penalty_diagonal(problem.A, np.where(active != 0, np.inf, 0.0))
    x, b = problem.A.createVecs()
    b.array[:] = np.where(problem.fixed | (active != 0), 0.0, forces)
    solved = _solve(problem.level.dofs, problem.A, b, x)
    most = largest(problem.level.comm, np.abs(x.array_r))
    for vector in (x, b):
        vector.destroy()
    if solved:
        return most
    return np.inf if problem.level.dofs <= LARGEST else None


def _solve(dofs: int, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> bool:
    """Solve A x = b; whether that was possible (collective).

    Judged by b - A x itself: a preconditioner hardly sees a direction that A is nearly singular in, and the factors
    of such an A have pivots of pure round-off, so that one solve with them may miss x by a factor of 1000.
    """
    ways: list[Mapping[str, Any]] = [GENERAL, DIRECT] if dofs <= LARGEST else [GENERAL]
    for options in reversed(ways) if direct_first(dofs) else ways:
        ksp = PETSc.KSP().create(A.comm)
        ksp.setOperators(A)
        ksp.setOptionsPrefix("sensitivity_")
        with defaults("sensitivity_", {**options, **BY_RESIDUAL}):
            ksp.setFromOptions()
        solved = attempt(partial(ksp.solve, b, x), ksp, b, x) and ksp.getConvergedReason() > 0
        ksp.destroy()
        if solved:
            return True
    return False

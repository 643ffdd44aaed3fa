"""Scales of the data: range of u, forces; checks that the data and not round-off determine a solution.

The round-off of the residual is machine epsilon times |A| |u|. A part of it is due to values of u in the data: boundary
values, obstacles in contact, the levels at which supports are at rest. The rest is due to the part of u outside of the
range of these values. If it is more than a small part of the forces of the data, the data do not determine u, and A is
singular in floating point.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.solvability import LIMIT
from fenicsx_obstacle.parallel import largest, smallest, total

EPSILON = float(np.finfo(float).eps)
NEGLIGIBLE_FORCE = 1e-30
ROUNDOFF_MARGIN = 8.0  # round-off may exceed its estimate by this factor


def range_of_data(problem: Problem, active: np.ndarray) -> tuple[float, float]:
    """The smallest and the largest value of u in the data; inf and -inf if the data have none (collective).

    Args:
        problem: Its boundary values, obstacles and supports.
        active: Which obstacle holds each owned point of I: -1 lower, 1 upper, 0 none.
    """
    comm, own = problem.level.comm, problem.level.owned
    dofs, values = problem.data.fixed
    given = [np.atleast_1d(heights) for effect in problem.model.effects for heights in effect.heights(problem.data)]
    given.append(values.x.array[dofs])
    if problem.constrained:
        for obstacle, side in zip(problem.obstacles(), (-1, 1), strict=True):
            held = problem.active_dofs(active == side)
            heights = np.broadcast_to(obstacle, len(values.x.array))[:own][held]
            given.append(heights[np.isfinite(heights)])
    known = np.concatenate(given)
    return smallest(comm, known), largest(comm, known)


def forces_of_data(problem: Problem) -> float:
    """The scale of the forces of the data (collective): the load, or the elastic forces of a u that equals the boundary
    values and obstacles and is constant elsewhere."""
    comm = problem.level.comm
    at_zero = total(comm, np.abs(problem.forms.forces_at(0.0)[~problem.fixed]))
    return max(problem.load, at_zero, total(comm, np.abs(problem.forms.forces_at(problem.flat()))))


def nearest_gap(problem: Problem) -> float:
    """The smallest distance of u from an obstacle, infinity if there is none (collective).

    A gap below the last digit of its obstacle is round-off and counts as contact.
    """
    found = []
    for gap, obstacle in zip(problem.gaps(), problem.obstacles(), strict=True):
        heights = np.abs(np.broadcast_to(obstacle, len(problem.w.x.array)))
        digit = EPSILON * (heights[: len(gap)] if problem.level.pair.nodal else problem.at_points(heights))
        found.append(np.abs(gap[np.abs(gap) > digit]))
    return smallest(problem.level.comm, np.concatenate(found))


def negligible_force(problem: Problem, stiffness: np.ndarray) -> float:
    """A force that is negligible against stiffness times nearest gap (collective)."""
    nearest = nearest_gap(problem)
    return NEGLIGIBLE_FORCE * nearest * total(problem.level.comm, stiffness) if np.isfinite(nearest) else 0.0


def stiffness_of(problem: Problem, *, exact_bounds: bool) -> np.ndarray:
    """Diagonal of A at owned free dofs, 0 at fixed ones; without the penalty diagonal (collective)."""
    if exact_bounds and problem.affine and problem.level.pair.nodal:
        return problem.nodal.diagonal * ~problem.fixed
    if not problem.A.assembled:  # no step was needed
        state = problem.state()
        problem.jacobian(state, penalised=not exact_bounds)
        state.destroy()
    diagonal = problem.A.getDiagonal()
    stiffness = diagonal.array_r * ~problem.fixed
    diagonal.destroy()
    return stiffness


def _round_off_outside(problem: Problem, stiffness: np.ndarray, low: float, high: float) -> float:
    """The round-off of the residual due to the part of u outside of an interval; 0 if that is empty (collective)."""
    own = problem.level.owned
    u = problem.w.x.array[:own] + problem.reference.x.array[:own]
    total_force = total(problem.level.comm, np.dot(stiffness, np.abs(u - np.clip(u, low, high))))
    return 0.0 if low > high else EPSILON * total_force


def determined(problem: Problem, active: np.ndarray, stiffness: np.ndarray, unbalanced: float) -> bool:
    """Whether the data, and not round-off, determine a state in balance (collective).

    Args:
        problem: In that state.
        active: Which obstacle holds each owned point of I: -1 lower, 1 upper, 0 none.
        stiffness: Diagonal of A at owned free dofs, 0 at fixed ones.
        unbalanced: Sum of |residual| over free dofs.
    """
    comm, own = problem.level.comm, problem.level.owned
    low, high = range_of_data(problem, active)
    w = problem.w.x.array[:own]
    beyond = _round_off_outside(problem, stiffness, low, high)
    if max(beyond, unbalanced) <= LIMIT * problem.load:
        return True
    forces = forces_of_data(problem)
    if forces == 0:  # no state but that of the data is in balance, and round-off is all that is left
        return True
    if max(forces, beyond, unbalanced) <= negligible_force(problem, stiffness):  # earlier steps left round-off in u
        return True
    largest_given = 0.0 if low > high else max(abs(low), abs(high))
    of_data = total(comm, stiffness * np.minimum(np.abs(w), largest_given))
    round_off = ROUNDOFF_MARGIN * EPSILON * of_data
    return beyond <= LIMIT * max(forces, round_off) and unbalanced <= max(LIMIT * forces, round_off)

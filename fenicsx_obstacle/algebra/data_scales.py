"""Scales of the data: range of u, forces; checks that the data and not round-off determine a solution.

The round-off of the residual is machine epsilon times |A| |u|. A part of it is due to values of u in the data: boundary
values, obstacles in contact, the levels at which supports are at rest. The rest is due to the part of u outside of the
range of these values. If it is more than a small part of the forces of the data, the data do not determine u, and A is
singular in floating point.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.algebra.affine import Affine
from fenicsx_obstacle.algebra.system import LIMIT, System
from fenicsx_obstacle.parallel import largest, smallest, total

EPSILON = float(np.finfo(float).eps)
NEGLIGIBLE_FORCE = 1e-30
ROUNDOFF_MARGIN = 8.0  # round-off may exceed its estimate by this factor


def range_of_data(problem: System, active: np.ndarray) -> tuple[float, float]:
    """The smallest and the largest value of u in the data; inf and -inf if the data have none (collective).

    Args:
        problem: Its boundary values, obstacles and supports.
        active: Which obstacle holds each owned point of I: -1 lower, 1 upper, 0 none.
    """
    comm = problem.comm
    given = [*problem.heights(), problem.given[problem.fixed]]
    if problem.constrained:
        for obstacle, side in zip(problem.obstacles(), (-1, 1), strict=True):
            held = problem.active_dofs(active == side)
            heights = np.broadcast_to(obstacle, problem.owned)[held]
            given.append(heights[np.isfinite(heights)])
    known = np.concatenate(given)
    return smallest(comm, known), largest(comm, known)


def forces_of_data(problem: System) -> float:
    """The scale of the forces of the data (collective): the load, or the elastic forces of a u that equals the boundary
    values and obstacles and is constant elsewhere."""
    comm = problem.comm
    at_zero = total(comm, np.abs(problem.law.forces_at(0.0)[~problem.fixed]))
    return max(problem.load, at_zero, total(comm, np.abs(problem.law.forces_at(problem.flat()))))


def nearest_gap(problem: System) -> float:
    """The smallest distance of u from an obstacle, infinity if there is none (collective).

    A gap below the last digit of its obstacle is round-off and counts as contact.
    """
    nearest = np.inf
    for gap, obstacle in zip(problem.gaps(), problem.obstacles(), strict=True):
        size, digit = np.abs(gap), np.abs(np.broadcast_to(obstacle, problem.owned))
        digit *= EPSILON
        size[size <= (digit if problem.nodal else problem.at_points(digit))] = np.inf
        nearest = min(nearest, smallest(problem.comm, size))
    return nearest


def negligible_force(problem: System, stiffness: np.ndarray) -> float:
    """A force that is negligible against stiffness times nearest gap (collective).

    No gap counts as larger than the data: what is negligible does not grow with a u that diverges.
    """
    data = [problem.given[problem.fixed], *(side for side in problem.obstacles() if np.ndim(side))]
    most = max(
        largest(problem.comm, np.abs(values, where=np.isfinite(values), out=np.zeros(len(values)))) for values in data
    )
    nearest = nearest_gap(problem)
    return NEGLIGIBLE_FORCE * min(nearest, most) * total(problem.comm, stiffness) if np.isfinite(nearest) else 0.0


def stiffness_of(problem: System, *, exact_bounds: bool) -> np.ndarray:
    """Diagonal of A at owned free dofs, 0 at fixed ones (collective).

    Args:
        problem: The system.
        exact_bounds: Whether bounds hold contact. Otherwise A has the penalty diagonal of the last step.
    """
    if exact_bounds and isinstance(problem.law, Affine):  # A has a large diagonal where bounds hold
        return problem.matrices.diagonal * ~problem.fixed
    if not problem.A.assembled:  # no step was needed
        state = problem.vector()
        problem.jacobian(state, penalised=not exact_bounds)
        state.destroy()
    diagonal = problem.A.getDiagonal()
    stiffness = diagonal.array_r * ~problem.fixed
    diagonal.destroy()
    return stiffness


def _round_off_outside(problem: System, stiffness: np.ndarray, low: float, high: float) -> float:
    """The round-off of the residual due to the part of u outside of an interval; 0 if that is empty (collective)."""
    u = problem.u
    total_force = total(problem.comm, np.dot(stiffness, np.abs(u - np.clip(u, low, high))))
    return 0.0 if low > high else EPSILON * total_force


def determined(problem: System, active: np.ndarray, stiffness: np.ndarray, unbalanced: float) -> bool:
    """Whether the data, and not round-off, determine a state in balance (collective).

    Args:
        problem: In that state.
        active: Which obstacle holds each owned point of I: -1 lower, 1 upper, 0 none.
        stiffness: Diagonal of A at owned free dofs, 0 at fixed ones.
        unbalanced: Sum of |residual| over free dofs.
    """
    comm, w = problem.comm, problem.w
    # the forces of a film, or of what becomes soft, stay small when u diverges: 1 % of them says nothing of u
    share = LIMIT if problem.affine else LIMIT**2
    low, high = range_of_data(problem, active)
    beyond = _round_off_outside(problem, stiffness, low, high)
    if max(beyond, unbalanced) <= share * problem.load:
        return True
    forces = forces_of_data(problem)
    if forces == 0:  # no state but that of the data is in balance, and round-off is all that is left
        return True
    if max(forces, beyond, unbalanced) <= negligible_force(problem, stiffness):  # earlier steps left round-off in u
        return True
    largest_given = 0.0 if low > high else max(abs(low), abs(high))
    of_data = total(comm, stiffness * np.minimum(np.abs(w), largest_given))
    round_off = ROUNDOFF_MARGIN * EPSILON * of_data
    return beyond <= share * max(forces, round_off) and unbalanced <= max(share * forces, round_off)

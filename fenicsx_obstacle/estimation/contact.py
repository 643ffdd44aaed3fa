"""Contact set, contact forces and penetration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.parallel import largest, total

TOUCHES = 1e-8  # of the largest distance
PRESSES = 1e-10  # of the largest pressure


@dataclass(frozen=True)
class Contact:
    """The contact of a solved problem; values are the same on every rank.

    Attributes:
        pressure: p_i at owned points of I, negative against the upper obstacle.
        lower: Whether a node presses against the lower obstacle.
        upper: Whether a node presses against the upper obstacle.
        area: Sum of D_i over the contact nodes; of obstacles on the boundary the length there.
        lower_force: Sum of D_i p_i there, >= 0.
        upper_force: Sum of -D_i p_i there, >= 0.
        penetration: Largest distance beyond an obstacle.
    """

    pressure: np.ndarray = field(repr=False)
    lower: np.ndarray = field(repr=False)
    upper: np.ndarray = field(repr=False)
    area: float
    lower_force: float
    upper_force: float
    penetration: float


def touching(problem: Problem, reach: tuple[float, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Whether the problem's state is at the lower obstacle or beyond it, at owned points of I, and at the upper one
    (collective).

    Args:
        problem: Holds the state.
        reach: Bounds of the solution, if they are known: it does not touch obstacles beyond them.
    """
    lower, upper = problem.gaps()
    if reach is not None:
        low, high = (np.atleast_1d(values)[: len(lower)] for values in problem.obstacles())
        lower, upper = np.where(low >= reach[0], lower, np.inf), np.where(high <= reach[1], upper, np.inf)
    finite = [np.abs(gap[np.isfinite(gap)]) for gap in (lower, upper)]
    near = TOUCHES * max(largest(problem.level.comm, np.concatenate(finite)), 0.0)
    return lower <= near, upper <= near


def contact_of(problem: Problem, pressure: np.ndarray) -> Contact:
    """Contact set, area and forces of the problem's state (collective).

    Args:
        problem: Holds the solution.
        pressure: Its contact pressure at owned points of I.
    """
    comm, D = problem.level.comm, problem.weights
    above_lower, below_upper = problem.gaps()
    at_lower, at_upper = touching(problem)
    least = PRESSES * max(largest(comm, np.abs(pressure)), 0.0)
    free = problem.touchable
    lower = free & at_lower & (pressure > least)
    upper = free & at_upper & (-pressure > least)
    beyond = largest(comm, np.concatenate([-above_lower[free], -below_upper[free]]))
    return Contact(
        pressure=pressure,
        lower=lower,
        upper=upper,
        area=total(comm, D[lower | upper]) / problem.thickness,
        lower_force=total(comm, (D * pressure)[lower]),
        upper_force=total(comm, -(D * pressure)[upper]),
        penetration=max(beyond, 0.0) + 0.0,  # no negative zero
    )

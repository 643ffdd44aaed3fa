"""Contact set, contact forces and penetration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.system import NO_BOUND
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.mesh.around_nodes import AroundNodes, with_ghosts
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.parallel import largest, total

TOUCHES = 1e-8  # of the range of u
PRESSES = 1e-10  # of the largest pressure
ON_OBSTACLE = 1e-10  # of the range of u: a boundary value is the obstacle's


@dataclass(frozen=True)
class Contact:
    """The contact of a solved problem; values are the same on every rank.

    Attributes:
        pressure: p_i at owned points of I, negative against the upper obstacle.
        lower: Whether a node presses against the lower obstacle.
        upper: Whether a node presses against the upper obstacle.
        shares: The part of D_i that is in contact, at owned points of I, see `contact_shares`.
        area: Of the contact set; of obstacles on the boundary the length there.
        lower_force: Sum of D_i p_i there, >= 0.
        upper_force: Sum of -D_i p_i there, >= 0.
        penetration: Largest distance beyond an obstacle.
    """

    pressure: np.ndarray = field(repr=False)
    lower: np.ndarray = field(repr=False)
    upper: np.ndarray = field(repr=False)
    shares: np.ndarray = field(repr=False)
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
    near = TOUCHES * problem.range_of_u()
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
    shares = contact_shares(problem, pressure, lower, upper)
    beyond = largest(comm, np.concatenate([-above_lower[free], -below_upper[free]]))
    return Contact(
        pressure=pressure,
        lower=lower,
        upper=upper,
        shares=shares,
        area=total(comm, D * shares) / problem.thickness,
        lower_force=total(comm, (D * pressure)[lower]),
        upper_force=total(comm, -(D * pressure)[upper]),
        penetration=max(beyond, 0.0) + 0.0,  # no negative zero
    )


def contact_shares(problem: Problem, pressure: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The part of D_i that is in contact, at each owned point of I, dimensionless, between 0 and 1 (collective).

    Inside the contact set it is 1. Along the free boundary contact ends between nodes, and a node carries the load of
    the part of its surroundings that is in contact. With R(v) = a(v, .) - f its share is R_i(u)/R_i(v), v being u with
    the neighbours on the obstacle, too, where they have one. Both R_i(u), the pressure, and R_i(v) - R_i(u), which is
    linear in their gaps, change continuously with the free boundary. For a uniform load on a string the area then has
    order 2 in h.

    Nodes at which u is given carry no pressure. Where the value is the obstacle's, they have the mean share of the
    nodes in contact in the cells around them. Where the points of I are not nodes, the share is 1 in contact.

    Args:
        problem: Holds the solution.
        pressure: Contact pressure at owned points of I.
        lower: Whether a point presses against the lower obstacle.
        upper: Whether it presses against the upper one.
    """
    shares = (lower | upper).astype(float)
    if not problem.constrained or not problem.level.pair.nodal:
        return shares
    w, gaps = problem.w, problem.gaps()
    here = problem.elastic_at(w)
    for inside, obstacle, gap, sign in (
        (lower, problem.below, gaps[0], 1.0), (upper, problem.above, gaps[1], -1.0)
    ):  # fmt: skip
        if obstacle is None:
            continue
        near = ~inside & (problem.weights > 0) & (gap < NO_BOUND)
        there = problem.elastic_at(w - np.where(near, sign * np.maximum(gap, 0.0), 0.0))
        force = problem.weights[inside] * np.abs(pressure[inside])
        with np.errstate(invalid="ignore"):  # F may be infinite there
            more = sign * (there - here)[inside]
        shares[inside] = force / (force + np.where(np.isfinite(more), np.maximum(more, 0.0), 0.0))
    return shares if problem.data.thin else _with_boundary(problem, shares, np.minimum(*gaps))


def _with_boundary(problem: Problem, shares: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """The shares, with those of fixed nodes on an obstacle beside the contact set (collective)."""
    level, comm = problem.level, problem.level.comm
    touching = problem.fixed & (problem.weights > 0) & (gap <= ON_OBSTACLE * problem.range_of_u())
    if total(comm, np.count_nonzero(touching)) == 0:
        return shares
    around = AroundNodes(level.V, releases.cell_dofs(level.V)[: own_cells(level.mesh)])
    local = with_ghosts(level.V, shares)[around.nodes]
    pressing = np.repeat(np.count_nonzero(local, axis=1)[:, None], local.shape[1], axis=1)
    means = local.sum(axis=1, keepdims=True) / np.maximum(pressing, 1)
    sums, counts = (around.sums(values)[: len(shares)] for values in (means, pressing > 0))
    return np.where(touching & (counts > 0), sums / np.maximum(counts, 1.0), shares)

"""Boundary values in error bounds: the base class, which is enough for intervals."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, smallest

ROUNDED = 4e-15  # relative to the values of u: of a difference of two of them,
ROUND_OFF = 1e-14  # and of a datum and what interpolates it

DEGREE = 4  # of interpolants of boundary values


def _lattice(corners: int) -> np.ndarray:
    """Barycentric coordinates of the nodes of degree DEGREE, times DEGREE, in the order of Bernstein coefficients,
    shape (nodes, corners)."""
    steps = product(range(DEGREE, -1, -1), repeat=corners)
    return np.array([one for one in steps if sum(one) == DEGREE])


NODES = {corners: _lattice(corners) for corners in (2, 3, 4)}
# Bernstein coefficients from values at these nodes
TO_BERNSTEIN = {
    corners: np.linalg.inv(polynomials.evaluate(np.eye(len(nodes)), nodes / DEGREE, DEGREE).T)
    for corners, nodes in NODES.items()
}


def places(corners: int) -> dict[tuple[int, ...], int]:
    """Where each node stands."""
    return {tuple(node): n for n, node in enumerate(NODES[corners].tolist())}


@dataclass(frozen=True, eq=False)
class Facets:
    """Facets of owned cells where one part of the boundary gives u.

    Attributes:
        cells: Owned cell beside each.
        opposite: Vertex of the cell opposite to it.
        members: Its vertices in the cell, shape (facets, d).
        x: Their coordinates, shape (facets, d, d).
        ends: The nodal boundary values there, shape (facets, d).
        value: What is given.
        height: Of each cell over its facet.
        foot: Of this height, shape (facets, d).
    """

    cells: np.ndarray
    opposite: np.ndarray
    members: np.ndarray
    x: np.ndarray
    ends: np.ndarray
    value: Field
    height: np.ndarray
    foot: np.ndarray

    @property
    def arm(self) -> np.ndarray:
        """The largest distance of a facet's points from the foot of the height."""
        return np.linalg.norm(self.x - self.foot[:, None], axis=2).max(axis=1, initial=0.0)

    def of_cone(self, value: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Bounds of the gradient of cones over the facets from those of functions on these and of their slopes."""
        return np.hypot(slope, (value + self.arm * slope) / self.height)


class BoundaryValues:
    """The difference d of boundary values and their nodal interpolant, extended into the domain; 0 in this class.

    Attributes:
        leaves: Whether the continuation may leave what d keeps to in each cell: v_h may be above a constant on the
            boundary and not with it inside.
        twice: Whether it may in any, on any rank.
        sampled: Whether no bounds of a boundary value, or of its slope, are known somewhere, on any rank.
        unbounded: Where a boundary value may be infinite, a point on one rank.
        least: A lower bound of what is given, on all ranks; infinite if nothing is.
        most: An upper bound.
        deviation: Bound of the continuation, shape (owned cells,).
        volume: Its integral over each cell,
        volume_rest: and how far it may be from that.
    """

    twice = False
    sampled = False
    unbounded: np.ndarray | None = None

    def __init__(self, simplices: Simplices):
        """Take the nodal values (collective)."""
        data = simplices.data
        given, comm = data.fixed[1].x.array[data.fixed[0]], data.level.comm
        self.simplices = simplices
        self.least, self.most = smallest(comm, given), largest(comm, given)
        self.deviation, self.volume, self.volume_rest = (np.zeros(len(simplices.area)) for _ in range(3))
        self.leaves = self.deviation > 0

    def below(self, obstacle: Field, sign: float) -> float:
        """By how much sign times what is given is below an obstacle between the nodes; -inf of intervals."""
        return -np.inf

    def energy(self, mu: np.ndarray) -> np.ndarray:
        """Bound of ||mu^(1/2) grad||^2 of the continuation in each cell, mu being the largest tension there."""
        return np.zeros(len(mu))

    def on_parts(self, owner: np.ndarray, inside: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the continuation on parts of cells.

        Args:
            owner: The owned cell of each part.
            inside: Barycentric coordinates of the corners of the parts, shape (parts, corners, corners).
            sign: Times the continuation.

        Returns:
            A lower bound of sign times it on each part, 0 at most, and a bound of its gradient.
        """
        return np.zeros(len(owner)), np.zeros(len(owner))

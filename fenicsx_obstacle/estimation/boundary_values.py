"""Boundary values in error bounds: the base class, which is enough for intervals."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, smallest

ROUND_OFF = 1e-14  # relative to the values of u: of a difference of a datum and what interpolates it


class BoundaryValues:
    """The difference d of boundary values and their nodal interpolant, extended into the domain; 0 in this class.

    Attributes:
        twice: Whether the continuation may leave what d keeps to.
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

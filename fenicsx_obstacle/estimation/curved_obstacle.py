"""An obstacle less the part of a function of P2 on intervals that is 0 at the vertices.

u of P2 is u_1 of P1 plus B = 4 b t (1 - t) in each cell, t from 0 to 1. It is above an obstacle where u_1 is above the
obstacle less B: the excess of this obstacle raises u_1, and with it u.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Bounds, Enclosed, Field, Names
from fenicsx_obstacle.estimation.boundary_data import BoundaryData
from fenicsx_obstacle.estimation.enclosed_data import Division
from fenicsx_obstacle.estimation.obstacle_excess import ObstacleExcess
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.estimation.simplices import Simplices


class Curved(Field):
    """The obstacle less B."""

    def __init__(self, obstacle: Field, simplices: Simplices, bubble: np.ndarray):
        """Subtract B.

        Args:
            obstacle: The obstacle.
            simplices: Intervals.
            bubble: b in each of them.
        """
        self.obstacle, self._simplices, self._bubble = obstacle, simplices, bubble
        self.source, self.text, self.continuous = obstacle.source, obstacle.text, obstacle.continuous
        self.needs_distance = obstacle.needs_distance

    @property
    def pointwise(self) -> bool:
        return self.obstacle.pointwise

    def on(self, level: Any) -> Field:
        return Curved(self.obstacle.on(level), self._simplices, self._bubble)

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        assert cells is not None
        return self.obstacle.at(x, names, cells) - _bubble(self._bubble[cells], self._places(x[0], cells))

    def over(self, corners: np.ndarray, names: Names, cells: np.ndarray) -> Enclosed | None:
        known = self.obstacle.over(corners, names, cells)
        if known is None:
            return None
        ends = self._places(corners[:, :, 0].T, cells).T
        return _CurvedCells(known, corners, ends, self._bubble[cells], self._simplices.area[cells])

    def _places(self, x: np.ndarray, cells: np.ndarray) -> np.ndarray:
        return (x - self._simplices.x[cells, 0, 0]) / self._simplices.area[cells]


def _bubble(b: np.ndarray, t: np.ndarray) -> np.ndarray:
    return 4 * b * t * (1 - t)


@dataclass(frozen=True, eq=False)
class _CurvedCells(Enclosed):
    """Parts of intervals, with t at their ends, and b and the length of the intervals."""

    known: Enclosed
    corners: np.ndarray
    ends: np.ndarray
    bubble: np.ndarray
    length: np.ndarray

    def _at(self, points: np.ndarray, cells: np.ndarray) -> np.ndarray:
        return _bubble(self.bubble[cells, None], self.ends[cells] @ points.T)

    def once(self) -> Bounds:
        bounds, every = self.known.once(), np.arange(len(self.bubble))
        B = polynomials.coefficients(self._at(polynomials.inner_points(2, 2), every), 2, 2)
        margin = polynomials.round_off(B, 2, 2)
        steep = 4 * np.abs(self.bubble) / self.length
        lower = bounds.lower - polynomials.row_max(B) - margin
        upper = bounds.upper - polynomials.row_min(B) + margin
        of_bubble, degree = {1: steep, 2: steep / self.length}, np.maximum(bounds.degree, 2)
        return Bounds(lower, upper, degree, bounds.whole, bounds.defined,
                      lambda k: bounds.derivative(k) + of_bubble.get(k, 0.0))  # fmt: skip

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """With the chord of B, which is b s^2 from it at most where t grows by s."""
        at_corners, rest, steep = self.known.linear(cells)
        size = np.abs(self.bubble[cells])
        s = np.abs(self.ends[cells, 1] - self.ends[cells, 0])
        slope = 4 * size * s / self.length[cells]
        return at_corners - self._at(np.eye(2), cells), rest + size * s**2, steep + slope

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.known.cuts(cells)

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        return self.known.values(degree, cells) - self._at(polynomials.inner_points(2, degree), cells)


class CurvedExcess(ObstacleExcess):
    """The excess of an obstacle less B over the nodal maximum of u_1 and the obstacle."""

    divisions, least_height = (Division(0, 1e-4), Division(4, 1e-4, 1e-4)), -np.inf

    def __init__(
        self, simplices: Simplices, dirichlet: BoundaryData, sign: float, field: Field, known: Pieces,
        linear: np.ndarray, bubble: np.ndarray,
    ):  # fmt: skip
        """Compare it with the state (collective); other arguments are those of `CoveredObstacle` and `Curved`.

        Args:
            linear: u_1 at local dofs.
        """
        low, high = np.minimum(-bubble, 0.0), np.maximum(-bubble, 0.0)
        shifted = Pieces([], known.lower + low, known.upper + high, known.sampled)
        super().__init__(simplices, dirichlet, sign, field, shifted)
        self._field, self._flat = Curved(field, simplices, bubble), False
        self.nodal = np.maximum(self.floor, sign * linear)
        self._compare(shifted)

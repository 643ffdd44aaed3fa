"""Surfaces of measured data: values at points, and bounds over segments and triangles."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import NO_POLYNOMIAL, Bounds, Enclosed

EDGE = 1e-9  # of its size: how far outside the data a point may lie
AT_ONCE = 2_000_000  # values of a table that are looked at together
MARGIN = 1 + 1e-12  # for round-off in bounds of slopes
_ROUND_OFF = 1e-14  # of the largest height: of sums in an interpolant


class Surface(ABC):
    """Piecewise polynomial values over a part of the plane or the line.

    Attributes:
        continuous: Whether it is, for sure; then `bounds` holds over all of a simplex, without samples.
        degree: Of the polynomials.
        low: Least coordinates that it covers, shape (2,).
        high: Largest coordinates.
        spacing: Distance of neighbouring data, the median of all.
    """

    continuous: bool = True
    degree: int
    low: np.ndarray
    high: np.ndarray
    spacing: float

    @abstractmethod
    def at(self, points: np.ndarray) -> np.ndarray:
        """Heights at points, shape (n, 2); not-a-number outside."""

    @abstractmethod
    def beside(self, corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """The distance of the values from linear functions on segments or triangles.

        Args:
            corners: Of the simplices, shape (simplices, corners, 2).
            values: Of the linear functions there, shape (simplices, corners).

        Returns:
            Least and largest difference, the heights less these functions; a bound of its gradient; whether one
            polynomial is the surface all over a simplex; and whether the surface covers it.
        """

    def bounds(self, corners: np.ndarray) -> Bounds:
        """Bounds over segments or triangles, shape (simplices, corners, 2), widened for round-off; `defined` where the
        surface covers them."""
        low, high, steepest, whole, covered = self.beside(corners, np.zeros(corners.shape[:2]))
        margin = _ROUND_OFF * np.maximum(np.abs(low), np.abs(high))
        lower, upper = np.where(covered, low - margin, -np.inf), np.where(covered, high + margin, np.inf)
        whole = whole & covered
        degree = np.where(whole, self.degree, NO_POLYNOMIAL)
        return Bounds(lower, upper, degree, whole, covered, lambda k: steepest * MARGIN if k == 1 else np.inf)

    def cuts(self, corners: np.ndarray) -> np.ndarray:
        """Values at the corners of linear functions that are 0 on a line where polynomials meet; 0 where none is
        known."""
        return np.zeros(corners.shape[:2])


@dataclass(frozen=True, eq=False)
class OnSurface(Enclosed):
    """A surface on simplices.

    Attributes:
        surface: The heights.
        corners: Of the simplices, in the coordinates of the surface.
    """

    surface: Surface
    corners: np.ndarray

    def once(self) -> Bounds:
        return self.surface.bounds(self.corners)

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        corners = self.corners[cells]
        if not len(cells):
            return np.zeros(corners.shape[:2]), np.zeros(0), np.zeros(0)
        values = self.surface.at(corners.reshape(-1, 2)).reshape(corners.shape[:2])
        low, high, steep, *_ = self.surface.beside(corners, values)
        size = np.maximum(polynomials.row_size(values), np.maximum(np.abs(low), np.abs(high)))
        middle = np.zeros(len(cells))  # nothing is known over simplices without a size
        np.add(low / 2, high / 2, out=middle, where=np.isfinite(low))
        return values + middle[:, None], (high - low) / 2 + _ROUND_OFF * size, steep * MARGIN

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = self.surface.cuts(self.corners[cells])
        known = np.ptp(values, axis=1) > 0 if len(cells) else np.zeros(0, dtype=bool)
        return values, np.where(known, 0.0, np.inf)

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        points = polynomials.inner_points(self.corners.shape[1], degree)
        inside = points @ self.corners[cells]
        return self.surface.at(inside.reshape(len(cells) * len(points), 2)).reshape(len(cells), len(points))


def gradients(corners: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Gradients of linear functions on triangles, or along segments, shape (simplices, 2).

    Those on triangles without an area are not numbers, except that of 0.
    """
    edges, rises = corners[:, 1:] - corners[:, :1], values[:, 1:] - values[:, :1]
    with np.errstate(all="ignore"):
        if corners.shape[1] == 2:
            found = edges[:, 0] * (rises[:, 0] / np.sum(edges[:, 0] ** 2, axis=1))[:, None]
        else:
            (a, b), (c, d) = edges[:, 0].T, edges[:, 1].T
            across = np.column_stack([d * rises[:, 0] - b * rises[:, 1], a * rises[:, 1] - c * rises[:, 0]])
            found = across / (a * d - b * c)[:, None]
    return np.where((rises == 0).all(axis=1, keepdims=True), 0.0, found)


def runs(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Items counted row by row: the row of each item, its number within the row, and where rows start."""
    starts = np.cumsum(counts) - counts
    rows = np.repeat(np.arange(len(counts)), counts)
    return rows, np.arange(len(rows)) - starts[rows], starts


def parts(counts: np.ndarray) -> Iterator[slice]:
    """Slices of rows that have `AT_ONCE` items at most, or one row."""
    ends, start = np.cumsum(counts), 0
    while start < len(counts):
        before = ends[start - 1] if start else 0
        end = max(start + 1, int(np.searchsorted(ends, before + AT_ONCE, "right")))
        yield slice(start, end)
        start = end

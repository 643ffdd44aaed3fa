"""Heights on a grid, bilinear in its rectangles, of one axis alone linear between its points; bounds of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import NO_POLYNOMIAL, Bounds, Enclosed

EDGE = 1e-9  # of its size: how far outside the data a point may lie
AT_ONCE = 2_000_000  # values of a table that are looked at together
_FAR = 1e150  # the ends of the other axis of data along one axis
_MARGIN = 1 + 1e-12  # for round-off in bounds of slopes
_ROUND_OFF = 1e-14  # of the largest height: of sums in an interpolant
_SNAP = 1e-11  # of its length: an end of a cell so near a line of the grid is on it


class Grid:
    """Values z at the points of a grid, whose lines need not be at equal distances.

    Attributes:
        low: Least coordinates that it covers, shape (2,).
        high: Largest coordinates.
        spacing: Distance of neighbouring data, the median of all.
    """

    def __init__(self, x: np.ndarray, y: np.ndarray | None, z: np.ndarray):
        """Take it.

        Args:
            x: Ascending, two or more.
            y: In the same form, or None: the heights depend on x alone.
            z: Heights, shape (len(x), len(y)), or (len(x),).
        """
        self.z = np.column_stack([z, z]) if y is None else z
        self.axes = (x, np.array([-_FAR, _FAR]) if y is None else y)
        self.degree = 1 if y is None else 2
        self.low, self.high = (np.array([axis[end] for axis in self.axes]) for end in (0, -1))
        steps = [np.diff(axis) for axis in self.axes]
        self.spacing = float(max(np.median(step) for step in (steps[:1] if y is None else steps)))
        self._slopes = np.diff(self.z, axis=0) / steps[0][:, None], np.diff(self.z, axis=1) / steps[1]

    def at(self, points: np.ndarray) -> np.ndarray:
        """Heights at points, shape (n, 2); not-a-number outside."""
        cells, shares, outside = [], [], np.zeros(len(points), dtype=bool)
        for axis, p in zip(self.axes, points.T, strict=True):
            margin = EDGE * (axis[-1] - axis[0])
            outside |= ~((p >= axis[0] - margin) & (p <= axis[-1] + margin))
            cell = np.clip(np.searchsorted(axis, p, "right") - 1, 0, len(axis) - 2)
            cells.append(cell)
            shares.append(np.clip((p - axis[cell]) / (axis[cell + 1] - axis[cell]), 0.0, 1.0))
        found = self._bilinear(*cells, *shares)
        found[outside] = np.nan
        return found

    def _bilinear(self, i: np.ndarray, j: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        z = self.z
        return (z[i, j] * (1 - s) + z[i + 1, j] * s) * (1 - t) + (z[i, j + 1] * (1 - s) + z[i + 1, j + 1] * s) * t

    def bounds(self, corners: np.ndarray) -> Bounds:
        """Bounds over segments or triangles, shape (simplices, corners, 2), widened for round-off; `defined` where the
        surface covers them."""
        low, high, steepest, whole, covered = self.beside(corners, np.zeros(corners.shape[:2]))
        margin = _ROUND_OFF * np.maximum(np.abs(low), np.abs(high))
        lower, upper = np.where(covered, low - margin, -np.inf), np.where(covered, high + margin, np.inf)
        whole = whole & covered
        degree = np.where(whole, self.degree, NO_POLYNOMIAL)
        return Bounds(lower, upper, degree, whole, covered, lambda k: steepest * _MARGIN if k == 1 else np.inf)

    def beside(self, corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """The distance of the heights from linear functions on segments or triangles: over the boxes around them, whose
        parts in rectangles of the grid are bilinear.

        Args:
            corners: Of the simplices, shape (simplices, corners, 2).
            values: Of the linear functions there, shape (simplices, corners).

        Returns:
            Least and largest difference, the heights less these functions; a bound of its gradient; whether one
            polynomial is the surface all over a simplex; and whether the surface covers it.
        """
        first, last = self._lines(corners)
        low, high, steep = (np.empty(len(corners)) for _ in range(3))
        slope = gradients(corners, values)
        for block in parts(np.prod(last - first + 1, axis=1)):
            found = self._in_boxes(corners[block], values[block, 0], slope[block], first[block], last[block])
            low[block], high[block], steep[block] = found
        unknown = ~np.isfinite(slope).all(axis=1)
        low[unknown], high[unknown], steep[unknown] = -np.inf, np.inf, np.inf
        margin = EDGE * (self.high - self.low)
        covered = np.all((corners >= self.low - margin) & (corners <= self.high + margin), axis=(1, 2))
        return low, high, steep, np.all(last - first == 1, axis=1), covered

    def _in_boxes(
        self, corners: np.ndarray, start: np.ndarray, slope: np.ndarray, first: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Extremes of the values minus linear functions at the corners of all pieces, and a bound of the gradient."""
        wide = last - first + 1
        rows, number, starts = runs(wide[:, 0] * wide[:, 1])
        i, j = first[rows, 0] + number // wide[rows, 1], first[rows, 1] + number % wide[rows, 1]
        ends = np.clip(corners.min(axis=1), self.low, self.high), np.clip(corners.max(axis=1), self.low, self.high)
        points = np.column_stack([
            np.clip(self.axes[n][k], ends[0][rows, n], ends[1][rows, n]) for n, k in enumerate((i, j))
        ])  # fmt: skip
        away = self.at(points) - start[rows] - np.sum(slope[rows] * (points - corners[rows, 0]), axis=1)
        steep = np.zeros(len(corners))
        before = np.minimum(i, last[rows, 0] - 1), np.minimum(j, last[rows, 1] - 1)
        along = self._slopes[0][before[0], j], self._slopes[1][i, before[1]]
        for n, values in enumerate(along):
            there = np.abs(values - slope[rows, n])
            steep = np.hypot(steep, np.maximum.reduceat(there, starts))
        return np.minimum.reduceat(away, starts), np.maximum.reduceat(away, starts), steep

    def _lines(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The lines of the grid that enclose simplices, as their numbers, shape (simplices, 2) each."""
        first, last = (np.empty((len(corners), 2), dtype=np.int64) for _ in range(2))
        for n, axis in enumerate(self.axes):
            x, near = corners[..., n], _SNAP * (axis[-1] - axis[0])
            low, high = x.min(axis=1, initial=np.inf), x.max(axis=1, initial=-np.inf)
            first[:, n] = np.clip(np.searchsorted(axis, low + near, "right") - 1, 0, len(axis) - 2)
            last[:, n] = np.clip(np.searchsorted(axis, high - near, "left"), first[:, n] + 1, len(axis) - 1)
        return first, last

    def cuts(self, corners: np.ndarray) -> np.ndarray:
        """Values at the corners of linear functions that are 0 on a line where polynomials meet: that in the middle of
        those that cross a simplex, of the axis that has more; 0 where none does."""
        first, last = self._lines(corners)
        rows, inner = np.arange(len(corners)), last - first - 1
        across = np.argmax(inner, axis=1)
        middle = (first + last)[rows, across] // 2
        lines = np.where(across == 0, self.axes[0][np.minimum(middle, len(self.axes[0]) - 1)],
                         self.axes[1][np.minimum(middle, len(self.axes[1]) - 1)])  # fmt: skip
        there = np.take_along_axis(corners, across[:, None, None], axis=2)[..., 0] - lines[:, None]
        return np.where(inner[rows, across][:, None] > 0, there, 0.0)


@dataclass(frozen=True, eq=False)
class OnGrid(Enclosed):
    """Heights on a grid, on simplices.

    Attributes:
        grid: The heights.
        corners: Of the simplices, in the coordinates of the grid.
    """

    grid: Grid
    corners: np.ndarray

    def once(self) -> Bounds:
        return self.grid.bounds(self.corners)

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        corners = self.corners[cells]
        if not len(cells):
            return np.zeros(corners.shape[:2]), np.zeros(0), np.zeros(0)
        values = self.grid.at(corners.reshape(-1, 2)).reshape(corners.shape[:2])
        low, high, steep, *_ = self.grid.beside(corners, values)
        size = np.maximum(polynomials.row_size(values), np.maximum(np.abs(low), np.abs(high)))
        middle = np.zeros(len(cells))  # nothing is known over simplices without a size
        np.add(low / 2, high / 2, out=middle, where=np.isfinite(low))
        return values + middle[:, None], (high - low) / 2 + _ROUND_OFF * size, steep * _MARGIN

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = self.grid.cuts(self.corners[cells])
        known = np.ptp(values, axis=1) > 0 if len(cells) else np.zeros(0, dtype=bool)
        return values, np.where(known, 0.0, np.inf)

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        points = polynomials.inner_points(self.corners.shape[1], degree)
        inside = points @ self.corners[cells]
        return self.grid.at(inside.reshape(len(cells) * len(points), 2)).reshape(len(cells), len(points))


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

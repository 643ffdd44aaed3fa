"""Heights on a grid, bilinear in its rectangles; of one axis alone linear between its points."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.data.measured.surface import EDGE, Surface, gradients, parts, runs

_FAR = 1e150  # the ends of the other axis of data along one axis
_SNAP = 1e-11  # of its length: an end of a cell so near a line of the grid is on it


class Grid(Surface):
    """Values z at the points of a grid, whose lines need not be at equal distances."""

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

    def beside(self, corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """As `Surface.beside`, over the boxes around the simplices, whose parts in the grid's rectangles are bilinear.

        Args:
            corners: Of the simplices.
            values: Of linear functions there.
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
        """The line of the grid in the middle of those that cross a simplex, of the axis that has more."""
        first, last = self._lines(corners)
        rows, inner = np.arange(len(corners)), last - first - 1
        across = np.argmax(inner, axis=1)
        middle = (first + last)[rows, across] // 2
        lines = np.where(across == 0, self.axes[0][np.minimum(middle, len(self.axes[0]) - 1)],
                         self.axes[1][np.minimum(middle, len(self.axes[1]) - 1)])  # fmt: skip
        there = np.take_along_axis(corners, across[:, None, None], axis=2)[..., 0] - lines[:, None]
        return np.where(inner[rows, across][:, None] > 0, there, 0.0)

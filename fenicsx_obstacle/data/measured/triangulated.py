"""Heights on triangles: scattered points, and the facets of a surface in space."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.data.measured.grid import EDGE, parts, runs

_INSIDE = 1e-9  # how far a barycentric coordinate may be below 0


class Triangulated:
    """Linear on triangles; where some lie above others the highest counts. It is known by samples alone.

    Attributes:
        low: As those of `Grid`.
        high: Too.
        spacing: Too.
    """

    def __init__(self, points: np.ndarray, z: np.ndarray, triangles: np.ndarray):
        """Take them.

        Args:
            points: Shape (n, 2).
            z: Heights there.
            triangles: Numbers of their points, shape (m, 3); those without an area are not included.

        Raises:
            ValueError: If none has one.
        """
        x = points[triangles]
        a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
        longest = np.maximum(np.sum(a**2, axis=1), np.sum(b**2, axis=1))
        wide = np.abs(_cross(a, b)) > 1e-12 * longest
        if not wide.any():
            raise ValueError("no triangle has an area")
        self._x, self._z = x[wide], z[triangles[wide]]
        self.low, self.high = self._x.min(axis=(0, 1)), self._x.max(axis=(0, 1))
        self.spacing = float(np.median(np.sqrt(longest[wide])))
        self._sort()

    def _sort(self) -> None:
        """Put the triangles into boxes of a grid, about one for each triangle."""
        count, size = len(self._x), self.high - self.low
        per_axis = np.sqrt(count * size / size[::-1])
        self._boxes = np.clip(per_axis.astype(np.int64), 1, 4096)
        first, last = self._box(self._x.min(axis=1)), self._box(self._x.max(axis=1))
        wide = last - first + 1
        rows, number, _ = runs(wide[:, 0] * wide[:, 1])
        across, up = first[rows, 0] + number // wide[rows, 1], first[rows, 1] + number % wide[rows, 1]
        box = np.ravel_multi_index((across, up), self._boxes)
        order = np.argsort(box, kind="stable")
        self._items = rows[order]
        self._starts = np.searchsorted(box[order], np.arange(np.prod(self._boxes) + 1))

    def _box(self, points: np.ndarray) -> np.ndarray:
        """The box of each point, shape (n, 2)."""
        share = (points - self.low) / (self.high - self.low)
        return np.clip((share * self._boxes).astype(np.int64), 0, self._boxes - 1)

    def _weights(self, rows: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Barycentric coordinates of points (n, 2) in triangles (n,), shape (n, 3)."""
        x = self._x[rows]
        a, b, there = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0], points - x[:, 0]
        second, third = _cross(there, b) / _cross(a, b), _cross(a, there) / _cross(a, b)
        return np.stack([1 - second - third, second, third], axis=-1)

    def at(self, points: np.ndarray) -> np.ndarray:
        """Heights at points, shape (n, 2); not-a-number outside."""
        margin = EDGE * (self.high - self.low)
        box = self._box(points)
        number = np.ravel_multi_index(tuple(box.T), self._boxes)
        counts = (self._starts[number + 1] - self._starts[number]) * np.all(
            (points >= self.low - margin) & (points <= self.high + margin), axis=1
        )
        found = np.full(len(points), -np.inf)
        for block in parts(counts):
            rows, k, _ = runs(counts[block])
            item = self._items[self._starts[number[block]][rows] + k]
            weights = self._weights(item, points[block][rows])
            inside = weights.min(axis=1, initial=np.inf) >= -_INSIDE
            heights = np.sum(weights * self._z[item], axis=1)
            there = found[block]
            np.maximum.at(there, rows[inside], heights[inside])
        return np.where(np.isfinite(found), found, np.nan)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The areas that vectors (n, 2) span, with their sign."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

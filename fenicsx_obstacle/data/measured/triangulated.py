"""Heights on triangles: scattered points, and the facets of a surface in space."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.data.measured.surface import EDGE, Surface, gradients, parts, runs

_INSIDE = 1e-9  # how far a barycentric coordinate may be below 0
_NEAR_WHOLE = 1e-12  # the same of the corners of a cell that is said to lie in one triangle
_ROUND_OFF = 1e-12  # of differences of planes, where triangles are thin
_TURN = 1e-9  # how far the sum of angles may be from a whole turn


class Triangulated(Surface):
    """Linear on triangles; where some lie above others the highest counts.

    Bounds hold where the triangles fill a convex set and do not overlap; otherwise it is known by samples alone.
    """

    degree = 1

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
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        longest = np.maximum(np.sum(a**2, axis=1), np.sum(b**2, axis=1))
        wide = np.abs(cross) > 1e-12 * longest
        if not wide.any():
            raise ValueError("no triangle has an area")
        self._members = np.where(cross[:, None] > 0, triangles, triangles[:, ::-1])[wide]
        self._x, self._z = points[self._members], z[self._members]
        self._slope = gradients(self._x, self._z)
        self.low, self.high = self._x.min(axis=(0, 1)), self._x.max(axis=(0, 1))
        self.spacing = float(np.median(np.sqrt(longest[wide])))
        self.continuous = _fills_convex_set(points, self._members)
        self._sort()

    def _sort(self) -> None:
        """Put the triangles into boxes of a grid, about one for each triangle."""
        count, size = len(self._x), self.high - self.low
        per_axis = np.sqrt(count * size / size[::-1])
        self._boxes = np.clip(per_axis.astype(np.int64), 1, 4096)
        first, last = self._box(self._x.min(axis=1)), self._box(self._x.max(axis=1))
        rows, box = self._listed(first, last)
        order = np.argsort(box, kind="stable")
        self._items = rows[order]
        self._starts = np.searchsorted(box[order], np.arange(np.prod(self._boxes) + 1))

    def _box(self, points: np.ndarray) -> np.ndarray:
        """The box of each point, shape (n, 2)."""
        share = (points - self.low) / (self.high - self.low)
        return np.clip((share * self._boxes).astype(np.int64), 0, self._boxes - 1)

    def _listed(self, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows and numbers of all boxes between the first and the last of each row."""
        wide = last - first + 1
        rows, number, _ = runs(wide[:, 0] * wide[:, 1])
        across, up = first[rows, 0] + number // wide[rows, 1], first[rows, 1] + number % wide[rows, 1]
        return rows, np.ravel_multi_index((across, up), self._boxes)

    def _weights(self, rows: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Barycentric coordinates of points (n, ..., 2) in triangles (n,), shape (n, ..., 3)."""
        x = self._x[rows]
        shape = (len(rows), *(1,) * (points.ndim - 2))
        a, b, there = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0], points - x[:, 0].reshape(*shape, 2)
        cross = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).reshape(shape)
        a, b = a.reshape(*shape, 2), b.reshape(*shape, 2)
        second = (there[..., 0] * b[..., 1] - there[..., 1] * b[..., 0]) / cross
        third = (a[..., 0] * there[..., 1] - a[..., 1] * there[..., 0]) / cross
        return np.stack([1 - second - third, second, third], axis=-1)

    def at(self, points: np.ndarray) -> np.ndarray:
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

    def beside(self, corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
        first, last = self._box(corners.min(axis=1)), self._box(corners.max(axis=1))
        slope = gradients(corners, values)
        found = tuple(np.empty(len(corners)) for _ in range(3)) + tuple(np.empty((2, len(corners)), dtype=bool))
        # about as many triangles as boxes
        for block in parts(np.prod(last - first + 1, axis=1)):
            seen = self._in_boxes(corners[block], values[block], slope[block], first[block], last[block])
            for whole, part in zip(found, seen, strict=True):
                whole[block] = part
        return found

    def _in_boxes(
        self, corners: np.ndarray, values: np.ndarray, slope: np.ndarray, first: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        rows, box = self._listed(first, last)
        again, k, _ = runs(self._starts[box + 1] - self._starts[box])
        item, rows = self._items[self._starts[box][again] + k], rows[again]
        shape = len(corners), len(self._x)
        rows, item = np.unravel_index(np.unique(np.ravel_multi_index((rows, item), shape)), shape)
        weights = self._weights(item, corners[rows])  # of the corners of a simplex in a triangle
        meets = np.all(weights.max(axis=1) >= -_INSIDE, axis=1)
        rows, item, weights = rows[meets], item[meets], weights[meets]
        # both planes differ by a linear function: extremes at the corners of the simplex, and of the triangle
        at_corners = weights @ self._z[item][..., None]
        one = at_corners[..., 0] - values[rows]
        linear = np.sum(slope[rows, None] * (self._x[item] - corners[rows, None, 0]), axis=2) + values[rows, :1]
        other = self._z[item] - linear
        known = np.isfinite(other).all(axis=1)
        least = np.where(known, np.maximum(one.min(axis=1), other.min(axis=1)), one.min(axis=1))
        most = np.where(known, np.minimum(one.max(axis=1), other.max(axis=1)), one.max(axis=1))
        size = np.abs(at_corners).max(axis=(1, 2)) + np.abs(self._z[item]).max(axis=1)
        size += np.where(known, np.abs(linear).max(axis=1), 0.0)
        some = most >= least - _ROUND_OFF * size  # otherwise the triangle does not meet the simplex
        low, high, steep = (np.full(len(corners), end) for end in (np.inf, -np.inf, 0.0))
        np.minimum.at(low, rows[some], np.minimum(least, most)[some])
        np.maximum.at(high, rows[some], np.maximum(least, most)[some])
        away = np.hypot(*(self._slope[item] - slope[rows]).T)
        np.maximum.at(steep, rows, np.where(np.isfinite(away), away, np.inf))
        whole, covered = np.zeros(len(corners), dtype=bool), np.zeros(corners.shape[:2], dtype=bool)
        np.logical_or.at(whole, rows, weights.min(axis=(1, 2)) >= -_NEAR_WHOLE)
        np.logical_or.at(covered, rows, weights.min(axis=2) >= -_INSIDE)
        return low, high, steep, whole, covered.all(axis=1) & np.isfinite(low)


def _fills_convex_set(points: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether triangles, all turning left, cover a convex set once.

    Each side is that of two triangles that run along it in opposite directions, or of one; the latter go once round a
    convex polygon. As every triangle turns left, each point inside then lies in as many triangles as the polygon winds
    around it: one.
    """
    sides, shape = (
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]),
        (len(points),) * 2,
    )
    forth, back = (np.ravel_multi_index(ends, shape) for ends in (sides.T, sides.T[::-1]))
    if len(np.unique(forth)) < len(forth):
        return False
    rim = sides[~np.isin(back, forth)]
    if len(rim) < 3 or len(np.unique(rim[:, 0])) < len(rim) or set(rim[:, 0]) != set(rim[:, 1]):
        return False
    follows = dict(rim.tolist())
    start = at = int(rim[0, 0])
    loop = [start]
    while (at := follows[at]) != start:
        loop.append(at)
    if len(loop) < len(rim):
        return False
    x = points[loop]
    edges = np.roll(x, -1, axis=0) - x
    after = np.roll(edges, -1, axis=0)
    cross = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    turns = np.arctan2(cross, np.sum(edges * after, axis=1))
    return bool(np.all(turns >= -_TURN) and abs(turns.sum() - 2 * np.pi) < 1e-6)

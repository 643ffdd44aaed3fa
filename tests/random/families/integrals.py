"""True energy errors by quadrature on triangles that are cut where the data jump, along lines and circles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import basix
import numpy as np

from tests.random.families.elements import Field, areas

DEEPEST = 80  # how often pieces are halved
MOST = 16000  # pieces that circles cross
FLAT = 1e-14  # area over squared diameter of what cuts through vertices leave by round-off
FEWEST = 3  # Gauss points in each direction of small pieces
BLOCK = 20000  # points at which functions are evaluated at once
ALONG = 12  # Gauss points in each part of an interval


@dataclass(frozen=True)
class Pieces:
    """Triangles that fill cells.

    Attributes:
        cells: The cell that holds each of them.
        corners: Shape (pieces, 3, 2).
    """

    cells: np.ndarray
    corners: np.ndarray

    @classmethod
    def of(cls, field: Field) -> Pieces:
        """The cells; quadrilaterals in two halves."""
        vertices = field.vertices
        halves = [[0, 1, 2]] if vertices.shape[1] == 3 else [[0, 1, 2], [1, 3, 2]]
        cells = np.arange(len(vertices))
        return cls(np.tile(cells, len(halves)), np.concatenate([vertices[:, half] for half in halves]))

    def cut(self, direction: tuple[float, float], places: Sequence[float] | np.ndarray) -> Pieces:
        """Cut along the lines direction . (x, y) = place, places rising."""
        if not len(places) or not len(self.cells):
            return self
        middle = len(places) // 2
        found = self._cut(self.corners @ np.array(direction) - places[middle])
        above = found.corners.mean(axis=1) @ np.array(direction) > places[middle]
        sides = ((~above, places[:middle]), (above, places[middle + 1 :]))
        parts = [Pieces(found.cells[side], found.corners[side]).cut(direction, rest) for side, rest in sides]
        return Pieces(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("cells", "corners")))

    def _cut(self, height: np.ndarray) -> Pieces:
        """Cut where heights of the corners, linear between these, are 0."""
        above = height > 0
        count = above.sum(axis=1)
        whole = (count == 0) | (count == 3)
        crossed = np.flatnonzero(~whole)
        # the vertex that is alone on its side comes first
        alone = np.where(count[crossed] == 1, above[crossed].argmax(axis=1), above[crossed].argmin(axis=1))
        order = (alone[:, None] + np.arange(3)) % 3
        corners = self.corners[crossed[:, None], order]
        height = height[crossed[:, None], order]
        share = height[:, :1] / (height[:, :1] - height[:, 1:])
        p, q = (corners[:, 0] + share[:, [k]] * (corners[:, 1 + k] - corners[:, 0]) for k in (0, 1))
        a, b, c = (corners[:, k] for k in range(3))
        parts = [np.stack(part, axis=1) for part in ((a, p, q), (p, b, c), (p, c, q))]
        return Pieces(
            np.concatenate([self.cells[whole], *[self.cells[crossed]] * 3]),
            np.concatenate([self.corners[whole], *parts]),
        )

    def along(self, circles: Sequence[Circle], poles: Sequence[tuple[float, float]] = (), count: int = 8) -> Nodes:
        """Gauss points on these pieces, ever smaller ones towards circles and points: the last pieces that circles
        cross are cut by chords, the last ones at points are omitted.

        Args:
            circles: They need not meet a piece.
            poles: Points towards which functions are singular.
            count: Gauss points in each direction, of pieces that are not halved.
        """
        edges = np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
        rest, found = self[areas(self.corners) > FLAT * edges**2], []
        for level in range(DEEPEST):
            middle = rest.corners.mean(axis=1)
            radius = np.linalg.norm(rest.corners - middle[:, None], axis=2).max(axis=1, initial=0.0)
            near, crossed = np.zeros((2, len(middle)), dtype=bool)
            for pole in poles:
                near |= np.linalg.norm(middle - pole, axis=1) <= 2 * radius
            for circle in circles:
                crossed |= np.abs(circle.distance(middle)) <= radius
            found.append(rest[~near & ~crossed].nodes(count if poles else max(count - level, FEWEST)))
            if np.count_nonzero(crossed) > MOST:
                last, crossed = rest[crossed & ~near], near
                for circle in circles:
                    last = last._cut(circle.distance(last.corners))
                found.append(last.nodes(FEWEST))
            rest = rest[near | crossed]._halved()
            if not len(rest.cells):
                break
        return Nodes.joined(found)

    def _halved(self) -> Pieces:
        """Each in two by the middle of its longest edge: flat triangles become less so."""
        edges = np.linalg.norm(self.corners - np.roll(self.corners, -1, axis=1), axis=2)
        order = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(self.corners, order[..., None], axis=1), 1, 0)
        middle = (a + b) / 2
        parts = [np.stack(part, axis=1) for part in ((a, middle, c), (middle, b, c))]
        return Pieces(np.tile(self.cells, 2), np.concatenate(parts))

    def nodes(self, count: int) -> Nodes:
        """Gauss points on these pieces."""
        points, weights = gauss(basix.CellType.triangle, 2 * count - 2)
        return Nodes(np.repeat(self.cells, len(weights)),
                     np.einsum("qk,pkd->pqd", points, self.corners).reshape(-1, 2),
                     (areas(self.corners)[:, None] * weights).ravel())  # fmt: skip

    def __getitem__(self, chosen: np.ndarray) -> Pieces:
        return Pieces(self.cells[chosen], self.corners[chosen])


@dataclass(frozen=True)
class Nodes:
    """Points of a quadrature.

    Attributes:
        cells: The cell that holds each.
        points: Shape (n, dimension).
        weights: Not negative; their sum is the area, or the length.
    """

    cells: np.ndarray
    points: np.ndarray
    weights: np.ndarray

    @property
    def coordinates(self) -> tuple[np.ndarray, np.ndarray]:
        """x and y; on an interval y is 0."""
        x, *rest = self.points.T
        return x, rest[0] if rest else np.zeros(len(x))

    def __getitem__(self, chosen: np.ndarray) -> Nodes:
        return Nodes(self.cells[chosen], self.points[chosen], self.weights[chosen])

    @classmethod
    def joined(cls, parts: Sequence[Nodes]) -> Nodes:
        """All of these."""
        return cls(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("cells", "points", "weights")))


@dataclass(frozen=True)
class Circle:
    """A circle in the plane; 'below' it is inside of it.

    Attributes:
        middle: Its centre.
        radius: Positive.
    """

    middle: tuple[float, float]
    radius: float

    def distance(self, points: np.ndarray) -> np.ndarray:
        """From it, with a sign; of points, shape (..., 2)."""
        return np.linalg.norm(points - self.middle, axis=-1) - self.radius

    def below(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (x - self.middle[0]) ** 2 + (y - self.middle[1]) ** 2 < self.radius**2

    def sides(self, spelling: int) -> tuple[str, str]:
        """What is compared."""
        (a, b), R = self.middle, self.radius
        if spelling % 2:
            return f"((x - ({a!r}))^2 + (y - ({b!r}))^2)", f"({R**2!r})"
        return f"hypot(x - ({a!r}), y - ({b!r}))", f"({R!r})"


def gauss(cell: basix.CellType, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points and weights of sum 1 on a triangle or a tetrahedron."""
    points, weights = basix.make_quadrature(cell, degree)
    return np.column_stack([1 - points.sum(axis=1), points]), weights / weights.sum()


def intervals(field: Field, places: Sequence[float]) -> Nodes:
    """Gauss points on the cells of an interval, between places that rise."""
    ends, cells = np.sort(field.vertices[:, :, 0], axis=1), np.repeat(np.arange(len(field.vertices)), ALONG)
    t, weights = np.polynomial.legendre.leggauss(ALONG)
    found = []
    for low, high in pairwise([-np.inf, *places, np.inf]):
        start, end = np.clip(ends, low, high).T[:, :, None]
        points = start + (end - start) * (t + 1) / 2
        found.append(Nodes(cells, points.reshape(-1, 1), ((end - start) * weights / 2).ravel()))
    return Nodes.joined(found)

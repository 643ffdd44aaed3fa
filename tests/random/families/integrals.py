"""True energy errors by quadrature on triangles that are cut where the data jump, along lines and circles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import basix
import numpy as np

from tests.random.families.elements import Field, areas

DEEPEST = 80  # how often pieces are divided,
STEEP = 4.0  # sine of an angle at least, times radius over size
FLAT = 1e-14  # area over squared diameter of what cuts through vertices leave by round-off
TANGENT = 36  # and where a circle touches an edge
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
        found = self._cut(np.array(direction), places[middle])
        above = found.corners.mean(axis=1) @ np.array(direction) > places[middle]
        sides = ((~above, places[:middle]), (above, places[middle + 1 :]))
        parts = [Pieces(found.cells[side], found.corners[side]).cut(direction, rest) for side, rest in sides]
        return Pieces(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("cells", "corners")))

    def _cut(self, direction: np.ndarray, place: float) -> Pieces:
        height = self.corners @ direction - place
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
        """Gauss points on these pieces, which are cut along circles and ever smaller towards points.

        Pieces that no circle crosses, or one that cuts off a corner, are integrated; others are halved again and again,
        and the last ones are omitted.

        Args:
            circles: They need not meet a piece.
            poles: Points towards which functions are singular.
            count: Gauss points in each direction.
        """
        edges = np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
        rest, found = self[areas(self.corners) > FLAT * edges**2], []
        for level in range(DEEPEST):
            middle = rest.corners.mean(axis=1)
            radius = np.linalg.norm(rest.corners - middle[:, None], axis=2).max(axis=1, initial=0.0)
            open_ = np.zeros(len(middle), dtype=bool)
            for pole in poles:
                open_ |= np.linalg.norm(middle - pole, axis=1) <= 2 * radius
            near_pole = open_.copy()
            crossed = [circle.crosses(rest.corners) for circle in circles]
            open_ |= np.sum(crossed, axis=0) > 1 if crossed else False
            whole = ~open_ & ~np.any(crossed, axis=0) if crossed else ~open_
            found.append(rest[whole].nodes(count))
            for circle, cut in zip(circles, crossed, strict=True):
                chosen = np.flatnonzero(cut & ~open_)
                regular, nodes = circle.divide(rest[chosen], count)
                found.append(nodes)
                open_[chosen[~regular]] = True
            rest = rest[open_ if level < TANGENT else near_pole]._halved()
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

    def below(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (x - self.middle[0]) ** 2 + (y - self.middle[1]) ** 2 < self.radius**2

    def sides(self, spelling: int) -> tuple[str, str]:
        """What is compared."""
        (a, b), R = self.middle, self.radius
        if spelling % 2:
            return f"((x - ({a!r}))^2 + (y - ({b!r}))^2)", f"({R**2!r})"
        return f"hypot(x - ({a!r}), y - ({b!r}))", f"({R!r})"

    def crosses(self, triangles: np.ndarray) -> np.ndarray:
        """Whether it meets triangles, shape (n, 3, 2), which are on one side of it otherwise."""
        outside = np.linalg.norm(triangles - self.middle, axis=2) > self.radius
        return ~outside.all(axis=1) & outside.any(axis=1) | outside.all(axis=1) & (
            self._nearest(triangles) < self.radius
        )

    def _nearest(self, triangles: np.ndarray) -> np.ndarray:
        """Distance of triangles from the centre."""
        start, along = triangles, np.roll(triangles, -1, axis=1) - triangles
        to = np.asarray(self.middle) - start
        length = np.maximum((along**2).sum(axis=2), 1e-300)
        share = np.clip((to * along).sum(axis=2) / length, 0, 1)
        across = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
        inside = (across > 0).all(axis=1) | (across < 0).all(axis=1)
        return np.where(inside, 0.0, np.linalg.norm(to - share[..., None] * along, axis=2).min(axis=1, initial=np.inf))

    def divide(self, pieces: Pieces, count: int) -> tuple[np.ndarray, Nodes]:
        """Gauss points on both sides of the circle, where it cuts one corner off.

        Near the corner A lie the points A + s (c - A), c on the arc from one edge to the other, 0 < s < 1; beyond the
        arc those between c and the point of the opposite edge with the same parameter.

        Args:
            pieces: Triangles that it crosses.
            count: Gauss points in each direction.

        Returns:
            Whether it is so for each, and the points on those.
        """
        outside = np.linalg.norm(pieces.corners - self.middle, axis=2) > self.radius
        number = outside.sum(axis=1)
        alone = np.where(number == 1, outside.argmax(axis=1), outside.argmin(axis=1))
        order = (alone[:, None] + np.arange(3)) % 3
        corners = np.take_along_axis(pieces.corners, order[..., None], axis=1)
        a, b, c = (corners[:, k] for k in range(3))
        opposite = np.stack([b, c, c], axis=1)
        regular = (number == 1) | (number == 2) & (self._nearest(opposite) > self.radius)
        a, b, c = a[regular, None], b[regular, None], c[regular, None]
        inward = (number == 2)[regular, None]  # A is inside of the circle
        t, w = np.polynomial.legendre.leggauss(count)
        t, w = (t + 1) / 2, w / 2
        p, q = (a + self._reach(a, edge - a, inward)[..., None] * (edge - a) for edge in (b, c))
        chord = p + np.concatenate([[0.0, 1.0], t])[:, None] * (q - p) - a
        reach = self._reach(a, chord, inward)[..., None]
        arc = reach * chord
        normal = a + arc - self.middle
        # rays from A meet the arc at angles beside which it is nearly straight
        size = np.linalg.norm(np.concatenate([b - a, c - a, c - b], axis=1), axis=2).max(axis=1, initial=0.0)
        steep = np.abs((normal * chord).sum(axis=2)) > STEEP * size[:, None] * np.linalg.norm(chord, axis=2)
        regular[regular] = steep.all(axis=1)
        chosen = steep.all(axis=1)
        a, b, c, p, q = (point[chosen] for point in (a, b, c, p, q))
        chord, reach, arc, normal = (value[chosen, 2:] for value in (chord, reach, arc, normal))
        turn = -reach * (normal * (q - p)).sum(axis=2, keepdims=True) / (normal * chord).sum(axis=2, keepdims=True)
        along = turn * chord + reach * (q - p)  # derivative of the arc
        edge = b + t[:, None] * (c - b) - a
        s = t[:, None]
        near = _cross(arc, along)
        points = [a[:, :, None] + s * arc[:, :, None], a[:, :, None] + (1 - s) * arc[:, :, None] + s * edge[:, :, None]]
        beyond = _cross((edge - arc)[:, :, None], (1 - s) * along[:, :, None] + s * (c - b)[:, :, None])
        sign = np.sign(_cross(b - a, c - a))
        densities = [near[:, :, None] * t * sign[..., None], beyond * sign[..., None]]
        cells = np.repeat(pieces.cells[regular], count**2)
        return regular, Nodes.joined([
            Nodes(cells, x.reshape(-1, 2), (density * w[:, None] * w).ravel())
            for x, density in zip(points, densities, strict=True)
        ])  # fmt: skip

    def _reach(self, a: np.ndarray, along: np.ndarray, inward: np.ndarray) -> np.ndarray:
        """The s for which a + s along is on the circle: the only one if a is inside, otherwise the first."""
        from_middle = a - self.middle
        A, B = (along**2).sum(axis=2), (from_middle * along).sum(axis=2)
        C = (from_middle**2).sum(axis=2) - self.radius**2
        root = np.sqrt(np.maximum(B**2 - A * C, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):  # where A is on the circle itself
            return np.where(inward == (B < 0), (np.abs(B) + root) / A, -C / (B + np.where(B < 0, -root, root)))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


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

"""True energy errors by quadrature on triangles that are cut where the data jump."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fenicsx_obstacle.studies.hard.families.elements import Field, areas

Scalar = Callable[[np.ndarray, np.ndarray], np.ndarray]
Vector = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


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

    def refined(self, crossed: Callable[[np.ndarray, np.ndarray], np.ndarray], levels: int) -> Pieces:
        """Divide those that are crossed into four, again and again, and leave out what is crossed at last.

        Args:
            crossed: From middles and radii of pieces, whether each may be.
            levels: How often.
        """
        kept, rest = [], self
        for level in range(levels + 1):
            middle = rest.corners.mean(axis=1)
            radius = np.linalg.norm(rest.corners - middle[:, None], axis=2).max(axis=1, initial=0.0)
            hit = crossed(middle, radius)
            kept.append(Pieces(rest.cells[~hit], rest.corners[~hit]))
            if level < levels:
                rest = Pieces(rest.cells[hit], rest.corners[hit])._quartered()
        return Pieces(np.concatenate([k.cells for k in kept]), np.concatenate([k.corners for k in kept]))

    def _quartered(self) -> Pieces:
        a, b, c = (self.corners[:, k] for k in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        return Pieces(np.tile(self.cells, 4), np.concatenate(parts))


def gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points and weights of sum 1 on a triangle, exact to degree 2 count - 2."""
    t, w = np.polynomial.legendre.leggauss(count)
    t, w = (t + 1) / 2, w / 2
    first, second = np.repeat(t, count), np.tile(t, count)
    points = np.column_stack([first, (1 - first) * second, (1 - first) * (1 - second)])
    return points, 2 * np.repeat(w, count) * np.tile(w, count) * (1 - first)


def energy_error(
    field: Field, pieces: Pieces, tension: Scalar, gradient: Vector, count: int = 4
) -> tuple[float, float]:
    """||tension^(1/2) grad(u - u_h)|| and ||tension^(1/2) grad u|| on the pieces (collective).

    Args:
        field: u_h.
        pieces: Inside of each tension and gradient are smooth.
        tension: Of x and y.
        gradient: Of u.
        count: Gauss points in each direction.
    """
    points, weights = gauss(count)
    found = np.zeros(2)
    for part in np.array_split(np.arange(len(pieces.cells)), max(1, len(pieces.cells) // 20000)):
        x = np.einsum("qk,pkd->pqd", points, pieces.corners[part])
        weight = areas(pieces.corners[part])[:, None] * weights * tension(x[..., 0], x[..., 1])
        true = np.stack(np.broadcast_arrays(*gradient(x[..., 0], x[..., 1])), axis=2)
        off = field.gradient(pieces.cells[part], x) - true
        found += (weight * (off**2).sum(axis=2)).sum(), (weight * (true**2).sum(axis=2)).sum()
    error, norm = np.sqrt(field.comm.allreduce(found))
    return float(error), float(norm)

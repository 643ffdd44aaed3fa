"""Parts of segments, triangles and tetrahedra: halved, or cut along lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.estimation.simplex_geometry import least_heights
from fenicsx_obstacle.mesh.cells import longest_edges

CLOSE = 1e-12  # of the range of a linear function over a part: where it is so near a level, it is there
EMPTY = 1e-14  # share of a part that is round-off


class Arrays:
    """A dataclass of arrays with as many rows each, and of what all rows share."""

    def __getitem__(self, chosen: np.ndarray | slice) -> Self:
        """Some of the rows."""
        return self._with({name: values[chosen] for name, values in self._arrays.items()})

    def and_(self, *others: Self) -> Self:
        """These rows and others."""
        every = [self._arrays, *(other._arrays for other in others)]
        return self._with({name: np.concatenate([arrays[name] for arrays in every]) for name in every[0]})

    def _with(self, arrays: dict[str, np.ndarray]) -> Self:
        return type(self)(**{**vars(self), **arrays})

    @property
    def _arrays(self) -> dict[str, np.ndarray]:
        return {name: values for name, values in vars(self).items() if isinstance(values, np.ndarray)}


@dataclass(frozen=True, eq=False)
class Parts(Arrays):
    """Parts of simplices.

    Attributes:
        rows: The simplex that each is a part of.
        cells: The owned cell.
        x: Corners, shape (parts, corners, coordinates).
        inside: Their barycentric coordinates in the simplex; None: each part is a simplex itself.
        share: Of its measure.
        least: Lower bound of a datum there.
        most: Upper bound.
    """

    rows: np.ndarray
    cells: np.ndarray
    x: np.ndarray
    inside: np.ndarray | None
    share: np.ndarray
    least: np.ndarray
    most: np.ndarray

    @classmethod
    def whole(cls, x: np.ndarray, cells: np.ndarray) -> Parts:
        """Simplices as they are, with nothing known of the datum."""
        share, least, most = (np.broadcast_to(number, len(cells)) for number in (1.0, -np.inf, np.inf))
        return cls(np.arange(len(cells)), cells, x, None, share, least, most)

    @property
    def size(self) -> int:
        """Number of corners of each part."""
        return self.x.shape[1]

    @property
    def times(self) -> int:
        """Number of parts into which one is halved."""
        return 2 ** (self.size - 1)

    def _replaced(self, source: np.ndarray, x: np.ndarray, inside: np.ndarray, share: np.ndarray) -> Parts:
        """Parts of these parts."""
        rows, cells, least, most = (a[source] for a in (self.rows, self.cells, self.least, self.most))
        return Parts(rows, cells, x, inside, self.share[source] * share, least, most)

    @property
    def places(self) -> np.ndarray:
        """`inside`, of whole simplices too."""
        if self.inside is not None:
            return self.inside
        return np.broadcast_to(np.eye(self.size), (len(self.rows), self.size, self.size))

    def halved(self) -> Parts:
        """With their edges halved."""
        source = np.repeat(np.arange(len(self.rows)), self.times)
        share = np.full(len(source), 1 / self.times)
        return self._replaced(source, polynomials.halved(self.x), polynomials.halved(self.places), share)

    def cut(self, values: np.ndarray, levels: np.ndarray) -> Parts:
        """Cut where linear functions are at given distances from 0, on both sides.

        Args:
            values: Of the functions at the corners, shape (parts, corners).
            levels: Shape (parts,).
        """
        above, values, levels = self._cut(values, levels)
        return above._cut(values, -levels)[0]

    def _cut(self, values: np.ndarray, levels: np.ndarray) -> tuple[Parts, np.ndarray, np.ndarray]:
        """Where the functions are at these levels: the parts, values and the absolute levels there."""
        low, high = values.min(axis=1, initial=np.inf), values.max(axis=1, initial=-np.inf)
        close = CLOSE * (high - low)
        crossed = (low < levels - close) & (high > levels + close)
        kept, rows = np.flatnonzero(~crossed), np.flatnonzero(crossed)
        above = values[rows] > levels[rows, None]
        found = []  # parts cut, and weights of the corners of each of their parts
        for count in range(1, self.size):
            chosen = np.flatnonzero(above.sum(axis=1) == count)
            if not len(chosen):
                continue
            # the corners on the side that has fewer come first
            first = above[chosen] == (2 * count <= self.size)
            order = np.argsort(~first, axis=1, kind="stable")
            there = np.take_along_axis(values[rows[chosen]], order, axis=1)
            found += _cut_along(
                rows[chosen], there, levels[rows[chosen]], np.eye(self.size)[order], min(count, self.size - count)
            )
        source = np.concatenate([kept, *(part for part, _ in found)])
        whole = np.broadcast_to(np.eye(self.size), (len(kept), self.size, self.size))
        weights = np.concatenate([whole, *(part for _, part in found)])
        share = np.concatenate([np.ones(len(kept)), *(np.abs(np.linalg.det(part)) for _, part in found)])
        filled = share > EMPTY  # where a line runs through a corner some have none, or only round-off,
        small = np.flatnonzero(~filled & (share > 0))  # unless they are small in all directions
        whole_x = self.x[source[small]]
        filled[small] = least_heights(weights[small] @ whole_x) > CLOSE * longest_edges(whole_x)
        source, weights, share = source[filled], weights[filled], share[filled]
        parts = self._replaced(source, weights @ self.x[source], weights @ self.places[source], share)
        return parts, (weights @ values[source][..., None])[..., 0], np.abs(levels[source])


# the parts of simplices by how many corners are on one side: these come first. After the corners stand the places where
# edges from the first ones to the others are cut
_PRISM = ((0, 1, 2, 5), (0, 1, 4, 5), (0, 3, 4, 5))
_PIECES: dict[tuple[int, int], list[tuple[int, ...]]] = {
    (2, 1): [(0, 2), (2, 1)],
    (3, 1): [(0, 3, 4), (3, 1, 2), (3, 2, 4)],
    (4, 1): [(0, 4, 5, 6), *(tuple((4, 5, 6, 1, 2, 3)[k] for k in part) for part in _PRISM)],
    (4, 2): [tuple(prism[k] for k in part) for prism in ((0, 4, 5, 1, 6, 7), (2, 4, 6, 3, 5, 7)) for part in _PRISM],
}


def _cut_along(
    rows: np.ndarray, values: np.ndarray, levels: np.ndarray, corners: np.ndarray, first: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Simplices cut where linear functions have given values.

    Args:
        rows: Which they are.
        values: At their corners, the first ones on one side.
        levels: Of the cuts.
        corners: Weights of the corners, in the same order.
        first: How many corners are on that side.

    Returns:
        Of the parts at each place: which simplices they are of, and the weights of their corners.
    """
    size = values.shape[1]
    points = [corners]
    for i in range(first):
        for j in range(first, size):
            t = np.clip((levels - values[:, i]) / (values[:, j] - values[:, i]), 0.0, 1.0)[:, None]
            points.append((corners[:, i] * (1 - t) + corners[:, j] * t)[:, None])
    together = np.concatenate(points, axis=1)
    return [(rows, together[:, list(piece)]) for piece in _PIECES[size, first]]

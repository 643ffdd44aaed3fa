"""Parts of segments and triangles, which need not be cells of any mesh: halved, or cut along lines."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fenicsx_obstacle import polynomials

CLOSE = 1e-12  # of the range of a linear function over a part: where it is so near a level, it is there


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of simplices.

    Attributes:
        rows: The simplex that each is a part of.
        cells: The owned cell.
        x: Corners, shape (parts, corners, 2).
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
        unknown = np.full(len(cells), np.inf)
        return cls(np.arange(len(cells)), cells, x, None, np.ones(len(cells)), -unknown, unknown)

    @property
    def size(self) -> int:
        """How many corners each has."""
        return self.x.shape[1]

    @property
    def times(self) -> int:
        """How many parts one is halved into."""
        return 2 ** (self.size - 1)

    def __getitem__(self, chosen: np.ndarray | slice) -> Parts:
        inside = None if self.inside is None else self.inside[chosen]
        return Parts(
            self.rows[chosen], self.cells[chosen], self.x[chosen], inside, self.share[chosen], self.least[chosen],
            self.most[chosen],
        )  # fmt: skip

    def _replaced(self, source: np.ndarray, x: np.ndarray, inside: np.ndarray, share: np.ndarray) -> Parts:
        """Parts of these parts."""
        rows, cells, least, most = (a[source] for a in (self.rows, self.cells, self.least, self.most))
        return Parts(rows, cells, x, inside, self.share[source] * share, least, most)

    @property
    def _inside(self) -> np.ndarray:
        if self.inside is not None:
            return self.inside
        return np.broadcast_to(np.eye(self.size), (len(self.rows), self.size, self.size))

    def halved(self) -> Parts:
        """With their edges halved."""
        source = np.repeat(np.arange(len(self.rows)), self.times)
        share = np.full(len(source), 1 / self.times)
        return self._replaced(source, polynomials.halved(self.x), polynomials.halved(self._inside), share)

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
        # the corner that is alone on its side comes first
        alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
        order = (alone[:, None] + np.arange(self.size)) % self.size
        there = np.take_along_axis(values[rows], order, axis=1)
        t = (levels[rows, None] - there[:, :1]) / (there[:, 1:] - there[:, :1])
        t = np.clip(t, 0.0, 1.0)
        corners = np.eye(self.size)[order]  # weights of the corners of the part
        ends = corners[:, :1] * (1 - t)[..., None] + corners[:, 1:] * t[..., None]
        tip = np.concatenate([corners[:, :1], ends], axis=1)
        if self.size == 2:
            found, shares = [tip, np.stack([ends[:, 0], corners[:, 1]], axis=1)], [t[:, 0], 1 - t[:, 0]]
        else:
            far = np.stack([ends[:, 0], corners[:, 1], corners[:, 2]], axis=1)
            near = np.stack([ends[:, 0], corners[:, 2], ends[:, 1]], axis=1)
            found, shares = [tip, far, near], [t[:, 0] * t[:, 1], 1 - t[:, 0], t[:, 0] * (1 - t[:, 1])]
        source = np.concatenate([kept, *[rows] * len(found)])
        weights = np.concatenate([np.broadcast_to(np.eye(self.size), (len(kept), self.size, self.size)), *found])
        share = np.concatenate([np.ones(len(kept)), *shares])
        filled = share > 0  # where a line runs through a corner some have none
        source, weights, share = source[filled], weights[filled], share[filled]
        parts = self._replaced(source, weights @ self.x[source], weights @ self._inside[source], share)
        return parts, (weights @ values[source][..., None])[..., 0], np.abs(levels[source])

    def within(self, least: np.ndarray, most: np.ndarray) -> Parts:
        """The same with bounds that were found meanwhile."""
        return replace(self, least=least, most=most)

    def with_(self, other: Parts) -> Parts:
        """These and others."""
        joint = (np.concatenate(pair) for pair in zip(self._arrays, other._arrays, strict=True))
        return Parts(*joint)

    @property
    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self.rows, self.cells, self.x, self._inside, self.share, self.least, self.most

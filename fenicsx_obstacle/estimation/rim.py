"""Boundary values between the nodes.

The difference of a boundary value and its nodal interpolant along an edge is extended into the cell beside it as a cone
that vanishes at the opposite vertex. Where the boundary value is a polynomial along the edge, the energy of the cone is
integrated exactly; elsewhere it is sampled.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fenicsx_obstacle.estimation.edges import Jumps, edges_of
from fenicsx_obstacle.estimation.exactness import on_simplices
from fenicsx_obstacle.estimation.polynomials import MAX_DEGREE, coefficients, evaluate, inner_points
from fenicsx_obstacle.estimation.quadrature import gauss
from fenicsx_obstacle.estimation.triangles import Triangles
from fenicsx_obstacle.parallel import largest, total

SEGMENTS = 16  # of an edge where u is given
ROUND_OFF = 1e-14  # of the heights


class Rim:
    """Boundary values along the edges where u is given (d = g - g_h, zero at the nodes).

    Attributes:
        twice: Whether a cell has two such edges.
        sampled: Whether a boundary value is no polynomial on some edge, on any rank.
        unbounded: Where a boundary value may be infinite, a point on one rank.
        cells: Cells with an edge where d is not zero, once for each edge.
        opposite: Vertex opposite to that edge.
        dip: Largest |d|, shape (all owned cells,).
        volume: Integral of the cones over each cell.
    """

    def __init__(self, triangles: Triangles, middles: np.ndarray | None = None):
        """Sample the boundary values (collective).

        Args:
            triangles: The cells.
            middles: Of P2 the nodal values at the middle of the edge opposite to each vertex, shape (cells, 3).
        """
        self.triangles, data, self._middles = triangles, triangles.data, middles
        cells = len(triangles.area)
        values = data.fixed[1].x.array
        part = np.full(max(triangles.facets.max(initial=-1) + 1, 1), -1)
        for number, facets in enumerate(data.held):
            part[facets[facets < len(part)]] = number  # of two parts the later one counts
        self._given = [(number, one.value) for number, one in enumerate(data.model.boundary) if one.value is not None]
        steps = np.linspace(0.0, 1.0, SEGMENTS + 1)
        found: list[tuple[np.ndarray, ...]] = []
        comm = data.level.comm
        heights = largest(comm, np.abs(values[data.fixed[0]]))
        jumps, sampled = Jumps(data, max(heights, 0.0)), 0
        self.unbounded: np.ndarray | None = None
        for number, field in self._given:
            beside, opposite = np.nonzero(part[triangles.facets] == number)
            ends = values[triangles.dofs[beside[:, None], (opposite[:, None] + [1, 2]) % 3]]
            edges = edges_of(triangles, beside, opposite)
            jumps.look(field, edges, ends)
            if field.uniform:
                continue
            known = on_simplices(data, field, edges.corners, beside)
            sampled += np.count_nonzero(~known.exact)
            if not known.finite.all():
                self.unbounded = np.append(edges.at(np.flatnonzero(~known.finite)[:1], np.full(1, 0.5))[0], 0.0)
            d = triangles.values(field, _on_edge(opposite, steps), beside)
            d = d - self._interpolated(beside, opposite, ends, steps[None])
            d[:, [0, -1]] = 0.0
            curved = np.abs(d).max(axis=1, initial=0.0) > ROUND_OFF * heights
            curved &= known.degree > self.degree
            found.append((beside[curved], opposite[curved], np.full(np.count_nonzero(curved), number), d[curved],
                          known.degree[curved]))  # fmt: skip
        jumps.reject()
        self.sampled = total(comm, sampled) > 0
        empty = (np.empty(0, int), np.empty(0, int), np.empty(0, int), np.empty((0, SEGMENTS + 1)), np.empty(0, int))
        self.cells, self.opposite, self._number, self._d, self._degree = (
            np.concatenate(parts) for parts in zip(empty, *found, strict=True)
        )
        # one cone keeps to the segments between its ends, two in a corner may together leave them
        self.twice = total(comm, np.count_nonzero(np.bincount(self.cells) > 1)) > 0
        self.dip, self.volume = np.zeros(cells), np.zeros(cells)
        highest = np.abs(self._d).max(axis=1, initial=0.0)
        means = (self._d[:, :-1] + self._d[:, 1:]).mean(axis=1) / 2
        for _, exact, found_there in self._polynomials():
            highest[exact], means[exact] = np.abs(found_there).max(axis=1), found_there.mean(axis=1)
        np.maximum.at(self.dip, self.cells, highest)
        # (H/3) int d: the cone is (1 - t/H) d
        np.add.at(self.volume, self.cells, 2 * triangles.area[self.cells] / 3 * means)

    @property
    def degree(self) -> int:
        """Of the elements."""
        return 1 if self._middles is None else 2

    def _polynomials(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Where d is a polynomial: its degree, the edges, and its Bernstein coefficients along them."""
        values = self.triangles.data.fixed[1].x.array
        for degree in np.unique(self._degree[self._degree <= MAX_DEGREE]):
            edges, t = np.flatnonzero(self._degree == degree), inner_points(2, int(degree))[:, 1]
            cells, opposite = self.cells[edges], self.opposite[edges]
            ends = values[self.triangles.dofs[cells[:, None], (opposite[:, None] + [1, 2]) % 3]]
            g = np.empty((len(edges), len(t)))
            for number, field in self._given:
                mine = self._number[edges] == number
                g[mine] = self.triangles.values(field, _on_edge(opposite[mine], t), cells[mine])
            d = g - self._interpolated(cells, opposite, ends, t[None])
            yield int(degree), edges, coefficients(d, 2, int(degree))

    def _interpolated(self, cells: np.ndarray, opposite: np.ndarray, ends: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """The nodal interpolant along the edges opposite to vertices."""
        linear = (1 - steps) * ends[:, :1] + steps * ends[:, 1:]
        if self._middles is None:
            return linear
        return linear + 4 * steps * (1 - steps) * (self._middles[cells, opposite] - ends.mean(axis=1))[:, None]

    def energy(self, mu: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad||^2 of the cones in each cell, mu being the largest tension there."""
        x, area = self.triangles.x[self.cells], self.triangles.area[self.cells]
        row = np.arange(len(area))
        a, b, c = (x[row, (self.opposite + k) % 3] for k in range(3))
        length = np.linalg.norm(c - b, axis=1)
        height = 2 * area / length
        foot = np.einsum("ix,ix->i", a - b, c - b) / length
        step = (length / SEGMENTS)[:, None]
        slope = np.diff(self._d, axis=1) / step
        # d - (s - s_0) d' is constant on each segment, where d is taken to be linear
        across = (self._d[:, :-1] - slope * (step * np.arange(SEGMENTS) - foot[:, None])) / height[:, None]
        edges = np.bincount(self.cells, minlength=len(mu))
        squares = (1 + 1 / SEGMENTS) ** 2 * ((slope**2 + across**2) * step).sum(axis=1)
        for degree, exact, coefficient in self._polynomials():
            t, weights = gauss(degree + 1)
            points, size = np.column_stack([1 - t, t]), length[exact, None]
            d = evaluate(coefficient, points, degree)
            slope = evaluate(degree * np.diff(coefficient, axis=1), points, degree - 1) / size
            across = (d - (size * t - foot[exact, None]) * slope) / height[exact, None]
            squares[exact] = (slope**2 + across**2) @ weights * length[exact]
        energy = mu[self.cells] * height / 2 * squares
        return edges * np.bincount(self.cells, weights=energy, minlength=len(mu))

    def cones(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Their sum in given cells at barycentric coordinates, shape (points, 3) (collective)."""
        found = np.zeros((len(cells), len(where)))
        row = np.full(len(self.triangles.area), -1)
        row[cells] = np.arange(len(cells))
        values = self.triangles.data.fixed[1].x.array
        for number, field in self._given:
            chosen = np.flatnonzero((self._number == number) & (row[self.cells] >= 0))
            beside, opposite = self.cells[chosen], self.opposite[chosen]
            share = where[:, (opposite[:, None] + [1, 2]) % 3].transpose(1, 0, 2)
            width = share.sum(axis=2)
            step = np.divide(share[..., 1], width, out=np.zeros_like(width), where=width > 0)
            ends = values[self.triangles.dofs[beside[:, None], (opposite[:, None] + [1, 2]) % 3]]
            g = self.triangles.values(field, _on_edge(opposite, step), beside)
            np.add.at(found, row[beside], width * (g - self._interpolated(beside, opposite, ends, step)))
        return found


def _on_edge(opposite: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Barycentric coordinates, shape (edges, points, 3), of points on the edges opposite to vertices."""
    where = np.zeros((len(opposite), steps.shape[-1], 3))
    row = np.arange(len(opposite))
    where[row, :, (opposite + 1) % 3], where[row, :, (opposite + 2) % 3] = 1 - steps, steps
    return where

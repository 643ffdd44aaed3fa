"""Boundary values between the nodes.

The difference of a boundary value and its nodal interpolant along an edge is extended into the cell beside it as a cone
that vanishes at the opposite vertex. The boundary value is a polynomial on parts of the edge, up to a rest that is
bounded with its derivative.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.estimation.boundary_values import ROUND_OFF, BoundaryValues
from fenicsx_obstacle.estimation.edges import Edges, Jumps, edges_of
from fenicsx_obstacle.estimation.pieces import Division, Group, pieces_of
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, smallest, total

EDGES = Division(24, 1e-4, 1e-8)  # what counts is the distance of a boundary value and of its slope to the interpolant


@dataclass(frozen=True, eq=False)
class _Difference:
    """d on parts of edges: polynomials of one degree, and how far they may be from it.

    Attributes:
        edges: Place in `DirichletData.cells`.
        share: Of the edge's length.
        start: Of the part, in parts of the edge.
        degree: Of the polynomials.
        coefficients: Of Bernstein, shape (parts, degree + 1).
        rest: Bound of the distance of d.
        slope: Bound of the distance of its derivative, per length.
    """

    edges: np.ndarray
    share: np.ndarray
    start: np.ndarray
    degree: int
    coefficients: np.ndarray = field(repr=False)
    rest: np.ndarray = field(repr=False)
    slope: np.ndarray = field(repr=False)


class DirichletData(BoundaryValues):
    """Boundary values along the edges where u is given (d = g - g_h, zero at the nodes).

    Attributes:
        twice: Whether a cell has two such edges.
        sampled: Whether no bounds of a boundary value, or of its slope, are known on some edge, on any rank.
        unbounded: Where a boundary value may be infinite, a point on one rank.
        least: A lower bound of what is given, on all ranks; infinite if nothing is.
        most: An upper bound.
        cells: Cells with an edge where d is not zero, once for each edge.
        opposite: Vertex opposite to that edge.
        deviation: Bound of the absolute value of the sum of the cones of a cell, shape (all owned cells,).
        volume: Integral of the cones over each cell,
        volume_rest: and how far it may be from that.
    """

    def __init__(self, simplices: Simplices, middles: np.ndarray | None = None):
        """Enclose the boundary values (collective).

        Args:
            simplices: The cells.
            middles: Of P2 the nodal values at the middle of the edge opposite to each vertex, shape (cells, 3).
        """
        self.simplices, data, self._middles = simplices, simplices.data, middles
        cells, values = len(simplices.area), data.fixed[1].x.array
        self._given = [(number, one.value) for number, one in enumerate(data.model.boundary) if one.value is not None]
        comm = data.level.comm
        self._heights = max(largest(comm, np.abs(values[data.fixed[0]])), 0.0)
        jumps, self._sampled = Jumps(data, self._heights), 0
        self.unbounded: np.ndarray | None = None
        heights = [values[data.fixed[0]]]
        self.cells, self.opposite, self._number = (np.empty(0, dtype=int) for _ in range(3))
        self._differences: list[_Difference] = []
        for number, value in self._given:
            beside, opposite = np.nonzero(simplices.part_of == number)
            ends = values[simplices.dofs[beside[:, None], (opposite[:, None] + [1, 2]) % 3]]
            edges = edges_of(simplices, beside, opposite)
            jumps.look(value, edges, ends)
            if value.uniform:
                continue
            pieces = pieces_of(data, value, edges.corners, beside, EDGES)
            self._sampled += pieces.sampled
            heights += [pieces.lower, pieces.upper]
            if not pieces.finite.all():
                place = edges.at(np.flatnonzero(~pieces.finite)[:1], np.full(1, 0.5))[0]
                self.unbounded = np.append(place, 0.0)
            groups = [jumps.between_samples(value, edges, group) for group in pieces.groups]
            for known, group in zip(pieces.groups, groups, strict=True):
                replaced = (group.rest < known.rest) & (known.rest > ROUND_OFF * self._heights)
                self._sampled += np.count_nonzero(replaced)
            self._take(groups, edges, opposite, number, ends)
        jumps.reject()
        self.least, self.most = (fold(comm, np.concatenate(heights)) for fold in (smallest, largest))
        self.sampled = total(comm, self._sampled) > 0
        # one cone keeps between its ends, two in a corner may together leave them
        self.twice = total(comm, np.count_nonzero(np.bincount(self.cells) > 1)) > 0
        self.deviation, self.volume, self.volume_rest = (np.zeros(cells) for _ in range(3))
        most = np.zeros(len(self.cells))
        for d in self._differences:
            cell = self.cells[d.edges]
            np.maximum.at(most, d.edges, np.abs(d.coefficients).max(axis=1) + d.rest)
            # (H/3) int d: the cone is (1 - t/H) d
            measure = 2 / 3 * simplices.area[cell] * d.share
            np.add.at(self.volume, cell, measure * d.coefficients.mean(axis=1))
            np.add.at(self.volume_rest, cell, measure * d.rest)
        np.add.at(self.deviation, self.cells, most)  # the cones of two edges of a cell may have the same sign

    def _take(self, groups: list[Group], edges: Edges, opposite: np.ndarray, number: int, ends: np.ndarray) -> None:
        """Add a boundary value on the edges of its part on which it differs from its interpolant."""
        beside, length = edges.cells, edges.lengths
        found, curved = [], np.zeros(len(beside), dtype=bool)
        for group in groups:
            degree, rows = max(group.degree, self.degree), group.rows
            reference = polynomials.inner_points(2, degree)
            steps = np.broadcast_to(group.points(reference)[..., 1], (len(rows), len(reference)))
            d = group.values(reference) - self._interpolated(beside[rows], opposite[rows], ends[rows], steps)
            coefficients = polynomials.coefficients(d, 2, degree)
            found.append((group, degree, coefficients))
            # on a whole edge a polynomial of the elements' degree is its interpolant; between parts there may be kinks
            exact = (group.corners is None) & (group.degree <= self.degree) & (group.rest == 0)
            curved[rows] |= ~exact & (np.abs(d).max(axis=1, initial=0.0) + group.rest > ROUND_OFF * self._heights)
        place = np.cumsum(curved) - 1 + len(self.cells)
        for group, degree, coefficients in found:
            kept = np.flatnonzero(curved[group.rows])
            rows, size = group.rows[kept], (group.share * length[group.rows])[kept]
            slope = group.steep[kept]
            unknown = ~np.isfinite(slope)
            self._sampled += np.count_nonzero(unknown)
            slope = np.where(unknown, (group.upper - group.lower)[kept] / size, slope)
            start = np.zeros(len(kept)) if group.corners is None else group.corners[kept, 0, 1]
            finite = np.isfinite(group.rest[kept]) & np.isfinite(slope)  # others make it an indicator
            rest, slope = (np.where(finite, bound, 0.0) for bound in (group.rest[kept], slope))
            d = _Difference(place[rows], group.share[kept], start, degree, coefficients[kept], rest, slope)
            self._differences.append(d)
        self.cells = np.append(self.cells, beside[curved])
        self.opposite = np.append(self.opposite, opposite[curved])
        self._number = np.append(self._number, np.full(np.count_nonzero(curved), number))

    @property
    def degree(self) -> int:
        """Degree of the elements."""
        return 1 if self._middles is None else 2

    def _interpolated(self, cells: np.ndarray, opposite: np.ndarray, ends: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """The nodal interpolant along the edges opposite to vertices."""
        linear = (1 - steps) * ends[:, :1] + steps * ends[:, 1:]
        if self._middles is None:
            return linear
        return linear + 4 * steps * (1 - steps) * (self._middles[cells, opposite] - ends.mean(axis=1))[:, None]

    def energy(self, mu: np.ndarray) -> np.ndarray:
        """Bound of ||mu^(1/2) grad||^2 of the cones in each cell, mu being the largest tension there.

        On an edge it is (H/2) int d'^2 + ((d - (s - s_0) d')/H)^2, H the height of the cell, s_0 its foot.
        """
        length, height, foot = self._shapes()
        known, unknown = np.zeros(len(length)), np.zeros(len(length))
        for d in self._differences:
            points, weights = rule(1, 2 * d.degree + 1)
            t, size = points[:, 1], length[d.edges] * d.share
            H = height[d.edges, None]
            along = polynomials.slopes(d.coefficients, 2, d.degree)
            slope = polynomials.evaluate(along[:, 1] - along[:, 0], points, d.degree - 1) / size[:, None]
            arm = (d.start[:, None] + d.share[:, None] * t) * length[d.edges, None] - foot[d.edges, None]
            across = (polynomials.evaluate(d.coefficients, points, d.degree) - arm * slope) / H
            np.add.at(known, d.edges, size * ((slope**2 + across**2) @ weights))
            reach = np.maximum(np.abs(foot), np.abs(length - foot))[d.edges]
            np.add.at(unknown, d.edges, size * (d.slope**2 + ((d.rest + reach * d.slope) / H[:, 0]) ** 2))
        energy = mu[self.cells] * height / 2 * (np.sqrt(known) + np.sqrt(unknown)) ** 2
        edges = np.bincount(self.cells, minlength=len(mu))
        return edges * np.bincount(self.cells, weights=energy, minlength=len(mu))

    def _shapes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For each cone: length of its edge, height of its cell, and foot of the height along the edge."""
        a = self.simplices.x[self.cells, self.opposite]
        edges = edges_of(self.simplices, self.cells, self.opposite)
        b, c, length = edges.start, edges.end, edges.lengths
        return length, 2 * self.simplices.area[self.cells] / length, np.einsum("ix,ix->i", a - b, c - b) / length

    def on_parts(self, owner: np.ndarray, inside: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the cones on parts of cells.

        At a + w (b + s (c - b) - a), a the vertex opposite to the edge from b to c, the cone is w d(s).

        Args:
            owner: The owned cell of each part.
            inside: Barycentric coordinates of the corners of the parts, shape (parts, 3, 3).
            sign: Times the cones.

        Returns:
            A lower bound of sign times their sum on each part, and a bound of its gradient.
        """
        order = np.argsort(owner, kind="stable")
        parts = np.searchsorted(owner[order], self.cells), np.searchsorted(owner[order], self.cells, side="right")
        length, height, foot = self._shapes()
        least, gradient = np.zeros(len(owner)), np.zeros(len(owner))
        for d in self._differences:
            first, count = parts[0][d.edges], (parts[1] - parts[0])[d.edges]
            piece = np.repeat(np.arange(len(count)), count)
            part = order[np.arange(len(piece)) - np.repeat(np.cumsum(count) - count - first, count)]
            edge = d.edges[piece]
            corner = self.opposite[edge][:, None]
            width = 1 - np.take_along_axis(inside[part], corner[..., None], axis=2)[..., 0]
            after = np.take_along_axis(inside[part], ((corner + 2) % 3)[..., None], axis=2)[..., 0]
            apex = (width <= ROUND_OFF).any(axis=1)
            s = after / np.where(width <= ROUND_OFF, 1.0, width)
            begin, share = d.start[piece], d.share[piece]
            start = (np.where(apex, 0.0, s.min(axis=1)) - begin) / share
            end = (np.where(apex, 1.0, s.max(axis=1)) - begin) / share
            there = (end >= 0) & (start <= 1)
            piece, part, edge, begin, share = (a[there] for a in (piece, part, edge, begin, share))
            start, end, width = np.clip(start[there], 0.0, 1.0), np.clip(end[there], 0.0, 1.0), width[there]
            along = polynomials.slopes(d.coefficients, 2, d.degree)
            along = polynomials.restricted((along[:, 1] - along[:, 0])[piece], start, end, d.degree - 1)
            slope = np.abs(along).max(axis=1, initial=0.0) / (length[edge] * share) + d.slope[piece]
            values, rest = polynomials.restricted(sign * d.coefficients[piece], start, end, d.degree), d.rest[piece]
            arms = [np.abs((begin + share * t) * length[edge] - foot[edge]) for t in (start, end)]
            rise = (np.abs(values).max(axis=1, initial=0.0) + rest + np.maximum(*arms) * slope) / height[edge]
            below = np.minimum(values.min(axis=1, initial=np.inf) - rest, 0.0) * width.max(axis=1, initial=0.0)
            # pieces of one edge count together: the sum of what is below 0 is a bound, as is that of gradients
            np.add.at(least, part, below)
            np.add.at(gradient, part, np.hypot(slope, rise))
        return least, gradient

    def cones(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Their sum in given cells at barycentric coordinates, shape (points, 3) (collective)."""
        found = np.zeros((len(cells), len(where)))
        row = np.full(len(self.simplices.area), -1)
        row[cells] = np.arange(len(cells))
        values = self.simplices.data.fixed[1].x.array
        for number, value in self._given:
            chosen = np.flatnonzero((self._number == number) & (row[self.cells] >= 0))
            beside, opposite = self.cells[chosen], self.opposite[chosen]
            share = where[:, (opposite[:, None] + [1, 2]) % 3].transpose(1, 0, 2)
            width = share.sum(axis=2)
            step = np.divide(share[..., 1], width, out=np.zeros_like(width), where=width > 0)
            ends = values[self.simplices.dofs[beside[:, None], (opposite[:, None] + [1, 2]) % 3]]
            g = self.simplices.values(value, _on_edge(opposite, step), beside)
            np.add.at(found, row[beside], width * (g - self._interpolated(beside, opposite, ends, step)))
        return found


def _on_edge(opposite: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Barycentric coordinates, shape (edges, points, 3), of points on the edges opposite to vertices."""
    where = np.zeros((len(opposite), steps.shape[-1], 3))
    row = np.arange(len(opposite))
    where[row, :, (opposite + 1) % 3], where[row, :, (opposite + 2) % 3] = 1 - steps, steps
    return where

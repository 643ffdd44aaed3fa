"""Boundary values between the nodes of triangles and tetrahedra.

On the facets where u is given let d be the difference of boundary value and nodal interpolant. It is continued into the
cells as a continuous function w with w = d there:

    w = sum_k c_k B_k + sum_E (phi_i + phi_j) e_E(phi_j/(phi_i + phi_j)) + sum_F (1 - phi_a) r_F.

B_k are the Bernstein polynomials of degree 4 of a cell. On the facets where u is given c_k are the coefficients of the
interpolant of d of degree 4, elsewhere they are 0. e = d less that interpolant is of fifth order where the datum is
smooth. On triangles e is 0 at the ends of an edge F, r_F is e, and there is no second sum. On tetrahedra e_E is e along
an edge E = (i, j); w has this term in all cells around it (`shared_edges`). r_F is what is left of e on a facet F. It
is 0 on the boundary of F, and continued into the cell as a cone with the tip at the opposite vertex a.

With one term alone in a triangle v_h + w is nowhere below a constant that v_h and v_h + d are not below on the edge:
the polynomials are t^4 d, t = 1 - phi_a, which is at least t d where d < 0. Along a line from the vertex a to the edge
v_h + t d is linear.

The polynomials are integrated exactly. The gradient of the second sum depends only on phi_j/(phi_i + phi_j), which is
uniformly distributed over the cell, and that of the third only on the point of the facet: means of |e|^2 and of its
slope there are enough, and are bounded.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.boundary_values import (
    DEGREE,
    NODES,
    ROUND_OFF,
    ROUNDED,
    TO_BERNSTEIN,
    Facets,
    places,
)
from fenicsx_obstacle.estimation.edges import Edges, Jumps
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of
from fenicsx_obstacle.estimation.parts import Parts
from fenicsx_obstacle.estimation.pieces import Group
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.shared_edges import SharedEdges
from fenicsx_obstacle.estimation.simplex_geometry import sizes
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.mesh.cells import facet_vertices, longest_edges
from fenicsx_obstacle.parallel import largest, smallest, total

# of facets, by the dimension of the cells
DIVISION = {2: Division(24, 1e-4, 1e-8), 3: Division(4, 1e-2, 1e-3, slopes=True)}
HALVED = {2: 0, 3: 3}  # subdivisions of facets on which the bound of the slope of e is above
MIN_DEPTH = 2  # of the division of the smallest ones, along the line where a condition changes and beside it
STEEP = 0.02  # this fraction of the slope of d
MAX_PARTS = 100_000  # of facets; no subdivision beyond
# where obstacles are compared with what is given: facets are divided where either is rough; degree of the points there
APART = {2: Division(6), 3: Division(2)}
LOOKS = {2: 12, 3: 6}
NO_WIDTH = 1e-14  # relative to the facet: parts between two cuts that are narrower are lines, up to round-off


class BoundaryData:
    """The continuation of boundary values from facets into the cells, (E3); 0 on intervals, whose facets are nodes.

    Attributes:
        leaves: Whether the continuation may leave what d keeps to in each cell: v_h may be above a constant on the
            boundary and not with it inside.
        twice: Whether it may in any, on any rank.
        sampled: Whether no bounds of a boundary value, or of its slope, are known somewhere, on any rank.
        unbounded: Where a boundary value may be infinite, a point on one rank.
        least: A lower bound of what is given, on all ranks; infinite if nothing is.
        most: An upper bound.
        deviation: Bound of the continuation, shape (owned cells,).
        volume: Its integral over each cell,
        volume_rest: and how far it may be from that.
    """

    unbounded: np.ndarray | None = None

    def __init__(self, simplices: Simplices, middles: np.ndarray | None = None):
        """Enclose the boundary values (collective).

        Args:
            simplices: The cells.
            middles: Of P2 the nodal values at the middle of the edge opposite to each vertex, shape (cells, 3).

        Raises:
            InputError: If they jump.
        """
        self.simplices = simplices
        data, comm, self._dim, self._middles = simplices.data, simplices.data.level.comm, simplices.dim, middles
        nodal = data.fixed[1].x.array
        given = nodal[data.fixed[0]]
        self._heights = max(largest(comm, np.abs(given)), 0.0)
        self._jumps, self._samples = Jumps(data, given), 0
        self._bounds = 3 if self._dim == 2 else 4
        self._parts = parts = self._facets(nodal)
        self._edges = SharedEdges(simplices, nodal) if self._dim == 3 else None
        if self._edges is None:
            for part in parts:
                self._jumps.look(part.value, _edges_of(part), part.ends)
        else:
            self._samples += self._edges.compare(parts, self._jumps)
        self._jumps.reject()
        low, high, found = [smallest(comm, given)], [largest(comm, given)], []
        for part in parts:
            d, bounds, lower, upper = self._enclosed(part)
            found.append((part, d, bounds))
            low.append(smallest(comm, lower))
            high.append(largest(comm, upper))
        self.least, self.most = min(low), max(high)
        self.sampled = total(comm, self._samples) > 0
        self._take_polynomials([(part, d) for part, d, _ in found])
        self._add_rest([(part, bounds) for part, _, bounds in found])
        terms = np.zeros(len(self.deviation))
        for part, d, bounds in found:
            terms += np.bincount(part.cells, d.any(axis=1).astype(float) + (bounds[0] > 0), len(terms))
        self.leaves = terms > 1 if self._edges is None else self.deviation > 0
        self.twice = total(comm, np.count_nonzero(self.leaves)) > 0

    def below(self, obstacle: Field, sign: float) -> float:
        """By how much sign times what is given is below an obstacle at points of facets, on this rank; -inf of
        intervals (collective where the obstacle is the first to need the distance)."""
        most, data = -np.inf, self.simplices.data
        for part in self._parts:
            both = (pieces_of(data, one, part.x, part.cells, APART[self._dim]) for one in (obstacle, part.value))
            for group in (group for pieces in both for group in pieces.groups):
                x = group.points(polynomials.inner_points(self._dim, LOOKS[self._dim])) @ part.x[group.rows]
                points, cells = np.zeros((3, x.shape[0] * x.shape[1])), np.repeat(part.cells[group.rows], x.shape[1])
                points[: self._dim] = x.reshape(-1, self._dim).T
                gap = sign * (data.at(obstacle, points, cells) - data.at(part.value, points, cells))
                most = max(most, float(gap[np.isfinite(gap)].max(initial=-np.inf)))
        return most

    def _facets(self, nodal: np.ndarray) -> list[Facets]:
        """The facets of each part (local)."""
        simplices, found = self.simplices, []
        for number, part in enumerate(simplices.data.model.boundary):
            if part.value is not None and self._dim > 1:
                cells, opposite = np.nonzero(simplices.part_of == number)
                members = np.array(facet_vertices(self._dim))[opposite]
                x, ends = simplices.x[cells[:, None], members], nodal[simplices.dofs[cells[:, None], members]]
                size = sizes(x)
                height = self._dim * simplices.area[cells] / size
                inward = simplices.normal[:, cells, opposite].T / size[:, None]
                foot = simplices.x[cells, opposite] - height[:, None] * inward
                found.append(Facets(cells, opposite, members, x, ends, part.value, height, foot))
        return found

    def _enclosed(self, part: Facets) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What is known of d on facets (collective).

        Returns:
            The Bernstein coefficients of its interpolant; bounds of e on each facet, of shape (n, facets): of |e|, of
            its slope, and of the root of the mean of |grad w|^2 in the cell, of tetrahedra instead of that of the roots
            of the means of the squares of the first two; and bounds of the boundary value.
        """
        count, to_bernstein = len(part.cells), TO_BERNSTEIN[self._dim]
        if part.value.uniform:
            return np.zeros((count, len(to_bernstein))), np.zeros((self._bounds, count)), np.empty(0), np.empty(0)
        d, interpolant = self._at_nodes(part)
        enough = STEEP * DEGREE * np.abs(d).max(axis=1, initial=0.0) / longest_edges(part.x)
        groups, lower, upper = self._groups(part, enough)
        if self._edges is None:  # an interpolant is not near kinks of d, at which edges are divided
            rows = np.concatenate([part.cells[:0], *(group.rows for group in groups)])
            d[np.bincount(rows, minlength=count) > 1] = 0.0
        polynomial, bounds, found = (interpolant + d) @ to_bernstein.T, np.zeros((self._bounds, count)), []
        for group in groups:
            away, steep, *means = self._beyond(part, group, polynomial)
            found.append((group, away, steep))
            for bound, values in zip(bounds[:2], (away, steep), strict=True):
                np.maximum.at(bound, group.rows, values)
            for bound, values in zip(bounds[2:], means, strict=True):
                np.add.at(bound, group.rows, group.share * values**2)
        if self._edges is not None:
            self._edges.take(part, found)
        return d @ to_bernstein.T, np.vstack([bounds[:2], np.sqrt(bounds[2:])]), lower, upper

    def _at_nodes(self, part: Facets) -> tuple[np.ndarray, np.ndarray]:
        """d and the nodal interpolant at the nodes of degree 4 on facets, each of shape (facets, nodes) (collective on
        first use of the datum)."""
        nodes = NODES[self._dim]
        interpolant = part.ends @ (nodes.T / DEGREE)
        if self._middles is not None:
            bend = self._middles[part.cells, part.opposite] - part.ends.mean(axis=1)
            interpolant += bend[:, None] * (4 * nodes.prod(axis=1) / DEGREE**2)
        d = np.zeros(interpolant.shape)
        for n, node in enumerate(nodes):
            if np.count_nonzero(node) == self._dim:  # inside the facet
                points = np.zeros((3, len(part.cells)))
                points[: self._dim] = np.einsum("k,fkx->xf", node / DEGREE, part.x)
                d[:, n] = self.simplices.data.at(part.value, points, part.cells) - interpolant[:, n]
            elif np.count_nonzero(node) == 2 and self._edges is not None:
                d[:, n] = self._edges.at_node(part, node) - interpolant[:, n]
        d[np.abs(d) <= ROUNDED * self._heights] = 0.0
        return d, interpolant

    def _groups(self, part: Facets, enough: np.ndarray) -> tuple[list[Group], np.ndarray, np.ndarray]:
        """The boundary value on parts of facets, and its bounds on these (collective on first use of the datum).

        Args:
            part: The facets.
            enough: A bound of the slope that need not be improved, on each facet.
        """
        dim, parts = self._dim, Parts.whole(part.x, part.cells)
        lower, upper, found = [], [], []
        for split in range(HALVED[dim] + 1):
            last = split == HALVED[dim] or parts.times * len(parts.rows) > MAX_PARTS
            division = replace(DIVISION[dim], depth=max(DIVISION[dim].depth - split, MIN_DEPTH))
            pieces = pieces_of(self.simplices.data, part.value, parts.x, parts.cells, division)
            self._samples += int(pieces.sampled)
            lower.append(pieces.lower)
            upper.append(pieces.upper)
            if not pieces.finite.all():
                self.unbounded = np.pad(part.x[parts.rows[np.argmin(pieces.finite)]].mean(axis=0), (0, 3 - dim))
            groups = [self._between_samples(part, group) for group in pieces.groups]
            far = np.zeros(len(parts.rows), dtype=bool)
            for group in groups:
                far[group.rows[group.steep > enough[parts.rows[group.rows]]]] = not last
            for group in groups:
                kept = group[np.flatnonzero(~far[group.rows])]
                of = parts[kept.rows]
                corners = of.places if kept.corners is None else kept.corners @ of.places
                found.append(replace(kept, rows=of.rows, corners=corners, share=of.share * kept.share))
            if not far.any():
                break
            parts = parts[far].halved()
        return found, np.concatenate(lower), np.concatenate(upper)

    def _between_samples(self, part: Facets, known: Group) -> Group:
        """See `Jumps.between_samples`; facets of tetrahedra are not divided into parts that are so short."""
        if self._dim == 3:
            return known
        group = self._jumps.between_samples(part.value, _edges_of(part), known)
        self._samples += np.count_nonzero((group.rest < known.rest) & (known.rest > ROUND_OFF * self._heights))
        return group

    def _beyond(self, part: Facets, group: Group, polynomial: np.ndarray) -> tuple[np.ndarray, ...]:
        """The bounds of e that `_enclosed` returns, on parts of facets (local).

        Args:
            part: The facets.
            group: Of parts.
            polynomial: Bernstein coefficients of the interpolants of the boundary value.
        """
        assert group.corners is not None
        dim, degree, rows, rest = self._dim, max(group.degree, DEGREE), group.rows, group.known_rest
        there = polynomials.restricted(polynomial[rows], group.corners, DEGREE)
        coefficients = group.coefficients @ polynomials.raised(dim, group.degree, degree).T
        coefficients -= there @ polynomials.raised(dim, DEGREE, degree).T
        along, away = polynomials.slopes(coefficients, dim, degree), polynomials.row_size(coefficients)
        if dim == 3:
            slope, narrowest = slopes_on_facets(group, along, part.x)
        else:
            narrowest = longest_edges(part.x)[rows] * group.share
            slope = polynomials.row_size(along[:, 1] - along[:, 0]) / narrowest
        exact = away + group.rest <= 4 * ROUND_OFF * self._heights
        unknown = ~np.isfinite(group.steep)
        self._samples += np.count_nonzero(unknown & ~exact)
        # where nothing is known of the slope the bound rests on samples
        more = np.where(unknown, (group.upper - group.lower) / narrowest, group.steep)
        more = np.where(np.isfinite(more), more, 0.0)
        points, weights = rule(dim - 1, 2 * degree)
        values = polynomials.evaluate(coefficients, points, degree)
        if dim == 3:
            means = [np.sqrt(values**2 @ weights) + rest, slope + more]
        else:
            x = group.corners @ part.x[rows]  # parts of an edge may be turned around
            edge = (x[:, 1] - x[:, 0]) / narrowest[:, None]
            derivative = polynomials.evaluate(along[:, 1] - along[:, 0], points, degree - 1) / narrowest[:, None]
            arm = np.einsum("npx,nx->np", points @ x - part.foot[rows, None], edge)
            across = (values - arm * derivative) / part.height[rows, None]
            of_rest = np.hypot(more, (rest + part.arm[rows] * more) / part.height[rows])
            means = [np.sqrt((derivative**2 + across**2) @ weights) + of_rest]
        return tuple(np.where(exact, 0.0, found) for found in (away + rest, slope + more, *means))

    def _take_polynomials(self, found: list[tuple[Facets, np.ndarray]]) -> None:
        """The polynomials of w in the cells (local)."""
        simplices, corners, inside = self.simplices, self._dim + 1, NODES[self._dim].all(axis=1)
        count = len(simplices.area)
        near, self.volume = np.zeros(count, dtype=bool), np.zeros(count)
        for part, d in found:
            near[part.cells[d.any(axis=1)]] = True
        if self._edges is not None:
            near |= self._edges.near
        self._cells, self._row = np.flatnonzero(near), np.full(count, -1)
        self._row[self._cells] = np.arange(len(self._cells))
        place, self._coefficients = places(corners), np.zeros((len(self._cells), len(NODES[corners])))
        if self._edges is not None:
            self._edges.put(self._cells, self._coefficients, ROUNDED * self._heights)
        for part, d in found:
            there = np.flatnonzero(near[part.cells])
            for n in np.flatnonzero(inside):
                node = np.zeros((len(there), corners), dtype=int)
                np.put_along_axis(node, part.members[there], NODES[self._dim][None, n], axis=1)
                column = np.array([place[tuple(one)] for one in node.tolist()], dtype=int)
                self._coefficients[self._row[part.cells[there]], column] = d[there, n]
        area = simplices.area[self._cells]
        gradients = np.moveaxis(simplices.normal[:, self._cells], 0, 2) / (self._dim * area)[:, None, None]
        self._slopes = np.einsum("ckn,ckx->xcn", polynomials.slopes(self._coefficients, corners, DEGREE), gradients)
        points, weights = rule(self._dim, 2 * (DEGREE - 1))
        there = np.stack([polynomials.evaluate(slopes, points, DEGREE - 1) for slopes in self._slopes])
        self._energy, self._below = np.zeros(count), np.zeros((2, count))
        self._energy[self._cells] = np.einsum("xcp,xcp,p->c", there, there, weights)
        for below, sign in zip(self._below, (-1.0, 1.0), strict=True):
            highest = polynomials.largest(sign * self._coefficients, corners, DEGREE)
            below[self._cells] = np.maximum(highest, 0.0)
        self.volume[self._cells] = area * self._coefficients.mean(axis=1)

    def _add_rest(self, found: list[tuple[Facets, np.ndarray]]) -> None:
        """Bounds of the part of w in the cells that is no polynomial (local)."""
        simplices = self.simplices
        self._rest, self._steep, mean = (np.zeros(len(simplices.area)) for _ in range(3))
        if self._edges is not None:
            self._edges.add_to(self._rest, self._steep, mean)
        for part, bounds in found:
            value, slope, *means = bounds if self._edges is None else self._edges.left_on(part, bounds)
            np.add.at(self._rest, part.cells, value)
            np.add.at(self._steep, part.cells, part.of_cone(value, slope))
            np.add.at(mean, part.cells, means[0] if self._edges is None else part.of_cone(*means))
        self._energy = (np.sqrt(self._energy) + mean) ** 2
        self.deviation = self._below.max(axis=0) + self._rest
        self.volume_rest = simplices.area * self._rest

    def energy(self, mu: np.ndarray) -> np.ndarray:
        """Bound of ||mu^(1/2) grad||^2 of the continuation in each cell, mu being the largest tension there."""
        return mu * self.simplices.area * self._energy

    def values(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """The polynomials of w in given cells at barycentric coordinates, shape (cells, points) (local).

        Args:
            cells: Which.
            where: The points, shape (points, d + 1).
        """
        found, row = np.zeros((len(cells), len(where))), self._row[cells]
        found[row >= 0] = polynomials.evaluate(self._coefficients[row[row >= 0]], where, DEGREE)
        return found

    def on_parts(self, owner: np.ndarray, inside: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the continuation on parts of cells.

        Args:
            owner: The owned cell of each part.
            inside: Barycentric coordinates of the corners of the parts, shape (parts, corners, corners).
            sign: Times the continuation.

        Returns:
            A lower bound of sign times it on each part, 0 at most, and a bound of its gradient.
        """
        least, steep, place = -self._rest[owner], self._steep[owner], np.flatnonzero(self._row[owner] >= 0)
        row = self._row[owner[place]]
        coefficients = polynomials.restricted(sign * self._coefficients[row], inside[place], DEGREE)
        least[place] += np.minimum(polynomials.row_min(coefficients), 0.0)
        slopes = [polynomials.restricted(along[row], inside[place], DEGREE - 1) for along in self._slopes]
        steep[place] += polynomials.row_max(np.linalg.norm(slopes, axis=0))
        return least, steep


def _edges_of(part: Facets) -> Edges:
    """Facets of triangles as edges."""
    return Edges(part.x[:, 0], part.x[:, 1], part.cells)


def slopes_on_facets(group: Group, along: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the slopes of polynomials within parts of facets, and the least heights of the parts.

    Parts between two cuts may be so narrow that they are lines, up to round-off. They contribute nothing to integrals
    over facets, and the parts beside them have the same values and their slopes across the line. But such a part may be
    all there is of an edge of its facet: the slope along its longest side is taken, and the height is this length.

    Args:
        group: Of the parts.
        along: The Bernstein coefficients of `polynomials.slopes` on the parts.
        x: Corners of the facets.
    """
    assert group.corners is not None
    # edges in an orthonormal basis of their facet, without the round-off of large coordinates
    facets = x[:, 1:] - x[:, :1]
    basis = np.linalg.qr(facets.transpose(0, 2, 1))[0]
    edges = (group.corners[:, 1:, 1:] - group.corners[:, :1, 1:]) @ (facets @ basis)[group.rows]
    derivatives = along[:, 1:] - along[:, :1]  # along these two edges
    first, second = edges[:, 0], edges[:, 1]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]  # of the parallelogram, with sign
    third, third_derivative = second - first, derivatives[:, 1] - derivatives[:, 0]
    sides = np.stack([first, second, third], axis=1)
    lengths = np.linalg.norm(sides, axis=2)
    longest = lengths.max(axis=1, initial=0.0)
    least = NO_WIDTH * longest_edges(x)[group.rows]
    line = np.abs(area) <= least * longest
    # the gradient times the area, turned by a right angle
    combined = derivatives[:, :1] * second[:, :, None] - derivatives[:, 1:] * first[:, :, None]
    slope = np.linalg.norm(combined, axis=1).max(axis=1, initial=0.0) / np.where(line, 1.0, np.abs(area))
    of_sides = np.abs(np.concatenate([derivatives, third_derivative[:, None]], axis=1)).max(axis=2, initial=0.0)
    tangential = np.take_along_axis(of_sides, lengths.argmax(axis=1)[:, None], axis=1)[:, 0]
    length = np.maximum(longest, least)
    return np.where(line, tangential / length, slope), np.where(line, length, np.abs(area) / length)

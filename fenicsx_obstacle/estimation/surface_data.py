"""Boundary values between the nodes of tetrahedra.

On the facets where u is given let d be the difference of boundary value and nodal interpolant. It is continued into the
cells as a continuous function w with w = d there:

    w = sum_E b_E phi_i phi_j + L e + sum_E (phi_i + phi_j) e'_E(phi_j/(phi_i + phi_j)) + sum_F (1 - phi_a) r_F.

E are the edges (i, j) of these facets and b_E/4 is d at the middle of E, so that the first sum is d where that is
quadratic. e = d - first sum; L e is the polynomial of degree 4 in each cell that equals e at the nodes on these facets
and 0 at the others. The rest e' = e - L e is of fifth order where the datum is smooth. e'_E is e' along an edge; w has
this term in all cells around it. r_F is what is left of e' on a facet. It is 0 on the edges of the facet, and continued
into the cell as a cone with the tip at the opposite vertex a. The polynomials are integrated exactly. The gradient of
the third sum depends only on phi_j/(phi_i + phi_j), which is uniformly distributed over the cell, and that of the
fourth only on the point of the facet: means of |e'|^2 and of its slope there are enough, and are bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.discrete.cells import facet_vertices, own_cells
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.around_nodes import over_ranks
from fenicsx_obstacle.estimation.boundary_values import ROUND_OFF, BoundaryValues
from fenicsx_obstacle.estimation.edges import Edges, Jumps
from fenicsx_obstacle.estimation.pieces import Division, Group, pieces_of
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.simplex_geometry import longest_edges, sizes
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, smallest, total

FACETS = Division(4, 1e-2, 1e-3, slopes=True)
HALVED = 3  # subdivisions of facets on which the bound of the slope of e' is above
MIN_DEPTH = 2  # of the division of the smallest ones, along the line where a condition changes and beside it
STEEP = 0.02  # this fraction of the slope of d
MAX_PARTS = 100_000  # of facets; no subdivision beyond
NO_WIDTH = 1e-14  # relative to the facet: parts between two cuts that are narrower are lines, up to round-off
INSIDE = 1e-11  # relative shift of edge points towards the facet's centroid, where the datum is that of this facet
ALONG = np.linspace(0.0, 1.0, polynomials.MAX_DEGREE + 1)  # polynomials that agree there agree on the edge
DEGREE = 4
PAIRS = list(combinations(range(4), 2))
SIDES = list(combinations(range(3), 2))  # edges of a facet


def _lattice(corners: int) -> np.ndarray:
    """Barycentric coordinates of the nodes of degree DEGREE, times DEGREE, shape (nodes, corners)."""
    steps = product(range(DEGREE + 1), repeat=corners)
    return np.array([one for one in steps if sum(one) == DEGREE])


NODES, NODES_ON_FACET = _lattice(4), _lattice(3)
TO_BERNSTEIN, TO_BERNSTEIN_ON_FACET = (
    np.linalg.inv(polynomials.evaluate(np.eye(len(nodes)), nodes / DEGREE, DEGREE).T)
    for nodes in (NODES, NODES_ON_FACET)
)


@dataclass(frozen=True, eq=False)
class _Facets:
    """Facets of owned cells where one part of the boundary gives u.

    Attributes:
        cells: Owned cell beside each.
        opposite: Vertex of the cell opposite to it.
        members: Its vertices in the cell, shape (facets, 3).
        x: Their coordinates, shape (facets, 3, 3).
        edges: Local numbers of its edges in the order of `SIDES`, shape (facets, 3).
        upward: Whether the second end of each edge has the larger global number.
        value: What is given.
    """

    cells: np.ndarray
    opposite: np.ndarray
    members: np.ndarray
    x: np.ndarray
    edges: np.ndarray
    upward: np.ndarray
    value: Field


class SurfaceData(BoundaryValues):
    """The extension of boundary values from the facets of tetrahedra into the cells."""

    def __init__(self, simplices: Simplices):
        """Enclose the boundary values (collective).

        Raises:
            InputError: If they jump.
        """
        super().__init__(simplices)
        data, comm = simplices.data, simplices.data.level.comm
        self._nodal = data.fixed[1].x.array
        self._heights = max(largest(comm, np.abs(self._nodal[data.fixed[0]])), 0.0)
        self._of_cells, self._index_map = self._edges()
        parts, self._samples, low, high = self._facets(), 0, [self.least], [self.most]
        traces = self._traces(parts)
        bounds, found = np.zeros((4, self._edge_count)), []
        for part in parts:
            nodal = self._at_nodes(part, traces)
            of_facets, of_edges, lower, upper = self._beyond(part, nodal)
            found.append((nodal, of_facets))
            low.append(smallest(comm, lower))
            high.append(largest(comm, upper))
            for bound, values in zip(bounds, of_edges, strict=True):
                np.maximum.at(bound, part.edges.ravel(), values.ravel())
        self.least, self.most = min(low), max(high)
        self.sampled = total(comm, self._samples) > 0
        self._take_polynomials(parts, traces, [nodal for nodal, _ in found])
        bounds = np.stack([self._over_ranks(bound, PETSc.InsertMode.MAX) for bound in bounds])
        self._add_rest(parts, [of_facets for _, of_facets in found], bounds)
        self.twice = total(comm, np.count_nonzero(self.deviation)) > 0

    @property
    def _edge_count(self) -> int:
        return self._index_map.size_local + self._index_map.num_ghosts

    def _edges(self) -> tuple[np.ndarray, Any]:
        """Local edges of owned cells by their two vertices, shape (cells, 4, 4), and the numbering of edges."""
        mesh = self.simplices.data.level.mesh
        mesh.topology.create_entities(1)
        mesh.topology.create_connectivity(3, 1)
        local = mesh.topology.connectivity(3, 1).array.reshape(-1, 6)[: own_cells(mesh)]
        vertices, dofs = self.simplices.data.level.V.dofmap.index_map, self.simplices.dofs.astype(np.int32)
        numbers = np.asarray(vertices.local_to_global(dofs.ravel())).reshape(dofs.shape)
        self._upward = numbers[:, :, None] < numbers[:, None]
        return self.simplices.edges(local), mesh.topology.index_map(1)

    def _facets(self) -> list[_Facets]:
        """The facets of each part (local)."""
        simplices, data = self.simplices, self.simplices.data
        found = []
        for part, one in enumerate(data.model.boundary):
            if one.value is None:
                continue
            cells, opposite = np.nonzero(simplices.part_of == part)
            members = np.array(facet_vertices(3))[opposite]
            ends = [(members[:, i], members[:, j]) for i, j in SIDES]
            edges = np.stack([self._of_cells[cells, i, j] for i, j in ends], axis=1)
            upward = np.stack([self._upward[cells, i, j] for i, j in ends], axis=1)
            x = simplices.x[cells[:, None], members]
            found.append(_Facets(cells, opposite, members, x, edges, upward, one.value))
        return found

    def _traces(self, parts: list[_Facets]) -> np.ndarray:
        """Values at `ALONG` on local edges, towards the larger global vertex number, shape (points, edges); 0 where u
        is not given (collective).

        Raises:
            InputError: If facets with a common edge, or a common vertex, do not agree.
        """
        data = self.simplices.data
        jumps, traces, comm = Jumps(data, self._heights), [], data.level.comm
        sums, counts = np.zeros((len(ALONG), self._edge_count)), np.zeros(self._edge_count)
        for part in parts:
            values = np.empty((len(part.cells), 3, len(ALONG)))
            inner = (1 - INSIDE) * part.x + INSIDE * part.x.mean(axis=1, keepdims=True)
            for side, (i, j) in enumerate(SIDES):
                edges = Edges(inner[:, i], inner[:, j], part.cells)
                nodal = self._nodal[self.simplices.dofs[part.cells[:, None], part.members[:, [i, j]]]]
                jumps.look(part.value, edges, nodal)
                for k, t in enumerate(ALONG):
                    points = np.ascontiguousarray(edges.at(np.arange(len(part.cells)), np.full(len(part.cells), t)).T)
                    values[:, side, k] = data.at(part.value, points, part.cells)
            values = np.where(part.upward[..., None], values, values[..., ::-1])
            traces.append(values)
            jumps.scale = max(jumps.scale, largest(comm, np.abs(values)))
            for k, row in enumerate(sums):
                np.add.at(row, part.edges.ravel(), values[..., k].ravel())
            np.add.at(counts, part.edges.ravel(), 1.0)
        sums = np.stack([self._over_ranks(row, PETSc.InsertMode.ADD) for row in sums])
        counts = self._over_ranks(counts, PETSc.InsertMode.ADD)
        mean = sums / np.maximum(counts, 1.0)
        for part, values in zip(parts, traces, strict=True):
            jumps.compare(part.value, values, np.moveaxis(mean[:, part.edges], 0, 2), self._places(part))
        jumps.reject()
        self._given = counts > 0
        if total(comm, self._unsure(parts)) > 0:
            self._samples += 1
        return mean

    def _places(self, part: _Facets) -> np.ndarray:
        """Points of `ALONG` on the edges of facets, shape (facets, 3, points, 3)."""
        start, end = (np.stack([part.x[:, side[k]] for side in SIDES], axis=1) for k in range(2))
        up = part.upward[..., None]
        start, end = np.where(up, start, end), np.where(up, end, start)
        return start[:, :, None] + ALONG[:, None] * (end - start)[:, :, None]

    def _unsure(self, parts: list[_Facets]) -> int:
        """Whether facets may disagree between the points at which they were compared (collective).

        They do not where all are polynomials there, nor where one continuous datum gives all of them.
        """
        curved = [part for part in parts if not part.value.uniform]
        if len(curved) == len(parts) == 1 and parts[0].value.continuous:
            return 0
        found = 0
        for part in curved:
            pieces = pieces_of(self.simplices.data, part.value, part.x, part.cells, Division(0))
            found += sum(np.count_nonzero(group.rest > 0) for group in pieces.groups)
        return found

    def _along(self, traces: np.ndarray, edges: np.ndarray, upward: np.ndarray, share: float) -> np.ndarray:
        """Values on edges at a share of the way from their first to their second end."""
        place = round(share * (len(ALONG) - 1))
        return np.where(upward, traces[place][edges], traces[len(ALONG) - 1 - place][edges])

    def _at_nodes(self, part: _Facets, traces: np.ndarray) -> np.ndarray:
        """d at the nodes on facets, shape (facets, nodes) (collective on first use of the datum)."""
        ends = self._nodal[self.simplices.dofs[part.cells[:, None], part.members]]
        found = np.zeros((len(part.cells), len(NODES_ON_FACET)))
        if part.value.uniform:
            return found
        for n, node in enumerate(NODES_ON_FACET):
            where = np.flatnonzero(node)
            if len(where) == 2:
                side = SIDES.index((where[0], where[1]))
                values = self._along(traces, part.edges[:, side], part.upward[:, side], node[where[1]] / DEGREE)
            elif len(where) == 3:
                points = np.ascontiguousarray(np.einsum("k,fkx->xf", node / DEGREE, part.x))
                values = self.simplices.data.at(part.value, points, part.cells)
            else:
                continue
            found[:, n] = values - ends @ (node / DEGREE)
        found[np.abs(found) <= 8 * ROUND_OFF * self._heights] = 0.0
        return found

    def _beyond(self, part: _Facets, nodal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Bounds of e', what is left of d minus its interpolant, on facets (collective).

        Returns:
            Bounds on each facet of |e'|, of its slope, and of the means of the squares of both, shape
            (4, facets); the same along its edges, shape (4, facets, 3); and bounds of the boundary value.
        """
        of_facets, of_edges = np.zeros((4, len(part.cells))), np.zeros((4, len(part.cells), 3))
        if part.value.uniform:
            return of_facets, of_edges, np.empty(0), np.empty(0)
        ends = self._nodal[self.simplices.dofs[part.cells[:, None], part.members]]
        polynomial = (nodal + ends @ (NODES_ON_FACET.T / DEGREE)) @ TO_BERNSTEIN_ON_FACET.T
        enough = STEEP * DEGREE * np.abs(nodal).max(axis=1, initial=0.0) / longest_edges(part.x)
        groups, lower, upper = self._enclosed(part, enough)
        for group in groups:
            away, steep = self._beyond_polynomials(group, polynomial, part.x)
            self._samples += np.count_nonzero(~np.isfinite(group.steep))
            for k, values in enumerate((away, steep)):
                np.maximum.at(of_facets[k], group.rows, values)
                np.add.at(of_facets[k + 2], group.rows, group.share * values**2)
            for side, (i, j) in enumerate(SIDES):
                share = _share_of_edge(group, i, j)
                for k, values in enumerate((away, steep)):
                    np.maximum.at(of_edges[k, :, side], group.rows, np.where(share > 0, values, 0.0))
                    np.add.at(of_edges[k + 2, :, side], group.rows, share * values**2)
        return of_facets, of_edges, lower, upper

    def _enclosed(self, part: _Facets, enough: np.ndarray) -> tuple[list[Group], np.ndarray, np.ndarray]:
        """The boundary value on parts of facets, and its bounds on these (collective on first use of the datum).

        Args:
            part: The facets.
            enough: A bound of the slope that need not be improved, on each facet.
        """
        owner, inside, found = np.arange(len(part.cells)), np.broadcast_to(np.eye(3), (len(part.cells), 3, 3)), []
        lower, upper, share = [], [], 1.0
        for split in range(HALVED + 1):
            last = split == HALVED or 4 * len(owner) > MAX_PARTS
            division = replace(FACETS, depth=max(FACETS.depth - split, MIN_DEPTH))
            pieces = pieces_of(self.simplices.data, part.value, inside @ part.x[owner], part.cells[owner], division)
            self._samples += int(pieces.sampled)
            lower.append(pieces.lower)
            upper.append(pieces.upper)
            if not pieces.finite.all():
                self.unbounded = part.x[owner[np.argmin(pieces.finite)]].mean(axis=0)
            far = np.zeros(len(owner), dtype=bool)
            for group in pieces.groups:
                far[group.rows[group.steep > enough[owner[group.rows]]]] = not last
            for group in pieces.groups:
                kept = group[np.flatnonzero(~far[group.rows])]
                corners = inside[kept.rows] if kept.corners is None else kept.corners @ inside[kept.rows]
                found.append(replace(kept, rows=owner[kept.rows], corners=corners, share=share * kept.share))
            if not far.any():
                break
            owner, inside, share = np.repeat(owner[far], 4), polynomials.halved(inside[far]), share / 4
        return found, np.concatenate(lower), np.concatenate(upper)

    def _beyond_polynomials(self, group: Group, polynomial: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of |e'| and of its slope on parts of facets (local).

        Args:
            group: Of parts.
            polynomial: Bernstein coefficients of the interpolants of the boundary value.
            x: Corners of the facets.
        """
        rows, degree = group.rows, max(group.degree, DEGREE)
        points = polynomials.inner_points(3, degree)
        at_points = polynomials.evaluate(np.eye(polynomial.shape[1]), group.points(points).reshape(-1, 3), DEGREE)
        at_points = at_points.T.reshape(len(rows), len(points), polynomial.shape[1])
        there = np.einsum("fpn,fn->fp", at_points, polynomial[rows])
        coefficients = polynomials.coefficients(group.values(points) - there, 3, degree)
        along = polynomials.slopes(coefficients, 3, degree)
        slope, narrowest = _slopes_on_facets(group, along, x)
        unknown = ~np.isfinite(group.steep)
        # where nothing is known of the slope the bound rests on samples
        more = np.where(unknown, (group.upper - group.lower) / narrowest, group.steep)
        away = polynomials.row_size(coefficients)
        exact = (away <= 64 * ROUND_OFF * self._heights) & (group.rest == 0)
        away = away + group.known_rest
        slope += np.where(np.isfinite(more), more, 0.0)
        return np.where(exact, 0.0, away), np.where(exact, 0.0, slope)

    def _take_polynomials(self, parts: list[_Facets], traces: np.ndarray, nodal: list[np.ndarray]) -> None:
        """The polynomials of w in the cells (local)."""
        simplices, edges = self.simplices, self._of_cells
        ends = self._nodal[simplices.dofs]
        upward = self._upward
        values = np.zeros((len(simplices.area), len(NODES)))
        place = {tuple(node): n for n, node in enumerate(NODES)}
        for i, j in PAIRS:
            edge = edges[:, i, j]
            given = self._given[edge]
            linear = (ends[:, i] + ends[:, j]) / 2
            middle = np.where(given, self._along(traces, edge, upward[:, i, j], 0.5) - linear, 0.0)
            values += 4 * middle[:, None] * (NODES[:, i] * NODES[:, j] / DEGREE**2)
            for step in range(1, DEGREE):
                share = step / DEGREE
                d = self._along(traces, edge, upward[:, i, j], share) - (1 - share) * ends[:, i] - share * ends[:, j]
                node = [0] * 4
                node[i], node[j] = DEGREE - step, step
                values[:, place[tuple(node)]] = np.where(given, d, 0.0)
        for part, of_part in zip(parts, nodal, strict=True):
            for n, node in enumerate(NODES_ON_FACET):
                if np.count_nonzero(node) < 3:
                    continue
                full = np.zeros((len(part.cells), 4), dtype=int)
                np.put_along_axis(full, part.members, np.broadcast_to(node, part.members.shape), axis=1)
                column = np.array([place[tuple(one)] for one in full.tolist()], dtype=int)
                values[part.cells, column] = of_part[:, n]
        values[np.abs(values) <= 8 * ROUND_OFF * self._heights] = 0.0
        self._cells = np.flatnonzero(values.any(axis=1))
        coefficients = values[self._cells] @ TO_BERNSTEIN.T
        area = simplices.area[self._cells]
        gradients = np.moveaxis(simplices.normal[:, self._cells], 0, 2) / (3 * area)[:, None, None]
        along = polynomials.slopes(coefficients, 4, DEGREE)
        slopes = np.einsum("ckn,ckx->cnx", along, gradients)
        points, weights = rule(3, 2 * (DEGREE - 1))
        there = np.stack([polynomials.evaluate(slopes[..., axis], points, DEGREE - 1) for axis in range(3)])
        count = len(simplices.area)
        self._energy, self._steepest, self._below = np.zeros(count), np.zeros(count), np.zeros((2, count))
        self._energy[self._cells] = np.einsum("xcp,xcp,p->c", there, there, weights)
        self._steepest[self._cells] = np.linalg.norm(slopes, axis=2).max(axis=1, initial=0.0)
        for k, sign in enumerate((1.0, -1.0)):
            lowest = -polynomials.largest(-sign * coefficients, 4, DEGREE)
            self._below[k, self._cells] = np.maximum(-lowest, 0.0)
        self.deviation = self._below.max(axis=0)
        self.volume[self._cells] = area * coefficients.mean(axis=1)

    def _add_rest(self, parts: list[_Facets], of_facets: list[np.ndarray], of_edges: np.ndarray) -> None:
        """Bounds of the non-polynomial part of w in the cells (local)."""
        simplices, edges = self.simplices, self._of_cells
        norms = np.linalg.norm(simplices.normal, axis=0) / (3 * simplices.area)[:, None]  # of grad phi_i
        rest, steep, mean = (np.zeros(len(simplices.area)) for _ in range(3))
        for i, j in PAIRS:
            value, slope, value_mean, slope_mean = of_edges[:, edges[:, i, j]]
            length = np.linalg.norm(simplices.x[:, i] - simplices.x[:, j], axis=1)
            both = np.linalg.norm(simplices.normal[:, :, i] + simplices.normal[:, :, j], axis=0) / (3 * simplices.area)
            along = length * np.maximum(norms[:, i], norms[:, j])
            rest += value
            steep += value * both + slope * along
            mean += np.sqrt(value_mean) * both + np.sqrt(slope_mean) * along
        for part, bounds in zip(parts, of_facets, strict=True):
            value, slope, value_mean, slope_mean = bounds[0], bounds[1], np.sqrt(bounds[2]), np.sqrt(bounds[3])
            size = sizes(part.x)
            norm = [
                np.linalg.norm(part.x[:, (m + 1) % 3] - part.x[:, (m + 2) % 3], axis=1) / (2 * size) for m in range(3)
            ]
            for side, (i, j) in enumerate(SIDES):
                of_edge = of_edges[:, part.edges[:, side]]
                length = np.linalg.norm(part.x[:, i] - part.x[:, j], axis=1)
                both, along = norm[3 - i - j], length * np.maximum(norm[i], norm[j])
                value = value + of_edge[0]
                slope = slope + of_edge[0] * both + of_edge[1] * along
                # the mean of (phi_i + phi_j)^2 on a facet is 1/2
                value_mean = value_mean + np.sqrt(of_edge[2] / 2)
                slope_mean = slope_mean + np.sqrt(of_edge[2]) * both + np.sqrt(of_edge[3]) * along
            height = 3 * simplices.area[part.cells] / size
            tip = simplices.x[part.cells, part.opposite]
            foot = tip - height[:, None] * simplices.normal[:, part.cells, part.opposite].T / size[:, None]
            arm = np.linalg.norm(part.x - foot[:, None], axis=2).max(axis=1, initial=0.0)
            np.add.at(rest, part.cells, value)
            np.add.at(steep, part.cells, np.hypot(slope, (value + arm * slope) / height))
            np.add.at(mean, part.cells, np.hypot(slope_mean, (value_mean + arm * slope_mean) / height))
        self._energy = (np.sqrt(self._energy) + mean) ** 2
        self._steepest += steep
        self._below += rest
        self.deviation += rest
        self.volume_rest = simplices.area * rest

    def energy(self, mu: np.ndarray) -> np.ndarray:
        """See `BoundaryValues.energy`."""
        return mu * self.simplices.area * self._energy

    def on_parts(self, owner: np.ndarray, inside: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """See `BoundaryValues.on_parts`; the bounds are those on whole cells."""
        return -self._below[0 if sign > 0 else 1][owner], self._steepest[owner]

    def _over_ranks(self, values: np.ndarray, how: PETSc.InsertMode) -> np.ndarray:
        """Values at local edges from those of all ranks (collective)."""
        return over_ranks(self._index_map, self.simplices.data.level.comm, values, how)


def _slopes_on_facets(group: Group, along: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def _share_of_edge(group: Group, i: int, j: int) -> np.ndarray:
    """The share of the edge from i to j of its facet in each part of a group."""
    assert group.corners is not None
    on = group.corners[..., 3 - i - j] == 0
    places = group.corners[..., j]
    low = np.where(on, places, np.inf).min(axis=1, initial=np.inf)
    high = np.where(on, places, -np.inf).max(axis=1, initial=-np.inf)
    return np.where(on.sum(axis=1) >= 2, high - low, 0.0)

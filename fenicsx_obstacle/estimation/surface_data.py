"""Boundary values between the nodes of tetrahedra.

On the facets where u is given let d be the difference of boundary value and nodal interpolant. It is continued into the
cells as a continuous function w with w = d there:

    w = sum_E b_E phi_i phi_j + sum_E (phi_i + phi_j) e_E(phi_j/(phi_i + phi_j)) + sum_F (1 - phi_a) r_F.

E are the edges (i, j) of these facets and b_E/4 is d at the middle of E, so that the first sum is d where that is
quadratic. e = d - first sum is of third order; e_E is e along an edge, which w has in all cells around it. r_F is what
is left of e on a facet. It is 0 on the edges of the facet, and in the cell beside it a cone with the tip at the
opposite vertex a. The first sum is integrated exactly; of e bounds of value and slope are enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.boundary_values import BoundaryValues
from fenicsx_obstacle.estimation.edges import Edges, Jumps
from fenicsx_obstacle.estimation.pieces import Division, Group, pieces_of
from fenicsx_obstacle.estimation.shapes import least_heights, sizes
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, smallest, total

FACETS = Division(4, 1e-2, 1e-3)
ROUND_OFF = 1e-14  # of the heights
INSIDE = 1e-11  # of the way from an edge to the middle of a facet: values there are those of this facet
ALONG = np.linspace(0.0, 1.0, polynomials.MAX_DEGREE + 1)  # polynomials that agree there agree on the edge
PAIRS = list(combinations(range(4), 2))
SIDES = list(combinations(range(3), 2))  # edges of a facet


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
    """Boundary values on the facets of tetrahedra."""

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
        middle = self._traces(parts)
        self._bubbles = self._amplitudes(middle)
        value, slope = (np.zeros(self._edge_count) for _ in range(2))
        found = []
        for part in parts:
            away, steep, lower, upper = self._beyond(part, middle)
            found.append((away, steep))
            low.append(smallest(comm, lower))
            high.append(largest(comm, upper))
            for bound, of_facets in ((value, away), (slope, steep)):
                np.maximum.at(bound, part.edges.ravel(), np.repeat(of_facets, 3))
        self.least, self.most = min(low), max(high)
        self.sampled = total(comm, self._samples) > 0
        value, slope = (self._largest(bound) for bound in (value, slope))
        self._bound(parts, found, value, slope)
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
        return self.simplices.edges(local), mesh.topology.index_map(1)

    def _facets(self) -> list[_Facets]:
        """The facets of each part (local)."""
        simplices, data = self.simplices, self.simplices.data
        owner = np.full(max(simplices.facets.max(initial=-1) + 1, 1), -1)
        for number, facets in enumerate(data.held):
            owner[facets[facets < len(owner)]] = number  # of two parts the later one counts
        index_map, dofs = data.level.V.dofmap.index_map, simplices.dofs.astype(np.int32)
        numbers = np.asarray(index_map.local_to_global(dofs.ravel())).reshape(dofs.shape)
        found = []
        for part, one in enumerate(data.model.boundary):
            if one.value is None:
                continue
            cells, opposite = np.nonzero(owner[simplices.facets] == part)
            members = np.array([[k for k in range(4) if k != a] for a in range(4)])[opposite]
            ends = [(members[:, i], members[:, j]) for i, j in SIDES]
            edges = np.stack([self._of_cells[cells, i, j] for i, j in ends], axis=1)
            upward = np.stack([numbers[cells, i] < numbers[cells, j] for i, j in ends], axis=1)
            x = simplices.x[cells[:, None], members]
            found.append(_Facets(cells, opposite, members, x, edges, upward, one.value))
        return found

    def _traces(self, parts: list[_Facets]) -> np.ndarray:
        """Values at the middles of edges; 0 where u is not given (collective).

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
        sums = np.stack([self._added(row) for row in sums])
        counts = self._added(counts)
        mean = sums / np.maximum(counts, 1.0)
        for part, values in zip(parts, traces, strict=True):
            jumps.compare(part.value, values, np.moveaxis(mean[:, part.edges], 0, 2), self._places(part))
        jumps.reject()
        self._given = counts > 0
        if total(comm, self._unsure(parts)) > 0:
            self._samples += 1
        return mean[len(ALONG) // 2]

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

    def _amplitudes(self, middle: np.ndarray) -> np.ndarray:
        """b_E of the edges of owned cells by their two vertices, shape (cells, 4, 4) (local)."""
        nodal, edges = self._nodal[self.simplices.dofs], self._of_cells
        found = 4 * (middle[edges] - (nodal[:, :, None] + nodal[:, None]) / 2)
        found[~self._given[edges] | (np.abs(found) <= 8 * ROUND_OFF * self._heights)] = 0.0
        found[:, np.arange(4), np.arange(4)] = 0.0
        return found

    def _beyond(self, part: _Facets, middle: np.ndarray) -> tuple[np.ndarray, ...]:
        """Bounds of |e| and of its slope on facets, and of the boundary value (collective)."""
        away, steep = np.zeros(len(part.cells)), np.zeros(len(part.cells))
        if part.value.uniform:
            return away, steep, np.empty(0), np.empty(0)
        pieces = pieces_of(self.simplices.data, part.value, part.x, part.cells, FACETS)
        self._samples += int(pieces.sampled)
        if not pieces.finite.all():
            self.unbounded = part.x[np.argmin(pieces.finite)].mean(axis=0)
        nodal = self._nodal[self.simplices.dofs[part.cells[:, None], part.members]]
        for group in pieces.groups:
            for_facet, slope = self._beyond_quadratic(group, nodal, middle[part.edges], part.x)
            np.maximum.at(away, group.rows, for_facet)
            np.maximum.at(steep, group.rows, slope)
        return away, steep, pieces.lower, pieces.upper

    def _beyond_quadratic(
        self, group: Group, nodal: np.ndarray, middle: np.ndarray, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same on parts of facets (local)."""
        rows, degree = group.rows, max(group.degree, 2)
        points = polynomials.inner_points(3, degree)
        t = np.broadcast_to(group.points(points), (len(rows), len(points), 3))
        quadratic = np.einsum("npk,nk->np", t * (2 * t - 1), nodal[rows])
        for side, (i, j) in enumerate(SIDES):
            quadratic += 4 * t[..., i] * t[..., j] * middle[rows, side][:, None]
        difference = group.values(points) - quadratic
        coefficients = polynomials.coefficients(difference, 3, degree)
        along = polynomials.slopes(coefficients, 3, degree)
        corners = x[rows] if group.corners is None else group.corners @ x[rows]
        heights = least_heights(corners)
        largest_slope = [np.abs(along[:, k] - along[:, 0]).max(axis=1, initial=0.0) for k in (1, 2)]
        unknown = ~np.isfinite(group.steep)
        self._samples += np.count_nonzero(unknown)
        # where nothing is known of the slope the datum is an indicator's
        more = np.where(unknown, (group.upper - group.lower) / heights, group.steep)
        away = np.abs(coefficients).max(axis=1, initial=0.0)
        exact = (away <= 64 * ROUND_OFF * self._heights) & (group.rest == 0)
        away = np.where(exact, 0.0, away + np.where(np.isfinite(group.rest), group.rest, 0.0))
        slope = (largest_slope[0] + largest_slope[1]) / heights + np.where(np.isfinite(more), more, 0.0)
        return away, np.where(exact, 0.0, slope)

    def _bound(
        self, parts: list[_Facets], found: list[tuple[np.ndarray, np.ndarray]], value: np.ndarray, slope: np.ndarray
    ) -> None:
        """Bounds of w in the cells (local)."""
        simplices, edges = self.simplices, self._of_cells
        gradients = np.moveaxis(simplices.normal, 0, 2) / (3 * simplices.area)[:, None, None]
        # of the sum over edges: its gradient at the vertices, which is linear
        self._gradients = np.einsum("cij,cjx->cix", self._bubbles, gradients)
        self._rough, rest = np.zeros(len(simplices.area)), np.zeros(len(simplices.area))
        norms = np.linalg.norm(gradients, axis=2)
        size = np.zeros((2, len(rest)))
        negative = np.zeros((2, len(rest)))
        for i, j in PAIRS:
            away, steep = value[edges[:, i, j]], slope[edges[:, i, j]]
            rest += away
            length = np.linalg.norm(simplices.x[:, i] - simplices.x[:, j], axis=1)
            both = np.linalg.norm(gradients[:, i] + gradients[:, j], axis=1)
            self._rough += away * both + steep * length * np.maximum(norms[:, i], norms[:, j])
            bubble = self._bubbles[:, i, j]
            size[0] += np.abs(bubble) / 4
            size[1] = np.maximum(size[1], np.abs(bubble))
            for k, sign in enumerate((1.0, -1.0)):
                negative[k] += np.maximum(-sign * bubble, 0.0) / 4
            self.volume += simplices.area / 20 * bubble
        for part, (away, steep) in zip(parts, found, strict=True):
            of_facet = sizes(part.x)
            for side, (i, j) in enumerate(SIDES):
                k = 3 - i - j
                length = np.linalg.norm(part.x[:, i] - part.x[:, j], axis=1)
                slopes = [
                    np.linalg.norm(part.x[:, (m + 1) % 3] - part.x[:, (m + 2) % 3], axis=1) / (2 * of_facet)
                    for m in (i, j, k)
                ]
                of_edge, its_slope = value[part.edges[:, side]], slope[part.edges[:, side]]
                away = away + of_edge
                steep = steep + of_edge * slopes[2] + its_slope * length * np.maximum(slopes[0], slopes[1])
            height = 3 * simplices.area[part.cells] / of_facet
            tip = simplices.x[part.cells, part.opposite]
            normal = simplices.normal[:, part.cells, part.opposite].T / of_facet[:, None]
            foot = tip - height[:, None] * normal
            arm = np.linalg.norm(part.x - foot[:, None], axis=2).max(axis=1, initial=0.0)
            np.add.at(rest, part.cells, away)
            np.add.at(self._rough, part.cells, np.hypot(steep, (away + arm * steep) / height))
        # sum |b| phi_i phi_j <= max |b| (1 - sum phi_i^2)/2
        self.deviation = np.minimum(size[0], 3 / 8 * size[1]) + rest
        self._below = np.minimum(negative, 3 / 8 * size[1]) + rest
        self.volume_rest = simplices.area * rest

    def energy(self, mu: np.ndarray) -> np.ndarray:
        """See `BoundaryValues.energy`."""
        area, at_vertices = self.simplices.area, self._gradients
        both = np.einsum("cix,cix->c", at_vertices, at_vertices) + (at_vertices.sum(axis=1) ** 2).sum(axis=1)
        return mu * area * (np.sqrt(both / 20) + self._rough) ** 2

    def on_parts(self, owner: np.ndarray, inside: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """See `BoundaryValues.on_parts`; the bounds are those on whole cells."""
        least = -self._below[0 if sign > 0 else 1][owner]
        steepest = np.linalg.norm(self._gradients[owner], axis=2).max(axis=1, initial=0.0)
        return least, steepest + self._rough[owner]

    def _added(self, values: np.ndarray) -> np.ndarray:
        """Sums over the ranks of values at local edges (collective)."""
        return self._over_ranks(values, PETSc.InsertMode.ADD)

    def _largest(self, values: np.ndarray) -> np.ndarray:
        """The largest over the ranks of values at local edges (collective)."""
        return self._over_ranks(values, PETSc.InsertMode.MAX)

    def _over_ranks(self, values: np.ndarray, how: PETSc.InsertMode) -> np.ndarray:
        edges, comm = self._index_map, self.simplices.data.level.comm
        size = edges.size_local, edges.size_global
        vector = PETSc.Vec().createGhost(np.asarray(edges.ghosts, dtype=PETSc.IntType), size, comm=comm)
        with vector.localForm() as local:
            local.array[:] = values
        vector.ghostUpdate(addv=how, mode=PETSc.ScatterMode.REVERSE)
        vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        with vector.localForm() as local:
            found = local.array_r.copy()
        vector.destroy()
        return found

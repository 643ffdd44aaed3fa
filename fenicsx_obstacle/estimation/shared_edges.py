"""Boundary values along the edges of tetrahedra, which cells on several ranks share."""

from __future__ import annotations

from functools import reduce
from itertools import combinations

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.estimation.boundary_values import DEGREE, NODES, TO_BERNSTEIN, Facets, places
from fenicsx_obstacle.estimation.edges import Edges, Jumps
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of
from fenicsx_obstacle.estimation.pieces import Group
from fenicsx_obstacle.estimation.simplex_geometry import sizes
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.mesh.around_nodes import over_ranks
from fenicsx_obstacle.mesh.cells import cell_edges, own_cells
from fenicsx_obstacle.parallel import total

INSIDE = 1e-11  # relative shift of edge points towards the facet's centroid, where the datum is that of this facet
ALONG = np.linspace(0.0, 1.0, polynomials.MAX_DEGREE + 1)  # polynomials that agree there agree on the edge
PAIRS = list(combinations(range(4), 2))
SIDES = list(combinations(range(3), 2))  # edges of a facet


class SharedEdges:
    """The edges of facets where u is given; the symbols are those of `boundary_data`."""

    def __init__(self, simplices: Simplices, nodal: np.ndarray):
        """Number them (collective).

        Args:
            simplices: The owned tetrahedra.
            nodal: Boundary values at local dofs.
        """
        self._simplices, self._nodal, mesh = simplices, nodal, simplices.data.level.mesh
        local = cell_edges(mesh)[: own_cells(mesh)]
        vertices, dofs = simplices.data.level.V.dofmap.index_map, simplices.dofs.astype(np.int32)
        numbers = np.asarray(vertices.local_to_global(dofs.ravel())).reshape(dofs.shape)
        self._upward = numbers[:, :, None] < numbers[:, None]
        self._of_cells, self._index_map = simplices.edges(local), mesh.topology.index_map(1)
        self._count = self._index_map.size_local + self._index_map.num_ghosts
        self._bounds = np.zeros((4, self._count))

    def _of_facets(self, part: Facets) -> tuple[np.ndarray, np.ndarray]:
        """Local numbers of the edges of facets in the order of `SIDES`, and whether the second end of each has the
        larger global number, shape (facets, 3)."""
        (i, j), cells = np.moveaxis(part.members[:, SIDES], 2, 0), part.cells[:, None]
        return self._of_cells[cells, i, j], self._upward[cells, i, j]

    def compare(self, parts: list[Facets], jumps: Jumps) -> int:
        """Find the values at `ALONG` on local edges, towards the larger global vertex number, and the jumps between
        facets with a common edge or vertex (collective).

        Returns:
            Whether facets may disagree between the points at which they were compared.
        """
        data, traces, comm = self._simplices.data, [], self._simplices.data.level.comm
        sums, counts = np.zeros((len(ALONG), self._count)), np.zeros(self._count)
        for part in parts:
            numbers, upward = self._of_facets(part)
            values = np.empty((len(part.cells), 3, len(ALONG)))
            inner = (1 - INSIDE) * part.x + INSIDE * part.x.mean(axis=1, keepdims=True)
            for side, (i, j) in enumerate(SIDES):
                edges = Edges(inner[:, i], inner[:, j], part.cells)
                jumps.look(part.value, edges, part.ends[:, [i, j]])
                for k, t in enumerate(ALONG):
                    points = np.ascontiguousarray(edges.at(np.arange(len(part.cells)), np.full(len(part.cells), t)).T)
                    values[:, side, k] = data.at(part.value, points, part.cells)
            values = np.where(upward[..., None], values, values[..., ::-1])
            traces.append(values)
            jumps.take(values)
            for k, row in enumerate(sums):
                np.add.at(row, numbers.ravel(), values[..., k].ravel())
            np.add.at(counts, numbers.ravel(), 1.0)
        sums = np.stack([self._over_ranks(row, PETSc.InsertMode.ADD) for row in sums])
        counts = self._over_ranks(counts, PETSc.InsertMode.ADD)
        self._traces, self._given = sums / np.maximum(counts, 1.0), counts > 0
        for part, values in zip(parts, traces, strict=True):
            mean = np.moveaxis(self._traces[:, self._of_facets(part)[0]], 0, 2)
            jumps.compare(part.value, values, mean, self._places(part))
        return int(total(comm, self._unsure(parts)) > 0)

    def _places(self, part: Facets) -> np.ndarray:
        """Points of `ALONG` on the edges of facets, shape (facets, 3, points, 3)."""
        start, end = np.moveaxis(part.x[:, SIDES], 2, 0)
        up = self._of_facets(part)[1][..., None]
        start, end = np.where(up, start, end), np.where(up, end, start)
        return start[:, :, None] + ALONG[:, None] * (end - start)[:, :, None]

    def _unsure(self, parts: list[Facets]) -> int:
        """Whether facets may disagree between the points at which they were compared (collective).

        They do not where all are polynomials there, nor where one continuous datum gives all of them.
        """
        curved = [part for part in parts if not part.value.uniform]
        if len(curved) == len(parts) == 1 and parts[0].value.continuous:
            return 0
        found = 0
        for part in curved:
            pieces = pieces_of(self._simplices.data, part.value, part.x, part.cells, Division(0))
            found += sum(np.count_nonzero(group.rest > 0) for group in pieces.groups)
        return found

    def _along(self, edges: np.ndarray, upward: np.ndarray, share: float) -> np.ndarray:
        """Boundary values on edges at a share of the way from their first to their second end."""
        place = round(share * (len(ALONG) - 1))
        return np.where(upward, self._traces[place][edges], self._traces[len(ALONG) - 1 - place][edges])

    def at_node(self, part: Facets, node: np.ndarray) -> np.ndarray:
        """Boundary values at a node on an edge of each facet."""
        i, j = np.flatnonzero(node)
        side, (numbers, upward) = SIDES.index((i, j)), self._of_facets(part)
        return self._along(numbers[:, side], upward[:, side], node[j] / DEGREE)

    def take(self, part: Facets, found: list[tuple[Group, np.ndarray, np.ndarray]]) -> None:
        """Let edges of facets have bounds of |e| and of its slope on parts of these (local)."""
        of_facets = np.zeros((4, len(part.cells), 3))
        for group, *bounds in found:
            for side, (i, j) in enumerate(SIDES):
                share = _share_of_edge(group, i, j)
                for k, values in enumerate(bounds):
                    np.maximum.at(of_facets[k, :, side], group.rows, np.where(share > 0, values, 0.0))
                    np.add.at(of_facets[k + 2, :, side], group.rows, share * values**2)
        numbers = self._of_facets(part)[0]
        for bound, values in zip(self._bounds, of_facets, strict=True):
            np.maximum.at(bound, numbers.ravel(), values.ravel())

    @property
    def near(self) -> np.ndarray:
        """Whether each owned cell has such an edge."""
        return reduce(np.logical_or, (self._given[self._of_cells[:, i, j]] for i, j in PAIRS))

    def put(self, cells: np.ndarray, coefficients: np.ndarray, negligible: float) -> None:
        """Set Bernstein coefficients of w on the edges of some cells (local).

        Args:
            cells: Which.
            coefficients: Of w, shape (cells, nodes).
            negligible: A value of d that is round-off.
        """
        ends, place = self._nodal[self._simplices.dofs[cells]], places(4)
        for i, j in PAIRS:
            edge, upward = self._of_cells[cells, i, j], self._upward[cells, i, j]
            d = np.zeros((len(cells), len(NODES[2])))
            for n in np.flatnonzero(NODES[2].all(axis=1)):
                share = NODES[2][n] / DEGREE
                d[:, n] = self._along(edge, upward, share[1]) - ends[:, [i, j]] @ share
            d[~self._given[edge]] = 0.0
            d[np.abs(d) <= negligible] = 0.0
            nodes = np.zeros((len(NODES[2]), 4), dtype=int)
            nodes[:, [i, j]] = NODES[2]
            coefficients[:, [place[tuple(node)] for node in nodes.tolist()]] = d @ TO_BERNSTEIN[2].T

    def add_to(self, rest: np.ndarray, steep: np.ndarray, mean: np.ndarray) -> None:
        """Add bounds of the second sum of w in the cells, of its gradient, and of the mean of that (collective)."""
        simplices, corners = self._simplices, self._simplices.x
        self._bounds = np.stack([self._over_ranks(bound, PETSc.InsertMode.MAX) for bound in self._bounds])
        norms = np.linalg.norm(simplices.normal, axis=0) / (3 * simplices.area)[:, None]  # of grad phi_i
        for i, j in PAIRS:
            value, slope, value_mean, slope_mean = self._bounds[:, self._of_cells[:, i, j]]
            length = np.linalg.norm(corners[:, i] - corners[:, j], axis=1)
            both = np.linalg.norm(simplices.normal[:, :, i] + simplices.normal[:, :, j], axis=0) / (3 * simplices.area)
            along = length * np.maximum(norms[:, i], norms[:, j])
            rest += value
            steep += value * both + slope * along
            mean += np.sqrt(value_mean) * both + np.sqrt(slope_mean) * along

    def left_on(self, part: Facets, bounds: np.ndarray) -> np.ndarray:
        """Bounds of r_F from those of e on facets, of shape (4, facets): of the absolute value, of the slope, and of
        the roots of the means of the squares of both (local)."""
        left, size, numbers = bounds.copy(), sizes(part.x), self._of_facets(part)[0]
        norm = [np.linalg.norm(part.x[:, (m + 1) % 3] - part.x[:, (m + 2) % 3], axis=1) / (2 * size) for m in range(3)]
        for side, (i, j) in enumerate(SIDES):
            value, slope, value_mean, slope_mean = self._bounds[:, numbers[:, side]]
            length = np.linalg.norm(part.x[:, i] - part.x[:, j], axis=1)
            both, along = norm[3 - i - j], length * np.maximum(norm[i], norm[j])
            # the mean of (phi_i + phi_j)^2 on a facet is 1/2
            means = np.sqrt(value_mean / 2), np.sqrt(value_mean) * both + np.sqrt(slope_mean) * along
            left += np.stack([value, value * both + slope * along, *means])
        return left

    def _over_ranks(self, values: np.ndarray, how: PETSc.InsertMode) -> np.ndarray:
        """Values at local edges from those of all ranks (collective)."""
        return over_ranks(self._index_map, self._simplices.data.level.comm, values, how)


def _share_of_edge(group: Group, i: int, j: int) -> np.ndarray:
    """The share of the edge from i to j of its facet in each part of a group."""
    assert group.corners is not None
    on = group.corners[..., 3 - i - j] == 0
    places = group.corners[..., j]
    low = np.where(on, places, np.inf).min(axis=1, initial=np.inf)
    high = np.where(on, places, -np.inf).max(axis=1, initial=-np.inf)
    return np.where(on.sum(axis=1) >= 2, high - low, 0.0)

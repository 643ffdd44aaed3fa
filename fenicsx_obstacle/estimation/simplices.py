"""Intervals, triangles or tetrahedra of a mesh as arrays, and data inside them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from fenicsx_obstacle import polynomials, releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.quadrature import blocks
from fenicsx_obstacle.estimation.simplex_geometry import inward
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import cell_facets, corners, own_cells, signed_volumes
from fenicsx_obstacle.parallel import total

ON_AXIS = 1e-12  # relative to the largest distance from it


class Simplices:
    """The owned cells of a level of P1 on intervals, triangles or tetrahedra, of as many coordinates as dimensions
    (methods are collective only where they say so).

    Attributes:
        dim: Their dimension d.
        dofs: Local dofs of the vertices, shape (cells, d + 1).
        x: Their coordinates, shape (cells, d + 1, d).
        facets: Local facet opposite to each vertex, shape (cells, d + 1).
        area: Length, area or volume |T|, shape (cells,).
        middle: The mean of the corners, shape (cells, d).
        radius: Distance of the vertices from the axis where that is the weight of all integrals, shape (cells, d + 1);
            None where they have none.
        size: Integral of the weight over each cell; |T| without one.
        part_of: The part of the boundary that gives u on the side opposite to each vertex, -1 if none does, shape
            (cells, d + 1).
        held: Whether one does.
        given: Whether u is given at each local dof.
        around: The cells around the vertices.
        normal: d |T| grad phi_i = the facet opposite to vertex i as a vector that points inward; by coordinates, shape
            (d, cells, d + 1).
    """

    def __init__(self, data: Data):
        """Turn all cells so that their corners have a positive determinant, and see where u is given (collective)."""
        self.data, level = data, data.level
        self.dim = level.mesh.topology.dim
        count = own_cells(level.mesh)
        x = corners(level.mesh)[:count, :, : self.dim]
        signed = signed_volumes(x)
        self._turned = np.flatnonzero(signed < 0)
        self.x = self.turned(x)
        self.dofs = self.turned(releases.cell_dofs(level.V)[:count])
        facets = cell_facets(level.mesh)[:count]
        self.facets = self.turned(facets[:, ::-1] if self.dim == 1 else facets)
        self.normal, self.area = inward(self.x), np.abs(signed)
        self.middle = np.stack([sums(self.x[:, :, k]) for k in range(self.dim)], axis=1) / (self.dim + 1)
        self.part_of = last_on_sides(self.facets, [self._known(facets) for facets in data.held])
        self.held = self.part_of >= 0
        fixed, values = data.fixed
        self.given = np.zeros(len(values.x.array), dtype=bool)
        self.given[fixed] = True
        self.around = AroundNodes(level.V, self.dofs)
        self.radius: np.ndarray | None = None
        self.size = self.area
        if data.axial:
            radius = self.x[:, :, 0]
            self.radius = np.where(np.abs(radius) <= ON_AXIS * radius.max(initial=0.0), 0.0, radius)
            self.size = self.area * sums(self.radius) / (self.dim + 1)

    @property
    def most_weight(self) -> np.ndarray | float:
        """The largest weight of integrals in each cell, 1 where they have none."""
        return 1.0 if self.radius is None else self.radius.max(axis=1, initial=0.0)

    def turned(self, values: np.ndarray) -> np.ndarray:
        """Values at vertices in the mesh's order, shape (cells, d + 1, ...), in the order here."""
        values, last = values.copy(), [self.dim, self.dim - 1]
        values[self._turned, self.dim - 1 :] = values[self._turned][:, last]
        return values

    def turned_nodes(self, dofs: np.ndarray) -> np.ndarray:
        """Dofs of P2 on triangles, shape (cells, 6), in the order here: at the vertices, then at the middles opposite
        to them; on intervals, shape (cells, 3), at the vertices, then at the middle."""
        if self.dim == 1:
            return np.hstack([self.turned(dofs[:, :2]), dofs[:, 2:]])
        return np.hstack([self.turned(dofs[:, :3]), self.turned(dofs[:, 3:])])

    def on_sides(self, facets: np.ndarray) -> np.ndarray:
        """Whether the side opposite to each vertex is one of some local facets, shape (cells, d + 1) (collective)."""
        return last_on_sides(self.facets, [self._known(facets)]) == 0

    def _known(self, facets: np.ndarray) -> np.ndarray:
        """Some local facets, with those inside that the rank of one of their two cells does not know (collective)."""
        level, count = self.data.level, self.facets.max(initial=-1) + 1
        inside = np.setdiff1d(facets[facets < count], level.boundary_facets).astype(np.int32)
        if total(level.comm, len(inside)) == 0 or level.comm.size == 1:
            return facets
        index_map, every = level.mesh.topology.index_map(self.dim - 1), np.arange(count, dtype=np.int32)
        numbers = np.concatenate(level.comm.allgather(np.asarray(index_map.local_to_global(inside))))
        return np.append(facets, every[np.isin(np.asarray(index_map.local_to_global(every)), numbers)])

    def edges(self, values: np.ndarray) -> np.ndarray:
        """Values at the edges of tetrahedra in the mesh's order, shape (cells, 6), by the two vertices in the order
        here, shape (cells, 4, 4)."""
        found = np.zeros((len(values), 4, 4), dtype=values.dtype)
        for k, (i, j) in enumerate(polynomials.EDGES[3]):
            found[:, i, j] = found[:, j, i] = values[:, k]
        last = found[self._turned]
        found[self._turned] = last[:, [0, 1, 3, 2]][:, :, [0, 1, 3, 2]]
        return found

    def gradient(self, values: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Gradients of a P1 function from its values at local dofs, shape (d, cells)."""
        dofs, normal, area = self.dofs[cells], self.normal[:, cells], self.area[cells]
        found = np.empty((self.dim, len(area)))
        for block in blocks(len(area)):
            corner = values[dofs[block]]
            np.einsum("ci,xci->xc", corner, normal[:, block], out=found[:, block])
            found[:, block] /= self.dim * area[block]
        return found

    def flux_fields(
        self, outward: np.ndarray, points: np.ndarray, cells: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Functions of RT0 in cells, sum of s_j (x - x_j)/(d |T|), shape (cells, points, d).

        Args:
            outward: s_j, what flows out of each cell opposite to its vertex x_j, shape (cells, d + 1).
            points: Barycentric coordinates of the points x, shape (cells or 1, points, d + 1).
            cells: Which.
        """
        x = self.x[cells]
        found = np.einsum("ci,cpx->cpx", outward, points @ x) - np.einsum("ci,cix->cx", outward, x)[:, None]
        return found / (self.dim * self.area[cells])[:, None, None]

    def along_normals(self, vectors: np.ndarray, cells: slice = slice(None)) -> np.ndarray:
        """Inner products of one vector per cell, shape (d, cells), with `normal`: minus the flux out of each facet."""
        normals = self.normal[:, cells]
        found = vectors[0][:, None] * normals[0]
        for along, normal in zip(vectors[1:], normals[1:], strict=True):
            found += along[:, None] * normal
        return found

    def values(self, value: Field, where: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """A datum at barycentric coordinates, shape (points, d + 1), of cells.

        Collective where it is the first to need the distance.

        Returns:
            Shape (cells, points).
        """
        chosen = np.arange(len(self.area))[cells]
        if value.parts is None:
            return self._field(value, where, chosen)
        found, groups = np.zeros((len(chosen), len(where))), self.data.level.groups
        for name, field in value.parts.items():
            inside = np.isin(chosen, groups[name])
            found[inside] = self._field(field, where, chosen[inside])
        return found

    def _field(self, field: Field, where: np.ndarray, cells: np.ndarray) -> np.ndarray:
        here, names = self.data.here(field), self.data.names(field)
        found = np.empty((len(cells), len(where)))
        for block in blocks(len(cells)):
            x = np.zeros((3, found[block].size))
            corners = self.x[cells[block]]
            # term by term: two cells have the same point of their edge to the last digit, which a datum that jumps sees
            for axis in range(self.dim):
                terms = (where[:, k] * corners[:, None, k, axis] for k in range(self.dim + 1))
                x[axis] = reduce(np.add, terms).ravel()
            found[block] = here.at(x, names, np.repeat(cells[block], len(where))).reshape(-1, len(where))
        return found


def last_on_sides(sides: np.ndarray, sets: Sequence[np.ndarray]) -> np.ndarray:
    """The number of the last set of local facets that each side of cells is in, -1 if it is in none.

    Args:
        sides: The facets of the cells, shape (cells, d + 1).
        sets: Of facets: of two parts of the boundary the later one counts.
    """
    last = np.full(max(sides.max(initial=-1) + 1, 1), -1, dtype=np.int32)
    for number, facets in enumerate(sets):
        last[facets[facets < len(last)]] = number
    return last[sides]


def next_(values: np.ndarray) -> np.ndarray:
    """For each vertex of a triangle the value at the one after it, shape (cells, 3)."""
    return np.take(values, [1, 2, 0], axis=1)  # several times faster than np.roll


def previous(values: np.ndarray) -> np.ndarray:
    """For each vertex of a triangle the value at the one before it, shape (cells, 3)."""
    return np.take(values, [2, 0, 1], axis=1)


def sums(values: np.ndarray) -> np.ndarray:
    """Sums of values at the vertices of each cell, shape (cells, vertices)."""
    return reduce(np.add, values.T)  # several times faster than values.sum(axis=1)


def integrals(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Of values of shape (cells, points), by weights as `pieces.Group.weights` has them."""
    return values @ weights if weights.ndim == 1 else np.einsum("cp,cp->c", values, weights)


def reciprocals(values: np.ndarray) -> np.ndarray:
    """1/values, 0 where a value is 0."""
    return np.divide(1.0, values, out=np.zeros(values.shape), where=values != 0)

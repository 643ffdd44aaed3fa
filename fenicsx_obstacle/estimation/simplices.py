"""Triangles of a plane mesh as arrays, counter-clockwise, and data inside them."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import cell_facets, corners, own_cells
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.quadrature import blocks, rule


class Simplices:
    """The owned cells of a level of P1 on triangles in the plane (nothing here is collective but `values`).

    Attributes:
        dofs: Local dofs of the vertices, shape (cells, 3).
        x: Their coordinates, shape (cells, 3, 2).
        facets: Local facet opposite to each vertex, shape (cells, 3).
        area: Shape (cells,).
        normal: 2 |T| grad phi_i = the edge opposite to vertex i turned inward; x and y of it, shape (2, cells, 3).
    """

    def __init__(self, data: Data):
        """Turn all cells counter-clockwise (collective where the spaces are new)."""
        self.data, level = data, data.level
        count = own_cells(level.mesh)
        x = corners(level.mesh)[:count, :, :2]
        clockwise = _cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) < 0
        self._clockwise = np.flatnonzero(clockwise)
        self.x = self.turned(x)
        self.dofs = self.turned(releases.cell_dofs(level.V)[:count])
        self.facets = self.turned(cell_facets(level.mesh)[:count])
        x, y = self.x[..., 0], self.x[..., 1]
        # the edge from the vertex after i to the one before, turned to the left
        self.normal = np.stack([next_(y) - previous(y), previous(x) - next_(x)])
        self.area = (self.normal[0, :, 1] * self.normal[1, :, 2] - self.normal[1, :, 1] * self.normal[0, :, 2]) / 2

    def turned(self, values: np.ndarray) -> np.ndarray:
        """Values at vertices in the mesh's order, shape (cells, 3, ...), in the order here."""
        values = values.copy()
        values[self._clockwise] = values[self._clockwise][:, [0, 2, 1]]
        return values

    def turned_nodes(self, dofs: np.ndarray) -> np.ndarray:
        """Dofs of P2, shape (cells, 6), in the order here: at the vertices, then at the middles opposite to them."""
        return np.hstack([self.turned(dofs[:, :3]), self.turned(dofs[:, 3:])])

    def gradient(self, values: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Gradients of a P1 function from its values at local dofs, shape (2, cells)."""
        corner = values[self.dofs[cells]]
        return np.einsum("ci,xci->xc", corner, self.normal[:, cells]) / (2 * self.area[cells])

    def along_normals(self, vectors: np.ndarray) -> np.ndarray:
        """Inner products of one vector per cell, shape (2, cells), with `normal`: minus the flux out of each edge."""
        return vectors[0][:, None] * self.normal[0] + vectors[1][:, None] * self.normal[1]

    def values(self, value: Field, where: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """A datum at barycentric coordinates, shape (points, 3) or (cells, points, 3), of cells.

        Collective where it is the first to need the distance.

        Returns:
            Shape (cells, points).
        """
        chosen = np.arange(len(self.area))[cells]
        if value.parts is None:
            return self._field(value, where, chosen)
        points = where.shape[-2]
        found, groups = np.zeros((len(chosen), points)), self.data.level.groups
        for name, field in value.parts.items():
            inside = np.isin(chosen, groups[name])
            part = where if where.ndim == 2 else where[inside]
            found[inside] = self._field(field, part, chosen[inside])
        return found

    def _field(self, field: Field, where: np.ndarray, cells: np.ndarray) -> np.ndarray:
        here, names = self.data.here(field), self.data.names(field)
        found = np.empty((len(cells), where.shape[-2]))
        for block in blocks(len(cells)):
            x = np.zeros((3, (block.stop - block.start) * where.shape[-2]))
            w = where[None] if where.ndim == 2 else where[block]
            corners = self.x[cells[block]]
            # term by term: two cells have the same point of their edge to the last digit, which a datum that jumps sees
            inside = sum(w[..., k, None] * corners[:, None, k] for k in range(3))
            x[:2] = inside.reshape(-1, 2).T
            found[block] = here.at(x, names, np.repeat(cells[block], where.shape[-2])).reshape(-1, where.shape[-2])
        return found


def next_(values: np.ndarray) -> np.ndarray:
    """For each vertex of a cell the value at the one after it, shape (cells, 3)."""
    return np.take(values, [1, 2, 0], axis=1)  # several times faster than np.roll


def previous(values: np.ndarray) -> np.ndarray:
    """For each vertex of a cell the value at the one before it, shape (cells, 3)."""
    return np.take(values, [2, 0, 1], axis=1)


def sums(values: np.ndarray) -> np.ndarray:
    """Of values at the vertices of each cell, shape (cells, 3)."""
    return values[:, 0] + values[:, 1] + values[:, 2]  # several times faster than values.sum(axis=1)


def lattice(parts: int) -> np.ndarray:
    """Barycentric coordinates of the points that divide the edges and the inside evenly, shape (n, 3)."""
    steps = [(i, j, parts - i - j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    return np.array(steps) / parts


def lattice_cells(parts: int) -> list[list[int]]:
    """The small triangles between the points of `lattice`, corners in the order of the cell's own."""
    steps = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    number = {step: k for k, step in enumerate(steps)}
    same = [[number[i + 1, j], number[i, j + 1], number[i, j]] for i, j in steps if i + j < parts]
    turned = [[number[i, j + 1], number[i + 1, j], number[i + 1, j + 1]] for i, j in steps if i + j < parts - 1]
    return same + turned


def halved_rule(times: int) -> tuple[np.ndarray, np.ndarray]:
    """The rule in each of the 4^times parts of a triangle with its edges halved."""
    points, weights = rule(2)
    parts = np.eye(3)[None]
    for _ in range(times):
        a, b, c = parts[:, 0], parts[:, 1], parts[:, 2]
        d, e, f = (b + c) / 2, (c + a) / 2, (a + b) / 2
        parts = np.concatenate([np.stack(p, axis=1) for p in ((a, f, e), (f, b, d), (e, d, c), (d, e, f))])
    return (points @ parts).reshape(-1, 3), np.tile(weights, len(parts)) / len(parts)


def with_ghosts(V: fem.FunctionSpace, owned: np.ndarray) -> np.ndarray:
    """Values at local dofs from those at owned ones (collective)."""
    function = fem.Function(V)
    function.x.array[: len(owned)] = owned
    function.x.scatter_forward()
    return function.x.array


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]

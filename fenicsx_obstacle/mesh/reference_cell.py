"""Reference cells of every kind: values, gradients, measures and facets.

A place in a cell is given by the weights of its vertices, the Lagrange functions of degree 1 there: barycentric
coordinates in simplices, products of such in quadrilaterals and hexahedra. All functions are local.
"""

from __future__ import annotations

from functools import cached_property
from math import comb, factorial
from typing import Any

import basix
import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh import cells as simplices
from fenicsx_obstacle.mesh.cells import corners, facet_corners

NEWTON_STEPS = 20  # to a place in a quadrilateral or hexahedron; parallelograms take one


class Reference:
    """The reference cell of a mesh.

    Attributes:
        kind: That of basix.
        simplex: Whether it is one.
        dim: Its dimension.
        vertices: Coordinates, shape (vertices, dim).
        facets: Vertices of each facet.
    """

    def __init__(self, mesh: dmesh.Mesh):
        self.mesh, self.dim = mesh, mesh.topology.dim
        self.simplex = releases.cell_name(mesh) in SIMPLICES
        self.kind = getattr(basix.CellType, releases.cell_name(mesh))
        self.vertices = basix.geometry(self.kind)
        self.facets = facet_corners(mesh)
        self._linear = _linear(releases.cell_name(mesh))

    def basis(self, space: fem.FunctionSpace, where: np.ndarray) -> np.ndarray:
        """Basis functions of a scalar space at places (..., vertices), shape (..., dofs of a cell)."""
        if lagrange_degree(space) == 1:
            return where
        # a basis function is 1 at its node and 0 at the others, but for round-off: values at nodes are compared
        return np.round(_tabulated(releases.element(space), where @ self.vertices, 0)[0], 15)

    def slopes(self, space: fem.FunctionSpace, where: np.ndarray) -> np.ndarray:
        """Their derivatives along the axes of the reference cell, shape (..., dofs of a cell, dim)."""
        return np.moveaxis(_tabulated(releases.element(space), where @ self.vertices, 1)[1:], 0, -1)

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Weights of the vertices at points (..., dim) of the reference cell, shape (..., vertices)."""
        if self.simplex:
            return np.concatenate([1 - x.sum(axis=-1, keepdims=True), x], axis=-1)
        return np.prod(np.where(self.vertices == 1, x[..., None, :], 1 - x[..., None, :]), axis=-1)

    def nodes(self, space: fem.FunctionSpace) -> np.ndarray:
        """Weights of the vertices at the nodes of a Lagrange space, shape (nodes, vertices)."""
        return self.weights(np.asarray(releases.called(space.element.interpolation_points))[:, : self.dim])

    def values(self, function: fem.Function | fem.Constant, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Values in cells, shape (cells, points), at places (cells or 1, points, vertices)."""
        if isinstance(function, fem.Constant):
            return np.full((len(cells), where.shape[1]), float(function.value))
        space = function.function_space
        local = function.x.array[releases.cell_dofs(space)[cells]]
        return (self.basis(space, where) @ local[:, :, None])[:, :, 0]

    def gradients(self, function: fem.Function, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Gradients, on surfaces in space along them, shape (cells, points, 3)."""
        space = function.function_space
        local = function.x.array[releases.cell_dofs(space)[cells]]
        slopes = self.slopes(space, where)
        along = np.einsum("qpnd,cn->cpd" if len(slopes) == 1 else "cpnd,cn->cpd", slopes, local)
        return np.einsum("cpid,cpd->cpi", self.duals(cells, where), along)

    def jacobians(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Derivatives of the map from the reference cell, shape (cells, points, 3, dim)."""
        slopes = np.moveaxis(_tabulated(self._linear, where @ self.vertices, 1)[1:], 0, -1)
        return np.einsum("cvi,qpvd->cpid" if len(slopes) == 1 else "cvi,cpvd->cpid", self._corners[cells], slopes)

    def duals(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """The matrices that map derivatives along the axes of the reference cell to gradients, shape (cells, points,
        3, dim)."""
        if self.simplex:  # one for each cell
            distinct, back = np.unique(cells, return_inverse=True)
            of_cells = simplices.duals(self._corners[distinct]).transpose(0, 2, 1)[back, None]
            return np.broadcast_to(of_cells, (len(cells), where.shape[1], *of_cells.shape[2:]))
        J = self.jacobians(cells, where)
        return J @ np.linalg.inv(J.transpose(0, 1, 3, 2) @ J)

    def measures(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Measure of a cell if it were everywhere as it is at a place, shape (cells, points)."""
        return _measures(self.jacobians(cells, where), simplex=self.simplex)

    def facet_measures(self, cells: np.ndarray, numbers: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """The same of facets at places that are given by weights of their vertices, shape (facets, points)."""
        members = np.array(self.facets)[numbers]
        if self.dim == 1:
            return np.ones((len(cells), len(shares)))
        x = self._corners[cells[:, None], members]
        simplex = members.shape[1] == self.dim
        # the reference facet is the one between the first vertices
        element = _linear({2: "interval", 3: "triangle" if simplex else "quadrilateral"}[self.dim])
        places = self.vertices[: members.shape[1], : self.dim - 1]
        slopes = np.moveaxis(_tabulated(element, shares @ places, 1)[1:], 0, -1)
        return _measures(np.einsum("fvi,pvd->fpid", x, slopes), simplex=simplex)

    def on_facets(self, numbers: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Weights of the vertices of cells at places on their facets, shape (facets, points, vertices)."""
        members = np.array(self.facets)[numbers]
        where = np.zeros((len(numbers), len(shares), len(self.vertices)))
        np.put_along_axis(where, np.repeat(members[:, None], len(shares), axis=1), shares[None], axis=2)
        return where

    def normals(self, cells: np.ndarray, numbers: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Outward unit normals on facets of cells, on surfaces along them, shape (facets, points, 3)."""
        outward = basix.cell.facet_outward_normals(self.kind)[numbers]
        found = np.einsum("cpid,cd->cpi", self.duals(cells, where), outward)
        return found / np.linalg.norm(found, axis=2, keepdims=True)

    def pulled_back(self, cells: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Weights of the vertices at one point (n, 3) in each of some cells, shape (n, vertices) (Newton's method).

        Of points outside of a cell those of a place near them in it.
        """
        x = np.broadcast_to(self.vertices.mean(axis=0), (len(cells), self.dim)).copy()
        for _ in range(NEWTON_STEPS):
            where = self.weights(x)
            away = points - np.einsum("cv,cvi->ci", where, self._corners[cells])
            back = np.linalg.pinv(self.jacobians(cells, where[:, None])[:, 0])  # far outside it may be singular
            x = np.clip(x + np.einsum("cdi,ci->cd", back, away), -1.0, 2.0)
        return self.weights(np.clip(x, 0.0, 1.0))

    @cached_property
    def _corners(self) -> np.ndarray:
        return corners(self.mesh)


def lagrange_degree(V: fem.FunctionSpace) -> int | None:
    """Degree, 1 or 2, of continuous Lagrange elements; None of other elements (local)."""
    layout, dim, simplex = V.dofmap.dof_layout, V.mesh.topology.dim, releases.cell_name(V.mesh) in SIMPLICES
    of_dofs = {comb(dim + k, k) if simplex else (k + 1) ** dim: k for k in (1, 2)}  # in a cell
    nodal = len(layout.entity_dofs(0, 0)) == 1 and V.element.interpolation_ident
    return of_dofs.get(layout.num_dofs) if nodal else None


def _linear(cell: str) -> Any:
    """The element of degree 1 on a cell, whose dofs are the vertices."""
    kind, variant = getattr(basix.CellType, cell), basix.LagrangeVariant.gll_warped  # of this degree all are the same
    return basix.create_element(basix.ElementFamily.P, kind, 1, variant)


def _tabulated(element: Any, x: np.ndarray, order: int) -> np.ndarray:
    """Basis functions at points (..., dim) and, for order 1, their derivatives, shape (1 or 1 + dim, ..., dofs)."""
    points, shape = np.ascontiguousarray(x.reshape(-1, x.shape[-1])), (1 + order * x.shape[-1], *x.shape[:-1])
    if not len(points):  # basix takes no empty list of points
        return np.zeros((*shape, element.dim))
    return np.asarray(element.tabulate(order, points)).reshape(*shape, element.dim)


def _measures(jacobians: np.ndarray, *, simplex: bool) -> np.ndarray:
    gram = np.linalg.det(jacobians.transpose(0, 1, 3, 2) @ jacobians)
    return np.sqrt(np.maximum(gram, 0.0)) / (factorial(jacobians.shape[-1]) if simplex else 1)

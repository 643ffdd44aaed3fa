"""Reference cells of every kind: Lagrange functions, gradients, measures and facets, by NumPy only.

A place in a cell is given by the weights of its vertices, the Lagrange functions of degree 1 there: barycentric
coordinates in simplices, products of such in quadrilaterals and hexahedra. All functions are local.
"""

from __future__ import annotations

from functools import cached_property
from itertools import product
from math import comb, factorial
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners, facet_corners
from fenicsx_obstacle.forms.pairs import SIMPLICES

NEWTON_STEPS = 20  # to a place in a quadrilateral or hexahedron; parallelograms take one


class Lagrange:
    """Polynomials on a reference cell that are given by their values at points."""

    def __init__(self, points: np.ndarray, *, simplex: bool):
        """Find the polynomials that are 1 at one of the points and 0 at the others.

        Args:
            points: Shape (n, dim), as many as polynomials of some degree need.
            simplex: Whether the degree is that of all factors together, not of each.
        """
        count, dim = points.shape
        degree = next(d for d in range(9) if (comb(d + dim, dim) if simplex else (d + 1) ** dim) == count)
        powers = product(range(degree + 1), repeat=dim)
        self._powers = np.array([power for power in powers if not simplex or sum(power) <= degree]).reshape(count, dim)
        self._inverse = np.linalg.inv(self._monomials(points))

    def _monomials(self, x: np.ndarray) -> np.ndarray:
        return np.prod(x[..., None, :] ** self._powers, axis=-1)

    def values(self, x: np.ndarray) -> np.ndarray:
        """At points (..., dim), shape (..., n)."""
        return self._monomials(x) @ self._inverse

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives along the axes, shape (..., n, dim)."""
        found = []
        for axis in range(self._powers.shape[1]):
            lower = self._powers - np.eye(self._powers.shape[1], dtype=int)[axis]
            factor = self._powers[:, axis]
            found.append((factor * np.prod(x[..., None, :] ** np.maximum(lower, 0), axis=-1)) @ self._inverse)
        return np.stack(found, axis=-1)


class Reference:
    """The reference cell of a mesh.

    Attributes:
        simplex: Whether it is one.
        dim: Its dimension.
        vertices: Coordinates, shape (vertices, dim).
        facets: Vertices of each facet.
    """

    def __init__(self, mesh: dmesh.Mesh):
        self.mesh, self.dim = mesh, mesh.topology.dim
        self.simplex = releases.cell_name(mesh) in SIMPLICES
        if self.simplex:
            self.vertices = np.vstack([np.zeros(self.dim), np.eye(self.dim)])
        else:  # the digits of their numbers
            self.vertices = np.array([[v >> axis & 1 for axis in range(self.dim)] for v in range(2**self.dim)], float)
        self.facets = facet_corners(mesh)
        self._linear = Lagrange(self.vertices, simplex=self.simplex)
        self._of_space: dict[Any, Lagrange] = {}

    def of(self, space: fem.FunctionSpace) -> Lagrange:
        """The basis of a space in a cell: Lagrange, continuous or not, or linear with nodes at midpoints of edges."""
        key = id(space)
        if key not in self._of_space:
            count = releases.cell_dofs(space).shape[1]
            if count == 1:
                points = self.vertices.mean(axis=0)[None]
            else:  # the nodes, those of Crouzeix and Raviart too
                points = np.asarray(releases.called(space.element.interpolation_points))[:, : self.dim]
            self._of_space[key] = Lagrange(points, simplex=self.simplex)
        return self._of_space[key]

    def weights(self, x: np.ndarray) -> np.ndarray:
        """Weights of the vertices at points (..., dim) of the reference cell, shape (..., vertices)."""
        return self._linear.values(x)

    def nodes(self, space: fem.FunctionSpace) -> np.ndarray:
        """Weights of the vertices at the nodes of a Lagrange space, shape (nodes, vertices)."""
        return self.weights(np.asarray(releases.called(space.element.interpolation_points))[:, : self.dim])

    def values(self, function: fem.Function, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Values in cells, shape (cells, points), at places (cells or 1, points, vertices)."""
        space = function.function_space
        local = function.x.array[releases.cell_dofs(space)[cells]]
        return (self.of(space).values(where @ self.vertices) @ local[:, :, None])[:, :, 0]

    def gradients(self, function: fem.Function, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Gradients, on surfaces in space along them, shape (cells, points, 3)."""
        space = function.function_space
        local = function.x.array[releases.cell_dofs(space)[cells]]
        slopes = self.of(space).slopes(where @ self.vertices)
        along = np.einsum("qpnd,cn->cpd" if len(slopes) == 1 else "cpnd,cn->cpd", slopes, local)
        return np.einsum("cpid,cpd->cpi", self.duals(cells, where), along)

    def jacobians(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Derivatives of the map from the reference cell, shape (cells, points, 3, dim)."""
        slopes = self._linear.slopes(where @ self.vertices)
        return np.einsum("cvi,qpvd->cpid" if len(slopes) == 1 else "cvi,cpvd->cpid", self._corners[cells], slopes)

    def duals(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """The matrices that map derivatives along the axes of the reference cell to gradients, shape (cells, points,
        3, dim)."""
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
        vertices = members.shape[1]
        simplex = vertices == self.dim
        places = np.vstack([np.zeros(self.dim - 1), np.eye(self.dim - 1)]) if simplex else self.vertices[:4, :2]
        slopes = Lagrange(places, simplex=simplex).slopes(shares @ places)
        return _measures(np.einsum("fvi,pvd->fpid", x, slopes), simplex=simplex)

    def on_facets(self, numbers: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Weights of the vertices of cells at places on their facets, shape (facets, points, vertices)."""
        members = np.array(self.facets)[numbers]
        where = np.zeros((len(numbers), len(shares), len(self.vertices)))
        np.put_along_axis(where, np.repeat(members[:, None], len(shares), axis=1), shares[None], axis=2)
        return where

    def normals(self, cells: np.ndarray, numbers: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Outward unit normals on facets of cells, on surfaces along them, shape (facets, points, 3)."""
        outward = []
        for members in self.facets:
            x = self.vertices[members]
            away = x.mean(axis=0) - self.vertices.mean(axis=0)
            edges = (x[1:] - x[0]).reshape(len(x) - 1, self.dim)
            normal = np.linalg.svd(edges)[2][-1] if len(edges) else np.ones(1)
            outward.append(normal * np.sign(normal @ away))
        found = np.einsum("cpid,cd->cpi", self.duals(cells, where), np.array(outward)[numbers])
        return found / np.linalg.norm(found, axis=2, keepdims=True)

    def pulled_back(self, cells: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Weights of the vertices at one point (n, 3) in each of some cells, shape (n, vertices) (Newton's method)."""
        x = np.broadcast_to(self.vertices.mean(axis=0), (len(cells), self.dim)).copy()
        for _ in range(NEWTON_STEPS):
            where = self.weights(x)
            away = points - np.einsum("cv,cvi->ci", where, self._corners[cells])
            x += np.einsum("cid,ci->cd", self.duals(cells, where[:, None])[:, 0], away)
        return self.weights(np.clip(x, 0.0, 1.0))

    @cached_property
    def _corners(self) -> np.ndarray:
        return corners(self.mesh)


def _measures(jacobians: np.ndarray, *, simplex: bool) -> np.ndarray:
    gram = np.linalg.det(jacobians.transpose(0, 1, 3, 2) @ jacobians)
    return np.sqrt(np.maximum(gram, 0.0)) / (factorial(jacobians.shape[-1]) if simplex else 1)

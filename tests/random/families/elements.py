"""Computed functions as polynomials in each cell, from values and coordinates of their degrees of freedom.

It shares nothing with the error bound and the solvers: neither basis functions nor the order of degrees of freedom.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle import releases

# exponents of the monomials by dimension and number of nodes: P1, P2, Q1, Q2
_SPACES = {(1, 2): (1, False), (1, 3): (2, False), (2, 3): (1, False), (2, 6): (2, False), (2, 4): (1, True),
           (2, 9): (2, True), (3, 4): (1, False), (3, 8): (1, True)}  # fmt: skip


class Field:
    """A function of a finite element space on the owned cells; quadrilaterals must be parallelograms.

    Attributes:
        comm: Communicator.
        vertices: Of each cell, shape (cells, vertices, dimension).
    """

    def __init__(self, u: fem.Function):
        self._u = u  # the communicator lives as long as its mesh
        V = u.function_space
        mesh = V.mesh
        self.comm, dim = mesh.comm, mesh.topology.dim
        own = mesh.topology.index_map(dim).size_local
        dofs = releases.cell_dofs(V)[:own]
        self.vertices = mesh.geometry.x[releases.geometry_dofs(mesh)[:own]][:, :, :dim]
        nodes = V.tabulate_dof_coordinates()[dofs][:, :, :dim]
        degree, tensor = _SPACES[dim, dofs.shape[1]]
        powers = [p for p in product(range(degree + 1), repeat=dim) if tensor or sum(p) <= degree]
        self._powers = np.array(powers)
        self._middle = nodes.mean(axis=1, keepdims=True)
        self._size = np.abs(nodes - self._middle).max(axis=(1, 2), initial=1e-300).reshape(-1, 1, 1)
        self.values = u.x.array[dofs].real
        matrix = self._monomials((nodes - self._middle) / self._size, self._powers)
        self._coefficients = np.linalg.solve(matrix, self.values[:, :, None])[:, :, 0] if own else self.values

    @staticmethod
    def _monomials(x: np.ndarray, powers: np.ndarray) -> np.ndarray:
        return np.prod(x[..., None, :] ** powers, axis=-1)

    def at(self, cells: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Values at points of cells, shape (cells, points)."""
        x = (points - self._middle[cells]) / self._size[cells]
        return np.einsum("cqm,cm->cq", self._monomials(x, self._powers), self._coefficients[cells])

    def gradient(self, cells: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Gradients at points of cells, shape (cells, points, dimension)."""
        x = (points - self._middle[cells]) / self._size[cells]
        parts = []
        for axis in range(points.shape[2]):
            lower = self._powers.copy()
            lower[:, axis] = np.maximum(lower[:, axis] - 1, 0)
            slopes = self._monomials(x, lower) * self._powers[:, axis]
            parts.append(np.einsum("cqm,cm->cq", slopes, self._coefficients[cells]))
        return np.stack(parts, axis=2) / self._size[cells]

    def ends(self) -> tuple[float, float]:
        """Least and largest value at the nodes (collective)."""
        low, high = self.values.min(initial=np.inf), self.values.max(initial=-np.inf)
        return self.comm.allreduce(float(low), MPI.MIN), self.comm.allreduce(float(high), MPI.MAX)


def areas(triangles: np.ndarray) -> np.ndarray:
    """Of triangles in the plane, shape (n, 3, 2)."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2

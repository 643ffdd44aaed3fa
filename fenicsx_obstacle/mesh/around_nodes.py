"""Sums and extrema over the cells around nodes, on whatever ranks the cells are."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc


class AroundNodes:
    """The cells around the nodes of a space; all methods are collective.

    Attributes:
        V: The space.
        nodes: Local dofs of the nodes of the owned cells, shape (cells, n).
    """

    def __init__(self, V: fem.FunctionSpace, nodes: np.ndarray):
        """Take the nodes.

        Args:
            V: The space.
            nodes: See the attributes; those that count, if it has more.
        """
        self.V, self.nodes, self._map = V, nodes, V.dofmap.index_map
        self._count = self._map.size_local + self._map.num_ghosts

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums at local dofs of values at the nodes of cells, shape (cells, n)."""
        found = np.bincount(self.nodes.ravel(), values.ravel(), self._count).astype(float, copy=False)  # even of none
        return over_ranks(self._map, self.V.mesh.comm, found, PETSc.InsertMode.ADD)

    def largest(self, values: np.ndarray) -> np.ndarray:
        """The largest of these values at each local dof, 0 if that is more."""
        return self._at_most(values, 0.0)

    def smallest(self, values: np.ndarray) -> np.ndarray:
        """The smallest of them, infinite without one."""
        return -self._at_most(-values, -np.inf)

    def _at_most(self, values: np.ndarray, least: float) -> np.ndarray:
        """The largest value, or `least` if that is more."""
        found, some = np.full(self._count, least), values > least
        np.maximum.at(found, self.nodes[some], values[some])
        return over_ranks(self._map, self.V.mesh.comm, found, PETSc.InsertMode.MAX)


def over_ranks(index_map: Any, comm: MPI.Comm, values: np.ndarray, how: PETSc.InsertMode) -> np.ndarray:
    """What ranks have for the same dofs or edges, put together (collective).

    Args:
        index_map: Of the dofs or edges, ghosts included.
        comm: Of the mesh.
        values: Of this rank.
        how: ADD for sums, MAX for the largest.
    """
    if comm.size == 1:
        return values
    size = index_map.size_local, index_map.size_global
    vector = PETSc.Vec().createGhost(np.asarray(index_map.ghosts, dtype=PETSc.IntType), size, comm=comm)
    with vector.localForm() as local:
        local.array[:] = values
    vector.ghostUpdate(addv=how, mode=PETSc.ScatterMode.REVERSE)
    vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
    with vector.localForm() as local:
        found = local.array_r.copy()
    vector.destroy()
    return found


def with_ghosts(V: fem.FunctionSpace, owned: np.ndarray) -> np.ndarray:
    """Values at local dofs from those at owned ones (collective)."""
    function = fem.Function(V)
    function.x.array[: len(owned)] = owned
    function.x.scatter_forward()
    return function.x.array

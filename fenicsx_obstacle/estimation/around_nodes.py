"""Sums and extrema over the cells around nodes, on whatever ranks the cells are."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases


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
        self.V, self.nodes = V, nodes

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums at local dofs of values at the nodes of cells, shape (cells, n)."""
        function = fem.Function(self.V)
        function.x.array[:] = np.bincount(self.nodes.ravel(), values.ravel(), len(function.x.array))
        releases.add_ghosts(function)
        function.x.scatter_forward()
        return function.x.array.copy()

    def largest(self, values: np.ndarray) -> np.ndarray:
        """The largest of these values at each local dof, 0 if that is more."""
        return self._at_most(values, 0.0)

    def smallest(self, values: np.ndarray) -> np.ndarray:
        """The smallest of them, infinite without one."""
        return -self._at_most(-values, -np.inf)

    def _at_most(self, values: np.ndarray, least: float) -> np.ndarray:
        """The largest value, or `least` if that is more."""
        function = fem.Function(self.V)
        function.x.array[:] = least
        some = values > least
        np.maximum.at(function.x.array, self.nodes[some], values[some])
        vector = releases.vec(function)
        vector.ghostUpdate(addv=PETSc.InsertMode.MAX, mode=PETSc.ScatterMode.REVERSE)
        vector.destroy()
        function.x.scatter_forward()
        return function.x.array.copy()

"""Values and gradients of Lagrange functions in simplices at barycentric coordinates."""

from __future__ import annotations

import basix
import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners, duals
from fenicsx_obstacle.discrete.fields import Cellwise

CELLS = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}
_DEGREE = {2: {1: 0, 2: 1, 3: 2}, 3: {1: 0, 3: 1, 6: 2}, 4: {1: 0, 4: 1, 10: 2}}  # by vertices and dofs of a cell


def values(function: Cellwise, cells: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values (local).

    Args:
        function: Of one component: a number, or of degree 0, 1 or 2, continuous or not, on simplices.
        cells: Local cells, shape (n,).
        places: Barycentric coordinates of one point in each, shape (n, vertices).

    Returns:
        Shape (n,).
    """
    if isinstance(function, fem.Constant):
        return np.full(len(cells), float(function.value))
    local = _local(function, cells)
    return np.einsum("nd,nd->n", _tabulated(local, places, 0)[0], local)


def values_and_slopes(function: fem.Function, cells: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same with gradients, shape (n, 3); on surfaces in space and on curves along them (local)."""
    local = _local(function, cells)
    found, *along = np.einsum("knd,nd->kn", _tabulated(local, places, 1), local)
    distinct, back = np.unique(cells, return_inverse=True)
    gradients = duals(corners(function.function_space.mesh, distinct))[back]
    return found, np.einsum("dn,ndi->ni", along, gradients)


def _local(function: fem.Function, cells: np.ndarray) -> np.ndarray:
    """Values at the dofs of each cell."""
    return function.x.array[releases.cell_dofs(function.function_space)[cells]]


def _tabulated(local: np.ndarray, places: np.ndarray, order: int) -> np.ndarray:
    """The basis functions and, for order 1, their derivatives, shape (1 or 1 + dim, n, dofs)."""
    vertices = places.shape[1]
    degree = _DEGREE[vertices][local.shape[1]]
    if degree == 0 or not len(places):  # basix takes no empty list of points
        return np.ones((1 + order * (vertices - 1), len(places), local.shape[1]))
    lagrange = basix.LagrangeVariant.gll_warped  # up to degree 2 all are the same
    element = basix.create_element(basix.ElementFamily.P, CELLS[vertices - 1], degree, lagrange)
    return np.asarray(element.tabulate(order, np.ascontiguousarray(places[:, 1:])))[..., 0]

"""Values at points: search for the cells that contain a point, on any number of ranks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import corners, duals, own_cells
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.reference_cell import Reference
from fenicsx_obstacle.text import counted

ROUND_OFF = 1e-9  # of the size of a cell: how far outside a point may lie
OFF_SURFACE = 0.1  # of the size of a cell, for surfaces in space: points of the true surface lie beside the flat cells


def locate(level: Level, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The owned cells that hold points; on an edge all cells beside it (collective).

    Args:
        level: Mesh.
        points: The same on every rank, shape (n, 3).

    Returns:
        Rows of `points`, cells, and weights of their vertices, as in `Reference`, shape (pairs, vertices).
    """
    mesh = level.mesh
    allowed = ROUND_OFF if mesh.topology.dim == mesh.geometry.dim else OFF_SURFACE
    rows, cells, weights, gap, size = nearby(mesh, points, allowed * level.h_max)
    nearest = np.full(len(points), np.inf)
    np.minimum.at(nearest, rows, gap)
    level.comm.Allreduce(MPI.IN_PLACE, nearest, MPI.MIN)
    holds = (gap <= allowed * size) & (gap <= nearest[rows] + ROUND_OFF * size)
    return rows[holds], cells[holds], weights[holds]


def nearby(mesh: dmesh.Mesh, points: np.ndarray, padding: float) -> tuple[np.ndarray, ...]:
    """The owned cells that may hold points, and the point of each cell that is nearest (local).

    Args:
        mesh: Mesh.
        points: Shape (n, 3).
        padding: A length by which the boxes around cells are widened.

    Returns:
        Of each pair the row of `points`; the cell; weights of its vertices, shape (pairs, vertices); distance of the
        point from there; and size of the cell. In curved cells the weights are those of the straight one, and the
        search is that of DOLFINx, whose tolerance is a length: the distance is 0.
    """
    curved = releases.geometry_degree(mesh) > 1 and mesh.topology.dim == mesh.geometry.dim
    rows, cells = releases.cells_near(mesh, points, 0.0 if curved else padding, within=curved)
    distinct, back = np.unique(cells, return_inverse=True)  # of many points many lie in one cell
    vertices = corners(mesh, distinct)
    edges = vertices[:, 1:] - vertices[:, :1]
    size = np.linalg.norm(edges, axis=2).max(axis=1)[back]
    there = points[rows] - vertices[back, 0]
    if releases.cell_name(mesh) in SIMPLICES:
        inner = np.einsum("pdi,pi->pd", duals(vertices)[back], there)
        weights = np.maximum(np.column_stack([1 - inner.sum(axis=1), inner]), 0.0)
        weights /= weights.sum(axis=1, keepdims=True)
    else:
        weights = Reference(mesh).pulled_back(cells, points[rows])
    gap = np.linalg.norm(np.einsum("pd,pdi->pi", weights[:, 1:], edges[back]) - there, axis=1)
    return rows, cells, weights, np.zeros(len(rows)) if curved else gap, size


def places(level: Level) -> np.ndarray:
    """Coordinates of the local nodes of V, and the mean of the middles of the cells around each, shape (nodes, 6): of
    two nodes at one place, on both sides of a slit, the latter differ (collective)."""
    own = slice(own_cells(level.mesh))
    dofs, middles = releases.cell_dofs(level.V)[own], corners(level.mesh, own).mean(axis=1)
    around = AroundNodes(level.V, dofs)
    sums = [around.sums(np.broadcast_to(values[:, None], dofs.shape)) for values in (*middles.T, np.ones(len(dofs)))]
    return np.column_stack([level.points.T, *(part / sums[3] for part in sums[:3])])


def spread(level: Level, forces: Sequence[tuple[tuple[float, ...], float]], place: str) -> np.ndarray:
    """Forces at points as forces at owned nodes: each loads those of its cell by their basis functions there.

    Args:
        level: Mesh.
        forces: Coordinates and force of each point, the same on every rank (collective).
        place: Where they stand, for messages.

    Raises:
        InputError: If a point is outside the mesh or has another number of coordinates, or for other elements.
    """
    dim = level.mesh.geometry.dim
    if not (level.pair.nested_hierarchy or (level.pair.has_p1_coarse_space and dim == 1)):
        raise InputError(f"{place}: is for element P1, not for {level.pair.name}")
    points = np.zeros((len(forces), 3))
    for row, (at, _) in enumerate(forces):
        if len(at) != dim:
            raise InputError(f"{place}: a point needs {counted(dim, 'coordinate')} here, not {len(at)}")
        points[row, :dim] = at
    rows, cells, weights = locate(level, points)
    found = np.bincount(rows, minlength=len(points))
    level.comm.Allreduce(MPI.IN_PLACE, found, MPI.SUM)
    if not found.all():
        outside = forces[int(np.argmin(found))][0]
        raise InputError(f"{place}: the point ({', '.join(f'{x:g}' for x in outside)}) is outside the mesh")
    # on an edge all cells beside it say the same: each has its share
    share = np.array([force for _, force in forces])[rows] / found[rows]
    values = Reference(level.mesh).basis(level.V, weights)
    around = AroundNodes(level.V, releases.cell_dofs(level.V)[cells])
    return around.sums(values * share[:, None])[: level.owned]


def mean_over_cells(comm: MPI.Comm, count: int, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Mean of the values found at each of `count` points, not-a-number where there is none (collective)."""
    sums = np.zeros((2, count))
    np.add.at(sums[0], rows, values)
    np.add.at(sums[1], rows, 1.0)
    comm.Allreduce(MPI.IN_PLACE, sums, MPI.SUM)
    return np.divide(sums[0], sums[1], out=np.full(count, np.nan), where=sums[1] > 0)


def values_of(u: fem.Function, points: np.ndarray, *, level: Level | None = None) -> np.ndarray:
    """Values of a Function of one component at points, on any cells; not-a-number outside its mesh (collective).

    Where it has several values, on the sides of cells, it is their mean.

    Args:
        u: Function.
        points: The same on every rank, shape (n, 3).
        level: The mesh of u, where there is one already.
    """
    mesh = u.function_space.mesh
    level = level or Level(mesh, 0.0)
    rows, cells, weights = locate(level, points)
    if releases.geometry_degree(mesh) == 1:
        values = Reference(mesh).values(u, cells, weights[:, None])[:, 0]
        return mean_over_cells(level.comm, len(points), rows, values)
    x = points[rows]
    if mesh.topology.dim < mesh.geometry.dim:  # of a point beside a surface the nearest one in its cell
        x = np.einsum("pv,pvi->pi", weights, corners(mesh, cells))
    found = u.eval(x, cells.astype(np.int32)) if len(rows) else np.empty(0)
    return mean_over_cells(level.comm, len(points), rows, np.ravel(found))

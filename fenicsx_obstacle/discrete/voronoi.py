"""Voronoi areas: weights D_i with which the lumped Laplacian is consistent on any mesh of Delaunay's kind.

-(A I_h w)_i / D_i is to tend to the Laplacian of w: D is chosen so that it is right for w = |x - x_i|^2, whose
Laplacian is 2 dim. The weights |T|/(dim + 1) of the vertex rule are right only where all vertices have as many
neighbours.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners, own_cells, volumes
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import smallest


def voronoi_areas(V: fem.FunctionSpace) -> np.ndarray:
    """D_i = -(1 / (2 dim)) sum_j A_ij |x_i - x_j|^2 at owned dofs of a P1 space, A the Laplacian (collective).

    In the plane these are the areas of the Voronoi cells.

    Raises:
        InputError: If one is not positive: the mesh is not Delaunay.
    """
    mesh = V.mesh
    x, dim = corners(mesh, slice(own_cells(mesh))), mesh.topology.dim
    edges = x[:, 1:] - x[:, :1]
    inner = np.linalg.solve(edges @ edges.transpose(0, 2, 1), edges)  # gradients of all barycentric coordinates but one
    slopes = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    stiffness = volumes(x)[:, None, None] * (slopes @ slopes.transpose(0, 2, 1))
    squares = ((x[:, :, None] - x[:, None, :]) ** 2).sum(axis=3)
    parts = -(stiffness * squares).sum(axis=2) / (2 * dim)
    D = fem.Function(V)
    np.add.at(D.x.array, releases.cell_dofs(V)[: len(x)].ravel(), parts.ravel())
    releases.add_ghosts(D)
    areas = D.x.array[: V.dofmap.index_map.size_local].copy()
    if smallest(mesh.comm, areas) <= 0:
        raise InputError("element P1-voronoi: the mesh is not Delaunay, so that a Voronoi area is not positive (3.6)")
    return areas

"""The coarsest grid of a shape."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete import shapes
from fenicsx_obstacle.forms.pairs import SIMPLICES

Named: TypeAlias = dict[str, np.ndarray]
COARSEST = {1: 16, 2: 500, 3: 500}  # cells at least on the coarsest level of a shape,
PER_RANK = {1: 8, 2: 100, 3: 100}  # and on each rank: cells stay on their rank when refined


def coarsest_grid(asked: shapes.Shape, comm: MPI.Comm) -> tuple[dmesh.Mesh, Named, float, int]:
    """The coarsest grid that leads to the one asked for (collective).

    Returns:
        The mesh, the local facets of its named sides, its h, and how often to halve its edges.
    """
    dim, shape, halvings = len(asked.cells), asked, 0
    while shape.coarser is not None and shape.cell in SIMPLICES:
        coarser = shape.coarser()
        if coarser.simplices < max(COARSEST[dim], PER_RANK[dim] * comm.size):
            break
        shape, halvings = coarser, halvings + 1
    if shape.arrays is not None:
        points, cells = shape.arrays() if comm.rank == 0 else (np.empty((0, dim)), np.empty((0, dim + 1), np.int64))
        mesh = releases.create_mesh(comm, cells, points, shape.cell)
    else:
        ghosts = {"ghost_mode": releases.FACET_GHOSTS}
        ends = [np.array(shape.lower), np.array(shape.upper)]
        if dim == 1:
            mesh = dmesh.create_interval(comm, shape.cells[0], [shape.lower[0], shape.upper[0]], **ghosts)
        elif dim == 2:
            kind = releases.diagonal({"union-jack": "right_left"}.get(shape.diagonal, shape.diagonal))
            ghosts["cell_type"] = getattr(dmesh.CellType, shape.cell)
            mesh = dmesh.create_rectangle(comm, ends, list(shape.cells), diagonal=kind, **ghosts)
        else:
            ghosts["cell_type"] = getattr(dmesh.CellType, shape.cell)
            mesh = dmesh.create_box(comm, ends, list(shape.cells), **ghosts)
        mesh = releases.settle(mesh)
    sides = {name: dmesh.locate_entities_boundary(mesh, dim - 1, marker) for name, marker in shape.sides.items()}
    if shape.perturb:
        mesh.geometry.x[:] = shape.moved(mesh.geometry.x)
    return mesh, sides, shape.h, halvings

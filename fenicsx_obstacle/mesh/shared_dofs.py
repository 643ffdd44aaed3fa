"""Dofs that no cell of a rank has: other ranks, whose cells have them, know their points and values.

Submeshes of DOLFINx 0.5 have such dofs, among owned ones too. What DOLFINx evaluates in cells it leaves 0 there.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.parallel import total


def lost_nodes(V: fem.FunctionSpace) -> np.ndarray | None:
    """Local nodes that no local cell has; None if there are none on any rank, as on one rank (collective)."""
    if V.mesh.comm.size == 1:
        return None
    lost = np.ones(V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts, dtype=bool)
    lost[releases.cell_dofs(V)] = False
    return lost if total(V.mesh.comm, lost) > 0 else None


def share(u: fem.Function) -> None:
    """Give all ranks the owner's value of each dof; of a dof that no cell of its owner has, a value of the ranks whose
    cells have it (collective)."""
    V = u.function_space
    nodes = lost_nodes(V)
    if nodes is not None:
        lost = np.repeat(nodes, V.dofmap.index_map_bs)
        there = fem.Function(V)
        there.x.array[:] = np.where(lost, -np.inf, u.x.array)
        releases.vec(there).ghostUpdate(addv=PETSc.InsertMode.MAX, mode=PETSc.ScatterMode.REVERSE)
        mine = np.flatnonzero(lost[: V.dofmap.index_map.size_local * V.dofmap.index_map_bs])
        u.x.array[mine] = there.x.array[mine]
    u.x.scatter_forward()


def points_of_nodes(V: fem.FunctionSpace) -> np.ndarray:
    """Coordinates of the local nodes of a continuous space, shape (nodes, 3) (collective)."""
    if V.dofmap.dof_layout.num_dofs == releases.geometry_dofs(V.mesh).shape[1]:
        # as the mesh has them: DOLFINx's own table is off in the last digit, differently on each rank
        points = V.mesh.geometry.x[releases.dof_nodes(V)]
    else:
        points = V.tabulate_dof_coordinates()
    lost = lost_nodes(V)
    if lost is not None:
        for k, coordinate in enumerate(points.T):
            known = fem.Function(V)
            at_nodes = known.x.array.reshape(len(points), V.dofmap.index_map_bs)
            at_nodes[:, 0] = coordinate
            share(known)
            points[lost, k] = at_nodes[lost, 0]
    return points

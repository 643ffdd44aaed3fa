"""Maps between V_h and Q_h: functions of Q_h from values at the points of I, and their values at the nodes of V_h."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.discrete.levels import Level


def cell_means(level: Level) -> PETSc.Mat:
    """The map from values at owned dofs of V_h to the means of the nodal values of each cell, at the owned dofs of Q_h
    (collective)."""
    own, dofs = own_cells(level.mesh), releases.cell_dofs(level.V)
    rows = releases.cell_dofs(level.Q)[:own, 0]  # pressures are constant on cells
    columns = level.V.dofmap.index_map.local_to_global(dofs[:own].ravel().astype(np.int32)).reshape(own, -1)
    inverse = np.argsort(rows)
    columns = columns[inverse].astype(PETSc.IntType)
    count = columns.shape[1]
    starts = np.arange(0, columns.size + 1, count, dtype=PETSc.IntType)
    size = (own, None), (level.owned, None)
    return PETSc.Mat().createAIJ(
        size, csr=(starts, columns.ravel(), np.full(columns.size, 1.0 / count)), comm=level.comm
    )


def in_q(level: Level, values: np.ndarray) -> fem.Function:
    """The function of Q_h with these values at the owned points of I (collective).

    Args:
        level: Mesh and spaces.
        values: One for each owned dof of V_h, or of Q_h where the pair is not nodal.
    """
    q = fem.Function(level.Q)
    if level.Q is level.V or not level.pair.nodal:
        q.x.array[: len(values)] = values
    else:  # midpoints of edges: the dofs of V_h there follow those of the vertices
        everywhere = fem.Function(level.V)
        everywhere.x.array[: len(values)] = values
        everywhere.x.scatter_forward()
        middles = releases.cell_dofs(level.V)[:, -releases.cell_dofs(level.Q).shape[1] :]
        q.x.array[releases.cell_dofs(level.Q).ravel()] = everywhere.x.array[middles.ravel()]
    q.x.scatter_forward()
    return q


def at_nodes(level: Level) -> np.ndarray:
    """Weights of the dofs of Q_h in a cell in the value at each node of V_h, shape (nodes, dofs of Q_h); rows sum to
    1."""
    nodes, points = releases.cell_dofs(level.V).shape[1], releases.cell_dofs(level.Q).shape[1]
    if level.Q is level.V:
        return np.eye(nodes)
    if not level.pair.nodal:
        return np.ones((nodes, 1))
    # a vertex lies between the two edges that are not opposite to it
    return np.vstack([(1 - np.eye(points)) / (points - 1), np.eye(points)])

"""Connected components of a mesh: what holds one of them does not hold the others."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.parallel import before


def components_of(level: Level) -> tuple[int, np.ndarray]:
    """Number of connected components, and the component of each local dof, ghosts included (collective).

    The meshes of shapes are connected. Two cells are connected where they share a dof.
    """
    space = level.V
    size = len(level.points.T)
    if level.shape is not None:
        return 1, np.zeros(size, dtype=np.int64)
    from scipy.sparse import coo_matrix  # only where a mesh may have several
    from scipy.sparse.csgraph import connected_components

    comm, cells = level.comm, releases.cell_dofs(space)
    first, others = np.repeat(cells[:, 0], cells.shape[1] - 1), cells[:, 1:].ravel()
    here, part = connected_components(coo_matrix((np.ones(len(first)), (first, others)), shape=(size, size)), False)
    part = part + before(comm, here)
    # a dof of two ranks joins a component of the one with a component of the other
    owners = fem.Function(space)
    owners.x.array[:] = part
    owners.x.scatter_forward()
    joined = np.unique(np.column_stack([part, owners.x.array.astype(np.int64)]), axis=0)
    pairs = np.vstack(comm.allgather(joined))
    count = 1 + int(pairs.max(initial=0))
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    number, names = connected_components(links, False)
    return number, names[part].astype(np.int64)

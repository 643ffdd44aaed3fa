"""Interpolation between nested meshes, and from P1 to P2 on the same mesh."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.halving import Numbers
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.shared_dofs import lost_nodes
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.polynomials import EDGES


def downward(level: Level) -> Iterator[Transfer]:
    """Interpolation to a level from the one below, to that from the next, and so on (collective).

    Below P2 is P1 on the same mesh, below that the grids and meshes that it was refined from.
    """
    while level.coarse is not None:
        numbers = [Numbers.of(level.comm, level.coarse.V.dofmap.index_map), *(grid.number for grid in level.grids)]
        yield _transfer(ends_of(level), numbers.pop(), level.comm)
        for grid in reversed(level.grids):
            assert grid.ends is not None
            yield _transfer(grid.ends[: grid.number.owned], numbers.pop(), level.comm)
        level = level.coarse


def ends_of(level: Level) -> np.ndarray:
    """For each owned dof the two local dofs of `coarse`, or vertices of the last of `grids`, of which it is the mean:
    the ends of the edge it halves, or twice the vertex it coincides with; shape (owned dofs, 2) (collective).

    Raises:
        InputError: If a rank owns a dof that none of its cells has.
    """
    V, parents, places = level.V, level.parents, level.places
    assert level.coarse is not None
    coarse = level.grids[-1].cells if level.grids else releases.cell_dofs(level.coarse.V)
    owned, dofs = V.dofmap.index_map.size_local, releases.cell_dofs(V)
    if parents is None or places is None:  # P2 over P1 on the same mesh
        parents, places = np.arange(len(dofs)), np.broadcast_to(np.arange(dofs.shape[1]), dofs.shape)
    dofs = dofs[: len(parents)]
    lost = lost_nodes(V)
    if lost is not None and total(V.mesh.comm, lost[:owned]) > 0:
        raise InputError("a rank owns nodes of the mesh that none of its cells has: create the submesh of a mesh with "
                         "ghost_mode=dolfinx.mesh.GhostMode.shared_facet, or take element P1")  # fmt: skip
    corner = np.zeros(owned + V.dofmap.index_map.num_ghosts, dtype=np.int32)  # one corner of a cell of each dof
    corner[dofs.ravel()] = np.arange(dofs.size, dtype=np.int32)
    corner, dim = corner[:owned], V.mesh.topology.dim
    ends = np.array([(i, i) for i in range(dim + 1)] + EDGES[dim])[places.ravel()[corner]]
    return np.take_along_axis(coarse[parents[corner // dofs.shape[1]]], ends, axis=1)


def _transfer(ends: np.ndarray, number: Numbers, comm: MPI.Comm) -> Transfer:
    """Interpolation at owned dofs from the two local dofs of the coarser level of which they are the mean."""
    same = ends[:, 0] == ends[:, 1]
    coincident, ghosts = ends[same, 0], number.values[number.owned :].astype(PETSc.IntType)

    def inject(fine: np.ndarray) -> np.ndarray:
        found = PETSc.Vec().createGhost(ghosts, (number.owned, None), comm=comm)
        with found.localForm() as local:
            local.set(0.0)
            local.array[coincident] = fine[same]  # of all fine nodes one coincides with a coarse node
        found.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        values = found.array.copy()
        found.destroy()
        return values

    starts = np.zeros(len(ends) + 1, dtype=PETSc.IntType)
    np.cumsum(2 - same, out=starts[1:])
    columns, values = np.empty(starts[-1], dtype=np.int32), np.full(starts[-1], 0.5)
    columns[starts[:-1]] = np.minimum(ends[:, 0], ends[:, 1])
    columns[starts[1:] - 1] = np.maximum(ends[:, 0], ends[:, 1])
    values[starts[:-1][same]] = 1.0
    csr = starts, number.values[columns].astype(PETSc.IntType), values
    P = PETSc.Mat().createAIJ(((len(ends), None), (number.owned, None)), csr=csr, comm=comm)
    return Transfer(P, inject, of_means=True)

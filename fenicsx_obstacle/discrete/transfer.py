"""Interpolation between nested meshes, and from P1 to P2 on the same mesh."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.discrete.halving import Numbers
from fenicsx_obstacle.discrete.levels import Level


def downward(level: Level) -> Iterator[Transfer]:
    """Interpolation to a level from the one below, to that from the next, and so on (collective).

    Below P2 is P1 on the same mesh, below that the grids and meshes that it was refined from.
    """
    while level.coarse is not None:
        numbers = [Numbers.of(level.comm, level.coarse.V.dofmap.index_map), *(grid.number for grid in level.grids)]
        yield _transfer(level.ends, numbers.pop(), level.comm)
        for grid in reversed(level.grids):
            assert grid.ends is not None
            yield _transfer(grid.ends[: grid.number.owned], numbers.pop(), level.comm)
        level = level.coarse


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
    columns[starts[:-1]] = ends.min(axis=1)
    columns[starts[1:] - 1] = ends.max(axis=1)
    values[starts[:-1][same]] = 1.0
    csr = starts, number.values[columns].astype(PETSc.IntType), values
    P = PETSc.Mat().createAIJ(((len(ends), None), (number.owned, None)), csr=csr, comm=comm)
    return Transfer(P, inject, of_means=True)

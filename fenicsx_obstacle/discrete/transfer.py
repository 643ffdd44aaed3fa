"""Interpolation from a level to the next finer one, and its transpose."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.discrete import parents
from fenicsx_obstacle.discrete.halving import Numbers
from fenicsx_obstacle.discrete.levels import Level

Injection = Callable[[np.ndarray], np.ndarray]


class Transfer:
    """Interpolation P, one row for each owned dof of the finer level.

    Attributes:
        P: The matrix; rows of nodes that coincide with a coarse node have one entry, 1.
        inject: Owned values of the finer level at the coarse nodes, which coincide with finer ones (collective).
        of_means: Whether values are means of coarse ones: weights are positive, and their sum is 1.
    """

    def __init__(self, P: PETSc.Mat, inject: Injection, *, of_means: bool = False):
        self.P, self.inject, self.of_means = P, inject, of_means

    def interpolate(self, coarse: np.ndarray) -> np.ndarray:
        """P times owned coarse values (collective)."""
        right, left = self.P.createVecs()
        right.array[:] = coarse
        self.P.mult(right, left)
        return _taken(left, right)

    def restrict(self, fine: np.ndarray) -> np.ndarray:
        """The transpose of P times owned fine values (collective)."""
        right, left = self.P.createVecs()
        left.array[:] = fine
        self.P.multTranspose(left, right)
        return _taken(right, left)

    def all_of(self, coarse: np.ndarray) -> np.ndarray:
        """Whether a condition on coarse nodes holds at all those that a fine node is interpolated from (collective)."""
        return self.interpolate((~coarse).astype(float)) == 0


def _taken(result: PETSc.Vec, other: PETSc.Vec) -> np.ndarray:
    """The owned values of a vector; both vectors are freed."""
    values = result.array.copy()
    result.destroy()
    other.destroy()
    return values


def to_parents(level: Level) -> Transfer:
    """Interpolation from the mesh that a mesh was refined from, or from P1 on the same mesh to P2 (collective)."""
    assert level.coarse is not None and not level.grids
    return _transfer(level.ends, Numbers.of(level.comm, level.coarse.V.dofmap.index_map), level.comm)


def downward(level: Level) -> Iterator[Transfer]:
    """Interpolation to a level from the one below, to that from the next, and so on (collective).

    Args:
        level: P1.
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
    same = np.flatnonzero(ends[:, 0] == ends[:, 1])
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

    return Transfer(parents.prolongation(ends, number, comm), inject, of_means=True)

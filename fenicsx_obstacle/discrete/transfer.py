"""Interpolation from a level to the next finer one, and its transpose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete import parents
from fenicsx_obstacle.discrete.levels import Level

Injection = Callable[[np.ndarray], np.ndarray]


class Transfer:
    """Interpolation P, one row for each owned dof of the finer level.

    Attributes:
        P: The matrix; rows of nodes that coincide with a coarse node have one entry, 1.
        inject: Owned values of the finer level at the coarse nodes, which coincide with finer ones (collective).
    """

    def __init__(self, P: PETSc.Mat, inject: Injection):
        self.P, self.inject = P, inject

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
    assert level.coarse is not None
    ends, coarse = level.ends, level.coarse.V
    same = np.flatnonzero(ends[:, 0] == ends[:, 1])
    coincident, found = ends[same, 0], fem.Function(coarse)
    own = coarse.dofmap.index_map.size_local

    def inject(fine: np.ndarray) -> np.ndarray:
        found.x.array[:] = 0.0
        found.x.array[coincident] = fine[same]  # of all fine nodes one coincides with a coarse node
        releases.add_ghosts(found)
        return found.x.array[:own].copy()

    return Transfer(parents.prolongation(ends, level.V, coarse), inject)

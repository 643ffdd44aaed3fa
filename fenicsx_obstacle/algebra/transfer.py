"""Interpolation from a level to the next finer one, and its transpose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

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

"""Interpolation from a level to the next finer one, and its transpose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.products import product

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
        return product(self.P, coarse)

    def restrict(self, fine: np.ndarray) -> np.ndarray:
        """The transpose of P times owned fine values (collective)."""
        return product(self.P, fine, transposed=True)

    def all_of(self, coarse: np.ndarray) -> np.ndarray:
        """Whether a condition on coarse nodes holds at all those that a fine node is interpolated from (collective)."""
        return self.interpolate((~coarse).astype(float)) == 0

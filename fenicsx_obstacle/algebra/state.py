"""The state of a system, w and its reference r, and the law that answers to it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from petsc4py import PETSc


class State:
    """The state of a problem. All arrays hold owned dofs, and are changed in place.

    Attributes:
        w: The unknown.
        r: The reference; u = w + r.
        below: Distance of the lower obstacle from r, <= 0 where u may be r; None if there is no lower obstacle.
        above: Distance of the upper obstacle from r, or None.
        multiplier: p_k of the augmented obstacle g + eps p_k at the points of I, if these are no dofs; else None.
        w_vector: w for PETSc; it shares the memory.
        r_vector: r for PETSc.
    """

    multiplier: np.ndarray | None = None

    def __init__(self, w_vector: PETSc.Vec, r_vector: PETSc.Vec, *, lower: bool, upper: bool):
        """Zero (collective).

        Args:
            w_vector: For w.
            r_vector: For r.
            lower: Whether there is a lower obstacle.
            upper: Whether there is an upper one.
        """
        self.w_vector, self.r_vector = w_vector, r_vector
        self.w, self.r = w_vector.array, r_vector.array
        self.below = np.zeros(len(self.w)) if lower else None
        self.above = np.zeros(len(self.w)) if upper else None
        self._eps = 1.0

    @property
    def eps(self) -> float:
        """The penalty parameter, a number here: `method_of` makes one of "auto" and of formulas."""
        return self._eps

    @eps.setter
    def eps(self, value: float) -> None:
        self._eps = float(value)

    def share(self) -> None:
        """Called when w has changed: forms need its values at dofs of other ranks (collective)."""

    def share_all(self) -> None:
        """Called when anything but eps has changed (collective)."""


class Law(Protocol):
    """What a problem answers to its state; all methods are collective."""

    state: State
    thickness: float

    def vector(self) -> PETSc.Vec:
        """A new vector."""

    def create_matrix(self) -> PETSc.Mat:
        """The matrix that `jacobian` fills."""

    def weights(self) -> np.ndarray:
        """D_i = I(phi_i, 1) at owned points of I: dofs, with 0 at those that are none, or others."""

    def set_reference(self) -> None:
        """Called when r has changed."""

    def elastic(self, out: PETSc.Vec) -> None:
        """out = a(w + r, .) - f, rows of fixed dofs included."""

    def reaction(self, out: PETSc.Vec) -> None:
        """out = (1/eps) I((u - g)^+, .)."""

    def jacobian(self, A: PETSc.Mat, *, penalised: bool) -> None:
        """Fill A with the derivative of the residual; rows and columns of fixed dofs are those of the identity."""

    def energy(self, *, penalised: bool, moving: bool = True) -> float:
        """The energy, with that of the penalty if `penalised`, of a step in time if `moving`."""

    def forces_at(self, u_values: np.ndarray | float) -> np.ndarray:
        """a(u, .) - f at owned dofs for this u; the state stays as it is."""

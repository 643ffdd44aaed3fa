"""Residual and derivative of a form in any space, also of saddle points, with the diagonal penalty of `Affine`."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.affine import Affine
from fenicsx_obstacle.algebra.state import State
from fenicsx_obstacle.parallel import total


class FormLaw(Affine):
    """Forms that are assembled at every evaluation, the matrix of an affine F only by `assemble` (all collective)."""

    def __init__(self, forms: dict[str, Any], u: fem.Function, D: np.ndarray, fixed: np.ndarray, sides: list[bool]):
        """Compiled F, J and perhaps energy of the Function u, whose values they overwrite; whether there is a lower and
        an upper bound."""
        self.comm, self.forms, self.u, self.D, self.fixed = u.function_space.mesh.comm, forms, u, D, fixed
        self._residual, *vectors = (releases.create_vector(u.function_space) for _ in range(3))
        self.state = State(*vectors, lower=sides[0], upper=sides[1])
        self.stiffness = fem.petsc.create_matrix(forms["J"])
        self._constant = self.stiffness.createVecLeft()

    def set_reference(self) -> None:
        """Nothing is kept that depends on r."""

    def elastic(self, out: PETSc.Vec) -> None:
        out.array[:] = self.forces_at(self.state.w + self.state.r)

    def forces_at(self, u_values: np.ndarray | float) -> np.ndarray:
        self._put(u_values)
        with self._residual.localForm() as local:
            local.set(0.0)
        fem.petsc.assemble_vector(self._residual, self.forms["F"])
        self._residual.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return self._residual.array.copy()

    def _put(self, u_values: np.ndarray | float) -> None:
        self.u.x.array[: len(self.D)] = u_values
        self.u.x.scatter_forward()

    def assemble(self) -> None:
        """Fill the stiffness at the present u."""
        self._put(self.state.w + self.state.r)
        self.stiffness.zeroEntries()
        fem.petsc.assemble_matrix(self.stiffness, self.forms["J"])
        self.stiffness.assemble()

    def hold_fixed(self, A: PETSc.Mat) -> None:
        super().hold_fixed(A)
        starts, _, values = A.getValuesCSR()
        rows = np.repeat(np.arange(len(self.D)), np.diff(starts))
        self._sums = np.bincount(rows, np.abs(values), len(self.D)).astype(float)  # integers without rows

    @property
    def scales(self) -> np.ndarray:
        """The sum of |A_ij| in each owned row: A_ii may be 0."""
        return self._sums

    def energy(self, *, penalised: bool, moving: bool = True) -> float:
        self._put(self.state.w + self.state.r)
        value = total(self.comm, fem.assemble_scalar(self.forms["energy"]))
        return value + (self.penalty_energy() if penalised else 0.0)


class NonlinearFormLaw(FormLaw):
    """The same where F is not linear in u."""

    def jacobian(self, A: PETSc.Mat, *, penalised: bool) -> None:
        self.assemble()
        self.take_stiffness(A)
        super().jacobian(A, penalised=penalised)

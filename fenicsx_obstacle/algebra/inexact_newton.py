"""Inexact Newton: tolerances of the linear systems, loose while the contact set changes, then by the balance of forces.

The multigrid cycle is the dearest part of a solver, so it is applied once per step of CG and never for a norm alone:
the residual of the system is the unbalanced force that the Newton step will leave, if no more contact changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.stopping import SMALL_CORRECTION, Stopping, small_correction

ON_THE_WAY = 0.1  # of the unbalanced force: more accuracy finds no better active set
FEW = 2e-4  # of the contact nodes that change: the next system is most likely the last
TO_SPARE = 0.03  # the last system is solved further than to the tolerance, so that figures agree on all ranks to 1e-9
EXACT = 1e-10  # of the unbalanced force: all that a linear solver reaches
SOLVED = PETSc.KSP.ConvergedReason.CONVERGED_RTOL
NOT_A_NUMBER = PETSc.KSP.ConvergedReason.DIVERGED_NANORINF
CONTINUE = PETSc.KSP.ConvergedReason.ITERATING


@dataclass
class Inexact:
    """PETSc convergence test for the systems of a Newton iteration.

    Attributes:
        stopping: Knows the state of the Newton iteration.
        cold_start: The iteration begins without contact and may have no forces before there is any, as that of a body
            that is only moved: those of the step before count too, and the first system is not the last.
    """

    stopping: Stopping
    cold_start: bool = False
    _least: int = 1
    _target: float = 0.0
    _last: bool = False  # the system is most likely the last

    def __call__(self, ksp: PETSc.KSP, iteration: int, norm: float) -> int:
        """PETSc's callback (collective)."""
        if not np.isfinite(norm):
            return NOT_A_NUMBER
        if iteration == 0:
            self._least, self._target = self._aim()
        if iteration < self._least:
            return CONTINUE
        residual = ksp.buildResidual()
        done = residual.norm(PETSc.NormType.N1) <= self._target
        if done and self._last:  # in the scale of `Stopping._correction_is_done` too
            diagonal = ksp.getOperators()[0].getDiagonal()
            residual.pointwiseDivide(residual, diagonal)
            step = ksp.buildSolution()  # the range of the state may still be 0
            moved = SMALL_CORRECTION * step.norm(PETSc.NormType.INFINITY)
            done = residual.norm(PETSc.NormType.N1) <= 0.5 * max(small_correction(self.stopping.problem), moved)
            for vector in (diagonal, step):
                vector.destroy()
        residual.destroy()
        return SOLVED if done else CONTINUE

    def _aim(self) -> tuple[int, float]:
        """The least number of CG steps, and the tolerance of the residual force (collective)."""
        stopping = self.stopping
        step = stopping.history[-1]
        first = self.cold_start and step.active == 0 and len(stopping.history) == 1
        if not stopping.exact and (step.changed > FEW * step.active or first):
            forces = max(one.forces for one in stopping.history[-2:]) if self.cold_start else step.forces
            # the first step of CG only reduces the residual of nodes that have just come into contact
            self._last = False
            return 2, ON_THE_WAY * min(step.unbalanced, forces)
        self._last = stopping.row_by_row and not stopping.exact  # which solves to the end
        if stopping.uneven:  # a correction has fewer digits to lose than u
            return 1, EXACT * step.unbalanced
        enough = 0.0 if stopping.exact else TO_SPARE * stopping.tolerance * step.forces
        return 1, max(enough, EXACT * step.unbalanced, stopping.round_off())

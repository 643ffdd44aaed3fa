"""Check of a theorem at run time: on M-matrices the active sets of (3.4)* decrease from the second step on.

The systems of two steps, with active sets chi and remainders r of the linear solver, differ by

    (A + chi_k D/eps) (u_k+1 - u_k) = -(chi_k - chi_k-1) D (u_k - g)/eps + r_k - r_k-1.

The first term on the right is nowhere positive, since chi_k is where u_k > g, and no entry of the inverse is negative:
so u_k+1 - u_k <= (A + chi_k D/eps)^-1 (|r_k| + |r_k-1|), and a node may enter by no more than that. What enters by more
shows an error in the program: an answer must not hide it.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.parallel import total

FEW = 8 * float(np.finfo(float).eps)  # of |A| |u|: how far the remainders themselves are known
SAFETY = 2.0  # the bound is the solution of a system too


class Shrinking:
    """Checks the active sets of the full steps of one attempt, with one obstacle on an M-matrix (all methods
    collective)."""

    def __init__(self, problem: System):
        self.problem = problem
        self._side = 1.0 if problem.above is not None else -1.0
        self._active: np.ndarray | None = None
        self._excess = self._left = np.empty(0)
        self._steps = 0

    def broken(self, ksp: PETSc.KSP, active: np.ndarray, elastic: np.ndarray) -> bool:
        """Whether a node has entered by more than inexact systems allow.

        Args:
            ksp: The linear solver, with the matrix of the last step.
            active: Owned nodes beyond the obstacle now.
            elastic: a(u, .) - f now.
        """
        problem = self.problem
        lower, upper = problem.gaps()
        excess = -(upper if self._side > 0 else lower)
        before, self._active = self._active, active
        if before is None:
            self._excess = excess
            return False
        penalty_diagonal = np.where(before, problem.weights / problem.eps, 0.0)
        left = np.abs(elastic + self._side * penalty_diagonal * np.where(before, excess, 0.0))
        left[problem.fixed] = 0.0
        entered = active & ~before
        # of nodes that enter alone: below no obstacle the excess is -inf, now as before
        rise, self._excess = excess[entered] - self._excess[entered], excess
        known, self._left = self._left, left
        self._steps += 1
        if self._steps == 1 or total(problem.comm, len(rise)) == 0:
            return False
        allowed = self._lift(ksp, known + left)[entered]
        return total(problem.comm, np.count_nonzero(rise > SAFETY * allowed)) > 0

    def _lift(self, ksp: PETSc.KSP, forces: np.ndarray) -> np.ndarray:
        """The displacement by forces, with the active set of the last step fixed."""
        problem = self.problem
        z, b = problem.A.createVecs()
        diagonal = problem.A.getDiagonal()
        round_off = FEW * diagonal.array_r * np.abs(problem.w[: len(forces)])
        b.array[:] = forces + np.where(problem.fixed, 0.0, round_off)
        ksp.solve(b, z)
        lift = z.array.copy()
        for vector in (z, b, diagonal):
            vector.destroy()
        return lift

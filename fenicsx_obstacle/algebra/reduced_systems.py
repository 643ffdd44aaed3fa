"""The reduced systems of SNES VI, for the nodes without contact, and their preconditioner, without copies of a matrix.

SNES VI copies the rows and columns of these nodes in each step, and the reduced system changes its size from step to
step. Here the whole matrix and the preconditioner of the whole level are applied to vectors filled up with zeros.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.truncated_multigrid import HeldRows, Multigrid


class Reduced:
    """PETSc Python Mat: some rows of a matrix, and the same columns; its submatrices are others of these.

    Attributes:
        rows: Their places among the owned ones.
    """

    def __init__(self, A: PETSc.Mat, rows: np.ndarray | slice):
        self.A, self.rows = A, rows
        self._whole, self._result = A.createVecs()

    @classmethod
    def whole(cls, A: PETSc.Mat) -> PETSc.Mat:
        """PETSc's matrix with all rows."""
        return PETSc.Mat().createPython(A.getSizes(), cls(A, slice(None)), comm=A.comm)

    def createSubMatrix(self, _: PETSc.Mat, rows: PETSc.IS, columns: PETSc.IS, __: PETSc.Mat | None) -> PETSc.Mat:
        """PETSc's callback, of the whole and for columns that are the rows (collective)."""
        size, places = (rows.getLocalSize(), rows.getSize()), rows.getIndices() - self.A.getOwnershipRange()[0]
        return PETSc.Mat().createPython((size, size), Reduced(self.A, places), comm=self.A.comm)

    def apply(self, action: Callable[[PETSc.Vec, PETSc.Vec], None], x: PETSc.Vec, y: PETSc.Vec) -> None:
        """What an action on whole vectors does to these rows, where the others are 0 (collective)."""
        self._whole.array[self.rows] = x.array_r
        action(self._whole, self._result)
        y.array[:] = self._result.array_r[self.rows]

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback (collective)."""
        self.apply(self.A.mult, x, y)

    def getDiagonal(self, _: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """PETSc's callback (collective)."""
        self.A.getDiagonal(self._result)
        diagonal.array[:] = self._result.array_r[self.rows]

    def destroy(self, _: PETSc.Mat) -> None:
        """Free the vectors."""
        for vector in (self._whole, self._result):
            vector.destroy()


class OnInactive:
    """PETSc Python PC of a `Reduced`: that of the whole level with contact nodes held."""

    def __init__(self, multigrid: Multigrid | HeldRows, prefix: str):
        self.multigrid, self.prefix = multigrid, prefix
        self.inner = self._make_inner()

    def _make_inner(self) -> PETSc.PC:
        A = self.multigrid.problem.A
        inner = PETSc.PC().create(A.comm)
        inner.setOptionsPrefix(self.prefix)
        inner.setOperators(A)
        self.multigrid.install(inner)
        inner.setFromOptions()
        return inner

    def setUp(self, pc: PETSc.PC) -> None:
        """Hold what the inequality holds now (collective)."""
        problem = self.multigrid.problem
        self.reduced = pc.getOperators()[0].getPythonContext()
        held = np.ones(problem.owned, dtype=bool)
        held[self.reduced.rows] = False
        self.multigrid.truncate(np.where(held & ~problem.fixed, np.inf, 0.0))
        if not self.multigrid.keeps_sizes:
            self.inner.destroy()
            self.inner = self._make_inner()
        self.inner.setUp()

    def apply(self, _: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback (collective)."""
        self.reduced.apply(self.inner.apply, x, y)

    def destroy(self, _: PETSc.PC) -> None:
        """Free the inner PC."""
        self.inner.destroy()

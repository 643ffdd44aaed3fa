"""Truncated multigrid: the preconditioner for a matrix with contact nodes.

At a contact node the penalty adds D_i/eps to the diagonal; the variational inequality fixes the node. Coarse
corrections must not change fixed nodes, nor those where the penalty is far stiffer than A, so the rows of the
prolongation there are zero (Kornhuber's truncation), and a coarse node is fixed if its coincident fine node is. With
this alone coarse operators would be too soft along the free boundary, and without contact along a line. Galerkin
products would correct this, but have to be computed again for every active set. Here the coarse operator is the
stiffness matrix of its level plus a coarse penalty diagonal: the row sums of the finer operator, over nodes that are
not fixed, minus those of the coarser one. So the active set changes diagonals only.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.parallel import total

# times A_ii: a larger penalty diagonal fixes a node; coarse corrections do not change it
STIFFER = 10.0
ENOUGH_CLOSED = 0.75  # of the nodes for which coarse levels were made: the others are left to the smoother
SMOOTHER = {
    # Chebyshev, PETSc's default, would estimate eigenvalues anew at every set-up
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_ksp_norm_type": "none",
    "mg_levels_pc_type": "sor",
    "mg_levels_pc_sor_omega": 1.3,  # smooths better than 1 (Yavneh 1996); 1.2 to 1.4 do as well
    "mg_coarse_ksp_type": "preonly",
    "mg_coarse_pc_type": "cholesky",
    "mg_coarse_pc_factor_mat_solver_type": "mumps",
}


class Multigrid:
    """The multigrid preconditioner of the last of a chain of problems.

    Matrices and prolongations live as long as their level and are changed in place: PETSc's smoothers ignore new
    ones.

    Attributes:
        problem: The last.
        coarser: The multigrid of all but the last; None on the coarsest.
        keeps_sizes: Whether a PC serves another active set; else it is made anew.
    """

    keeps_sizes = True

    def __init__(self, problem: System, coarser: Multigrid | None):
        self.problem, self.coarser = problem, coarser
        self._moves, self._row_sums = problem.A.createVecs()  # 1 where a correction may move a node; over those
        if coarser is not None:
            self._transfer = problem.transfer
            self._whole = self._transfer.P
            self.P = self._whole.duplicate()
            self._carried = coarser._row_sums.duplicate()

    def truncate(self, penalty_diagonal: np.ndarray) -> None:
        """Truncate the interpolation for a penalty diagonal at owned nodes, on this level and all coarser ones
        (collective)."""
        matrices = self.problem.matrices
        matrices.add_penalty_diagonal(self.problem.A, penalty_diagonal)
        self._moves.array[:] = ~((penalty_diagonal > STIFFER * matrices.diagonal) | self.problem.fixed)
        if self.coarser is None:
            return
        self._sum_rows(penalty_diagonal)
        self._whole.multTranspose(self._row_sums, self._carried)
        self.coarser.truncate(self._coarse_penalty_diagonal())
        self._whole.copy(self.P, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.P.diagonalScale(L=self._moves, R=self.coarser._moves)

    def _coarse_penalty_diagonal(self) -> np.ndarray:
        """The penalty diagonal at owned coarse nodes: infinite if the coincident fine node is fixed."""
        assert self.coarser is not None
        coarse = self.coarser
        held = self._transfer.inject((self._moves.array_r == 0).astype(float)) > 0
        coarse._moves.array[:] = ~(held | coarse.problem.fixed)
        coarse._sum_rows()
        penalty_diagonal = np.maximum(self._carried.array_r - coarse._row_sums.array_r, 0.0)
        penalty_diagonal[held] = np.inf
        penalty_diagonal[coarse.problem.fixed] = 0.0
        return penalty_diagonal

    def _sum_rows(self, penalty_diagonal: np.ndarray | None = None) -> None:
        """Compute the row sums of stiffness and penalty diagonal over nodes that are not fixed."""
        self.problem.matrices.stiffness.mult(self._moves, self._row_sums)
        if penalty_diagonal is not None:
            np.add(self._row_sums.array, penalty_diagonal, out=self._row_sums.array, where=self._moves.array_r > 0)
        self._row_sums.pointwiseMult(self._row_sums, self._moves)

    def install(self, pc: PETSc.PC) -> None:
        """Make a PC the cycle over all levels; options of `SMOOTHER` under its prefix say how."""
        grids = self._grids()
        pc.setType("mg")
        pc.setMGLevels(len(grids))
        for number, grid in enumerate(grids):
            if number:
                pc.setMGInterpolation(number, grid.P)
            smoother = pc.getMGSmoother(number) if number else pc.getMGCoarseSolve()
            smoother.setOperators(grid.problem.A)

    def _grids(self) -> list[Multigrid]:
        return [*(self.coarser._grids() if self.coarser else []), self]


class HeldRows:
    """A PETSc preconditioner of the whole matrix, with contact nodes fixed.

    The submatrix of the inactive set would lose blocks and near-null space, which algebraic multigrid needs.

    Attributes:
        problem: With a preconditioner.
        keeps_sizes: As for `Multigrid`.
    """

    keeps_sizes = False

    def __init__(self, problem: System):
        self.problem = problem

    def truncate(self, penalty_diagonal: np.ndarray) -> None:
        self.problem.hold(penalty_diagonal)

    def install(self, pc: PETSc.PC) -> None:
        pc.setType(self.problem.preconditioner["pc_type"])


class KeptLevels:
    """PETSc Python PC for the whole matrix of a problem that has a preconditioner of its own.

    Interpolation from rigid body motions is 0 at the normal components of closed nodes, so that coarse matrices do not
    depend on the penalty there. While no other nodes close, coarse levels stay as they are, and only the finest
    smoother is renewed. At fixed dofs, where interpolation may be other than 0 by round-off, it is the identity.
    """

    def __init__(self, problem: System, prefix: str):
        self.problem, self.prefix = problem, prefix
        self._inner: PETSc.PC | None = None
        self._closed = np.empty(0, dtype=bool)

    def setUp(self, pc: PETSc.PC) -> None:
        """Keep the coarse levels, or make new ones (collective)."""
        problem, closed = self.problem, self.problem.matrices.penalty_diagonal() > 0
        if self._inner is not None and problem.affine:
            counted = (closed & ~self._closed, closed, self._closed)
            others, now, then = (total(problem.comm, np.count_nonzero(one)) for one in counted)
            if others == 0 and now >= ENOUGH_CLOSED * then:
                return
        self.destroy(pc)
        self._closed, self._inner = closed, PETSc.PC().create(problem.comm)
        self._inner.setOptionsPrefix(self.prefix)
        self._inner.setOperators(problem.A)
        self._inner.setFromOptions()
        self._inner.setUp()
        self._inner.setReusePreconditioner(True)
        if self._inner.getType() in ("gamg", "mg"):  # PETSc 3.25 would reuse the smoothers too
            self._inner.getMGSmoother(self._inner.getMGLevels() - 1).getPC().setReusePreconditioner(False)

    def apply(self, _: PETSc.PC, residual: PETSc.Vec, correction: PETSc.Vec) -> None:
        """PETSc's callback (collective)."""
        assert self._inner is not None
        self._inner.apply(residual, correction)
        fixed = self.problem.fixed
        correction.array[fixed] = residual.array_r[fixed]

    def destroy(self, _: PETSc.PC) -> None:
        """Free the inner PC."""
        if self._inner is not None:
            self._inner.destroy()
            self._inner = None

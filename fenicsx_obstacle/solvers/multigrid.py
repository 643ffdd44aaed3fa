"""Truncated multigrid: the preconditioner for a membrane that is held at its contact nodes.

A coarse correction must not move a node in contact. So the rows of the prolongation at held nodes are zero, a coarse
node is held where the fine node it coincides with is (and where contact would be lost), and the operator of a coarse
level is its own stiffness matrix with the held rows and columns eliminated (after Kornhuber's truncated monotone
multigrid, without its triple product).
Held is a matter of the diagonal alone: a matrix row whose diagonal is 1e16 times what it was answers with zero. That
makes the change from one active set to the next cheap, and serves the penalty, whose diagonal is D/eps there, and the
variational inequality alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.discrete import parents
from fenicsx_obstacle.discrete.problem import Problem

SMOOTHER = {
    # Chebyshev, PETSc's default, would estimate eigenvalues anew at every set-up
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_ksp_norm_type": "none",
    "mg_levels_pc_type": "sor",
    "mg_coarse_ksp_type": "preonly",
    "mg_coarse_pc_type": "cholesky",
    "mg_coarse_pc_factor_mat_solver_type": "mumps",
}


class Multigrid:
    """The multigrid preconditioner of the last of a chain of problems.

    Matrices and prolongations live as long as their level and are changed in place: PETSc's smoothers ignore new
    ones.

    Attributes:
        problems: From the coarsest to the finest.
        coarser: The multigrid of all but the last; None on the coarsest.
    """

    def __init__(self, problem: Problem, coarser: Multigrid | None):
        self.problem, self.coarser = problem, coarser
        self.problems: tuple[Problem, ...] = (*(coarser.problems if coarser else ()), problem)
        self._moves = problem.A.createVecRight()  # 1 where a correction may move a node
        if coarser is not None:
            level = problem.level
            ends = level.ends
            self._whole = parents.prolongation(ends, level.V, coarser.problem.level.V)
            self.P = self._whole.duplicate()
            self._same = np.flatnonzero(ends[:, 0] == ends[:, 1])
            self._twin = ends[self._same, 0]

    @cached_property
    def _flags(self) -> PETSc.Vec:
        """Ghosted vector of the coarser level."""
        assert self.coarser is not None
        return self.coarser.problem.elastic.duplicate()

    def hold(self, held: np.ndarray) -> None:
        """Let no correction move these owned nodes (collective)."""
        self._moves.array[:] = ~(held | self.problem.fixed)
        if self.coarser is None:
            return
        coarse = self._coarse(held)
        self.coarser.hold(coarse)
        self.coarser.problem.hold(coarse)
        self._whole.copy(self.P, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.P.diagonalScale(L=self._moves, R=self.coarser._moves)

    def _coarse(self, held: np.ndarray) -> np.ndarray:
        """Which owned coarse nodes are held: twins of held nodes, and one end of each held edge that has none.

        Without the second kind, contact along a line would vanish from coarse levels, whose corrections then press
        through it.
        """
        flags, ends = self._flags, self.problem.level.ends[held]
        with flags.localForm() as local:
            local.set(0.0)
            local.array[self._twin] = held[self._same]
        flags.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        flags.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        with flags.localForm() as local:
            values = local.array
            lost = ends[values[ends].max(axis=1, initial=0.0) == 0, 0]
            values[len(flags.array_r) :] = 0.0
            values[lost] = 1.0
        flags.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return flags.array_r > 0

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


class OnInactive:
    """PETSc Python PC for the reduced systems of SNES VI: the multigrid of the whole level with contact nodes held.

    The reduced system changes its size from step to step, multigrid does not: vectors are filled up with zeros.
    """

    def __init__(self, snes: PETSc.SNES, multigrid: Multigrid, prefix: str):
        self.snes, self.multigrid = snes, multigrid
        A = multigrid.problem.A
        self.inner = PETSc.PC().create(A.comm)
        self.inner.setOptionsPrefix(prefix)
        self.inner.setOperators(A)
        multigrid.install(self.inner)
        self.inner.setFromOptions()
        self.whole, self.answer = A.createVecs()

    def setUp(self, pc: PETSc.PC) -> None:
        """Hold what the inequality holds now; safe while SNES solves, and only then."""
        problem = self.multigrid.problem
        inactive = self.snes.getVIInactiveSet()
        start, _ = problem.A.getOwnershipRange()
        self.free = inactive.getIndices() - start
        held = np.ones(problem.level.owned, dtype=bool)
        held[self.free] = False
        self.multigrid.hold(held)
        problem.hold(held)
        self.inner.setUp()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self.whole.set(0.0)
        self.whole.array[self.free] = x.array_r
        self.inner.apply(self.whole, self.answer)
        y.array[:] = self.answer.array_r[self.free]

    def destroy(self, pc: PETSc.PC) -> None:
        for owner in (self.inner, self.whole, self.answer):
            owner.destroy()


def chain(problems: Sequence[Problem]) -> list[Multigrid]:
    """One multigrid for each of the problems, from the coarsest on."""
    grids: list[Multigrid] = []
    for problem in problems:
        grids.append(Multigrid(problem, grids[-1] if grids else None))
    return grids

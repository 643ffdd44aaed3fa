"""(3.4) for affine problems with contact at dofs: A, f and D that are assembled once.

With the nodal rule the penalty (3.6) is a diagonal, so the residual is A w + (A r - f) + D chi (w - gap)/eps, and a
Newton step changes nothing but the diagonal of its matrix.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra.products import absolute_product, product
from fenicsx_obstacle.algebra.state import State
from fenicsx_obstacle.parallel import total

CANCELLED = 1e-14  # of A_ii: a sum of the entries of a row that is round-off
HELD = 1e16  # times the diagonal of a row whose solution is to be zero
TINY = 1e-300
MOSTLY = 0.25  # of the sum of the forces: those of P2 at vertices have either sign


class Affine:
    """Residual, derivative and energy of A w + (A r - f) and the penalty (all methods collective).

    Attributes:
        state: w, r, gaps, eps.
        stiffness: A, before rows of fixed dofs are those of the identity.
        minus_load: -f.
        D: Weights of I at owned dofs.
        fixed: Numbers of owned dofs at which u is given.
        diagonal: A_ii; 1 at fixed dofs.
        thickness: What makes weights on the boundary areas.
    """

    state: State
    stiffness: PETSc.Mat
    minus_load: PETSc.Vec
    D: np.ndarray
    fixed: np.ndarray
    comm: MPI.Comm
    thickness: float = 1.0

    def __init__(
        self,
        comm: MPI.Comm,
        state: State,
        stiffness: PETSc.Mat,
        minus_load: PETSc.Vec,
        D: np.ndarray,
        fixed: np.ndarray,
    ):
        """Take matrices; see the attributes."""
        self.comm, self.state, self.D, self.fixed = comm, state, D, fixed
        self.stiffness, self.minus_load = stiffness, minus_load
        self._constant = self.vector()

    def vector(self) -> PETSc.Vec:
        """A new vector."""
        return self.stiffness.createVecLeft()

    def weights(self) -> np.ndarray:
        """D."""
        return self.D

    def set_reference(self) -> None:
        """Called when r or the load has changed."""
        self.stiffness.mult(self.state.r_vector, self._constant)
        self._constant.axpy(1.0, self.minus_load)

    def elastic(self, out: PETSc.Vec) -> None:
        """out = A (w + r) - f."""
        self.stiffness.multAdd(self.state.w_vector, self._constant, out)

    def forces_at(self, u_values: np.ndarray | float) -> np.ndarray:
        """A u - f at owned dofs; the state stays as it is."""
        return product(self.stiffness, u_values) + self.minus_load.array_r

    def forces_within(self) -> tuple[np.ndarray, np.ndarray]:
        """A u and |A| |u| at owned dofs."""
        u = self.state.w + self.state.r
        return product(self.stiffness, u), absolute_product(self.stiffness, np.abs(u))

    def leans(self, side: int, share: float = MOSTLY) -> bool:
        """Whether the nodal forces have the sign of a side, -1 or 1, up to a share of their sum."""
        forces = -self.minus_load.array_r
        return total(self.comm, np.maximum(side * forces, 0.0)) > share * total(self.comm, np.abs(forces))

    def reaction(self, out: PETSc.Vec) -> None:
        """out = D chi (u - g)/eps."""
        values = self._excess()
        values *= self.D
        values /= self.state.eps
        out.array[:] = values

    def create_matrix(self) -> PETSc.Mat:
        """The matrix that `jacobian` fills."""
        A = self.stiffness.duplicate(copy=True)
        self._scratch = A.createVecLeft()  # every use overwrites it
        self.hold_fixed(A)
        return A

    def hold_fixed(self, A: PETSc.Mat) -> None:
        """Make rows and columns of fixed dofs those of the identity, and note the diagonal."""
        first, _ = A.getOwnershipRange()
        A.zeroRowsColumns((first + self.fixed).astype(PETSc.IntType), 1.0)
        A.getDiagonal(self._scratch)
        self.diagonal = self._scratch.array.copy()

    def take_stiffness(self, A: PETSc.Mat) -> None:
        """Copy a stiffness that has changed into the matrix that `jacobian` fills."""
        self.stiffness.copy(A, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.hold_fixed(A)

    def jacobian(self, A: PETSc.Mat, *, penalised: bool) -> None:
        """Set A to the derivative of the residual."""
        self.add_penalty_diagonal(A, self.penalty_diagonal() if penalised else None)

    def energy(self, *, penalised: bool, moving: bool = True) -> float:
        """u . A u/2 - f . u, and the energy of the penalty."""
        return self.work() + (self.penalty_energy() if penalised else 0.0)

    def work(self) -> float:
        """u . A u/2 - f . u, for a symmetric A.

        The round-off of a product with A is relative to sum of A_ii u_i^2. A constant in u, whose forces cancel in A,
        takes no digit: with the constant c for which this sum is the least of v = u - c,
        u . A u = v . A v + c (A 1) . (2 v + c).
        """
        u, (stiff, sums) = self.state.w + self.state.r, self._stiffness_of_rows()
        load = total(self.comm, u * self.minus_load.array_r)
        c = total(self.comm, stiff * u) / max(total(self.comm, stiff), TINY)
        v = u - c
        return 0.5 * total(self.comm, v * product(self.stiffness, v) + c * sums * (2 * v + c)) + load

    def _stiffness_of_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """|A_ii| and A 1 at owned dofs, which is 0 where it is round-off."""
        self.stiffness.getDiagonal(self._scratch)
        stiff, sums = np.abs(self._scratch.array), product(self.stiffness, 1.0)
        return stiff, np.where(np.abs(sums) > CANCELLED * stiff, sums, 0.0)

    def penalty_energy(self) -> float:
        """I((u - g)^+ ^2, 1)/(2 eps)."""
        return total(self.comm, self.D * self._excess() ** 2) / (2 * self.state.eps)

    def penalty_diagonal(self) -> np.ndarray:
        """The derivative of the penalty: D_i / eps at owned dofs in contact, otherwise 0."""
        penalty_diagonal = self.D * (self._excess() != 0) / self.state.eps
        penalty_diagonal[self.fixed] = 0.0
        return penalty_diagonal

    @property
    def scales(self) -> np.ndarray:
        """The stiffness of each owned dof, > 0 where it has one."""
        return self.diagonal

    def add_penalty_diagonal(self, A: PETSc.Mat, penalty_diagonal: np.ndarray | None) -> None:
        """Set A to the stiffness plus a diagonal at owned dofs; an infinite entry fixes the dof at zero."""
        self._scratch.array[:] = self.diagonal
        if penalty_diagonal is not None:
            self._scratch.array[:] += np.minimum(penalty_diagonal, HELD * self.scales)
        A.setDiagonal(self._scratch)

    def _excess(self) -> np.ndarray:
        """(u - upper)^+ - (lower - u)^+ at owned dofs."""
        state, excess = self.state, np.zeros(len(self.D))
        for gap, part in ((state.above, np.maximum), (state.below, np.minimum)):
            if gap is not None:
                beyond = state.w - gap
                excess += part(beyond, 0.0, out=beyond)
        return excess

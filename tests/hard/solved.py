"""Reference problems: computed solutions with bounds of their distance from the discrete solution.

A state w leaves the residual r = A w + ... + D (u - g)^+/eps - f at free dofs. Its distance e to the solution satisfies
(A + theta D/eps) e = r with some 0 <= theta_i <= 1, since t^+ is monotone and Lipschitz; for the inequality
this holds with theta_i = 0 or infinite. Hence, with r taken to contain the round-off of its own evaluation,

    |e| <= A^-1 |r|  at every node, and   ||e||_a <= R, R^2 = |r|' A^-1 |r|,   where A is an M-matrix,
    ||e||_a <= R,  R^2 = r' A^-1 r,   everywhere,

and two answers to one problem agree within the sum of these: no tolerance is chosen by hand. Other operators:

- with drift A is not symmetric; e' A e = e' r then gives R with the symmetric part of A, if that is positive definite,
  and |e| <= A^-1 |r| holds for M-matrices without symmetry too;
- convex terms beside a linear tension (soft obstacles) only add to the derivative: A without them is enough for both;
- where the tension itself depends on u, A is the derivative at the answer and ||e||_a^2 stands for (F(u) - F(u')) . e,
  F(u) = a(u, .): R is known to first order in e, for which it gets `NONLINEAR_FACTOR`. A wrong answer is not of second
  order.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.data_scales import NEGLIGIBLE_FORCE, nearest_gap
from fenicsx_obstacle.algebra.m_matrix import is_m_matrix, sums_nowhere_negative
from fenicsx_obstacle.check.verification import ROUNDED, State
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.solvability import ROUND_OFF
from fenicsx_obstacle.effects.effect import is_support, residual
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total

NONLINEAR_FACTOR = 2.0  # how many times stiffer than between two answers the membrane may be at either


@dataclass(frozen=True, eq=False)
class Solved(State):
    """A solution of one `ReferenceProblem`; arrays have values at owned dofs.

    Attributes:
        ground: What it is an answer to.
        w: u - r, whose digits are kept in contact.
        r: The reference, w = u - r.
        energy: That of the penalised problem, or of the inequality; None where there is none.
        z: How far u may be from the discrete solution, at each node.
        q: How far p may be, from D (p - p') = A e - r, row by row.
        R: How far in the energy norm; inf where nothing is known.
    """

    ground: ReferenceProblem
    w: np.ndarray = field(repr=False)
    r: np.ndarray = field(repr=False)
    energy: float | None
    z: np.ndarray = field(repr=False)
    q: np.ndarray = field(repr=False)
    R: float

    def penetration(self, side: str) -> float:
        """Largest distance beyond the `lower` or `upper` obstacle, >= 0 (collective)."""
        gap = {"lower": self.below, "upper": self.above}[side]
        return max(largest(self.ground.comm, -gap[self.ground.touchable]), 0.0)

    def minus(self, other: Solved) -> np.ndarray:
        """u - other.u, in contact without the round-off of u."""
        return (self.w - other.w) + (self.r - other.r)

    def apart(self, other: Solved) -> tuple[float, float]:
        """Distance of another answer in the energy norm, and the round-off of it (collective)."""
        g, e = self.ground, self.minus(other)
        if not g.bent:
            return float(np.sqrt(g.squared(e))), 0.0
        # of Bregman: (F(u) - F(u')) . e, nowhere negative, 0 only where the slopes are the same
        work = total(g.comm, np.where(g.free, e * (self.elastic - other.elastic), 0.0))
        return float(np.sqrt(max(work, 0.0))), float(np.sqrt(total(g.comm, np.abs(e) * (self.noise + other.noise))))

    def norm(self, p: np.ndarray) -> float:
        """||p||_I of (3.6) (collective)."""
        return float(np.sqrt(total(self.ground.comm, self.ground.D * p**2)))


class ReferenceProblem:
    """The factorised matrix and the weights of a problem, with which its solutions are checked (all methods
    collective).

    Attributes:
        problem: With contact at nodes.
        D: The weights of I at owned dofs.
        free: Dofs where u is not given.
        touchable: Those that can touch an obstacle.
        bent: Whether the tension depends on u, and the matrix with it.
        symmetric: Whether it is symmetric.
        held: Whether its symmetric part is positive definite: otherwise nothing is known of how far answers are from
            the solution.
        monotone: Whether the maximum principle holds: the stiffness between free dofs is an M-matrix, its rows nowhere
            sum to less than 0, and whatever else depends on u does so node by node, nowhere falling.
    """

    def __init__(self, problem: Problem):
        """Assemble.

        Raises:
            InputError: If contact is not at nodes.
        """
        if not problem.level.pair.nodal:
            raise InputError(f"{problem.model.source}: invariants are known for contact at nodes")
        self.problem, self.comm = problem, problem.level.comm
        self.D, self.free, self.touchable = problem.weights, ~problem.fixed, problem.touchable
        effects = problem.model.effects
        self.bent = not problem.model.elastic.affine
        self.symmetric = problem.symmetric
        law = problem.law
        lasting = [effect for effect in effects if effect.affine or effect is problem.model.elastic]
        form = residual(lasting, law.w + law.reference, law.v, problem.data)
        self._form = releases.form(ufl.derivative(form, law.w))
        self.A, self._S = PETSc.Mat(), PETSc.Mat()
        self._solvers: dict[str, PETSc.KSP] = {}
        self.held = False
        self._settle()
        self.held = self._definite()
        signs = is_m_matrix(self.A, self.diagonal, self.comm) and sums_nowhere_negative(
            self.A, self.diagonal, self.comm
        )
        beside = all(effect.affine or effect.role == "soft obstacle" for effect in effects)
        self.monotone = self.held and signs and beside and (self.symmetric or self._inverse_positive())

    def _settle(self) -> None:
        """Take the matrix of the present state."""
        self._free_matrices()
        problem = self.problem
        self.A = fem.petsc.create_matrix(self._form)
        fem.petsc.assemble_matrix(self.A, self._form)
        self.A.assemble()
        diagonal = self.A.getDiagonal()
        self.diagonal = diagonal.array.copy()
        diagonal.destroy()
        own = problem.level.V.dofmap.index_map.local_range[0]
        self.A.zeroRowsColumns((own + problem.law.fixed).astype(PETSc.IntType), 1.0)
        self._S = self.A
        if not self.symmetric:
            self._S = self.A.transpose(PETSc.Mat())
            self._S.axpy(1.0, self.A, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            self._S.scale(0.5)

    def _definite(self) -> bool:
        """Whether the symmetric part of the matrix is positive definite."""
        given = total(self.comm, np.count_nonzero(self.problem.fixed)) > 0
        if self.symmetric and (given or not any(map(is_support, self.problem.model.effects))):
            return given
        one, sums = self._S.createVecs()
        one.set(1.0)
        self._S.mult(one, sums)
        # a constant that meets no more than round-off is one that nothing holds
        resisted = given or sums.sum() > ROUND_OFF * total(self.comm, self.diagonal)
        for vector in (one, sums):
            vector.destroy()
        if not resisted:
            return False
        solver = self._solver("symmetric")
        solver.setUp()
        negative, zero, _ = solver.getPC().getFactorMatrix().getInertia()
        return negative == zero == 0

    def _inverse_positive(self) -> bool:
        """Whether A x = 1 has x > 0: with no positive entry off its diagonal A is an M-matrix then."""
        return smallest(self.comm, self.lift(np.ones(len(self.free)))[self.free]) > 0

    def _solver(self, part: str) -> PETSc.KSP:
        """Factors of the `whole` matrix, or of its `symmetric` part; made on first use."""
        part = "symmetric" if self.symmetric else part
        if part not in self._solvers:
            ksp = PETSc.KSP().create(self.comm)
            ksp.setOperators(self._S if part == "symmetric" else self.A)
            ksp.setType("preonly")
            ksp.getPC().setType("cholesky" if part == "symmetric" else "lu")
            ksp.getPC().setFactorSolverType("mumps")
            ksp.getPC().setFactorSetUpSolverType()
            for number in (13, 24):  # count negative and zero pivots on all ranks
                ksp.getPC().getFactorMatrix().setMumpsIcntl(number, 1)
            self._solvers[part] = ksp
        return self._solvers[part]

    def lift(self, forces: np.ndarray, part: str = "whole") -> np.ndarray:
        """A^-1 forces: where forces at free dofs move the membrane without obstacles; or by its symmetric part."""
        x, b = self.A.createVecs()
        b.array[:] = np.where(self.free, forces, 0.0)
        self._solver(part).solve(b, x)
        result = x.array.copy()
        for vector in (x, b):
            vector.destroy()
        return result

    def squared(self, e: np.ndarray) -> float:
        """a(e, e) of owned values that are 0 at fixed dofs."""
        x, y = self.A.createVecs()
        x.array[:] = np.where(self.free, e, 0.0)
        self.A.mult(x, y)
        value = max(x.dot(y), 0.0)
        for vector in (x, y):
            vector.destroy()
        return value

    def take(self, p: np.ndarray, eps: float | None) -> Solved:
        """The present state of the problem, with this pressure at owned points; its last residual was of this state."""
        problem = self.problem
        if self.bent:
            self._settle()
        w, r = problem.w.copy(), problem.state.r.copy()
        found = State.of(problem, problem.u, p, eps, 0.0, self.diagonal, self.diagonal * (np.abs(w) + np.abs(r)))
        # where all data are zero solvers take for nothing what they cannot compare with any force
        nearest = nearest_gap(problem)
        if np.isfinite(nearest):
            nothing = np.where(self.free, NEGLIGIBLE_FORCE * nearest * self.diagonal, 0.0)
            forces = max(found.forces, total(self.comm, nothing))
            found = replace(found, noise=found.noise + nothing, forces=forces)
        state = problem.vector()
        energy = problem.energy(state, penalised=eps is not None) if problem.has_energy else None
        state.destroy()
        left = np.abs(found.unbalanced) + found.noise
        # the values of u themselves are rounded, and w where it was counted from the other obstacle
        last = ROUNDED * (np.abs(w) + np.abs(r) + self._between()) * self.free
        z, R = np.full(len(w), np.inf), np.inf
        if self.held:
            z = np.abs(self.lift(left)) + last
            R = self._reach(left, found.unbalanced, last)
        q = np.where(
            self.touchable, (2 * self.diagonal * z + np.abs(found.unbalanced)) / np.maximum(self.D, 1e-300), 0.0
        )
        return Solved(**vars(found), ground=self, w=w, r=r, energy=energy, z=z, q=q, R=R)

    def _between(self) -> np.ndarray | float:
        """The distance between the obstacles, 0 where one of them is none."""
        below, above = self.problem.below, self.problem.above
        if below is None or above is None:
            return 0.0
        apart = above - below
        return np.where(np.isfinite(apart), np.abs(apart), 0.0)

    def _reach(self, left: np.ndarray, signed: np.ndarray, last: np.ndarray) -> float:
        """R of a residual, of which `left` is the size with its round-off."""
        off = np.abs(self.lift(left, "symmetric")) + last
        R = np.sqrt(total(self.comm, left * off)) + np.sqrt(total(self.comm, self.diagonal * last**2))
        if not self.monotone or not self.symmetric:  # r' S^-1 r may exceed |r|' S^-1 |r| then
            R += np.sqrt(max(total(self.comm, signed * self.lift(signed, "symmetric")), 0.0))
        return float(R) * (NONLINEAR_FACTOR if self.bent else 1.0)

    def close(self) -> None:
        """Free the matrix and its factors."""
        self._free_matrices()

    def _free_matrices(self) -> None:
        for solver in self._solvers.values():
            solver.destroy()
        self._solvers.clear()
        for matrix in (self.A, self._S):
            matrix.destroy()

"""A solved problem, frozen: what it answered, and how far that may be from the discrete solution.

A state w leaves the residual r = A w + ... + D (u - g)^+/eps - f at free dofs. Its distance e to the solution satisfies
(A + theta D/eps) e = r with some 0 <= theta_i <= 1, since t^+ is monotone and Lipschitz; for the inequality likewise
with theta_i = 0 or infinite. Hence, with r taken to contain the round-off of its own evaluation,

    |e| <= A^-1 |r|  at every node, and   ||e||_a <= R, R^2 = |r|' A^-1 |r|,   where A is an M-matrix,
    ||e||_a <= R,  R^2 = r' A^-1 r,   everywhere,

and two answers to one problem agree within the sum of these: no tolerance is chosen by hand.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.signs import sums_nowhere_negative
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.solvers.stopping import NOTHING, TOLERANCE

EPSILON = float(np.finfo(float).eps)
FEW = 8 * EPSILON  # of |A| |u| in a row of some seven entries
TOUCHING = 1e-12  # of the range of u: nearer than this SNES VI takes a node to be at its bound


@dataclass(frozen=True, eq=False)
class Solved:
    """An answer of one `Ground`; arrays hold owned dofs.

    Attributes:
        ground: What it is an answer to.
        eps: Penalty parameter; None for the inequality.
        w: u - r, whose digits are kept in contact.
        r: The heights from which w counts.
        p: Contact pressure, > 0 against the lower obstacle.
        elastic: a(u, .) - f, the support reactions at fixed dofs included.
        below: u - lower, inf without one.
        above: upper - u, likewise.
        energy: That of the penalised problem, or of the inequality; None where there is none.
        forces: Sum of the acting forces: load, support reactions, contact.
        floor: Sum over free dofs of the round-off of the residual, a force.
        range: Largest minus smallest height.
        z: How far u may be from the discrete solution, at each node.
        R: How far in the energy norm; inf where u is held nowhere.
    """

    ground: Ground
    eps: float | None
    w: np.ndarray = field(repr=False)
    r: np.ndarray = field(repr=False)
    p: np.ndarray = field(repr=False)
    elastic: np.ndarray = field(repr=False)
    below: np.ndarray = field(repr=False)
    above: np.ndarray = field(repr=False)
    energy: float | None
    forces: float
    floor: float
    range: float
    z: np.ndarray = field(repr=False)
    R: float

    @property
    def residual(self) -> np.ndarray:
        """a(u, .) - f - I(p, .): what is unbalanced at free dofs."""
        return np.where(self.ground.free, self.elastic - self.ground.D * self.p, 0.0)

    @property
    def q(self) -> np.ndarray:
        """How far the pressure may be from that of the discrete solution: D (p - p') = A e - r, row by row."""
        g = self.ground
        return np.where(g.touchable, (2 * g.diagonal * self.z + np.abs(self.residual)) / np.maximum(g.D, 1e-300), 0.0)

    def penetration(self, side: str) -> float:
        """Largest distance beyond the `lower` or `upper` obstacle, >= 0 (collective)."""
        gap = {"lower": self.below, "upper": self.above}[side]
        return max(largest(self.ground.comm, -gap[self.ground.touchable]), 0.0)

    def minus(self, other: Solved) -> np.ndarray:
        """u - other.u, in contact without the round-off of heights."""
        return (self.w - other.w) + (self.r - other.r)

    def norm(self, p: np.ndarray) -> float:
        """||p||_I of (3.6) (collective)."""
        return float(np.sqrt(total(self.ground.comm, self.ground.D * p**2)))


class Ground:
    """What all answers of a problem stand on: its matrix, factorised, and weights (all methods collective).

    Attributes:
        problem: With affine effects and contact at nodes.
        D: The weights of I at owned dofs.
        diagonal: Of the stiffness.
        free: Dofs where u is not given.
        touchable: Those that can touch an obstacle.
        held: Whether u is given anywhere: otherwise nothing is known of how far answers are from the solution.
        monotone: Whether the maximum principle holds: the stiffness between free dofs is an M-matrix, and its rows
            nowhere sum to less than 0.
    """

    def __init__(self, problem: Problem):
        """Factorise.

        Raises:
            InputError: If contact is not at nodes, or an effect is not affine.
        """
        if not problem.level.pair.nodal or not problem.affine:
            raise InputError(f"{problem.scene.source}: invariants are known for affine effects and contact at nodes")
        self.problem, self.comm = problem, problem.level.comm
        self.D, self.free, self.touchable = problem.weights, ~problem.fixed, problem.touchable
        state = problem.state()
        self.A = problem.jacobian(state, penalised=False).copy()
        state.destroy()
        self.diagonal = np.where(self.free, problem.nodal.diagonal, 0.0)
        self.held = total(self.comm, np.count_nonzero(problem.fixed)) > 0
        signs = problem.m_matrix and sums_nowhere_negative(self.A, problem.nodal.diagonal, self.comm)
        self.monotone = self.held and signs

    @cached_property
    def _factor(self) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self.comm)
        ksp.setOperators(self.A)
        ksp.setType("preonly")
        ksp.getPC().setType("cholesky")
        ksp.getPC().setFactorSolverType("mumps")
        return ksp

    def lift(self, forces: np.ndarray) -> np.ndarray:
        """A^-1 forces: where forces at free dofs move the membrane without obstacles."""
        x, b = self.A.createVecs()
        b.array[:] = np.where(self.free, forces, 0.0)
        self._factor.solve(b, x)
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
        problem, own = self.problem, self.problem.level.owned
        w, r = (f.x.array[:own].copy() for f in (problem.w, problem.reference))
        elastic = problem.elastic.array_r.copy()
        pressing = np.abs(self.D * p)
        forces = problem.load + total(self.comm, np.abs(elastic[problem.fixed])) + total(self.comm, pressing)
        noise = np.where(self.free, FEW * (self.diagonal * (np.abs(w) + np.abs(r)) + pressing), 0.0)
        below, above = problem.gaps()
        # where all data are zero solvers take for nothing what they cannot compare with any force
        nearest = smallest(self.comm, [np.abs(gap[gap != 0]).min(initial=np.inf) for gap in (below, above)])
        if np.isfinite(nearest):
            noise = noise + np.where(self.free, NOTHING * nearest * self.diagonal, 0.0)
        state = problem.state()
        energy = problem.energy(state, penalised=eps is not None) if problem.has_energy else None
        state.destroy()
        last = FEW * (np.abs(w) + np.abs(r)) * self.free
        left = np.where(self.free, np.abs(elastic - self.D * p), 0.0) + noise
        z = np.abs(self.lift(left)) if self.held else np.full(own, np.inf)
        heights = w + r
        span = largest(self.comm, heights) + largest(self.comm, -heights)
        # what SNES VI takes to be at its bound may be this far off
        slip = 0.0 if eps is not None else TOUCHING * span
        # heights themselves are rounded
        z = z + slip + last
        R = float(np.sqrt(total(self.comm, left * z)) + np.sqrt(total(self.comm, self.diagonal * last**2)))
        if self.held and not self.monotone:  # r' A^-1 r may exceed |r|' A^-1 |r| then
            signed = np.where(self.free, elastic - self.D * p, 0.0)
            R += float(np.sqrt(max(total(self.comm, signed * self.lift(signed)), 0.0)))
        return Solved(self, eps, w, r, np.array(p), elastic, below, above, energy, forces,
                      total(self.comm, noise), span, z, R)  # fmt: skip

    def close(self) -> None:
        """Free the factors."""
        if "_factor" in self.__dict__:
            self._factor.destroy()
        self.A.destroy()


def balanced_to(solved: Solved) -> float:
    """The sum of unbalanced forces that solvers may leave: their tolerance, or round-off."""
    return TOLERANCE * solved.forces + solved.floor

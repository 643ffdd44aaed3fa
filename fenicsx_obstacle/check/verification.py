"""Whether a solution is one of its discrete problem: (3.4) and (3.7), or (3.19) and (3.20), and an own solve.

The problem takes its data anew, so that a solution of other data is found out. Limits are the solver's tolerance and
the round-off of what is measured.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.stopping import TOLERANCE, small_correction
from fenicsx_obstacle.algebra.vi import AT_BOUND
from fenicsx_obstacle.check.finding import Finding, Verification
from fenicsx_obstacle.check.reference import Distance, distance
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.contact import contact_of
from fenicsx_obstacle.parallel import largest, smallest, total

EPSILON = float(np.finfo(float).eps)
ROUNDED = 8 * EPSILON  # of the sum of the absolute values of what is added
BY_MEANS = 1e-8  # of the range of u: as `AT_BOUND`, for contact that is not at nodes
SAME = 1e-9  # relative: areas and forces of one pressure


@dataclass(frozen=True, eq=False)
class State:
    """A state of a problem with its contact pressure; arrays have values at owned dofs, or owned points of I.

    Attributes:
        problem: The problem, with its data as they are now.
        eps: Penalty parameter; None for the inequality.
        u: Its components that the problem has.
        p: Contact pressure, > 0 against the lower obstacle.
        below: u - lower, inf without one.
        above: upper - u, inf without one.
        elastic: a(u, .) - f, the support reactions where u is given included.
        noise: Round-off of the unbalanced forces, >= 0; 0 where u is given.
        stiffness: A_ii.
        forces: Sum of the acting forces: load, support reactions, contact.
        size: Largest |u| and |given value| from which the gaps were computed; 0 where these have digits of their own.
        range: Largest minus smallest value of u, and at least the round-off of u.
    """

    problem: Problem
    eps: float | None
    u: np.ndarray = field(repr=False)
    p: np.ndarray = field(repr=False)
    below: np.ndarray = field(repr=False)
    above: np.ndarray = field(repr=False)
    elastic: np.ndarray = field(repr=False)
    noise: np.ndarray = field(repr=False)
    stiffness: np.ndarray = field(repr=False)
    forces: float
    size: float
    range: float

    @classmethod
    def of(
        cls, problem: Problem, u: np.ndarray, p: np.ndarray, eps: float | None, size: float, stiffness: np.ndarray,
        terms: np.ndarray,
    ) -> State:  # fmt: skip
        """The present state of a problem, of which its last residual was (collective).

        Args:
            problem: Its state is w.
            u: See the attributes, as all others.
            p: At owned points of I.
            eps: None for the inequality.
            size: See the attributes.
            stiffness: See the attributes.
            terms: How large the terms are that a(u, .) is a sum of, at owned dofs.
        """
        comm, elastic, pressing = problem.comm, problem.elastic.array_r.copy(), np.abs(problem.weights * p)
        below, above = problem.gaps()
        noise = np.where(problem.fixed, 0.0, ROUNDED * (terms + problem.from_points(pressing)))
        forces = problem.load + total(comm, np.abs(elastic[problem.fixed])) + total(comm, pressing)
        span = max(largest(comm, u) - smallest(comm, u), ROUNDED * size)
        return cls(problem, eps, u, np.array(p), below, above, elastic, noise, stiffness, forces, size, span)

    @property
    def unbalanced(self) -> np.ndarray:
        """a(u, .) - f - I(p, .); 0 where u is given (collective)."""
        push = self.problem.from_points(self.problem.weights * self.p)
        return np.where(self.problem.fixed, 0.0, self.elastic - push)

    @property
    def left(self) -> float:
        """The sum of unbalanced forces that solvers may leave: their tolerance, or round-off (collective)."""
        return TOLERANCE * self.forces + total(self.problem.comm, self.noise)


def _absolute(A: PETSc.Mat, values: np.ndarray) -> np.ndarray:
    """|A| times owned values (collective)."""
    starts, columns, entries = A.getValuesCSR()
    absolute = PETSc.Mat().createAIJ(A.getSizes(), csr=(starts, columns, np.abs(entries)), comm=A.comm)
    x, y = absolute.createVecs()
    x.array[:] = values
    absolute.mult(x, y)
    found = y.array.copy()
    for owner in (x, y, absolute):
        owner.destroy()
    return found


def verify(problem: Problem, solution: Any) -> Verification:
    """Check a solution (collective).

    Args:
        problem: Of the mesh of the solution. Its state is the solution afterwards.
        solution: With `u`, `pressure`, `contact`, `eps` and `record`, as `Solution` has them.

    Raises:
        InputError: If the solution is of another mesh or element, or of a step in time.
    """
    state = _taken(problem, solution)
    found = [*_values(state), *contact_law(state), balance(state), _moved(state), *_contact(state, solution)]
    known = distance(problem, state.eps, state.unbalanced, state.noise)
    if known is not None:
        found.append(_same(state, known))
    return Verification(tuple(found))


def _taken(problem: Problem, solution: Any) -> State:
    """A solution as the state of its problem, with the data anew (collective).

    Raises:
        InputError: If the solution is of another mesh or element, or of a step in time.
    """
    if not problem.at_rest:
        raise InputError(f"{problem.source}: verify: a step in time has no check; equilibria have")
    comm, u_values = problem.comm, solution.u.x.array[: problem.owned]
    if total(comm, len(solution.u.x.array) != len(problem.solution().x.array)) > 0:
        raise InputError(f"{problem.source}: verify: the solution is of another mesh or element")
    problem.renew(stiffness=True)
    problem.set_reference(u_values)
    if solution.eps is not None:
        problem.eps = solution.eps
    p = problem.points_of(solution.pressure) / problem.thickness
    size = max(largest(comm, np.abs(u_values)), largest(comm, np.abs(problem.given[problem.fixed])), 0.0)
    x, out = problem.vector(), problem.law.vector()
    problem.residual(x, out, penalised=False)
    A = problem.jacobian(x, penalised=False)
    diagonal = A.getDiagonal()
    stiffness, terms = diagonal.array_r.copy(), _absolute(A, np.abs(problem.w) + np.abs(problem.state.r))
    for vector in (x, out, diagonal):
        vector.destroy()
    return State.of(problem, problem.in_components(u_values), p, solution.eps, size, stiffness, terms)


def _values(s: State) -> list[Finding]:
    """u and p are numbers, and u has the given values."""
    problem, comm = s.problem, s.problem.comm
    bad = sum(total(comm, np.count_nonzero(~np.isfinite(values))) for values in (s.u, s.p))
    off = largest(comm, np.abs(problem.u - s.u)[problem.fixed])
    return [
        Finding("values that are no numbers", "u, p", bad, 0.0),
        Finding("u has the given values", "u in V", max(off, 0.0), ROUNDED * s.size),
    ]


def contact_law(s: State) -> list[Finding]:
    """(3.7), (3.8): p = -(u - g)^+/eps; of the inequality u <= g. (3.20): no pressure without contact."""
    problem, comm = s.problem, s.problem.comm
    if not problem.constrained:
        return []
    at = AT_BOUND if problem.nodal else BY_MEANS
    beyond = np.maximum(-s.below, 0.0) - np.maximum(-s.above, 0.0)
    if s.eps is None:
        most = max(largest(comm, np.abs(beyond)[problem.touchable]), 0.0)
        law = Finding("u between the obstacles", "(3.19)", most, at * s.range + ROUNDED * s.size)
    else:
        off = largest(comm, np.abs(beyond - s.eps * s.p)[problem.touchable])
        limit = ROUNDED * s.size + 4 * EPSILON * largest(comm, np.abs(beyond))
        law = Finding("p = -(u - g)^+/eps", "(3.7)-(3.8)", max(off, 0.0), limit)
    short = [np.where(np.isfinite(gap), np.maximum(gap, 0.0), s.range) for gap in (s.below, s.above)]
    D, work = problem.weights, np.maximum(s.p, 0.0) * short[0] + np.maximum(-s.p, 0.0) * short[1]
    inactive = np.where(problem.touchable, 0.0, np.abs(s.p) * s.range)  # where nothing can touch, nothing presses
    return [law, Finding("no pressure without contact", "(3.20)", total(comm, np.abs(D) * work + inactive),
                         (at * s.range + ROUNDED * s.size) * s.forces)]  # fmt: skip


def balance(s: State) -> Finding:
    """(3.4), or (3.10) of the inequality: a(u, v) - f(v) = I(p, v) for all v of V_h."""
    return Finding("forces at nodes balance", "(3.4)", total(s.problem.comm, np.abs(s.unbalanced)), s.left)


def _moved(s: State) -> Finding:
    """The same beside the stiffness of each node: forces of a stiff part may outweigh all others."""
    comm, problem, stiffness = s.problem.comm, s.problem, s.stiffness
    if s.eps is not None:
        stiffness = stiffness + problem.from_points(np.where(s.p != 0, problem.weights, 0.0)) / s.eps
    moved, rounded = (np.divide(part, stiffness, out=np.zeros(len(part)), where=stiffness > 0)
                      for part in (np.abs(s.unbalanced), s.noise))  # fmt: skip
    limit = small_correction(problem) + total(comm, rounded) + ROUNDED * total(comm, np.abs(s.u))
    return Finding("forces that are left move u", "(3.4)", total(comm, moved), limit, problem.affine and problem.nodal)


def _contact(s: State, solution: Any) -> list[Finding]:
    """The contact set, its area and the forces are those of this u and p."""
    problem, comm, record = s.problem, s.problem.comm, solution.record["contact"]
    contact = contact_of(problem, s.p)
    flags = problem.in_q((contact.lower | contact.upper).astype(float))
    different = total(comm, np.count_nonzero(flags.x.array != solution.contact.x.array))
    forces = {"lower": contact.lower_force, "upper": contact.upper_force}
    off = max((abs(forces[side] - record[side]["force"]) for side in forces if side in record), default=0.0)
    return [
        Finding("nodes in contact that are not, or the reverse", "contact", different, 0.0),
        Finding("area of contact", "area", abs(contact.area - record["area"]), SAME * abs(contact.area)),
        Finding("contact forces", "I(p, 1)", off, SAME * s.forces),
    ]


def _same(s: State, known: Distance) -> Finding:
    """(3.4) and (3.19) have one solution: r' A^-1 r bounds the square of the distance in the energy norm."""
    slip = ROUNDED * s.size * known.stiffness
    return Finding("u of active sets and a direct solver", "unique", known.apart, known.reach + slip)

"""Whether a solution is one of its discrete problem: (3.4) and (3.7), or (3.19) and (3.20), and solves of its own.

The problem takes its data anew, so that a solution of other data is found out. Limits are the solver's tolerance and
the round-off of what is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Any

import numpy as np

from fenicsx_obstacle.algebra.data_scales import EPSILON, ROUNDOFF_MARGIN
from fenicsx_obstacle.algebra.products import absolute_product
from fenicsx_obstacle.algebra.stopping import may_be_left, round_off, small_correction
from fenicsx_obstacle.check.finding import Finding, violated
from fenicsx_obstacle.check.other_units import other_units, reversed_rows, solved
from fenicsx_obstacle.check.reference import FreeRows, distance, free_rows, is_small, positive_factors
from fenicsx_obstacle.discrete.contact_set import Contact, contact_of
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, on_root, smallest, total
from fenicsx_obstacle.text import columns

ROUNDED = ROUNDOFF_MARGIN * EPSILON  # of the sum of the absolute values of what is added
BY_MEANS = 1e-8  # of the range of u: gaps at a bound, for contact that is not at nodes
TINY = 1e-300
SAME = 1e-9  # relative: areas and forces of one pressure


class Verdict(Enum):
    """Of all findings together."""

    RIGHT = "right"
    WRONG = "wrong"


class Reason(StrEnum):
    """The invariant that a wrong solution violates; its value is the name of the row."""

    NUMBERS = "values that are no numbers"
    GIVEN_VALUES = "u has the given values"
    OBSTACLES = "u between the obstacles"
    PENALTY = "p = -(u - g)^+/eps"
    COMPLEMENTARITY = "no pressure without contact"
    BALANCE = "forces at nodes balance"
    CORRECTION = "forces that are left move u"
    CONTACT = "nodes in contact that are not, or the reverse"
    AREA = "area of contact"
    FORCE = "contact forces"
    PUBLISHED = "fields and figures, over what they may differ by"
    ENERGY_NORM = "u of active sets and a direct solver"
    LARGEST_DIFFERENCE = "the same, largest difference"
    UNITS_COUNTS = "steps and contact in other units"
    UNITS_VALUES = "u in other units"
    RANKS = "u on one rank, rows reversed"


@dataclass(frozen=True)
class Verification:
    """All findings about one solution.

    Attributes:
        findings: In the order in which they were checked.
    """

    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> Verdict:
        """Whether all that should hold holds."""
        return Verdict.WRONG if violated(self.findings) else Verdict.RIGHT

    @property
    def reason(self) -> Reason | None:
        """The first invariant that is violated; None of a right solution."""
        wrong = violated(self.findings)
        return Reason(wrong[0].name) if wrong else None

    def __bool__(self) -> bool:
        return self.verdict is Verdict.RIGHT

    def __str__(self) -> str:
        heads = ("check", "of", "observed", "at most", "")
        rows = [(finding.name, finding.statement, f"{finding.observed:.3g}", f"{finding.limit:.3g}",
                 ("held" if finding.held else "VIOLATED") if finding.claimed else "not claimed")
                for finding in self.findings]  # fmt: skip
        return "\n".join([*columns([heads, *rows]), f"verdict: {self.verdict.value}"])


# the fields of a contact of bodies, and what the record says of it
Published = Callable[[Contact], tuple[Any, Mapping[str, Any]]]


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
        """The sum of unbalanced forces that solvers may leave, and the round-off of computing it anew (collective)."""
        floor = ROUNDOFF_MARGIN * round_off(self.problem, np.where(self.problem.fixed, 0.0, self.stiffness))
        return may_be_left(self.forces, floor) + total(self.problem.comm, self.noise)

    def largest(self, values: Any) -> float:
        """Largest absolute value over all ranks (collective)."""
        return max(largest(self.problem.comm, np.abs(values)), 0.0)

    def spread(self, u: Any) -> float:
        """Largest minus smallest value of a Function (collective)."""
        comm, values = self.problem.comm, u.x.array
        return largest(comm, values) - smallest(comm, values)


def verify(problem: Problem, solution: Any, of_body: Published | None = None) -> Verification:
    """Check a solution (collective).

    Args:
        problem: Of the mesh of the solution. Its state is the solution afterwards.
        solution: With `fields`, `eps` and `record`, as `Solution` has them.
        of_body: Of bodies: the fields and the record of a contact, for the state of the problem.

    Raises:
        InputError: If the solution is of another mesh or element, or of a step in time.
    """
    _check_kind(problem, solution)
    numbers = _numbers(problem, solution)
    if not numbers.held:  # nothing can be computed from such values
        return Verification((numbers,))
    state = _taken(problem, solution)
    of_contact, contact = _contact(state, solution)
    found = [numbers, _given_values(state), *contact_law(state), balance(state), _moved(state), *of_contact]
    found.append(_published(state, solution, of_body, contact))
    if is_small(problem) and not violated(found):  # what is wrong already needs no more solves
        rows = free_rows(problem, state.eps, state.elastic, state.unbalanced, state.noise)
        moved = small_correction(problem)
        found += on_root(problem.comm, lambda: solved_again(rows, state.size, moved))
    return Verification(tuple(found))


def _check_kind(problem: Problem, solution: Any) -> None:
    """Check that a solution is one of the mesh, the element and the kind of a problem (collective).

    Raises:
        InputError: Otherwise.
    """
    if not problem.at_rest:
        raise InputError(f"{problem.source}: verify: a step in time has no check; equilibria have")
    ours = problem.solution(), problem.in_q(np.zeros(len(problem.weights)))
    theirs = solution.u, solution.pressure
    other = [len(one.x.array) != len(known.x.array) for one, known in zip(theirs, ours, strict=True)]
    if total(problem.comm, other) > 0:
        raise InputError(f"{problem.source}: verify: the solution is of another mesh or element")


def _numbers(problem: Problem, solution: Any) -> Finding:
    """u, p and the figures of the record are numbers."""
    record = solution.record
    sides = [record["contact"][side]["force"] for side in ("lower", "upper") if side in record["contact"]]
    figures = [record[key] for key in ("eps", "energy", "penetration", "u_range")] + [record["contact"]["area"], *sides]
    values = solution.u.x.array, solution.pressure.x.array, np.array([one for one in figures if one is not None], float)
    bad = sum(total(problem.comm, np.count_nonzero(~np.isfinite(some))) for some in values)
    return Finding(Reason.NUMBERS, "u, p, record", bad, 0.0)


def _taken(problem: Problem, solution: Any) -> State:
    """A solution as the state of its problem, with the data anew (collective)."""
    comm, u_values = problem.comm, solution.u.x.array[: problem.owned]
    problem.renew(stiffness=True)
    problem.set_reference(u_values)
    problem.judge_load()
    if solution.eps is not None:
        problem.eps = solution.eps
    p = problem.points_of(solution.pressure) / problem.thickness
    size = max(largest(comm, np.abs(u_values)), largest(comm, np.abs(problem.given[problem.fixed])), 0.0)
    x, out = problem.vector(), problem.law.vector()
    problem.residual(x, out, penalised=False)
    A = problem.jacobian(x, penalised=False)
    diagonal = A.getDiagonal()
    stiffness, terms = diagonal.array_r.copy(), absolute_product(A, np.abs(problem.w) + np.abs(problem.state.r))
    for vector in (x, out, diagonal):
        vector.destroy()
    return State.of(problem, problem.in_components(u_values), p, solution.eps, size, stiffness, terms)


def _given_values(s: State) -> Finding:
    """u has the given values."""
    off = largest(s.problem.comm, np.abs(s.problem.u - s.u)[s.problem.fixed])
    return Finding(Reason.GIVEN_VALUES, "u in V", max(off, 0.0), ROUNDED * s.size)


def contact_law(s: State) -> list[Finding]:
    """(3.7), (3.8): p = -(u - g)^+/eps; of the inequality u <= g. (3.20): no pressure without contact."""
    problem, comm = s.problem, s.problem.comm
    if not problem.constrained:
        return []
    at = 0.0 if problem.nodal else BY_MEANS
    beyond = np.maximum(-s.below, 0.0) - np.maximum(-s.above, 0.0)
    if s.eps is None:
        most = max(largest(comm, np.abs(beyond)[problem.touchable]), 0.0)
        law = Finding(Reason.OBSTACLES, "(3.19)", most, at * s.range + ROUNDED * s.size)
    else:
        off = largest(comm, np.abs(beyond - s.eps * s.p)[problem.touchable]) if 0 < s.eps < np.inf else np.inf
        limit = ROUNDED * s.size + 4 * EPSILON * largest(comm, np.abs(beyond))
        law = Finding(Reason.PENALTY, "(3.7)-(3.8)", max(off, 0.0), limit)
    short = [np.where(np.isfinite(gap), np.maximum(gap, 0.0), s.range) for gap in (s.below, s.above)]
    D, work = problem.weights, np.maximum(s.p, 0.0) * short[0] + np.maximum(-s.p, 0.0) * short[1]
    inactive = np.where(problem.touchable | (s.p == 0), 0.0, np.inf)  # where nothing can touch, nothing presses
    return [law, Finding(Reason.COMPLEMENTARITY, "(3.20)", total(comm, np.abs(D) * work + inactive),
                         (at * s.range + ROUNDED * s.size) * s.forces)]  # fmt: skip


def balance(s: State) -> Finding:
    """(3.4), or (3.10) of the inequality: a(u, v) - f(v) = I(p, v) for all v of V_h."""
    return Finding(Reason.BALANCE, "(3.4)", total(s.problem.comm, np.abs(s.unbalanced)), s.left)


def _moved(s: State) -> Finding:
    """The same beside the stiffness of each node: forces of a stiff part may outweigh all others."""
    comm, problem, stiffness = s.problem.comm, s.problem, s.stiffness
    if s.eps is not None:
        stiffness = stiffness + problem.from_points(np.where(s.p != 0, problem.weights, 0.0)) / s.eps
    moved, rounded = (np.divide(part, stiffness, out=np.zeros(len(part)), where=stiffness > 0)
                      for part in (np.abs(s.unbalanced), s.noise))  # fmt: skip
    limit = small_correction(problem) + total(comm, rounded) + ROUNDED * total(comm, np.abs(s.u))
    return Finding(Reason.CORRECTION, "(3.4)", total(comm, moved), limit, problem.affine and problem.nodal)


def _contact(s: State, solution: Any) -> tuple[list[Finding], Contact]:
    """The contact set, its area and the forces are those of this u and p."""
    problem, comm, record = s.problem, s.problem.comm, solution.record["contact"]
    contact = contact_of(problem, s.p)
    flags = problem.in_q((contact.lower | contact.upper).astype(float))
    different = total(comm, np.count_nonzero(flags.x.array != solution.contact.x.array))
    forces = {"lower": contact.lower_force, "upper": contact.upper_force}
    sides = {"lower": problem.below, "upper": problem.above}
    off = [abs(forces[side] - record[side]["force"]) if side in record else np.inf
           for side, gap in sides.items() if gap is not None or side in record]  # fmt: skip
    return [
        Finding(Reason.CONTACT, "contact", different, 0.0),
        Finding(Reason.AREA, "area", abs(contact.area - record["area"]), SAME * abs(contact.area)),
        Finding(Reason.FORCE, "I(p, 1)", float(np.max(off, initial=0.0)), SAME * s.forces),
    ], contact


def _published(s: State, solution: Any, of_body: Published | None, contact: Contact) -> Finding:
    """The fields and figures are those of this u and p, in ghost nodes too; each beside the error it may have."""
    problem, fields, record, most = s.problem, solution.fields, solution.record, s.largest(s.p)
    x, rounded = problem.vector(), ROUNDED * s.size
    energy = problem.energy(x, penalised=s.eps is not None, moving=False) if problem.has_energy else None
    x.destroy()
    work = s.size * (total(problem.comm, s.noise) + ROUNDED * s.forces)
    pairs: list[tuple[Any, Any, float]] = [
        (fields.u.x.array, problem.solution().x.array, rounded),
        (fields.pressure.x.array, problem.pressures(s.p * problem.thickness).x.array, SAME * most * problem.thickness),
        (record["penetration"], contact.penetration, rounded + SAME * contact.penetration),
        (record["u_range"], s.spread(fields.u), rounded),
        (record["energy"] or 0.0, energy or 0.0, SAME * abs(energy or 0.0) + work),
    ]
    for here, there in ((fields.lower, problem.data.lower), (fields.upper, problem.data.upper)):
        if here is not None and there is not None:
            pairs.append((here.x.array, there.x.array, rounded + SAME * s.range))
    if of_body is not None:
        known, more = of_body(contact)
        extent = s.largest(known.nodes.points)
        for name, values in vars(known.nodes).items():
            scale = {"points": extent, "normals": 1.0, "pressure": most, "gap": s.size}
            pairs.append((getattr(fields.nodes, name), values, SAME * scale.get(name, s.largest(values))))
        pairs.append((fields.gap.x.array, known.gap.x.array, SAME * s.size))
        if known.von_mises is not None:
            pairs.append((fields.von_mises.x.array, known.von_mises.x.array, SAME * s.largest(known.von_mises.x.array)))
        pairs.append((record["contact"]["resultant"], more["resultant"], SAME * s.forces))
        pairs.append((record["contact"]["moment"], more["moment"], SAME * s.forces * extent))
    most_off = max(_share(np.asarray(a, float), np.asarray(b, float), limit) for a, b, limit in pairs)
    return Finding(Reason.PUBLISHED, "of u and p", s.largest(most_off), 1.0)


def _share(values: np.ndarray, known: np.ndarray, limit: float) -> float:
    """The largest difference over its limit; infinite where there is none to compare with."""
    if values.shape != known.shape:
        return np.inf
    same = (values == known) | (np.isnan(values) & np.isnan(known))
    off = np.abs(values[~same] - known[~same])
    return float(np.max(np.where(off <= limit, off / max(limit, TINY), np.inf), initial=0.0))


def solved_again(p: FreeRows | None, size: float, moved: float) -> list[Finding]:
    """The small problem has this one solution, by another method, in other units and on one rank (on rank 0)."""
    factors = None if p is None else positive_factors(p.A)
    if p is None or factors is None:
        return []
    found, known, one = [], distance(p, factors), solved(p)
    if known is not None:
        slip = ROUNDED * size * known.stiffness
        found += [
            Finding(Reason.ENERGY_NORM, "unique", known.apart, known.reach + slip),
            Finding(Reason.LARGEST_DIFFERENCE, "unique", known.largest, moved + known.moved + ROUNDED * size),
        ]
    if one is None:
        return found
    counts, apart = other_units(p, one)
    found += [Finding(Reason.UNITS_COUNTS, "2^33 N, 2^-21 m", counts, 0.0),
              Finding(Reason.UNITS_VALUES, "2^33 N, 2^-21 m", apart, ROUNDED)]  # fmt: skip
    if (other := reversed_rows(p, factors)) is not None:
        slip = ROUNDED * size * np.sqrt(p.A.diagonal().sum())
        found.append(Finding(Reason.RANKS, "unique", other[0], other[1] + slip))
    return found

"""The penalty parameter: eps = "auto", its smallest value, and the check of eps at the solution.

eps = "auto" is chosen before the solve, from the tension of a scene or the diagonal of A at the initial guess. Whether
it is small enough depends on the solution: the penetration eps p on the pressure, the stiffness on u if the problem is
nonlinear, and on the place of contact if there are several materials. So each penalty solve ends here with a check of
its solution, for scenes, forms, bodies and steps in time alike. With rate or inertia all steps are
then taken again with the smaller eps (`answers.time_stepper`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from fenicsx_obstacle.algebra.data_scales import negligible_force
from fenicsx_obstacle.algebra.newton import diagonal_of, joined, smallest_eps, solve_penalty
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.plausibility import solved
from fenicsx_obstacle.algebra.separate_parts import SeparateParts
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.stopping import ON_THE_WAY, TOLERANCE
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.errors import InputError, NotConverged, PenetrationWarning
from fenicsx_obstacle.parallel import largest, smallest, total, warn

PENETRATION = 0.01  # of the range of u between the obstacles: the largest penetration that eps = "auto" accepts
AIM = 0.1  # of that: the penetration that a new eps is chosen for
TOO_SOFT = 10.0  # times eps_share: eps A_ii/D_i at a contact node from which on eps does not fit the stiffness there
LOWERED = 1e-3  # from one eps to the next for a nonlinear problem, at least: its stiffness changes with u
MOST_SOLVES = 12
FLAT = 1e-8  # of the penetration: a smaller range of u may be round-off, and then is no scale for it
DIGITS = 1e-12  # of given values and obstacles: larger differences of them are no round-off


class NoPositiveDiagonal(InputError):
    """A has no positive diagonal entry at a contact node, from which eps = "auto" could be chosen."""

    def __init__(self, source: str) -> None:
        super().__init__(f"{source} A has no positive diagonal entry at a contact node: give eps as a number")


def penalty_parameter(problem: System, options: SolverOptions) -> float:
    """eps as a number, in units of u/p (collective).

    A number is absolute. A formula in h is divided by the largest tension: (1/eps) D and the stiffness then stay in
    proportion whatever the units. "auto" is `AUTO` where the tension is among the data, otherwise a share of the median
    of D_i/A_ii over the free nodes. Where tensions differ so much that it would be below the floor of round-off
    somewhere, it is the floor.

    Raises:
        InputError: If it is not positive and finite, or below the floor.
    """
    formula, automatic = options.formula, options.eps == "auto"
    tension = problem.tension()
    if automatic and tension is None:
        return _share_of_compliance(problem, options.source)
    eps, place = formula.value(problem.h), f"{options.source} eps = {formula.text}"
    if not 0 < eps < np.inf:
        raise InputError(f"{place}: must be positive, it is {eps:g}")
    if formula.scaled:
        assert tension is not None
        eps /= tension
    floor = smallest_eps(problem)
    if automatic:
        return max(eps, floor)
    if eps < floor:
        raise InputError(
            f"{place}: below the limit of round-off, {floor:.2g}, at which contact "
            "changes u by less than its last digit; take a larger eps, or the method vi"
        )
    return eps


def _share_of_compliance(problem: System, source: str) -> float:
    """A share of the median of D_i/A_ii over the free nodes, A being the stiffness at the present state (collective).

    Raises:
        NoPositiveDiagonal: If no A_ii is positive there.
    """
    diagonal = diagonal_of(problem)
    good = (diagonal > 0) & (problem.weights > 0) & ~problem.fixed
    everywhere = np.concatenate(problem.comm.allgather(problem.weights[good] / diagonal[good]))
    if not len(everywhere):
        raise NoPositiveDiagonal(source)
    return problem.eps_share * float(np.median(everywhere))


@dataclass
class PenaltySolve:
    """`solve_penalty`, with a check of eps at the solution.

    Attributes:
        eps: With which each solve begins, in units of u/p. A solve does not change it.
        automatic: Whether eps may be lowered. If not, a large penetration causes a warning.
        successive: As for `solve_penalty`.
        source: What messages call the problem.
    """

    eps: float
    automatic: bool
    successive: bool
    source: str

    def __call__(self, problem: System, *, tolerance: float = TOLERANCE, **how: Any) -> Outcome:
        """Solve from the present state (collective).

        Args:
            problem: Holds the start, then the solution.
            tolerance: As for `solve_penalty`; with a large one the solution is a start for a finer level, and eps is
                not checked.
            **how: As for `solve_penalty`.

        Returns:
            The outcome, with the eps that fits its solution.

        Raises:
            NotConverged: With PETSc's reason, or if no eps is found that fits its solution.
        """
        eps = self.eps
        outcome = self._once(problem, eps, tolerance, how)
        if tolerance >= ON_THE_WAY or not self.automatic:
            if tolerance < ON_THE_WAY and (found := large_penetration(problem)):
                warn(problem.comm, f"{self.source} {found}", PenetrationWarning)
            return outcome
        how = {**how, "patience": None, "least": 0}
        for solves in count(1):
            fitting = fitting_eps(problem, eps)
            if fitting >= eps:
                return outcome
            if solves > MOST_SOLVES:
                break
            if not problem.affine:
                fitting = max(fitting, LOWERED * eps)
            if (fitting := max(fitting, smallest_eps(problem))) >= eps:
                break
            _lift(problem, fitting / eps)
            eps = fitting
            outcome = joined(outcome, self._once(problem, eps, tolerance, how))
        raise NotConverged(
            outcome.solver,
            f"eps = 'auto' found no eps that fits the solution, down to {eps:.2g}; "
            "take the method vi, or give eps as a number",
            outcome.iterations, eps=None, h=problem.h,
        )  # fmt: skip

    def _once(self, problem: System, eps: float, tolerance: float, how: dict[str, Any]) -> Outcome:
        try:
            found = solve_penalty(problem, eps * problem.share, successive=self.successive, tolerance=tolerance, **how)
        except NotConverged as error:
            if problem.affine or not self.automatic or error.eps is None:
                raise
            # the first eps is that of the stiffness at the start, and may be far too large: a larger one is no remedy
            remedy = f"eps = 'auto' was {eps:.3g}: start from another u, or take the method vi"
            raise error.changed(eps=None, reason=f"{error.reason}; {remedy}") from None
        return replace(found, eps=eps)


def penetration_and_range(problem: System) -> tuple[float, float]:
    """The largest penetration of the present state, and the range of its u where it is between the obstacles; those of
    the field whose penetration is the largest share of its range (collective)."""
    comm, excess = problem.comm, _excess(problem)
    u, found = np.clip(problem.u, *problem.obstacles()), list[tuple[float, float]]()
    for dofs in problem.bounded_fields():
        height = max(largest(comm, u[dofs]) - smallest(comm, u[dofs]), 0.0)
        found.append((max(largest(comm, excess[dofs]), 0.0), height))
    return max(found, key=lambda one: one[0] / one[1] if one[1] > 0 else 0.0)


def large_penetration(problem: System) -> str | None:
    """A remark, if the penetration is not small compared with the range of u, in some part (collective)."""
    penetration, height = penetration_and_range(problem)
    where = "the range of u between the obstacles"
    if penetration > PENETRATION * height:
        share = "more than" if penetration > height else f"{penetration / height:.1%} of"
    elif problem.affine and (in_parts := share_in_parts(problem)) > PENETRATION:  # A of others is to be assembled
        share, where = f"{in_parts:.1%} of", "the range of u in a part of the domain that given values separate"
    else:
        return None
    return f"penetration is {share} {where}: for accurate values take a smaller eps, or the method vi"


def share_in_parts(problem: System) -> float:
    """The largest share of the range of u that is the penetration, in parts that given values separate (collective).

    0 unless the penalty is softer than A_ii at some contact node, as it may be on a mesh that is graded: elsewhere a
    penetration is below the error of the mesh in the cells around it.
    """
    if not problem.nodal or problem.fields is not None:
        return 0.0
    if smallest(problem.comm, _compliance_in_contact(problem)) >= problem.eps:
        return 0.0
    u = np.clip(problem.u, *problem.obstacles())
    parts = SeparateParts(problem, u)
    heights, penetrations = parts.ranges, parts.largest(_excess(problem))
    scaled = FLAT * penetrations < heights
    return float(np.max(penetrations[scaled] / heights[scaled], initial=0.0))


def fitting_eps(problem: System, eps: float) -> float:
    """The given eps if it fits the present solution, otherwise a smaller one that does (collective).

    It fits if

    - the penetration is at most `PENETRATION` times the range of u between the obstacles, also in each part of the
      domain that given values separate, and
    - no node moves farther than this, to first order, with the contact nodes that go back to the obstacle, and
    - at each contact node the penalty D_i/eps is much stiffer than A_ii, the stiffness of the solution. Then the
      penetration is small in each part of the domain, also in one that is much stiffer than the others. If the tension
      is among the data, eps is that of the largest tension, and fits.

    Args:
        problem: Solved with this eps.
        eps: In units of u/p.
    """
    comm, fitting = problem.comm, eps
    penetration, height = penetration_and_range(problem)
    if penetration == 0.0:
        return eps
    scaled = FLAT * penetration < height or (height > 0 and _differ(problem))
    if scaled and penetration > PENETRATION * height:
        fitting = AIM * PENETRATION * height / penetration * eps
    elif (share := share_in_parts(problem)) > PENETRATION:
        fitting = AIM * PENETRATION / share * eps
    elif scaled and (moved := _moved_by_penetration(problem, PENETRATION * height)) > 0:
        fitting = AIM * PENETRATION * height / moved * eps
    if problem.tension() is None:  # otherwise eps is that of the largest tension
        least = problem.eps_share * smallest(comm, _compliance_in_contact(problem) * _of_median_size(problem))
        if eps > TOO_SOFT * least:
            fitting = min(fitting, least)
    return eps if fitting < eps and _presses_by_round_off(problem, eps) else fitting


def _differ(problem: System) -> bool:
    """Whether given values and obstacles in contact are not all the same; not looked for in several fields, or where
    the points of I are not nodes (collective)."""
    if not problem.nodal or problem.fields is not None:
        return False
    known = np.clip(problem.u, *problem.obstacles())[problem.fixed | (_excess(problem) > 0)]
    most, least = largest(problem.comm, known), smallest(problem.comm, known)
    return most - least > DIGITS * max(abs(most), abs(least))


def _moved_by_penetration(problem: System, allowed: float) -> float:
    """How far u moves with the contact nodes that go back to the obstacle, to first order; 0 if not farther than is
    allowed (collective).

    No node moves farther than these where a(., .) is bilinear. If the stiffness is a function of u, as in porous media,
    soft parts do: by the ratio of the stiffnesses.
    """
    if problem.affine or not problem.nodal or problem.fields is not None:
        return 0.0
    comm, stiffness = problem.comm, diagonal_of(problem)
    held = _excess(problem) > 0
    pulls = largest(comm, np.where(held, stiffness * _excess(problem), 0.0))
    if pulls <= allowed * smallest(comm, stiffness[~held & ~problem.fixed]):
        return 0.0
    x, b = problem.A.createVecs()
    state = problem.vector()
    problem.jacobian(state)
    b.array[:] = np.where(held, problem.weights * _excess(problem) / problem.eps, 0.0)
    moved = largest(comm, np.abs(x.array_r)) if solved(problem.dofs, problem.A, b, x) else 0.0
    for vector in (x, b, state):
        vector.destroy()
    return moved if moved > allowed else 0.0


def _presses_by_round_off(problem: System, eps: float) -> bool:
    """Whether the contact forces are the round-off of a state that only touches the obstacle (collective)."""
    force = total(problem.comm, problem.weights * _excess(problem)) / eps
    return force <= negligible_force(problem, diagonal_of(problem) * ~problem.fixed)


def _excess(problem: System) -> np.ndarray:
    """The penetration at owned points of I."""
    beyond = np.maximum(-np.minimum(*problem.gaps()), 0.0)
    return np.where(problem.touchable, beyond, 0.0)


def _compliance_in_contact(problem: System) -> np.ndarray:
    """D_i/A_ii at owned contact nodes, A being the stiffness of the solution; elsewhere infinite (collective)."""
    none = np.full(len(problem.weights), np.inf)
    if not problem.nodal:
        return none
    diagonal, weights = diagonal_of(problem), problem.weights
    return np.divide(weights, diagonal, out=none, where=(_excess(problem) > 0) & (diagonal > 0))


def _of_median_size(problem: System) -> np.ndarray:
    """The factor by which D_i/A_ii changes if the cells at a node are of median size (collective).

    D_i/A_ii is proportional to a power of the size: 2 if contact is in the domain, 1 if it is on the boundary. On a
    graded mesh it is small in the small cells, but the penetration is not to be smaller there than elsewhere.
    """
    weights, power = problem.weights, problem.compliance_power
    good = problem.touchable & (weights > 0)
    everywhere = np.concatenate(problem.comm.allgather(weights[good]))
    if power == 0 or not len(everywhere):
        return np.ones(len(weights))
    relative = np.where(good, weights / float(np.median(everywhere)), 1.0)
    return np.asarray(relative**-power)


def _lift(problem: System, ratio: float) -> None:
    """Move u back towards the obstacle where it is beyond it, so that the contact forces stay as they are with an eps
    that is smaller by this ratio (collective)."""
    if not problem.nodal:
        return
    lower, upper = (np.maximum(-gap, 0.0) for gap in problem.gaps())
    w = problem.w
    w += np.where(problem.touchable, (1.0 - ratio) * (lower - upper), 0.0)
    problem.state.share()

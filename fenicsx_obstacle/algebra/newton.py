"""Semismooth Newton for the penalised problem (3.4), and the paper's successive iteration (3.4)*: one loop.

The generalised derivative of t^+ is 1 where t > 0 and 0 elsewhere, at t = 0 too: with it a Newton step solves the
linear problem of (3.4)* on the present active set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from fenicsx_obstacle.algebra import releases
from fenicsx_obstacle.algebra.fields import stopping_of
from fenicsx_obstacle.algebra.linear_solvers import user_has_set
from fenicsx_obstacle.algebra.snes import Outcome, is_limited, refuse, require, run
from fenicsx_obstacle.algebra.stopping import CYCLING, TOLERANCE, TOO_MANY, StepMonitor
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.truncated_multigrid import Multigrid
from fenicsx_obstacle.parallel import largest

NEWTON = {
    "snes_type": "newtonls",
    "snes_max_it": 500,
    "snes_max_funcs": 100000,
    releases.LONGEST_STEP: 1e100,  # PETSc's default 1e8 is absolute, and cuts steps if u is large
    # `Stopping` decides alone; PETSc's tests return wrong answers as converged for small eps
    "snes_rtol": 0.0,
    "snes_stol": 0.0,
    "snes_divergence_tolerance": 1e100,
}
ONE_STEP = "it takes one linear step, without a look at what is left; leave the option out"
REFUSED = {"snes_type": (lambda kind: kind in ("ksponly", "ksptransposeonly"), ONE_STEP)}
CONTINUATION_FACTOR = 1e-2  # from one eps to the next
CONTINUATION_TOLERANCE = 1e-6  # unbalanced force there
PATIENCE = 20  # steps to try without
TINY = 1e-300
MAX_REFERENCE_UPDATES = 4  # times, at most
STIFFEST = 1e15  # penalty diagonal over stiffness, a tenth of the ratio at which the stiffness is below round-off


def solve_penalty(
    problem: System,
    eps: float,
    *,
    successive: bool = False,
    multigrid: Multigrid | None = None,
    least: int = 0,
    tolerance: float = TOLERANCE,
    patience: int | None = None,
    monitor: StepMonitor | None = None,
) -> Outcome:
    """Solve (3.4) from the problem's present state (collective).

    Full steps first: where a(.,.) is an M-matrix active sets only decrease after the first step, and the iteration is
    finite. Should they repeat, a line search on the convex energy breaks the cycle, or on the norm of the residual if
    there is no energy. A residual that is not linear and has an energy begins with the line search; where all that
    fails, because of a nonlinear operator and a small eps together, continuation in eps starts from the same state.

    Args:
        problem: Holds the start, then the solution.
        eps: Penalty parameter, in units of u/p.
        successive: The paper's (3.4)*: start without contact, stop when the active set stays as it was.
        multigrid: Preconditioner; by default algebraic multigrid.
        least: Steps to take at least.
        tolerance: Unbalanced force over acting forces to stop at.
        patience: Steps to take at most in one attempt.
        monitor: Called after each step.

    Returns:
        The converged outcome, iterations of all attempts together.

    Raises:
        InputError: If the user's PETSc options have a value in `REFUSED`.
        NotConverged: With PETSc's reason.
    """
    refuse(problem, "penalty", REFUSED)
    problem.eps = eps
    if successive:
        problem.set_reference(problem.cold_start())
    how: dict[str, Any] = {"unchanged": successive, "least": least, "tolerance": tolerance, "monitor": monitor}
    if patience is not None:
        how["patience"] = patience
    if problem.affine or not problem.constrained or is_limited(problem, "penalty"):
        outcome = _settled(problem, how, multigrid)
        if outcome.reason == CYCLING and not (successive or is_limited(problem, "penalty")):
            # a node that comes into contact from a distance d has a round-off of d times machine epsilon, and with a
            # tiny eps its penetration is less; from a larger eps it comes from a penetration
            outcome = joined(outcome, _by_continuation(problem, eps, how))
        return require(outcome, problem, eps, tolerance)
    start = problem.u
    outcome = _settled(problem, {**how, "patience": PATIENCE}, multigrid)
    if not outcome.converged:
        problem.set_unknown(start)
        outcome = joined(outcome, _by_continuation(problem, eps, how))
    return require(outcome, problem, eps, tolerance)


def soft_eps(problem: System) -> float:
    """The eps for which the penalty diagonal equals the stiffness (collective)."""
    comm, diagonal = problem.comm, diagonal_of(problem)
    return largest(comm, problem.weights) / max(largest(comm, diagonal[~problem.fixed]), TINY)


def diagonal_of(problem: System) -> np.ndarray:
    """A_ii at owned dofs, A being the derivative of the residual at the present state, without penalty; of several
    fields the sums of |A_ij| (collective)."""
    if problem.affine and problem.nodal:
        return problem.matrices.scales
    state = problem.vector()
    diagonal = problem.jacobian(state, penalised=False).getDiagonal()
    found = diagonal.array_r.copy() if problem.fields is None else problem.matrices.scales
    for owner in (state, diagonal):
        owner.destroy()
    return found


def _settled(problem: System, how: dict[str, Any], multigrid: Multigrid | None) -> Outcome:
    """All attempts; sets also repeat if the reference r of w is not the obstacle in contact."""
    limited = is_limited(problem, "penalty")
    return settled(problem, how, lambda given: _attempts(problem, given, multigrid),
                   lambda outcome: outcome.reason == TOO_MANY and limited)  # fmt: skip


def settled(
    problem: System,
    how: dict[str, Any],
    attempts: Callable[[dict[str, Any]], Outcome],
    is_final: Callable[[Outcome], bool],
) -> Outcome:
    """Attempts, with the reference r at the obstacle that each node touches (collective).

    Args:
        problem: Holds the start, then the last state.
        how: Arguments of `Stopping`.
        attempts: Solves from the present state, for such arguments.
        is_final: Whether another reference is not tried after this outcome.
    """
    outcome = attempts(how)
    for _ in range(MAX_REFERENCE_UPDATES):
        limited = outcome.roundoff_limited or outcome.from_afar
        if is_final(outcome) or not problem.update_reference(roundoff_limited=limited):
            break
        if not outcome.from_afar and _in_balance(outcome, how["tolerance"]):
            break
        outcome = joined(outcome, attempts({**how, "least": 0, "before": outcome.active}))
    return outcome


def _by_continuation(problem: System, eps: float, how: dict[str, Any]) -> Outcome:
    """Continuation in eps, from a penalty diagonal of the size of the stiffness."""
    outcomes = []
    softer = soft_eps(problem)
    while softer > eps:
        problem.eps = softer
        outcomes.append(_settled(problem, {**how, "tolerance": max(how["tolerance"], CONTINUATION_TOLERANCE)}, None))
        if not outcomes[-1].converged:  # a smaller eps does not converge either
            return reduce(joined, outcomes)
        softer *= CONTINUATION_FACTOR
    problem.eps = eps
    outcomes.append(_settled(problem, how, None))
    return reduce(joined, outcomes)


def smallest_eps(problem: System) -> float:
    """The smallest eps: above `STIFFEST` times the stiffness, D/eps exceeds floating-point resolution (collective).

    The penetration eps p is then below the last digit of the neighbouring values of u; round-off decides which nodes
    are in contact, and active sets do not converge. 0 where contact couples nodes or effects are not affine.
    """
    if not problem.affine or not problem.nodal:
        return 0.0
    stiff = problem.touchable & (problem.matrices.scales > 0)
    flexible = np.divide(problem.weights, problem.matrices.scales, out=np.zeros(len(stiff)), where=stiff)
    return max(largest(problem.comm, flexible), 0.0) / STIFFEST


def _attempts(problem: System, how: dict[str, Any], multigrid: Multigrid | None) -> Outcome:
    """Full steps and line searches in turn, each from the last state of the one before, until one converges.

    A line search ends where the round-off of the energy hides any descent: full steps continue from there. For a
    residual that is not linear it begins where full steps, which did not converge, began.
    """
    if user_has_set(problem.options_of("penalty") + "snes_linesearch_type"):
        return _attempt(problem, "basic", how, multigrid, objective=problem.has_energy)
    searches = ("basic", "bt", "basic") if problem.affine or not problem.has_energy else ("bt", "basic")
    start = problem.w.copy()
    outcome = _attempt(problem, searches[0], how, multigrid)
    for search in searches[1:]:
        if outcome.converged or is_limited(problem, "penalty"):
            break
        if outcome.reason == TOO_MANY and "patience" in how and (problem.affine or search == "basic"):
            break  # far from a solution: full steps would diverge
        if search == "bt" and not problem.affine:
            problem.w[:] = start  # full steps have led nowhere
        outcome = joined(outcome, _attempt(problem, search, how, multigrid))
    return outcome


def _attempt(
    problem: System, search: str, how: dict[str, Any], multigrid: Multigrid | None, *, objective: bool = False
) -> Outcome:
    full = search == "basic" and not objective
    stopping = stopping_of(problem, watch_cycles=full, **how)
    options = {**NEWTON, "snes_linesearch_type": search}
    objective |= search == "bt" and problem.has_energy
    return run(problem, "penalty", options, stopping, objective=objective, multigrid=multigrid)


def _in_balance(outcome: Outcome, tolerance: float) -> bool:
    """Whether a state is in balance to the tolerance, not only to the round-off of w: then it is so with another
    reference r, since u has not moved."""
    if not outcome.converged:
        return False
    last = outcome.history[-1]
    return last.unbalanced <= tolerance * last.forces


def joined(first: Outcome, second: Outcome) -> Outcome:
    """One outcome of two attempts; the history of one without a step has nothing new."""
    return replace(
        second, iterations=first.iterations + second.iterations,
        krylov=first.krylov + second.krylov, history=first.history + (second.history if second.iterations else ()),
        seconds=first.seconds + second.seconds,
    )  # fmt: skip


def penalty_pressure(problem: System) -> np.ndarray:
    """(3.7)-(3.8) in the gap form: p_i = -(w - gap)^+ / eps, at the owned points of I."""
    lower, upper = problem.pressed_gaps()
    p = (np.maximum(-lower, 0.0) - np.maximum(-upper, 0.0)) / problem.eps
    return np.where(problem.touchable, p, 0.0)

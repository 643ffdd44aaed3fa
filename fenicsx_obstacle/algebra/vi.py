"""The reference: the discrete variational inequality (3.13)/(3.19), by PETSc's SNES VI (reduced-space active set)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.fields import stopping_of
from fenicsx_obstacle.algebra.newton import NEWTON, PATIENCE, joined, settled, soft_eps, solve_penalty
from fenicsx_obstacle.algebra.snes import Outcome, is_limited, is_on, refuse, require, run
from fenicsx_obstacle.algebra.stopping import TOLERANCE, StepMonitor
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.truncated_multigrid import Multigrid

# without descent PETSc's line search fails, or takes round-off for a minimum of its merit function
LINE_SEARCH_FAILED = (PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH, PETSc.SNES.ConvergedReason.DIVERGED_LOCAL_MIN)
INFINITE = float(PETSc.INFINITY)  # PETSc's bound for 'no bound'
NEAR = 1e-6  # the same contact, but for nodes that press very little
# the state lies between the bounds, so a node in contact is at its bound to the last digit
VI = {**NEWTON, "snes_type": "vinewtonrsls", "snes_vi_zero_tolerance": 0.0}
MATRIX = "SNES VI takes the rows without contact of the assembled matrix; leave the option out"
REFUSED = {  # what `Stopping` is not made for, what ignores bounds, and what fails
    "snes_type": (lambda kind: kind != VI["snes_type"], f"the method vi is made for {VI['snes_type']} alone; leave the "
                  "option out, or take the method penalty"),
    "pc_type": (lambda kind: kind == "gamg", "SNES VI changes the size of its linear systems, which gamg does not "
                "take; take hypre or lu, leave the option out, or take the method penalty"),
    "snes_mf": (is_on, MATRIX),
    "snes_mf_operator": (is_on, MATRIX),
}  # fmt: skip


def solve_vi(
    problem: System,
    *,
    multigrid: Multigrid | None = None,
    least: int = 0,
    tolerance: float = TOLERANCE,
    patience: int | None = None,
    monitor: StepMonitor | None = None,
) -> Outcome:
    """Solve a(u, v - u) >= f(v - u) for all v between the obstacles, from the present state (collective).

    Args:
        problem: Holds the start, then the solution.
        multigrid: Preconditioner; by default algebraic multigrid.
        least: Steps to take at least.
        tolerance: Unbalanced force over acting forces to stop at.
        patience: Steps to take at most in one attempt.
        monitor: Called after each step.

    Returns:
        The converged outcome.

    Raises:
        InputError: If the user's PETSc options have a value in `REFUSED`.
        NotConverged: With PETSc's reason.
    """
    refuse(problem, "vi", REFUSED)
    how: dict[str, Any] = {"least": least, "tolerance": tolerance, "monitor": monitor}
    if patience is not None:
        how["patience"] = patience
    if problem.loose is not None:
        return require(_from_penalty(problem, how), problem, None, tolerance)
    limited, start = not problem.constrained or is_limited(problem, "vi"), problem.u
    outcome = _settled(problem, how if problem.affine or limited else {**how, "patience": PATIENCE}, multigrid)
    ended = outcome.converged or limited or (problem.affine and patience is not None)
    if not ended:  # active sets of what is no M-matrix may also repeat
        problem.set_unknown(start)
        outcome = joined(outcome, _from_penalty(problem, how))
    return require(outcome, problem, None, tolerance)


def _settled(problem: System, how: dict[str, Any], multigrid: Multigrid | None) -> Outcome:
    """All attempts; another reference r does not help where one fails."""
    return settled(problem, how, lambda given: _attempts(problem, given, multigrid),
                   lambda outcome: not outcome.converged)  # fmt: skip


def _from_penalty(problem: System, how: dict[str, Any]) -> Outcome:
    """From the solution with a small eps. PETSc's line search goes by the norm of the residual, which for what is not
    linear has minima of its own; the penalty has the energy, which has none. A body that contact alone holds needs
    closed nodes from the first step on, and SNES VI opens those where its first residual pulls."""
    first = solve_penalty(problem, NEAR * soft_eps(problem), monitor=how["monitor"])
    return joined(first, _settled(problem, how, None))


def _attempts(problem: System, how: dict[str, Any], multigrid: Multigrid | None) -> Outcome:
    """PETSc's line search; where it fails, because round-off is all that is left, full steps from the same start."""
    start = problem.w.copy()
    outcome = _attempt(problem, how, multigrid, VI)
    if outcome.reason in LINE_SEARCH_FAILED:
        problem.w[:] = start  # PETSc looks for a local minimum then, with x as its work space
        outcome = joined(outcome, _attempt(problem, how, multigrid, {**VI, "snes_linesearch_type": "basic"}))
    return outcome


def _attempt(problem: System, how: dict[str, Any], multigrid: Multigrid | None, options: Mapping[str, Any]) -> Outcome:
    x = problem.vector()
    lower, upper = x.duplicate(), x.duplicate()
    lower.array[:] = -INFINITE if problem.below is None else np.maximum(problem.below, -INFINITE)
    upper.array[:] = INFINITE if problem.above is None else np.minimum(problem.above, INFINITE)
    # fixed dofs are no contact, even where the boundary value touches the obstacle
    lower.array[~problem.touchable], upper.array[~problem.touchable] = -INFINITE, INFINITE
    x.array[:] = np.clip(x.array_r, lower.array_r, upper.array_r)
    problem.set_state(x)
    stopping = stopping_of(problem, exact_bounds=True, **how)
    outcome = run(problem, "vi", options, stopping, penalised=False, multigrid=multigrid,
                  prepare=lambda snes: snes.setVariableBounds(lower, upper))  # fmt: skip
    for vector in (x, lower, upper):
        vector.destroy()
    return outcome


def residual_pressure(problem: System) -> np.ndarray:
    """p_i = (a(u, phi_i) - f(phi_i)) / D_i at owned points of I that touch an obstacle, 0 elsewhere (collective).

    The last residual must be the one of the solution.
    """
    lower, upper = problem.gaps()
    p = np.where(problem.touchable, problem.elastic.array_r, 0.0) / np.where(problem.touchable, problem.weights, 1.0)
    held = ((lower <= 0) & (p > 0)) | ((upper <= 0) & (p < 0))
    return np.where(held, p, 0.0)

"""Nested iteration: the solution of each level, interpolated and relaxed, is the start on the next finer one.

Active-set methods move the boundary of contact by about one layer of nodes per step, so a cold start takes O(1/h)
steps. From the next coarser level contact is right up to a layer or two, whatever h.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fenicsx_obstacle.algebra.multigrid import Multigrid
from fenicsx_obstacle.algebra.relaxation import relax
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.errors import NotConverged

_log = logging.getLogger(__name__)
FEW = 8  # Newton steps from a start that is said to be near
# on coarse levels, whose discretisation error is larger by far: a step, and this unbalanced force
ON_THE_WAY: dict[str, Any] = {"least": 1, "tolerance": 1e-2}


def solve_nested(
    grids: Sequence[Multigrid | System],
    solve: Callable[..., Outcome],
    stiffness: float,
    before: System | None = None,
    start: np.ndarray | None = None,
) -> list[Outcome]:
    """Nested iteration: solve on each level, from the coarsest to the finest (collective).

    Args:
        grids: The multigrid of each level, or its problem where multigrid does not serve; the last problem holds the
            solution afterwards.
        solve: Solves a problem from its present state, given `multigrid`, and `ON_THE_WAY`.
        stiffness: Of the obstacle, 1/eps or infinite.
        before: The problem of the level below the first of these, holding its solution; by default there is none.
        start: Values of u on the finest level, near its solution: Newton begins there, and where few
            steps do not do, as always.

    Returns:
        The outcome of each level that was solved, the finest last.

    Raises:
        NotConverged: On the finest level; where the coarsest level is algebraic, or contact alone bears the load, from
            a cold start too. A coarse state is a start, converged or not, if the problem is affine.
    """
    if start is not None and (found := solve_from(grids[-1], start, solve)) is not None:
        return [found]
    outcomes: list[Outcome] = []
    for grid in grids:
        multigrid, problem = as_multigrid(grid), problem_of(grid)
        if before is None:
            problem.set_reference(problem.cold_start())
        else:
            begin_from(problem, before)
            if problem.constrained and multigrid is not None:
                none = np.zeros(len(problem.weights))
                relax(problem, np.multiply(stiffness, problem.weights, out=none, where=problem.weights > 0))
        finest = grid is grids[-1]
        unwatched = {"monitor": None} if not problem.on_mesh and not finest else {}  # nothing to be shown on
        try:
            outcomes.append(solve(problem, multigrid=multigrid, **({} if finest else ON_THE_WAY | unwatched)))
        except NotConverged as error:
            if finest:
                if not (_algebraic(grids) or problem.borne is not None):
                    raise
                _log.info("no convergence from the coarser levels: continuing with a cold start")
                problem.set_reference(problem.cold_start())
                last = solve(problem)
                outcomes.append(replace(last, iterations=error.iterations + last.iterations))
            if not problem.affine:  # it may be anywhere
                before = None
                continue
        before = problem
    return outcomes


def solve_from(grid: Multigrid | System, start: np.ndarray, solve: Callable[..., Outcome]) -> Outcome | None:
    """Solve from the solution for other data; None if a few steps are not enough (collective).

    Args:
        grid: The multigrid of the problem, or the problem where multigrid does not serve.
        start: Values of u.
        solve: As for `solve_nested`.
    """
    multigrid, problem = as_multigrid(grid), problem_of(grid)
    problem.set_reference(start)
    try:
        return solve(problem, multigrid=multigrid, patience=FEW)
    except NotConverged:
        _log.info("the solution for other data is too far away to start from")
        return None


def _algebraic(grids: Sequence[Multigrid | System]) -> bool:
    coarsest, finest = problem_of(grids[0]), problem_of(grids[-1])
    return coarsest is not finest and not coarsest.on_mesh


def problem_of(grid: Multigrid | System) -> System:
    """The problem of a level."""
    return grid.problem if isinstance(grid, Multigrid) else grid


def as_multigrid(grid: Multigrid | System) -> Multigrid | None:
    """The multigrid of a level, where it serves."""
    return grid if isinstance(grid, Multigrid) else None


def begin_from(problem: System, coarse: System) -> None:
    """Set the state to the interpolant of the next coarser level (collective).

    Where both ends of an edge are in contact its middle is: gaps, not values of u, are interpolated there, or
    the middle of a curved obstacle's edge would start far off.
    """
    transfer, w = problem.transfer, problem.w
    problem.set_unknown(transfer.interpolate(coarse.u))
    for ours, theirs, sign in ((problem.below, coarse.below, 1), (problem.above, coarse.above, -1)):
        if ours is None or theirs is None:
            continue
        distance = sign * (coarse.w - theirs)
        touching = transfer.all_of(distance <= 0) & ~problem.fixed
        between = transfer.interpolate(np.minimum(distance, 0.0))
        w[touching] = ours[touching] + sign * between[touching]
    problem.state.share()

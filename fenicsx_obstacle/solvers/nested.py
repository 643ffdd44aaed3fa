"""Nested iteration: the solution of each level, interpolated, is the start on the next finer one.

Active-set methods move the boundary of contact by about one layer of nodes per step, so a cold start takes O(1/h)
steps. From the next coarser level contact is right up to a layer or two, whatever h.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import NotConverged
from fenicsx_obstacle.solvers.multigrid import Multigrid
from fenicsx_obstacle.solvers.snes import Outcome
from fenicsx_obstacle.solvers.stopping import TOLERANCE

ON_THE_WAY = 1e-2  # unbalanced force on coarse levels: their discretisation error is larger by far


def solve_nested(grids: Sequence[Multigrid], solve: Callable[..., Outcome]) -> list[Outcome]:
    """Solve on each level from the coarsest on (collective).

    Args:
        grids: The multigrid of each level; the problem of the last holds the solution afterwards.
        solve: Solves a problem from its present state, given `multigrid` and `tolerance`.

    Returns:
        The outcome of each level, the finest last.

    Raises:
        NotConverged: On the finest level. A coarse state is a start, converged or not.
    """
    outcomes: list[Outcome] = []
    before: Problem | None = None
    for grid in grids:
        problem = grid.problem
        if before is None:
            problem.refer(problem.cold_start())
        else:
            problem.begin_from(before)
        finest = grid is grids[-1]
        try:
            outcomes.append(solve(problem, multigrid=grid, tolerance=TOLERANCE if finest else ON_THE_WAY))
        except NotConverged:
            if finest:
                raise
        before = problem
    return outcomes

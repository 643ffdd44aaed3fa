"""The variational inequality for pairs whose contact couples nodes, by an augmented Lagrangian method.

SNES VI holds nodes between bounds. Where the points of I are no nodes, u <= g there couples several nodes, and the
multiplier p of the program is found by p_(k+1) = -(u - g - eps p_k)^+ / eps, u of (3.4) with the obstacle g + eps p_k:
Hestenes' and Powell's method, whose steps are penalty solves and whose limit does not depend on eps.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fenicsx_obstacle.algebra.newton import joined, penalty_pressure, soft_eps, solve_penalty
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.stopping import TOLERANCE, StepMonitor
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.truncated_multigrid import Multigrid
from fenicsx_obstacle.errors import NotConverged
from fenicsx_obstacle.parallel import largest

STIFF = 1e-4  # eps over the flexibility D_i / A_ii of a cell: errors shrink by about this factor in each step
CLOSE = 1e-10  # penetration over the range of u
STEPS = 50


def solve_augmented(
    problem: System,
    *,
    multigrid: Multigrid | None = None,
    tolerance: float = TOLERANCE,
    monitor: StepMonitor | None = None,
) -> Outcome:
    """Solve the inequality with u <= g at the points of I, from the present state (collective).

    Afterwards the penalty pressure is the multiplier.

    Args:
        problem: Whose pair is not nodal; holds the start, then the solution.
        multigrid: None: contact couples nodes.
        tolerance: As for `solve_penalty`.
        monitor: Called after each step.

    Returns:
        The converged outcome, iterations of all steps together.

    Raises:
        NotConverged: With the reason.
    """
    state, comm = problem.state, problem.comm
    assert state.multiplier is not None
    state.multiplier[:] = 0.0
    state.share_all()
    eps = STIFF * soft_eps(problem)
    how: dict[str, Any] = {"multigrid": multigrid, "tolerance": tolerance, "monitor": monitor}
    outcome = solve_penalty(problem, eps, **how)
    for _ in range(STEPS):
        state.multiplier[:] = penalty_pressure(problem)
        state.share_all()
        outcome = joined(outcome, solve_penalty(problem, eps, **how))
        change = largest(comm, np.abs(penalty_pressure(problem) - state.multiplier))
        if eps * change <= CLOSE * problem.range_of_u():
            return outcome
    raise NotConverged("vi", "the multipliers of the augmented obstacle do not converge", outcome.iterations, eps=None,
                       h=problem.h)  # fmt: skip

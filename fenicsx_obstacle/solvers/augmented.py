"""The variational inequality for pairs whose contact couples nodes, by an augmented Lagrangian method.

SNES VI holds nodes between bounds. Where the points of I are no nodes, u <= g there couples several nodes, and the
multiplier p of the program is found by p_(k+1) = -(u - g - eps p_k)^+ / eps, u of (3.4) with the obstacle g + eps p_k:
Hestenes' and Powell's method, whose steps are penalty solves and whose limit does not depend on eps.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import NotConverged
from fenicsx_obstacle.parallel import largest, smallest
from fenicsx_obstacle.solvers.newton import joined, penalty_pressure, soft_eps, solve_penalty
from fenicsx_obstacle.solvers.snes import Outcome
from fenicsx_obstacle.solvers.stopping import StepMonitor

STIFF = 1e-4  # eps over the flexibility D_i / A_ii of a cell: errors shrink by about this factor in each step
CLOSE = 1e-10  # penetration over the range of u
STEPS = 50


def solve_augmented(problem: Problem, *, monitor: StepMonitor | None = None) -> Outcome:
    """Solve the inequality with u <= g at the points of I, from the present state (collective).

    Afterwards the penalty pressure is the multiplier.

    Args:
        problem: Whose pair is not nodal; holds the start, then the solution.
        monitor: Called after each step.

    Returns:
        The converged outcome, iterations of all steps together.

    Raises:
        NotConverged: With the reason.
    """
    multiplier = problem.forms.multiplier
    assert multiplier is not None
    comm, own = problem.level.comm, len(problem.weights)
    multiplier.x.array[:] = 0.0
    eps = STIFF * soft_eps(problem)
    outcome = solve_penalty(problem, eps, monitor=monitor)
    for _ in range(STEPS):
        multiplier.x.array[:own] = penalty_pressure(problem)
        multiplier.x.scatter_forward()
        outcome = joined(outcome, solve_penalty(problem, eps, monitor=monitor))
        u_values = problem.solution().x.array
        span = largest(comm, u_values) - smallest(comm, u_values)
        change = largest(comm, np.abs(penalty_pressure(problem) - multiplier.x.array[:own]))
        if eps * change <= CLOSE * span:
            return outcome
    raise NotConverged("vi", "the multipliers of the augmented obstacle do not converge", outcome.iterations, eps=None,
                       h=problem.level.h)  # fmt: skip

"""Damped Jacobi relaxation of the penalised problem or of the inequality.

Interpolated heights are wrong where they bend: along the edge of contact, and over obstacles that only the finer mesh
resolves. Relaxation mends that node by node for the price of a few residuals, where Newton steps would peel off one
layer of wrong contact each.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem

SWEEPS = 8  # together as dear as one step of multigrid
DAMPING = 2 / 3  # smooths best in one dimension, and converges in all: D^-1 A <= 2 where A has M-matrix signs


def relax(problem: Problem, penalty_diagonal: np.ndarray) -> None:
    """Damped Jacobi sweeps on the penalised residual or the inequality, from the present state (collective).

    A sweep is a proximal gradient step, so it lowers the energy whatever the springs.

    Args:
        problem: With affine effects; holds the state.
        penalty_diagonal: D/eps at owned dofs, or infinite: what an obstacle answers to penetration.
    """
    own, free, forms = problem.level.owned, ~problem.fixed, problem.nodal
    step = DAMPING / forms.diagonal * free
    answer = penalty_diagonal * DAMPING / forms.diagonal
    back = (1.0 - 1.0 / (1.0 + answer)) * free  # share of a penetration that is undone
    w, change = problem.w.x.array[:own], np.empty(own)
    obstacles = [
        (gap.x.array[:own], excess)
        for gap, excess in ((problem.below, np.minimum), (problem.above, np.maximum))
        if gap is not None
    ]
    for _ in range(SWEEPS):
        forms.elastic(problem.elastic)
        w -= np.multiply(step, problem.elastic.array_r, out=change)
        for gap, excess in obstacles:
            np.subtract(w, gap, out=change)
            w -= np.multiply(excess(change, 0.0, out=change), back, out=change)
        problem.w.x.scatter_forward()

"""Damped Jacobi relaxation of the penalised problem or of the inequality.

The interpolant of a coarse solution has a wrong contact set along the free boundary, and over obstacles that only the
finer mesh resolves. A few Jacobi sweeps correct this at the cost of a few residuals; each Newton step would remove one
layer of wrong contact nodes only.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.algebra.system import System

SWEEPS = 8  # together they cost as much as one step of multigrid
DAMPING = 2 / 3  # smooths best in one dimension, and converges in all: D^-1 A <= 2 where A has M-matrix signs


def relax(problem: System, penalty_diagonal: np.ndarray) -> None:
    """Damped Jacobi sweeps on the penalised residual or the inequality, from the present state (collective).

    A sweep is a proximal gradient step, so it lowers the energy for any penalty.

    Args:
        problem: With affine effects; holds the state.
        penalty_diagonal: D/eps at owned dofs, or infinite: what an obstacle answers to penetration.
    """
    free, matrices = ~problem.fixed, problem.matrices
    step = DAMPING / matrices.diagonal * free
    answer = penalty_diagonal * DAMPING / matrices.diagonal
    back = (1.0 - 1.0 / (1.0 + answer)) * free  # share of a penetration that is undone
    w, change = problem.w, np.empty(problem.owned)
    obstacles = [
        (gap, excess) for gap, excess in ((problem.below, np.minimum), (problem.above, np.maximum)) if gap is not None
    ]
    for _ in range(SWEEPS):
        matrices.elastic(problem.elastic)
        w -= np.multiply(step, problem.elastic.array_r, out=change)
        for gap, excess in obstacles:
            np.subtract(w, gap, out=change)
            w -= np.multiply(excess(change, 0.0, out=change), back, out=change)
        problem.state.share()

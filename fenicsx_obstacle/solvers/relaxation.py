"""Relaxation: each node goes to its own balance between membrane, load and obstacle, its neighbours resting.

Interpolated heights are wrong where they bend: along the edge of contact, and over obstacles that only the finer mesh
resolves. Relaxation mends that node by node for the price of a few residuals, where Newton steps would peel off one
layer of wrong contact each.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem

SWEEPS = 8  # together as dear as one step of multigrid
DAMPING = 2 / 3  # smooths best in one dimension, and converges in all: D^-1 A <= 2 where A has M-matrix signs


def relax(problem: Problem, springs: np.ndarray) -> None:
    """Damped Jacobi sweeps on the penalised residual or the inequality, from the present state (collective).

    A sweep is a proximal gradient step, so it lowers the energy whatever the springs.

    Args:
        problem: With affine effects; holds the state.
        springs: D/eps at owned dofs, or infinite: what an obstacle answers to penetration.
    """
    x = problem.state()
    residual = x.duplicate()
    step = DAMPING / problem.nodal.diagonal
    remains = 1.0 / (1.0 + springs * step)  # of a penetration
    for _ in range(SWEEPS):
        problem.residual(x, residual, penalised=False)
        x.array[:] -= step * residual.array_r
        problem.take(x)
        lower, upper = problem.gaps()
        x.array[:] += (1.0 - remains) * (np.maximum(-lower, 0.0) - np.maximum(-upper, 0.0)) * ~problem.fixed
    problem.take(x)
    for owner in (x, residual):
        owner.destroy()

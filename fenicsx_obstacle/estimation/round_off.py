"""Digits of the contact pressure: how many floating point leaves it, and how many who divides heights by eps.

(3.7)-(3.8), p = -(u - g)^+/eps, taken literally subtracts heights: the last digit of g, divided by eps, is a relative
error of about machine epsilon |g|/(eps |p|) in p. The unknown w = u - g avoids that. What is left does not depend on
eps: A g is a difference of heights as well, so that p = D^-1 (A u - f) is known to machine epsilon |g| A_ii/(D_i |p|) -
as if eps were D_i/A_ii, about h^2/(4 tension).
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.estimation.solved import EPSILON
from fenicsx_obstacle.parallel import largest


def round_off(problem: Problem, p: np.ndarray, eps: float | None) -> dict[str, float | None]:
    """Relative errors of the contact pressure of the problem's state, in the maximum norm (collective).

    Args:
        problem: With affine effects and contact at nodes.
        p: Its pressure at owned points.
        eps: Penalty parameter, or None.

    Returns:
        from_heights: Of the pressure that u and obstacle, as they are stored, give: what is lost, as it happens.
        line: What theory says may be lost, machine epsilon |g| / (eps |p|).
        left: What round-off may leave in `p`.
        None without pressure, or without eps.
    """
    comm, own = problem.level.comm, problem.level.owned
    size = largest(comm, np.abs(p))
    pressing = p != 0
    if size <= 0:
        return {"from_heights": None, "line": None, "left": None}
    r = np.abs(problem.reference.x.array[:own])
    stiff = (problem.nodal.diagonal * r)[pressing] / np.maximum(problem.weights[pressing], 1e-300)
    left = EPSILON * largest(comm, stiff) / size
    if eps is None:
        return {"from_heights": None, "line": None, "left": left}
    u_values = (problem.w.x.array + problem.reference.x.array)[:own]
    plain = np.zeros(own)
    for obstacle, sign in zip(problem.obstacles(), (1.0, -1.0), strict=True):
        g = np.broadcast_to(obstacle, len(problem.w.x.array))[:own]
        with np.errstate(invalid="ignore"):
            plain += sign * np.maximum(sign * (g - u_values), 0.0)
    lost = largest(comm, np.abs(plain / eps - p)[pressing]) / size
    return {"from_heights": lost, "line": EPSILON * largest(comm, r[pressing]) / (eps * size), "left": left}

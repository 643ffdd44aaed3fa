"""Round-off of the contact pressure: computed from u - g, and from stored values of u.

(3.7)-(3.8), p = -(u - g)^+/eps, computed from stored values of u and g, has a relative error of about machine epsilon
|g|/(eps |p|), from the last digit of g. With the unknown w = u - g this error does not occur. The remaining error
does not depend on eps: A g is a difference of values of g as well, so that p = D^-1 (A u - f) has a relative error of
machine epsilon |g| A_ii/(D_i |p|), as if eps were D_i/A_ii, about h^2/(4 tension).
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.algebra.data_scales import EPSILON
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.parallel import largest


def round_off(problem: Problem, p: np.ndarray, eps: float | None) -> dict[str, float | None]:
    """Relative errors of the contact pressure of the problem's state, in the maximum norm (collective).

    Args:
        problem: With affine effects and contact at nodes.
        p: Its pressure at owned points.
        eps: Penalty parameter, or None.

    Returns:
        from_heights: Of the pressure computed from the stored u and obstacle, as measured.
        line: The same by theory, machine epsilon |g| / (eps |p|).
        left: Round-off in `p`.
        None without pressure, or without eps.
    """
    comm, own = problem.level.comm, problem.level.owned
    size = largest(comm, np.abs(p))
    pressing = p != 0
    if size <= 0:
        return {"from_heights": None, "line": None, "left": None}
    r = np.abs(problem.state.r)
    stiff = (problem.matrices.diagonal * r)[pressing] / np.maximum(problem.weights[pressing], 1e-300)
    left = EPSILON * largest(comm, stiff) / size
    if eps is None:
        return {"from_heights": None, "line": None, "left": left}
    u_values = problem.u
    plain = np.zeros(own)
    for obstacle, sign in zip(problem.obstacles(), (1.0, -1.0), strict=True):
        g = np.broadcast_to(obstacle, own)
        with np.errstate(invalid="ignore"):
            plain += sign * np.maximum(sign * (g - u_values), 0.0)
    lost = largest(comm, np.abs(plain / eps - p)[pressing]) / size
    return {"from_heights": lost, "line": EPSILON * largest(comm, r[pressing]) / (eps * size), "left": left}

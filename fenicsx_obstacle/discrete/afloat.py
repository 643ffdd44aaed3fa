"""The forces on a membrane as a whole: whether any hold one that is fixed nowhere, and which are at work in a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes.moments import INERTIA

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.problem import Problem

ROUND_OFF = 1e-12  # of the sum of its parts: what cancels


def refuse_afloat(problem: Problem, net_load: float) -> None:
    """Refuse a membrane held nowhere that its load does not press against its only obstacle (collective).

    (3.4) with v = 1 says that contact forces and loads add up to 0, and an obstacle only pushes.

    Args:
        problem: At rest at u = 0, its residual just evaluated; it is so again afterwards.
        net_load: The sum of all loads.

    Raises:
        InputError: Since no u is in balance.
    """
    comm = problem.level.comm
    if total(comm, np.count_nonzero(problem.fixed)) > 0 or (problem.below is None) == (problem.above is None):
        return
    at_rest = problem.elastic.array_r.copy()  # minus the loads
    problem.w.x.array[:] = 1.0
    problem.forms.elastic(problem.elastic)
    problem.w.x.array[:] = 0.0
    state = problem.state()
    diagonal = problem.jacobian(state, penalised=False).getDiagonal()
    answer = total(comm, problem.elastic.array_r - at_rest)
    shifts = answer <= ROUND_OFF * total(comm, diagonal.array_r)
    for vector in (state, diagonal):
        vector.destroy()
    if not shifts:  # something else than contact answers
        return
    side, push = ("lower", -net_load) if problem.below is not None else ("upper", net_load)
    if push <= ROUND_OFF * total(comm, np.abs(at_rest)):
        raise InputError(
            f"{problem.scene.source}: u is given nowhere, and the load, {net_load:.3g} in all, does not press "
            f"against the {side} obstacle: no u is in balance; add a [[boundary]] with a value"
        )


def forces_at_work(problem: Problem, load: float) -> float:
    """The load, or in a step with inertia the sum of |a(u, .) - f| over free dofs at the present heights (collective).

    There the residual at u = 0, the load, is no measure of forces: mass over the square of a step outweighs all.
    """
    time = problem.scene.time
    if time is None or time.order != INERTIA:
        return load
    problem.forms.elastic(problem.elastic)
    return total(problem.level.comm, np.abs(problem.elastic.array_r[~problem.fixed]))

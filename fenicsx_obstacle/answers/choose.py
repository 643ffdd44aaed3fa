"""Rules that choose for the user, each in one place: the value of eps, the solver."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.problem import Problem

METHODS = {
    "penalty": "semismooth Newton on (3.4) by PETSc SNES: full steps; a line search on the energy should sets repeat",
    "successive": "the paper's (3.4)*: the same Newton loop from no contact, until the active set stays as it was",
    "vi": "PETSc SNES VI (vinewtonrsls) on the discrete variational inequality (3.19), no penalty",
}
LINEAR_SOLVER = "conjugate gradients with algebraic multigrid (hypre BoomerAMG)"


def penalty_parameter(problem: Problem, value: float | str) -> float:
    """eps as a number, in units of u/p (collective).

    A number is absolute. A formula in h is divided by the largest tension: (1/eps) D and the stiffness then
    stay in proportion whatever the units.

    Raises:
        InputError: If it is not positive and finite.
    """
    scene = problem.scene
    formula = scene.formula(value, "[solve] eps")
    eps = scene.number(value, "[solve] eps", {"h": problem.level.h})
    if not 0 < eps < np.inf:
        raise InputError(f"{formula.place} = {formula.text}: must be positive, it is {eps:g}")
    if "h" not in formula.names:
        return eps
    stiffness = [problem.data.cellwise(effect.value) for effect in scene.effects if effect.elastic]
    return eps / largest(problem.level.comm, stiffness[0].x.array)

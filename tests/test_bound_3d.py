"""Error bounds on intervals and tetrahedra: in balance, never below a known error."""

import numpy as np
import pytest
from conftest import COMM

from fenicsx_obstacle import Scene
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import largest

SIDES = [-1, 1]
BOX = {"shape": "box", "x": SIDES, "y": SIDES, "z": SIDES, "cells": 4, "perturb": 0.2}
BALL = "r^2/6 + 0.6^3/(3*r) - 0.6^2/2"
SCENES = {
    "string": Scene(
        mesh={"shape": "interval", "x": [0, 1], "cells": 16}, tension=1, load=-1, lower=0,
        boundary=[{"value": "max(x - 0.3, 0)^2/2"}], exact="max(x - 0.3, 0)^2/2",
    ),
    "ball": Scene(
        mesh=BOX, tension=1, load=-1, lower=0, define={"exact_u": f"where(r < 0.6, 0, {BALL})"},
        boundary=[{"value": "exact_u"}], exact="exact_u",
    ),
    "plane contact": Scene(
        mesh=BOX, tension=1, load=-1, lower=0, exact="max(x - 0.3, 0)^2/2",
        boundary=[{"on": "left", "value": 0}, {"on": "right", "value": 0.245}],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_no_known_error_is_above_its_bound(name):
    """For all eps bounds of u_h and v_h are above the errors, u_h's at most 4 times."""
    scene = SCENES[name]
    context = SolverContext(scene)
    for eps in ("h", "h^2", "auto", "1e-10"):
        answer = context.answer(scene.options_with(eps=eps), bound=True)
        of_v, _ = context.exact.errors(answer.bound.admissible, answer.pressure, answer.record["eps"])
        assert "certified" in answer.bound.words
        assert answer.record["errors"]["energy"] <= answer.bound.total <= 4 * answer.record["errors"]["energy"]
        assert of_v["energy"] <= answer.bound.admissible_total
    context.close()


def test_the_flux_on_tetrahedra_is_in_balance():
    """div sigma = -(f_0 + lambda - nu + rho) in each cell, and its normal part is continuous."""
    context = SolverContext(SCENES["plane contact"])
    context.answer()
    problem, element = context.problem, context.estimator.element
    simplices, lower = element.simplices, problem.gaps()[0] <= 0
    flux = element.equilibration.flux(problem.solution().x.array, lower, np.zeros_like(lower))
    pressure = (flux.lower - flux.upper + flux.rest[simplices.dofs]).mean(axis=1)
    load = element.equilibration.load.moments.sum(axis=1) / simplices.area
    assert largest(COMM, np.abs(flux.normal.sum(axis=1) / simplices.area + load + pressure)) < 1e-11
    both = np.bincount(simplices.facets.ravel(), weights=flux.normal.ravel())
    inside = np.bincount(simplices.facets.ravel()) == 2
    assert largest(COMM, np.abs(both[inside])) <= 4e-15 * largest(COMM, np.abs(flux.normal))
    assert flux.incompatible <= 1e-12
    context.close()

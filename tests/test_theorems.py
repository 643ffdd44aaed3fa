"""Kikuchi's statements on u_eps and p_eps, measured on discrete problems."""

import itertools

import numpy as np
import pytest

from fenicsx_obstacle import Scene, study
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.studies.orders import order
from tests.conftest import COMM, DEMOS, slow_except


@pytest.fixture(scope="module")
def ladder():
    """disk.toml, 32 cells: eight solutions of the penalty."""
    context = SolverContext(Scene.read(DEMOS / "disk.toml").change({"mesh.cells": 32}))
    scene = context.scene
    answers = {eps: context.answer(scene.options_with(eps=eps)) for eps in [10.0**-k for k in range(1, 9)]}
    return context, answers


def test_penalty_errors_are_of_order_eps():
    """(5.5), Theorem 3.3 at fixed h: energy distance, pressure and penetration of order eps over 5 decades."""
    rows = study(Scene.read(DEMOS / "disk.toml"), {"eps": [10.0**-k for k in range(5, 11)]}, cells=32)
    for before, row in itertools.pairwise(rows):
        for key in ("to_vi.energy", "to_vi.max", "to_vi.pressure_l2", "penetration"):
            assert abs(order(key, row, before, "eps") - 1) < 0.1


def test_pressure_has_its_sign_and_balances_the_load(ladder):
    """p <= 0 against the upper obstacle, and a(u, v) = f(v) + I(p, v) at every free node."""
    context, answers = ladder
    problem = context.problem
    for answer in answers.values():
        assert largest(COMM, answer.pressure.x.array) <= 0
        problem.set_reference(answer.u.x.array[: problem.owned])
        x = problem.vector()
        out = x.duplicate()
        problem.residual(x, out, penalised=False)
        unbalanced = out.array - problem.weights * answer.pressure.x.array[: len(out.array)]
        assert largest(COMM, np.abs(unbalanced[~problem.fixed])) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_except(["string", "disk", "ball", "two_sided"], "disk"))
def test_orders_in_h(name):
    """(5.6), (5.8), (5.9) with eps = h^2: order 1 in H1 and in energy, at least 1 for the pressure in the dual norm."""
    rows = study(Scene.read(DEMOS / f"{name}.toml"), {"cells": [32, 64]}, eps="h^2")
    for key in ("errors.h1", "errors.energy"):
        assert 0.9 < order(key, rows[1], rows[0], "h") < 1.45  # the penalty's part is of higher order
    assert order("errors.pressure_dual", rows[1], rows[0], "h") >= 1
    assert order("errors.l2", rows[1], rows[0], "h") > 1.7


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_except(["string", "disk", "ball", "two_sided"], "disk"))
def test_vi_orders_in_h(name):
    """(5.6) for the variational inequality itself: order 1 in H1, 2 in L2."""
    rows = study(Scene.read(DEMOS / f"{name}.toml"), {"cells": [32, 64]}, method="vi")
    assert abs(order("errors.h1", rows[1], rows[0], "h") - 1) < 0.1
    assert order("errors.l2", rows[1], rows[0], "h") > 1.7
    assert order("errors.pressure_dual", rows[1], rows[0], "h") >= 1


@pytest.mark.slow
def test_three_dimensions():
    """NSV in a cube: u = ((|x|^2 - 0.49)^+)^2 with lower obstacle 0, errors of order 1 in H1."""
    outside = "4*(2*r^2 + 3*(r^2 - 0.49))"
    scene = Scene(
        mesh={"shape": "box", "x": [-1, 1], "y": [-1, 1], "z": [-1, 1], "cells": 8}, tension=1, lower=0,
        load=f"where(r > 0.7, -{outside}, -8*0.49*(1.49 - r^2))",
        exact="max(r^2 - 0.49, 0)^2", boundary=[{"value": "max(r^2 - 0.49, 0)^2"}],
    )  # fmt: skip
    rows = study(scene, {"cells": [8, 16]}, eps="h^2")
    assert order("errors.h1", rows[1], rows[0], "h") > 0.85

"""Kikuchi's statements on u_eps and p_eps, measured on discrete problems."""

import itertools

import numpy as np
import pytest
from conftest import COMM, DEMOS, membrane

from fenicsx_obstacle import Scene, study
from fenicsx_obstacle.answers.compute import Workbench
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.studies.orders import order


@pytest.fixture(scope="module")
def ladder():
    """disk.toml, 32 cells: the solution of the VI and eight of the penalty."""
    bench = Workbench(Scene.read(DEMOS / "disk.toml").change({"mesh.cells": 32}))
    scene = bench.problem.scene
    reference = bench.answer(scene.change({"solve.method": "vi"}))
    answers = {eps: bench.answer(scene.change({"solve.eps": eps})) for eps in [10.0**-k for k in range(1, 9)]}
    return bench, reference, answers


def test_penalty_errors_are_of_order_eps():
    """(5.5), Theorem 3.3 at fixed h: energy distance, pressure and penetration of order eps over 5 decades."""
    rows = study(Scene.read(DEMOS / "disk.toml"), {"eps": [10.0**-k for k in range(5, 11)]}, cells=32)
    for before, row in itertools.pairwise(rows):
        for key in ("to_vi.energy", "to_vi.max", "to_vi.pressure_l2", "penetration"):
            assert abs(order(key, row, before, "eps") - 1) < 0.1


def test_nodal_bounds(ladder):
    """On an M-matrix 0 <= u_eps - u_h <= eps max|p_h| at every node, hence penetration <= eps max|p_h|."""
    _, reference, answers = ladder
    for eps, answer in answers.items():
        excess = answer.u.x.array - reference.u.x.array
        bound = eps * largest(COMM, np.abs(reference.pressure.x.array))
        assert smallest(COMM, excess) >= -1e-10
        assert largest(COMM, excess) <= bound * (1 + 1e-9) + 1e-10
        assert answer.record["penetration"] <= bound * (1 + 1e-9)


def test_pressure_is_bounded_by_its_limit(ladder):
    """From (3.23)-(3.24) without LBB: ||p_eps||_I <= ||p_h||_I and a(e, e) <= (eps/4) ||p_h||_I^2."""
    bench, reference, answers = ladder
    D, own = bench.problem.weights, bench.problem.level.owned
    limit = total(COMM, D * reference.pressure.x.array[:own] ** 2)
    from fenicsx_obstacle.accuracy.norms import Distance

    distance = Distance(bench.problem)
    for eps, answer in answers.items():
        assert total(COMM, D * answer.pressure.x.array[:own] ** 2) <= limit * (1 + 1e-10)
        e = answer.u.x.array - reference.u.x.array
        assert distance.energy(e) ** 2 <= eps / 4 * limit


def test_pressure_has_its_sign_and_balances_the_load(ladder):
    """p <= 0 against the upper obstacle, and a(u, v) = f(v) + I(p, v) at every free node."""
    bench, _, answers = ladder
    problem = bench.problem
    for answer in answers.values():
        assert largest(COMM, answer.pressure.x.array) <= 0
        problem.refer(answer.u.x.array)
        x = problem.state()
        out = x.duplicate()
        problem.residual(x, out, penalised=False)
        unbalanced = out.array - problem.weights * answer.pressure.x.array[: len(out.array)]
        assert largest(COMM, np.abs(unbalanced[~problem.fixed])) < 1e-9


@pytest.mark.parametrize("name", ["string", "disk", "ball", "two_sided"])
def test_orders_in_h(name):
    """(5.6), (5.8), (5.9) with eps = h^2: order 1 in H1 and in energy, at least 1 for the pressure in the dual norm."""
    rows = study(Scene.read(DEMOS / f"{name}.toml"), {"cells": [32, 64]}, eps="h^2")
    for key in ("errors.h1", "errors.energy"):
        assert 0.9 < order(key, rows[1], rows[0], "h") < 1.45  # the penalty's part is of higher order
    assert order("errors.pressure_dual", rows[1], rows[0], "h") >= 1
    assert order("errors.l2", rows[1], rows[0], "h") > 1.7


@pytest.mark.parametrize("name", ["string", "disk", "ball", "two_sided"])
def test_vi_orders_in_h(name):
    """(5.6) for the variational inequality itself: order 1 in H1, 2 in L2."""
    rows = study(Scene.read(DEMOS / f"{name}.toml"), {"cells": [32, 64]}, method="vi")
    assert abs(order("errors.h1", rows[1], rows[0], "h") - 1) < 0.1
    assert order("errors.l2", rows[1], rows[0], "h") > 1.7
    assert order("errors.pressure_dual", rows[1], rows[0], "h") >= 1


def test_full_contact_and_none():
    """f = -1 on psi = 0 = g: u = 0 and p = 1; psi = -1: the Poisson solution after one linear solve, p = 0."""
    full = Workbench(membrane(load=-1, lower=0)).answer(membrane(load=-1, lower=0).change({"solve.method": "vi"}))
    assert largest(COMM, np.abs(full.u.x.array)) == 0
    inside = full.contact.x.array > 0
    assert np.allclose(full.pressure.x.array[inside], 1)
    lake = Workbench(membrane(load=1, lower=-1)).answer()
    assert lake.record["newton_iterations"] == 1
    assert lake.record["contact"]["lower"]["force"] == 0


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

"""P2 on intervals, with Simpson's rule: orders, flat Newton counts, closed forms with bounds, tolerances."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import ObstacleProblem, Scene, Solution, releases, solve
from fenicsx_obstacle.scenes import catalogue
from tests.conftest import COMM

KINKED = ("mu_jump", "point load")  # `errors` need vertices where the slope of u jumps
STRINGS = ("parabola", "two_obstacles", "mu_jump", "torsion", "wedge")
END, HELD = "where(x < a, c - f*(a - x)^2/2, c)", {"on": "right", "value": "c"}
FLAT = {"define": {"f": 8, "c": 0.3, "k": 5}, "tension": 1, "load": "f", "upper": "c"}
PIECES = {"a": 0.37, "K": 4, "P": 3, "g": "sin(3*x)", "u1": "3*cos(3*x) - where(x < a, 2*K*(a - x), 0)",
          "u2": "-9*sin(3*x) + where(x < a, 2*K, 0)", "push": "where(x < a, 0, P)",
          "w": "g + where(x < a, K*(a - x)^2, 0)"}  # fmt: skip


def string(more, boundary, exact, **data):
    known = {**data.pop("define", {}), **more}
    return Scene(mesh={"shape": "interval", "x": [0, 1], "cells": 16}, define=known, boundary=boundary,
                 exact={"u": exact}, **data)  # fmt: skip


def below(**data):
    """A string on a smooth obstacle; it leaves it at a, where the load jumps."""
    define = {**PIECES, **data.pop("define", {})}
    return string({}, [{"value": "w"}], "w", define=define, lower="g", **data)


CLOSED = {
    "spring": lambda: string({"a": "(sqrt(f^2 + 2*k^2*f*c) - f)/(k*f)"}, [{"on": "left", "spring": "k"}, HELD],
                             END, **FLAT),
    "flux": lambda: string({"a": 0.21}, [{"on": "left", "flux": "-f*a"}, HELD], END, **FLAT),
    "foundation": lambda: string({"s": "sqrt(k)", "m": "f/k/(f/k - c)", "a": "log(m + sqrt(m^2 - 1))/s"},
                                 [{"on": "left", "value": 0}, HELD],
                                 "where(x < a, f/k - (f/k - c)*cosh(s*(a - x)), c)", foundation="k", **FLAT),
    "smooth obstacle": lambda: below(tension=1, load="-u2 - push"),
    "tension": lambda: below(tension="1 + x", load="-(1 + x)*u2 - u1 - push"),
    "tension alone": lambda: string({"C": "1/ln(2)"}, [{"value": 0}], "C*ln(1 + x) - x", tension="1 + x", load=1,
                                    lower=-1),
    "foundation and tension": lambda: below(tension="exp(x)", foundation="2 + x",
                                            load="-exp(x)*(u2 + u1) + (2 + x)*w - push"),
    "point load": lambda: string({}, [{"value": "w"}], "w",
                                 define={"a": 0.37, "w": "where(x < a, 4*(a - x)^2, 0) + max(0.1 - x, 0)"}, tension=1,
                                 load="where(x < a, -8, -3)", lower=0, point_load=[{"at": [0.1], "force": -1}]),
}  # fmt: skip


def closed(name, cells):
    scene = CLOSED[name]() if name in CLOSED else catalogue.scene(f"string_{name}")
    return scene.change({"solve.element": "P2", "mesh.cells": cells})


@pytest.mark.parametrize("name", [*CLOSED, *STRINGS])
def test_bounds_of_closed_forms(name):
    """Loads, tensions and obstacles change inside cells: every bound is certified and above the true error, at two eps
    and without a penalty."""
    for cells in (20, 40) if name in KINKED else (16, 37):
        for options in ({}, {"eps": 1e-3}, {"method": "vi"}):
            answer = solve(closed(name, cells), bound=True, **options)
            assert answer.bound.guaranteed, answer.bound.words
            assert answer.bound.total >= answer.record["errors"]["energy"] * (1 - 1e-9) - 1e-12


@pytest.mark.parametrize("name", ["smooth obstacle", "foundation", "spring"])
def test_orders_with_contact(name):
    """A cell that is cut by the free boundary has an error of h^(3/2), and the bound no lower order."""
    worst = []
    for times in (1, 8):  # the place of the free boundary in its cell matters
        found = [solve(closed(name, times * cells), method="vi", bound=True) for cells in (10, 11, 13)]
        worst.append((max(one.record["errors"]["energy"] for one in found), max(one.bound.total for one in found)))
    for coarse, fine in zip(*worst, strict=True):
        assert fine < 1.5 / 8**1.5 * coarse


def test_orders_without_contact():
    """Energy 2, L2 3; the bound is at most a third larger than the error."""
    scene = Scene(mesh={"shape": "interval", "cells": 8}, tension=1, load="pi^2*sin(pi*x)", lower=-1,
                  boundary=[{"value": 0}], exact={"u": "sin(pi*x)"}).change({"solve.element": "P2"})  # fmt: skip
    coarse, fine = (solve(scene.change({"mesh.cells": cells}), bound=True) for cells in (8, 32))
    errors, finer = coarse.record["errors"], fine.record["errors"]
    assert errors["energy"] / finer["energy"] == pytest.approx(16, rel=0.05)
    assert errors["l2"] / finer["l2"] == pytest.approx(64, rel=0.05)
    assert finer["energy"] <= fine.bound.total <= 4 / 3 * finer["energy"]


@pytest.mark.parametrize("name", STRINGS)
def test_tolerance(name):
    """300 unknowns are enough for a certified error of 1e-6."""
    method = "vi" if name == "wedge" else "penalty"  # for the wedge eps would fall below its limit of round-off
    answer = solve(catalogue.scene(f"string_{name}"), element="P2", tol=1e-6, method=method)
    assert answer.bound.guaranteed and answer.bound.relative <= 1e-6 and answer.record["dofs"] <= 300
    assert answer.record["errors"]["energy"] <= answer.bound.total


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mu_jump", "torsion"])
def test_a_tenth_of_the_unknowns(name):
    """P1 needs ten times as many for 1e-4."""
    scene = catalogue.scene(f"string_{name}")
    linear, quadratic = (solve(scene, element=element, tol=1e-4) for element in ("P1", "P2"))
    assert quadratic.record["dofs"] <= linear.record["dofs"] / 10


@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_steps_do_not_grow(method):
    """Multigrid of P1 below P2, for scenes and for forms; the same values as from a cold start."""
    for cells in (40, 640):
        scene = catalogue.scene("string_two_obstacles").change({"solve.element": "P2", "mesh.cells": cells})
        nested, cold = solve(scene, method=method), solve(scene, method=method, start="cold")
        assert nested.record["newton_iterations"] <= 4
        assert nested.record["errors"]["energy"] == pytest.approx(cold.record["errors"]["energy"], rel=1e-7)
    domain = dmesh.create_unit_interval(COMM, 2000)  # meshes of fewer unknowns have no coarse levels
    u = fem.Function(releases.functionspace(domain, "Lagrange", 2))
    v = ufl.TestFunction(u.function_space)
    ends = fem.locate_dofs_geometrical(u.function_space, lambda x: np.isclose(abs(x[0] - 0.5), 0.5))
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - 8 * v * ufl.dx
    problem = ObstacleProblem(F, u, bcs=[fem.dirichletbc(0.0, ends, u.function_space)], upper=0.3)
    solution = problem.solve(method=method)
    assert solution.record["element"] == "P2" and solution.record["newton_iterations"] <= 4
    a = np.sqrt(0.3 / 4)
    assert solution.at([0.1]) == pytest.approx(8 * (a * 0.1 - 0.005), abs=1e-6)
    assert solution.force.upper == pytest.approx(8 * (1 - 2 * a), rel=1e-4)
    assert solution.area == pytest.approx(1 - 2 * a, rel=1e-3)


def test_saved_results(folder):
    """A saved answer has the nodes of P2, values between them, and the same bound."""
    answer = solve(closed("smooth obstacle", 16), bound=True)
    answer.save(folder)
    read = Solution.read(folder)
    for name in ("u", "pressure"):
        assert read.at([0.111], name) == pytest.approx(answer.at([0.111], name), rel=1e-12, abs=1e-12)
    assert read.bound.total == pytest.approx(answer.bound.total, rel=1e-12)

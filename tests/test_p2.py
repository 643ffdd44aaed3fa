"""P2, with contact at the middles of edges and Simpson's rule on intervals: solved by multigrid, bounded, refined."""

from contextlib import closing

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.answers.adapt import Adaptation
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.contact_set import touching
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.scenes import catalogue
from tests.conftest import COMM, DEMOS, membrane, slow_except
from tests.helpers import Membrane


def quadratic(name, **changes):
    return catalogue.scene(name).change({"solve.element": "P2", "mesh.cells": 16, **changes})


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(["penalty", "vi"], "vi"))
def test_steps_do_not_grow(method):
    """Multigrid of P1 below P2: from P1 on the same mesh few Newton and CG steps lead to the cold solution."""
    for name in ("ball", "nsv"):
        scene = quadratic(name, **{"solve.method": method, "mesh.cells": 32})
        nested, cold = solve(scene), solve(scene, start="cold")
        assert nested.record["newton_iterations"] <= 4 and nested.record["krylov_iterations"] <= 25
        for key in ("energy", "l2", "max"):
            assert nested.record["errors"][key] == pytest.approx(cold.record["errors"][key], rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("perturb", [0.0, 0.3])
def test_the_flux_is_in_balance(perturb):
    """With f, lambda, nu and rho in each cell; the normal part and its moment are continuous, and patches close."""
    for name in ("ball", "two_obstacle_square"):
        with closing(SolverContext(quadratic(name, **{"mesh.perturb": perturb}))) as context:
            context.answer(bound=True)
            element, problem = context.estimator.element, context.problem
            flux = element.equilibration.flux(problem.solution().x.array, *touching(problem))
            simplices = element.simplices
            load = element.equilibration.load.moments.sum(axis=(1, 2))
            others = (flux.lower - flux.upper + flux.rest).mean(axis=1) * simplices.area
            scale = largest(COMM, np.abs(flux.normal))
            assert largest(COMM, np.abs(flux.normal.sum(axis=1) + load + others)) < 1e-14 * max(scale, 1)
            facets, count = simplices.facets.ravel(), np.bincount(simplices.facets.ravel())
            inside = count == 2
            both = np.bincount(facets, weights=flux.normal.ravel())[inside]
            # out of the other cell, along the other direction: the moment is the same number
            moments = flux.moments[:, [1, 3, 5]].ravel()
            order = np.argsort(facets, kind="stable")
            twice = np.flatnonzero(facets[order][1:] == facets[order][:-1])
            jump = moments[order][twice] - moments[order][twice + 1]
            assert largest(COMM, np.abs(both)) < 1e-14 * scale and largest(COMM, np.abs(jump)) < 1e-14 * scale
            assert largest(COMM, np.abs(flux.rest)) < 1e-6


@pytest.mark.variant
@pytest.mark.slow
def test_adaptive_order():
    """The energy error of the ball falls faster than N^(-1.7/2), with its bound; on uniform meshes it is N^(-3/4)."""
    scene = quadratic("ball")
    rows = []
    with closing(Adaptation(scene, COMM).meshes(unknowns=8000)) as meshes:
        for context, answer in meshes:
            record = context.measured(answer).record
            rows.append((record["dofs"], record["errors"]["energy"], answer.bound.total))
            assert record["errors"]["energy"] <= answer.bound.total <= 4 * record["errors"]["energy"]
    dofs, error, bound = np.log(np.array(rows)).T
    for values in (error, bound):
        assert np.polyfit(dofs / 2, values, 1)[0] < -1.7
    first, second = (solve(scene, cells=cells).record["errors"]["energy"] for cells in (16, 64))
    assert np.log(first / second) / np.log(4) == pytest.approx(1.5, abs=0.2)


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball", "two_obstacle_square"])
def test_estimates_from_samples_are_near_the_bound(name):
    """Without enclosures of the obstacles the error is found within 10 %, and is no bound."""
    with closing(SolverContext(quadratic(name))) as context:
        bound = context.answer(bound=True, errors=False).bound
        context.estimator.sampled = True
        estimate = context.estimator.bound()
        assert bound.certified and not estimate.certified and not estimate.guaranteed
        assert 0.9 * bound.total < estimate.total < 1.01 * bound.total
        context.estimator.sampled = False
        assert context.estimator.bound().total == bound.total


@pytest.mark.variant
@pytest.mark.slow
def test_the_last_mesh_has_a_bound():
    """Without a budget the meshes before it have estimates; 1 % for the ball takes a tenth of the unknowns of P1."""
    answer = solve(quadratic("ball"), tol=0.01)
    record = answer.record
    assert record["adaptive"]["reached"] and record["errors"]["energy"] <= answer.bound.total and answer.dofs < 8000
    path = answer.record["adaptive"]["path"]
    assert [mesh["sampled"] for mesh in path] == [*[True] * (len(path) - 1), False]
    assert (
        answer.bound.certified
        and path[-1]["total"] == answer.bound.total <= 0.01 * answer.bound.total / answer.bound.relative
    )
    limited = solve(quadratic("ball"), tol=0.01, budget="10min")
    assert not any(mesh.sampled for mesh in limited.adaptive.path)
    few = solve(quadratic("ball"), tol=1e-4, budget="2000 unknowns")
    assert not few.adaptive.reached and few.bound.certified and not few.adaptive.path[-1].sampled


@pytest.mark.variant
@pytest.mark.slow
def test_free_sides_and_other_effects():
    """Nothing leaves through free sides; effects besides tension and load are refused, and surfaces in space."""
    exact = "sin(pi*x/2)*sin(pi*y)"
    free = membrane(
        load=f"1.25*pi^2*{exact}", lower=-10, exact=exact, boundary=[{"on": ["left", "top", "bottom"], "value": 0}]
    ).change({"solve.element": "P2"})
    answer = solve(free, bound=True)
    error = answer.record["errors"]["energy"]
    assert answer.bound.words == "certified" and error <= answer.bound.total <= 1.5 * error
    with pytest.raises(InputError, match="not for foundation"):
        solve(membrane(load=1, upper=0.05, foundation=20).change({"solve.element": "P2"}), bound=True)
    bearing = Scene.read(DEMOS / "bearing.toml").change({"solve.element": "P2", "report": {}})
    with pytest.raises(InputError, match="not for P2 on triangle cells in 3D"):
        solve(bearing, bound=True)


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
    """Data change inside cells: every bound is certified and above the true error, at two eps and without a penalty."""
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
                  exact={"u": "sin(pi*x)"}).change({"solve.element": "P2"})  # fmt: skip
    coarse, fine = (solve(scene.change({"mesh.cells": cells}), bound=True) for cells in (8, 32))
    errors, finer = coarse.record["errors"], fine.record["errors"]
    assert errors["energy"] / finer["energy"] == pytest.approx(16, rel=0.05)
    assert errors["l2"] / finer["l2"] == pytest.approx(64, rel=0.05)
    assert finer["energy"] <= fine.bound.total <= 4 / 3 * finer["energy"]


@pytest.mark.parametrize("name", STRINGS)
def test_tolerance_on_intervals(name):
    """300 unknowns are enough for a certified error of 1e-6."""
    method = "vi" if name == "wedge" else "penalty"  # for the wedge eps would fall below its limit of round-off
    answer = solve(catalogue.scene(f"string_{name}"), element="P2", tol=1e-6, method=method)
    assert answer.bound.guaranteed and answer.bound.relative <= 1e-6 and answer.record["dofs"] <= 300
    assert answer.record["errors"]["energy"] <= answer.bound.total


@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_steps_do_not_grow_on_intervals(method):
    """Multigrid of P1 below P2, for scenes and for forms; the same values as from a cold start."""
    for cells in (40, 640):
        scene = catalogue.scene("string_two_obstacles").change({"solve.element": "P2", "mesh.cells": cells})
        nested, cold = solve(scene, method=method), solve(scene, method=method, start="cold")
        assert nested.record["newton_iterations"] <= 4
        assert nested.record["errors"]["energy"] == pytest.approx(cold.record["errors"]["energy"], rel=1e-7)
    own = Membrane(dmesh.create_unit_interval(COMM, 2000), 2)  # meshes of fewer unknowns have no coarse levels
    solution = own.problem(upper=0.3).solve(method=method)
    assert solution.record["element"] == "P2" and solution.record["newton_iterations"] <= 4
    a = np.sqrt(0.3 / 4)
    assert solution.at([0.1]) == pytest.approx(8 * (a * 0.1 - 0.005), abs=1e-6)
    assert solution.force.upper == pytest.approx(8 * (1 - 2 * a), rel=1e-4)
    assert solution.area == pytest.approx(1 - 2 * a, rel=1e-3)

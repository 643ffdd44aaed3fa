"""Error bounds with foundations, fluxes and springs: in balance, never below a known error, near it."""

import numpy as np
import pytest

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import largest
from tests.conftest import COMM

OVER = "max(0.8*x + 0.6*y - 0.45, 0)"
CONTACT = f"{OVER}^2/2"
WAVE = "sin(2*x)*exp(y)"
SQUARE = {"shape": "rectangle", "cells": 16, "perturb": 0.2}
SCENES = {
    "contact on a foundation": Scene(
        mesh=SQUARE, tension=1, foundation=30, load=f"30*{CONTACT} - 1", lower=0, exact=CONTACT,
        boundary=[{"on": ["left", "bottom"], "value": CONTACT}, {"on": "top", "flux": f"0.6*{OVER}"},
                  {"on": "right", "flux": f"0.8*{OVER} + 2*{CONTACT}", "spring": 2}],
    ),
    "data that jump": Scene(
        mesh=SQUARE, tension="1 + x", foundation="where(x < 0.503, 1, 2 + y)", exact=WAVE,
        load=f"3*(1 + x)*{WAVE} - 2*cos(2*x)*exp(y) + where(x < 0.503, 1, 2 + y)*{WAVE}",
        boundary=[{"on": ["left", "bottom"], "value": WAVE}, {"on": "right", "flux": "4*cos(2)*exp(y)"},
                  {"on": "top", "flux": f"(1 + x)*{WAVE} + where(x < 0.303, 0, 3)*{WAVE}",
                   "spring": "where(x < 0.303, 0, 3)"}],
    ),
    "string": Scene(
        mesh={"shape": "interval", "x": [0, 1], "cells": 16}, tension=1, foundation=7, lower=0,
        load="7*max(x - 0.3, 0)^2/2 - 1", exact="max(x - 0.3, 0)^2/2",
        boundary=[{"on": "left", "value": 0}, {"on": "right", "flux": "0.7 + 2*0.49", "spring": 4}],
    ),
    "solid": Scene(
        mesh={"shape": "box", "cells": 4, "perturb": 0.2}, tension=1, foundation=6, load=f"9*{WAVE}*(1 + z)",
        boundary=[{"on": ["left", "right", "bottom", "top"], "value": f"{WAVE}*(1 + z)"},
                  {"on": "back", "flux": f"-{WAVE} + 2*{WAVE}", "spring": 2}, {"on": "front", "flux": WAVE}],
        exact=f"{WAVE}*(1 + z)",
    ),
}  # fmt: skip

GEO = """SetFactory("Built-in");
Point(1) = {0, 0, 0, 0.2}; Point(2) = {0.5, 0, 0, 0.2}; Point(3) = {1, 0, 0, 0.2};
Point(4) = {1, 1, 0, 0.2}; Point(5) = {0.5, 1, 0, 0.2}; Point(6) = {0, 1, 0, 0.2};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 6}; Line(6) = {6, 1};
Line(7) = {2, 5};
Curve Loop(1) = {1, 7, 5, 6}; Curve Loop(2) = {2, 3, 4, -7};
Plane Surface(1) = {1}; Plane Surface(2) = {2};
Physical Curve("sides") = {3, 6}; Physical Curve("wire") = {7};
Physical Surface("film") = {1, 2};
"""


@pytest.mark.parametrize("name", SCENES)
def test_no_known_error_is_above_its_bound(name):
    """For all eps bounds of u_h and v_h are above the errors and near them, and nothing is sampled in the plane."""
    scene = SCENES[name]
    context = SolverContext(scene)
    for eps in ("h", "auto") if "lower" in scene.toml() else ("auto",):
        answer = context.answer(scene.options_with(eps=eps), bound=True)
        of_v, _ = context.exact.errors(answer.bound.admissible, answer.pressure, answer.record["eps"])
        assert answer.bound.guaranteed or (name == "solid" and "sampled boundary value" in answer.bound.words)
        assert answer.record["errors"]["energy"] <= answer.bound.total <= 5 * answer.record["errors"]["energy"]
        assert of_v["energy"] <= answer.bound.admissible_total
    context.close()


@pytest.mark.parametrize("name", SCENES)
def test_the_flux_is_in_balance(name):
    """div sigma = -(f_0 - k u + lambda - nu + rho) in each cell, sigma . n = g - k u on the parts, or continuous."""
    context = SolverContext(SCENES[name])
    context.answer()
    problem, element = context.problem, context.estimator.element
    simplices, equilibration, u = element.simplices, element.equilibration, problem.solution().x.array
    lower = problem.gaps()[0] <= 0
    flux = equilibration.flux(u, lower, np.zeros_like(lower))
    force = (flux.lower - flux.upper + flux.rest[simplices.dofs]).mean(axis=1) + flux.averaged
    force += (equilibration.load.moments - equilibration.reaction.forces(u)).sum(axis=1) / simplices.area
    scale = largest(COMM, np.abs(flux.normal))
    assert largest(COMM, np.abs(flux.normal.sum(axis=1) + simplices.area * force)) < 1e-12 * scale
    sides = simplices.facets.ravel()
    both, times = np.bincount(sides, weights=flux.normal.ravel()), np.bincount(sides)
    assert largest(COMM, np.abs(both[times == 2])) <= 1e-14 * scale
    parts = equilibration.parts
    through = flux.normal[parts.cells, parts.sides] - flux.force.sum(axis=1)
    assert largest(COMM, np.abs(through[parts.free])) <= 1e-14 * scale
    solver = parts.size * ((parts.nodal[0] - parts.nodal[1] * u[parts.dofs]).mean(axis=1))
    assert largest(COMM, np.abs(solver - flux.force.sum(axis=1))[parts.free]) < 0.1 * scale
    context.close()


@pytest.mark.parametrize("stiff", [1e-6, 1.0, 1e2, 1e4, 1e6, 1e8])
def test_foundations_of_any_stiffness(stiff):
    """The bound of a(e, e)^(1/2) is above the error and near it, also far beyond tension/h^2."""
    scene = Scene(mesh=SQUARE, tension=1, foundation=stiff, load=f"({stiff!r} + 3)*{WAVE}", exact=WAVE,
                  boundary=[{"value": WAVE}])  # fmt: skip
    answer = solve(scene, bound=True)
    error = np.hypot(answer.record["errors"]["energy"], stiff**0.5 * answer.record["errors"]["l2"])
    assert answer.bound.guaranteed
    assert error <= answer.bound.total <= 8 * error


@pytest.mark.slow
def test_load_and_springs_along_a_curve_inside(folder):
    """A wire across a square, [du/dn] = 3 - 4 u: certified, above the error and near it."""
    if COMM.rank == 0:
        (folder / "wire.geo").write_text(GEO)
    COMM.barrier()
    parts = [{"on": "sides", "value": 0}, {"on": "wire", "flux": 3, "spring": 4}]
    answer = solve(Scene(mesh={"file": str(folder / "wire.geo")}, tension=1, load=2, boundary=parts,
                         exact="where(x < 0.5, x, 1 - x)/2 + x*(1 - x)"), bound=True)  # fmt: skip
    assert answer.bound.guaranteed
    assert answer.record["errors"]["energy"] <= answer.bound.total <= 2 * answer.record["errors"]["energy"]


@pytest.mark.slow
def test_a_tolerance_with_springs():
    """Adaptive meshes: the bound of a scene with all of them reaches its tolerance, and holds."""
    answer = solve(SCENES["contact on a foundation"].change({"mesh.cells": 4}), tol=0.05)
    assert answer.bound.guaranteed and answer.bound.relative <= 0.05
    assert answer.record["errors"]["energy"] <= answer.bound.total


def test_a_part_that_ends_inside_an_edge():
    """A flux whose `where` ends between two vertices: an indicator."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 8}, tension=1, load=1,
                  boundary=[{"on": "left", "value": 0}, {"where": "x > 1 - 1e-9 and y < 0.55", "flux": 1}])  # fmt: skip
    bound = solve(scene, bound=True).bound
    assert not bound.guaranteed and "is not made of whole edges" in bound.words

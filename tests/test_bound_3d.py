"""Error bounds on intervals and tetrahedra: in balance, never below a known error."""

from dataclasses import replace

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Scene, polynomials, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.boundary_data import slopes_on_facets
from fenicsx_obstacle.estimation.pieces import Group
from fenicsx_obstacle.parallel import largest
from tests.conftest import COMM

SIDES = [-1, 1]
BOX = {"shape": "box", "x": SIDES, "y": SIDES, "z": SIDES, "cells": 4, "perturb": 0.2}
BALL = "r^2/6 + 0.6^3/(3*r) - 0.6^2/2"
CROSSING = "-(where(x > 0.4, 1, 0)*max(y - 0.4, 0)^2 + where(y > 0.4, 1, 0)*max(x - 0.4, 0)^2)/2"
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
    context.close()


def test_held_surfaces_inside():
    """Where u is given on a surface inside the flux may jump: two boxes side by side, each on its own."""

    def scene(mesh, sides):
        return Scene(mesh=mesh, tension=1, load="abs(sin(pi*x))*y", lower=-1, boundary=[{"on": sides, "value": 0}])

    box = {"shape": "box", "x": [-1, 1], "y": [0, 1], "z": [0, 1], "cells": 4}
    level = SolverContext(scene(box, "left")).problem.level
    middle = dmesh.locate_entities(level.mesh, 2, lambda x: np.isclose(x[0], 0))
    ends = dmesh.locate_entities(level.mesh, 2, lambda x: np.isclose(np.abs(x[0]), 1))
    own = replace(level, facets={"middle": middle, "ends": ends}, coarse=None, parents=None, places=None, shape=None)
    both = SolverContext(scene(level.mesh, ["middle", "ends"]), level=own).answer(bound=True).bound
    one = solve(scene({**box, "x": [0, 1], "cells": 2}, ["left", "right"]), bound=True).bound
    assert np.isclose(both.discretisation, np.sqrt(2) * one.discretisation, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exact", "data", "effectivity"),
    [
        ("max(x - 0.4, 0)^2*max(y - 0.4, 0)^2/4", {"load": CROSSING}, 4),
        ("max(x - 0.4, 0)*max(y - 0.4, 0)", {"load": 1, "upper": "u_exact"}, np.inf),
        ("where(x > 0.4 and y > 0.4, (x - 0.4)*(y - 0.4), 0)", {"load": 1, "upper": "u_exact"}, np.inf),
        ("abs(x - 0.3)*abs(y - 0.3)", {"load": 1, "upper": "u_exact"}, np.inf),
    ],
)
def test_kinks_that_cross_on_facets(exact, data, effectivity):
    """Two cuts of a facet leave parts without an area; the bound is above the error, which is known."""
    scene = Scene(
        mesh={"shape": "box", "cells": 4}, tension=1, define={"u_exact": exact}, exact="u_exact",
        boundary=[{"value": "u_exact"}], **data,
    )  # fmt: skip
    context = SolverContext(scene)
    answer = context.answer(bound=True)
    error = answer.record["errors"]["energy"]
    assert "certified" in answer.bound.words
    assert error <= answer.bound.total <= effectivity * error
    context.close()


@pytest.mark.serial
@pytest.mark.parametrize("width", [0.3, 1e-6, 1e-12, 1e-17, 0.0])
def test_slopes_on_narrow_parts_of_facets(width):
    """They are those of the polynomial; on parts that are lines, up to round-off, those along the line."""
    rng = np.random.default_rng(3)
    x, slope = 1e3 + rng.random((1, 3, 3)), np.array([0.7, -1.3])  # of a linear function of the last two coordinates
    corners = np.array([[[0.2, 0.5, 0.3], [0.4, 0.3, 0.3], [0.3 - width, 0.4, 0.3 + width]]])
    group = Group(
        np.zeros(1, dtype=int), corners, np.ones(1), 1, corners[..., 1:] @ slope, *np.zeros((4, 1)), smooth=True
    )
    found, height = slopes_on_facets(group, polynomials.slopes(group.coefficients, 3, 1), x)
    edges = x[0, 1:] - x[0, 0]
    gradient = np.linalg.lstsq(edges, slope, rcond=None)[0]
    along = (corners[0, 1] - corners[0, 0]) @ x[0]
    length = np.linalg.norm(along)
    if width > 1e-14:
        assert found[0] == pytest.approx(np.linalg.norm(gradient), rel=1e-15 / width + 1e-9)
        assert height[0] <= 2 * width * np.linalg.norm(edges, axis=1).max()
    else:
        assert found[0] == pytest.approx(abs(gradient @ along) / length) and height[0] == pytest.approx(length)

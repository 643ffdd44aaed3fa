"""Bounds of the error stay near it where data are extreme: obstacles far away, vertical sides, loads that oscillate."""

import itertools
from functools import cache
from typing import Any

import numpy as np
import pytest
from dolfinx import fem

from fenicsx_obstacle import Answer, Scene, compare, polynomials, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.contact_set import touching
from fenicsx_obstacle.estimation.bound import Bound
from fenicsx_obstacle.estimation.oscillation import _energies, poincare
from fenicsx_obstacle.parallel import largest, smallest
from fenicsx_obstacle.releases import add_ghosts
from tests.conftest import COMM, membrane

FINE = 64
INSIDE = "hypot(x - 1/2, y - 1/2) < 1/5"


@cache
def reference(given: tuple[tuple[str, Any], ...]) -> Answer:
    """A solution on a mesh of 64 x 64 squares."""
    return solve(scene(FINE, **dict(given)), eps=1e-10)


def scene(cells: int, **given: Any) -> Scene:
    """On a square with 1 as the tension, u = 0 on the boundary."""
    return membrane(mesh={"shape": "rectangle", "cells": cells}, **given)


def compared(cells: int, element: str = "P1", **given: Any) -> tuple[Bound, float]:
    """The bound, and the distance to the reference."""
    answer = solve(scene(cells, **given), bound=True, element=element, eps="h^2")
    return answer.bound, compare(answer, reference(tuple(given.items())))["u"]["energy"]


@pytest.mark.slow
@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize(("given", "most"), [
    ({"load": 1, "lower": -1e20}, 2),
    ({"load": -1, "lower": f"where({INSIDE}, -0.02, -1e20)"}, 40),
    ({"load": 1, "upper": f"where({INSIDE}, 0.02, 1e20)", "lower": -1e20}, 40),
])  # fmt: skip
def test_obstacles_out_of_reach(given, most, element):
    """They are cut off where u cannot be: the bound does not know how far below they are."""
    bound, error = compared(16, element, **given)
    assert error <= bound.total <= most * error
    nearer = {key: str(value).replace("1e20", "1e10") for key, value in given.items()}
    assert np.isclose(compared(16, element, **nearer)[0].total, bound.total, rtol=1e-6)


def test_kinks_of_boundary_values_inside_facets():
    """A remainder, whose terms jump where it has a kink: its slope there is that of samples."""
    boundary = [{"value": "(x % 0.35)*(0.35 - x % 0.35)"}]
    fine = solve(scene(FINE, boundary=boundary))
    for element in ("P1", "P2"):
        answer = solve(scene(8, boundary=boundary), bound=True, element=element)
        error = compare(answer, fine)["u"]["energy"]
        assert error <= answer.bound.total <= 5 * error


BLOCK = "max(abs(x - 1/2), abs(y - 1/2)) <= {}"


@pytest.mark.slow
@pytest.mark.parametrize(("element", "half", "most"), [("P1", 0.25, 3.5), ("P1", 0.26, 6.5), ("P2", 0.25, 4.5)])
def test_blocks_with_vertical_sides(element, half, most):
    """However deep, pushed from either side: the contact force counts where u is near the block."""
    bounds = []
    for depth in (0.3, 10):
        given = {"load": -1, "lower": f"where({BLOCK.format(half)}, 0.3, -{depth})"}
        bound, error = compared(16, element, **given)
        assert error <= bound.total <= most * error
        bounds.append(bound.total)
    assert np.isclose(*bounds, rtol=1e-9)
    other = compared(16, element, load=1, upper=f"where({BLOCK.format(half)}, -0.3, 10)")[0]
    assert np.isclose(other.total, bounds[0], rtol=1e-9)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_forces_keep_their_sum(element):
    """Wherever contact forces are put, those of a patch add up to the same, with their sign."""
    context = SolverContext(
        scene(16, load=-1, lower=f"where({BLOCK.format(0.26)}, 0.3, -10)").change({"solve.element": element})
    )
    context.answer()
    problem, found = context.problem, context.estimator.element
    simplices = found.simplices
    state = problem.solution().x.array, *touching(problem)
    nodal = found.equilibration.flux(*state).lower
    far = np.linspace(0, 1, len(simplices.area))  # of each cell, in no order
    moved = found.equilibration.flux(*state, (far, None)).lower
    assert moved.min(initial=0.0) >= 0 and np.any(moved != nodal)
    dofs = simplices.dofs if element == "P1" else found.equilibration.nodes[:, 3:]
    force = fem.Function(problem.level.V)
    for values, sign in ((nodal, 1), (moved, -1)):
        np.add.at(force.x.array, dofs, sign * simplices.area[:, None] * values)
    add_ghosts(force)
    scale = largest(COMM, nodal) * largest(COMM, simplices.area)
    free = np.setdiff1d(np.arange(problem.level.owned), problem.data.fixed[0])
    assert scale > 0 and largest(COMM, np.abs(force.x.array[free])) <= 1e-12 * scale


@pytest.mark.slow
@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize("waves", [2, 6, 19])
def test_loads_that_oscillate(element, waves):
    """Whether the mesh resolves them or not; the solution is known."""
    u = f"sin({waves}*pi*x)*sin({waves}*pi*y)"
    for cells, perturb in ((4, 0.0), (8, 0.3), (32, 0.0)):
        mesh = {"shape": "rectangle", "cells": cells, "perturb": perturb}
        given = membrane(mesh=mesh, load=f"{2 * waves**2}*pi^2*{u}", exact=u)
        answer = solve(given, bound=True, element=element)
        error = answer.record["errors"]["energy"]
        assert error <= answer.bound.total * (1 + 1e-9)
        assert answer.bound.total <= (3 if element == "P1" else 4) * error


def test_poincare():
    """||tau|| of a load that is linear in one triangle: exact, by Poincare's constant, and by fluxes on its parts."""
    rng = np.random.default_rng(1)
    for x in (
        rng.normal(size=(3, 2)),
        np.array([(0, 0), (1, 0), (0, 1)]),
        np.array([(0, 0), (1, 0), (0.5, 0.75**0.5)]),
    ):
        area = abs(np.linalg.det(x[1:] - x[0])) / 2
        constant = poincare(x[None], np.array([area]))[0]
        metric = np.array([(x[1] - x[0]) @ (x[1] - x[0]), (x[1] - x[0]) @ (x[2] - x[0]), (x[2] - x[0]) @ (x[2] - x[0])])
        upper = []
        for depth in range(1, 5):
            inside = polynomials.halvings(3, depth)
            values = (inside @ x)[..., 0].mean(axis=1)  # the first coordinate
            means = (values - values.mean()) * area / len(values)
            squared = np.einsum("k,kij,i,j", metric / (2 * area), _energies(depth), means, means)
            spread = np.sqrt(area * np.mean((inside @ x)[..., 0].var(axis=1) / 4))
            upper.append(np.sqrt(squared) + constant / 2**depth * spread)
        variance = area * x[:, 0].var() / 4
        # (g, Q)/||grad Q|| <= ||tau|| for every Q; here Q = g
        assert variance / np.sqrt(area) <= min(upper) * (1 + 1e-9)
        assert upper[-1] <= upper[0] and upper[-1] <= constant * np.sqrt(variance) * 1.05


@pytest.mark.slow
def test_stiff_inclusions():
    """A square of a million times the tension, along mesh lines: no cell beside it counts as cut."""
    square = BLOCK.format(0.25)
    bounds = [
        solve(scene(cells, tension=f"where({square}, 1e6, 1)", load=1, upper=0.05), bound=True, eps=1e-10).bound
        for cells in (8, 16, 32)
    ]
    assert bounds[1].total < 0.03  # the true error is 0.021
    assert all(fine.total < 0.7 * coarse.total for coarse, fine in itertools.pairwise(bounds))


@pytest.mark.slow
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_pole_leaves_the_solution_as_it_is(element):
    """A bound of a load, 1e21 at its pole, is no force: u = r^0.1 stays between its boundary values."""
    answer = solve(
        membrane(load="-0.01*max(r, 1e-12)^(-1.9)", boundary=[{"value": "r^0.1"}]), bound=True, element=element
    )
    u = answer.u.x.array
    assert smallest(COMM, u) > -0.01 and largest(COMM, u) < 1.05
    assert answer.bound.total > 0.09  # the true error


def test_a_load_of_two_signs_in_one_cell():
    """Samples see the positive part of a load alone; a bound makes the solver use all of it, and u is negative."""
    scene = Scene(mesh={"shape": "interval", "cells": 2}, tension=1, load="where(x < 0.781, 1.45, -1.94)", upper=0,
                  boundary=[{"on": "left", "value": 0}])  # fmt: skip
    for method in ("penalty", "vi"):
        answer = solve(scene, method=method, bound=True)
        # u is 0 at 1/2, and its value at 1 the integral of (x - 1/2) f(x) from there
        assert answer.at([[1.0]])[0] == pytest.approx(1.45 * 0.281**2 / 2 - 1.94 * (0.5**2 - 0.281**2) / 2, rel=0.05)

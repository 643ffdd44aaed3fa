"""Scenes whose data are Functions, callables and UFL: the same as formulas, with bounds that name what was sampled."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.mesh.cells import corners
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.releases import functionspace, settle
from tests.conftest import COMM


def square(n=16):
    return settle(dmesh.create_unit_square(COMM, n, n))


def membrane(mesh, **given):
    """-div(tension grad u) = load + p, u >= lower, u = 0 on the boundary unless other parts are given."""
    return Scene(**{"mesh": mesh, "tension": 1, "load": -8, "lower": -0.1, "boundary": [{"value": 0}], **given})


def bound_of(scene, element="P1"):
    return solve(scene, element=element, bound=True).bound


def test_obstacles_and_boundary_values_may_be_functions():
    """A Function, a callable and UFL as obstacle and as boundary value give what the formula gives."""
    mesh = square(8)
    x = ufl.SpatialCoordinate(mesh)
    psi = fem.Function(functionspace(mesh, "Lagrange", 1))
    psi.interpolate(lambda x: 0.2 - np.hypot(x[0] - 0.5, x[1] - 0.5))
    formula = "0.2 - hypot(x - 0.5, y - 0.5)"
    exact, *found = (
        solve(membrane(mesh, load=0, lower=lower, boundary=[{"value": value}]), method="vi").u.x.array
        for lower, value in ((formula, "0.1*x"), (psi, lambda x: 0.1 * x[0]),
                             (lambda x: 0.2 - np.hypot(x[0] - 0.5, x[1] - 0.5), 0.1 * x[0]))
    )  # fmt: skip
    assert all(largest(COMM, np.abs(one - exact)) <= 1e-10 for one in found)


SAMPLED = {
    "load": lambda mesh: {"load": lambda x: -8 * (1 + x[0])},
    "tension": lambda mesh: {"tension": lambda x: 1 + x[0]},
    "obstacle": lambda mesh: {"lower": -0.1 + 0 * ufl.SpatialCoordinate(mesh)[0]},
    "boundary value": lambda mesh: {"boundary": [{"value": lambda x: 0.1 * x[0]}]},
}


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize("what", SAMPLED)
def test_bounds_say_what_was_sampled(what, element):
    """Of UFL or a callable nothing is known between its samples: the bound names it."""
    mesh = square()
    bound = bound_of(membrane(mesh, **SAMPLED[what](mesh)), element)
    assert bound.words.startswith("certified on the polygon of the mesh for the sampled")
    assert what in bound.words and not bound.guaranteed


def test_what_has_no_value_at_nodes():
    """Values by cells, and UFL of a Function that jumps, are refused as obstacles and boundary values."""
    mesh = square(8)
    mu = fem.Function(functionspace(mesh, "DG", 0))
    mu.interpolate(lambda x: np.where(x[0] < 0.5, 1.0, 10.0))
    for given, words in (
        ({"lower": {"all": 1.0}}, "lower unknown key 'all'"),
        ({"boundary": [{"value": {"all": 1.0}}]}, "value unknown key 'all'"),
        ({"lower": -1.0 * mu}, "is not continuous"),
        ({"tension": lambda x: x[0] - 2}, "must be positive"),
    ):
        with pytest.raises(InputError, match=words):
            solve(membrane(mesh, **given))


def test_data_outside_the_mesh_are_not_asked_for():
    """A table that ends with the domain is a tension like any other."""

    def table(x):
        if x.size and (x.min() < -1e-9 or x.max() > 1 + 1e-9):
            raise ValueError("outside the table")
        return 2 + x[0]

    assert solve(membrane(square(8), tension=table)).force.lower > 0


def test_data_of_some_cells_on_any_number_of_ranks():
    """UFL in a few cells, and a callable that cannot take an empty x: no rank waits for another."""
    mesh = square()
    middle = corners(mesh).mean(axis=1)
    numbers = np.where(np.linalg.norm(middle[:, :2] - 0.05, axis=1) < 0.1, 1, 2).astype(np.int32)
    tags = dmesh.meshtags(mesh, 2, np.arange(len(numbers), dtype=np.int32), numbers)
    x = ufl.SpatialCoordinate(mesh)
    found = []
    for part in (-8 * (1 + x[0]), lambda x: -8 * (1 + x[0]) + 0 * x[0].max()):
        bound = bound_of(membrane(mesh, cell_tags=tags, cell_names={"few": 1, "rest": 2},
                                  load={"few": part, "rest": -1.0}))  # fmt: skip
        assert "sampled load" in bound.words
        found.append(bound.total)
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_functions_away_from_the_origin():
    """A Function as boundary value has a value at every point of its mesh, wherever that lies."""
    mesh = settle(dmesh.create_rectangle(COMM, [np.array([10.1, 10.1]), np.array([10.7, 10.7])], [9, 9]))
    value = fem.Function(functionspace(mesh, "Lagrange", 2))
    value.interpolate(lambda x: x[0] ** 2)
    assert np.isfinite(bound_of(membrane(mesh, lower=None, boundary=[{"value": value}]), "P2").total)

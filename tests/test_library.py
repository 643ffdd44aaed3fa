"""The core takes data from its caller: with the layer of scenes out of reach a problem is made, solved and bounded."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import InputError
from fenicsx_obstacle.algebra.newton import solve_penalty
from fenicsx_obstacle.algebra.vi import solve_vi
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.fields import field
from fenicsx_obstacle.data.model import Model, Part
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import find
from fenicsx_obstacle.estimation.bound import Estimator
from fenicsx_obstacle.forms.pairs import pairs
from fenicsx_obstacle.mesh.cells import corners, own_cells
from fenicsx_obstacle.mesh.levels import of_mesh, of_pair
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.releases import functionspace, settle

COMM = MPI.COMM_WORLD


@pytest.fixture(autouse=True)
def no_scenes(monkeypatch):
    """Imports of the layer of scenes fail, also late ones."""
    for name in [name for name in sys.modules if name.startswith("fenicsx_obstacle.scenes")]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "fenicsx_obstacle.scenes", None)


def square(n=16):
    return settle(dmesh.create_unit_square(COMM, n, n))


def membrane(level, *, tension=1.0, load=-8.0, lower=-0.1, upper=None, boundary=None):
    """-div(tension grad u) = load + p, lower <= u <= upper."""
    given = {"tension": tension, "load": load, "lower": lower, "upper": upper}
    fields = {key: None if value is None else field(value, f"test: {key}") for key, value in given.items()}
    effects = tuple(find(key)(fields[key]) for key in ("tension", "load"))
    parts = [Part("the boundary", value=field(0.0, "test: value"))] if boundary is None else boundary
    return Problem(Data(Model(effects, fields["lower"], fields["upper"], parts, source="test"), level))


def begun(problem):
    problem.set_reference(problem.cold_start())
    return problem


def u_values(problem):
    return problem.solution().x.array[: problem.level.owned]


def norm(problem, values):
    return np.sqrt(total(COMM, values**2 * problem.weights))


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_problem_from_fields_is_solved_and_bounded(element):
    """u_eps tends to u of SNES VI at the rate of eps; all data are numbers, and the mesh is the caller's."""
    level = of_pair(of_mesh(square(), "test"), pairs()[element])
    problem = membrane(level)
    solve_vi(begun(problem))
    exact = u_values(problem).copy()
    assert largest(COMM, -0.1 - exact[problem.weights > 0]) <= 1e-12
    bound = Estimator(problem).bound()
    assert 0 < bound.relative < (0.4 if element == "P1" else 0.1)
    assert bound.words.startswith("certified on the polygon of the mesh")
    for eps in (1e-3, 1e-6):
        solve_penalty(begun(problem), eps)
        assert norm(problem, u_values(problem) - exact) <= 10 * eps


def test_obstacles_and_boundary_values_may_be_functions():
    """A Function, a callable and UFL as obstacle and as boundary value give what the formula gives, on any level."""
    mesh = square(8)
    x = ufl.SpatialCoordinate(mesh)
    psi = fem.Function(functionspace(mesh, "Lagrange", 1))
    psi.interpolate(lambda x: 0.2 - np.hypot(x[0] - 0.5, x[1] - 0.5))
    found = []
    for lower, value in (
        (psi, lambda x: 0.1 * x[0]),
        (lambda x: 0.2 - np.hypot(x[0] - 0.5, x[1] - 0.5), 0.1 * x[0]),
    ):
        part = Part("all", value=field(value, "test: value"))
        problem = membrane(of_mesh(mesh, "test"), load=0.0, lower=lower, boundary=[part])
        solve_vi(begun(problem))
        found.append(u_values(problem).copy())
    assert largest(COMM, np.abs(found[0] - found[1])) <= 1e-10


def jumping(mesh):
    """A tension of 1 and 10, on whole cells."""
    mu = fem.Function(functionspace(mesh, "DG", 0))
    mu.interpolate(lambda x: np.where(x[0] < 0.5, 1.0, 10.0))
    return mu


SAMPLED = {
    "load": lambda mesh: {"load": lambda x: -8 * (1 + x[0])},
    "tension": lambda mesh: {"tension": lambda x: 1 + x[0]},
    "obstacle": lambda mesh: {"lower": -0.1 + 0 * ufl.SpatialCoordinate(mesh)[0]},
    "boundary value": lambda mesh: {"boundary": [Part("all", value=field(lambda x: 0.1 * x[0], "test: value"))]},
}


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize("what", SAMPLED)
def test_bounds_say_what_was_sampled(what, element):
    """Of UFL or a callable nothing is known between its samples: the bound names it."""
    mesh = square()
    problem = membrane(of_pair(of_mesh(mesh, "test"), pairs()[element]), **SAMPLED[what](mesh))
    solve_penalty(begun(problem), 1e-6)
    bound = Estimator(problem).bound()
    assert bound.words.startswith("certified on the polygon of the mesh for the sampled")
    assert what in bound.words and not bound.guaranteed


def test_parts_that_are_given_by_callables_may_end_inside_edges():
    """Where u is held is known at vertices only: the bound is an indicator, which names the part."""
    where = field(lambda x: (x[0] < 1e-9) & (x[1] < 0.311), "test: where")
    problem = membrane(
        of_mesh(square(), "test"), boundary=[Part("a side", where=where, value=field(0.0, "test: value"))]
    )
    solve_vi(begun(problem))
    assert Estimator(problem).bound().words.startswith("an indicator: a side where")


def test_one_datum_may_serve_twice():
    """A Field as two fluxes acts on both parts; as load and as tension it is checked as a tension."""
    level = of_mesh(square(8), "test")
    one = field(1.0, "test: flux")
    sides = [Part(side, where=field(where, f"test: {side}"))
             for side, where in (("left", lambda x: x[0] < 1e-9), ("right", lambda x: x[0] > 1 - 1e-9))]  # fmt: skip
    rest = Part("rest", where=field(lambda x: (x[1] < 1e-9) | (x[1] > 1 - 1e-9), "test: rest"), value=field(0.0, "v"))
    flux = find("flux")
    effects = (find("tension")(one), flux(one, 0), flux(one, 1))
    problem = Problem(Data(Model(effects, boundary=(*sides, rest), source="test"), level))
    assert problem.load == pytest.approx(2 * (1 - 1 / 8))  # of each side but for what its two held ends take
    negative = field(lambda x: x[0] - 2, "test: datum")
    with pytest.raises(InputError, match=r"test: datum.*must be positive"):
        Problem(
            Data(Model((find("load")(negative), find("tension")(negative)), None, None, [rest], source="test"), level)
        )


def test_what_has_no_value_at_nodes():
    """Values by cells, and UFL of a Function that jumps, are refused as obstacles and boundary values."""
    mesh = square(8)
    level = of_mesh(mesh, "test", None, {"all": np.arange(mesh.topology.index_map(2).size_local)})
    with pytest.raises(InputError, match="needs one formula for all materials"):
        membrane(level, lower={"all": 1.0})
    with pytest.raises(InputError, match="which cells share"):
        membrane(level, boundary=[Part("edge", value=field({"all": 1.0}, "test: value"))])
    with pytest.raises(InputError, match="is not continuous"):
        membrane(level, lower=-1.0 * jumping(mesh))


def test_data_outside_the_mesh_are_not_asked_for():
    """A table that ends with the domain is a tension like any other."""

    def table(x):
        if x.size and (x.min() < -1e-9 or x.max() > 1 + 1e-9):
            raise ValueError("outside the table")
        return 2 + x[0]

    problem = membrane(of_mesh(square(8), "test"), tension=table)
    assert largest(COMM, -problem.data.values(problem.model.effects[0].value)) < -2


def test_data_of_some_cells_on_any_number_of_ranks():
    """UFL in a few cells, and a callable that cannot take an empty x: no rank waits for another."""
    mesh = square()
    middle = corners(mesh)[: own_cells(mesh)].mean(axis=1)
    few = np.linalg.norm(middle[:, :2] - 0.05, axis=1) < 0.1
    groups = {"few": np.flatnonzero(few), "rest": np.flatnonzero(~few)}
    level = of_mesh(mesh, "test", None, groups)
    x = ufl.SpatialCoordinate(mesh)
    found = []
    for part in (-8 * (1 + x[0]), lambda x: -8 * (1 + x[0]) + 0 * x[0].max()):
        problem = membrane(level, load={"few": part, "rest": -1.0})
        solve_penalty(begun(problem), 1e-6)
        bound = Estimator(problem).bound()
        assert "sampled load" in bound.words
        found.append(bound.total)
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_functions_away_from_the_origin():
    """A Function as boundary value has a value at every point of its mesh, wherever that lies."""
    mesh = settle(dmesh.create_rectangle(COMM, [np.array([10.1, 10.1]), np.array([10.7, 10.7])], [9, 9]))
    value = fem.Function(functionspace(mesh, "Lagrange", 2))
    value.interpolate(lambda x: x[0] ** 2)
    level = of_pair(of_mesh(mesh, "test"), pairs()["P2"])
    problem = membrane(level, lower=None, boundary=[Part("all", value=field(value, "test: value"))])
    solve_penalty(begun(problem), 1.0)
    assert np.isfinite(Estimator(problem).bound().total)

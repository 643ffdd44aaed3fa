"""The public penalty(): one added line in somebody else's residual."""

import importlib
import sys
from functools import partial

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import InputError, contact_pressure, nodal_rule, penalty, releases
from fenicsx_obstacle.algebra.linear_solvers import defaults
from fenicsx_obstacle.discrete import assembly as discrete
from fenicsx_obstacle.forms.penalty import penalty_energy
from fenicsx_obstacle.parallel import largest, total
from tests.conftest import COMM, DEMOS
from tests.helpers import Membrane

sys.path.insert(0, str(DEMOS))


@pytest.fixture
def space():
    return releases.functionspace(releases.settle(dmesh.create_unit_square(COMM, 6, 6)), "Lagrange", 1)


def assembled(form, V):
    """A linear form at owned dofs."""
    return discrete.assembled(form, V).x.array[: V.dofmap.index_map.size_local * V.dofmap.index_map_bs]


def test_nodes_without_an_obstacle_do_not_hide_those_beside_them(space):
    """-1e20 at every other node leaves the term of the others; -inf would make them not-a-number, and is refused."""
    u, v, g = fem.Function(space), ufl.TestFunction(space), fem.Function(space)
    u.x.array[:], g.x.array[:] = -1.0, -0.5
    everywhere = assembled(penalty(u, v, lower=g, eps=1.0), space)
    none = np.round(6 * space.tabulate_dof_coordinates()[:, :2].sum(axis=1)).astype(int) % 2 == 0
    g.x.array[none] = -1e20
    own = space.dofmap.index_map.size_local
    expected = np.where(none[:own], 0.0, everywhere)
    assert np.allclose(assembled(penalty(u, v, lower=g, eps=1.0), space), expected, rtol=1e-12, atol=0)
    g.x.array[none] = -np.inf
    for obstacle in (g, g + 1, -np.inf):
        with pytest.raises(InputError, match="not finite"):
            penalty(u, v, lower=obstacle, eps=1.0)


def test_form_is_nodal(space):
    """(3.4): row i of (1/eps) I((u - g)^+, v) is D_i (u_i - g_i)^+ / eps, and its mirror image below."""
    u, v = fem.Function(space), ufl.TestFunction(space)
    u.interpolate(lambda x: np.sin(5 * x[0]) * np.cos(3 * x[1]))
    D = assembled(v * nodal_rule("triangle").on(ufl.dx), space)
    own = u.x.array[: len(D)]
    rows = assembled(penalty(u, v, upper=0.2, lower=-0.3, eps=1e-3), space)
    assert np.allclose(rows, D * (np.maximum(own - 0.2, 0) - np.maximum(-0.3 - own, 0)) / 1e-3, atol=1e-12)


def test_pressure_balances_the_penalty(space):
    """(3.7)-(3.8): I(p, v) = -(1/eps) I((u - g)^+, v); p <= 0 above, p >= 0 below."""
    u, v, g = fem.Function(space), ufl.TestFunction(space), fem.Function(space)
    u.interpolate(lambda x: np.sin(5 * x[0]))
    g.interpolate(lambda x: 0.1 + 0.2 * x[1])
    p = contact_pressure(u, upper=g, eps=1e-2)
    assert p.x.array.max() <= 0
    rule = nodal_rule("triangle")
    assert np.allclose(
        assembled(p * v * rule.on(ufl.dx), space), -assembled(penalty(u, v, upper=g, eps=1e-2), space), atol=1e-14
    )
    assert contact_pressure(u, lower=g, eps=1e-2).x.array.min() >= 0
    # an obstacle given as an expression is sampled at the nodes
    x = ufl.SpatialCoordinate(space.mesh)
    assert np.allclose(contact_pressure(u, upper=0.1 + 0.2 * x[1], eps=1e-2).x.array, p.x.array)


def test_penalty_is_the_derivative_of_its_energy(space):
    """(3.2)-(3.4): the convex functional I((u - g)^+ ^2, 1)/(2 eps)."""
    u, v = fem.Function(space), ufl.TestFunction(space)
    u.interpolate(lambda x: np.sin(5 * x[0]) - x[1])
    eps = fem.Constant(space.mesh, PETSc.ScalarType(0.1))
    energy = penalty_energy(u, eps=eps, dI=nodal_rule("triangle").on(ufl.dx), upper=0.1, lower=-0.2)
    difference = ufl.derivative(energy, u, v) - penalty(u, v, upper=0.1, lower=-0.2, eps=eps)
    assert np.abs(assembled(difference, space)).max() < 1e-14


def test_on_part_of_the_boundary(space):
    """Any measure: contact of the boundary only, by the vertex rule of the facets."""
    u, v = fem.Function(space), ufl.TestFunction(space)
    u.x.array[:] = 1.0
    rows = assembled(penalty(u, v, upper=0.5, eps=1.0, measure=ufl.ds), space)
    assert abs(total(COMM, rows) - 0.5 * 4) < 1e-13


@pytest.mark.parametrize("cell", [dmesh.CellType.triangle, dmesh.CellType.quadrilateral])
@pytest.mark.parametrize("kind", ["dx", "ds"])
def test_beside_terms_with_a_rule_of_one_point(cell, kind):
    """u and an obstacle at one point of the cells, or at the nodes, in other terms of F: the penalty is what it is in a
    form of its own, and so is its derivative, in any order, and with u replaced. FFCx takes values of one point for
    those of all rules."""
    mesh = releases.settle(dmesh.create_unit_square(COMM, 4, 4, cell))
    mesh.geometry.x[:, 0] += 0.1 * mesh.geometry.x[:, 0] * mesh.geometry.x[:, 1]
    V, measure = releases.functionspace(mesh, "Lagrange", 1), getattr(ufl, kind)
    u, v, g, x = fem.Function(V), ufl.TestFunction(V), fem.Function(V), ufl.SpatialCoordinate(mesh)
    u.interpolate(lambda x: np.sin(5 * x[0]) - x[1])
    g.interpolate(lambda x: 0.1 + 0.2 * x[1])
    rule = nodal_rule(releases.cell_name(mesh) if kind == "dx" else "interval")
    b = ufl.as_vector([1.0, 2.0])
    others = [(u + g + x[0]) * v * measure(degree=0), ufl.exp(u) * v * rule.on(measure)]
    others += [u * ufl.dot(b, ufl.grad(v)) * measure] if cell == dmesh.CellType.triangle else []
    term = penalty(u, v, upper=g + x[0], eps=1e-2, measure=measure)
    expected = sum(assembled(form, V) for form in (*others, term))
    along = sum(assembled(ufl.derivative(form, u, g), V) for form in (*others, term))
    assert largest(COMM, np.abs(assembled(term, V))) > 0.1
    for F in (sum(others) + term, term + sum(others), others[0] - -term + sum(others[1:])):
        assert np.allclose(assembled(F, V), expected, rtol=1e-9, atol=1e-9)
        assert np.allclose(assembled(ufl.derivative(F, u, g), V), along, rtol=1e-9, atol=1e-9)
        replaced = sum(assembled(ufl.replace(form, {u: u + g}), V) for form in (*others, term))
        assert np.allclose(assembled(ufl.replace(F, {u: u + g}), V), replaced, rtol=1e-9, atol=1e-9)


def test_component_of_a_vector():
    """Any scalar UFL: the vertical displacement of a vector field against a floor."""
    mesh = releases.settle(dmesh.create_unit_square(COMM, 3, 3))
    W = releases.functionspace(mesh, "Lagrange", 1, 2)
    w, v = fem.Function(W), ufl.TestFunction(W)
    rows = assembled(penalty(w[1], v[1], lower=0.25, eps=0.5), W)
    assert abs(total(COMM, rows) + 0.25 / 0.5) < 1e-14


def test_eps_is_never_compiled_in(space):
    """Two values of eps give the same form, with one Constant in it."""
    u, v = fem.Function(space), ufl.TestFunction(space)
    first, second = (penalty(u, v, upper=1.0, eps=eps) for eps in (1e-2, 1e-9))
    assert first.signature() == second.signature()


@pytest.mark.parametrize(("arguments", "message"), [
    ({"eps": 1.0}, "give an obstacle"),
    ({"eps": 0.0, "upper": 1.0}, "positive"),
    ({"eps": np.inf, "lower": 1.0}, "finite"),
])  # fmt: skip
def test_mistakes(space, arguments, message):
    u, v = fem.Function(space), ufl.TestFunction(space)
    with pytest.raises(InputError, match=message):
        penalty(u, v, **arguments)
    with pytest.raises(InputError, match=message):
        contact_pressure(u, **arguments)
    with pytest.raises(InputError, match="test function"):
        penalty(u, u, upper=1.0, eps=1.0)


@pytest.mark.parametrize("degree", [2, 3])
def test_degrees_without_a_rule(degree):
    """P2 and P3 on triangles have no nodal rule with positive weights: the message says what to take."""
    V = releases.functionspace(dmesh.create_unit_square(COMM, 2, 2), "Lagrange", degree)
    message = f"v has degree {degree} on a triangle: .* take degree 1, or degree 2 with ObstacleProblem"
    with pytest.raises(InputError, match=message):
        penalty(fem.Function(V), ufl.TestFunction(V), upper=1.0, eps=1.0)


def cells_of(kind, family, degree, components=None):
    return releases.functionspace(dmesh.create_rectangle(COMM, [np.zeros(2), np.ones(2)], [4, 4], kind), family, degree,
                                  components)  # fmt: skip


def test_obstacles_and_elements_without_values_at_the_nodes(space):
    """Another mesh, several values at a node, a vector, dofs that are no values: none is taken for something else."""
    u, v, triangle = fem.Function(space), ufl.TestFunction(space), dmesh.CellType.triangle
    elsewhere, jumping = (fem.Function(cells_of(triangle, "Lagrange", 1)),
                          fem.Function(releases.functionspace(space.mesh, "DG", 0)))  # fmt: skip
    cases = ((elsewhere, "another mesh"), (2 * elsewhere, "another mesh"), (jumping, "not continuous"),
             (ufl.SpatialCoordinate(space.mesh), "has the shape"), (np.array([0.3]), "expected a number"))  # fmt: skip
    for g, message in cases:
        for term in (partial(penalty, u, v), partial(contact_pressure, u)):
            with pytest.raises(InputError, match=message):
                term(lower=g, eps=1e-3)
    both = fem.Function(cells_of(triangle, "Lagrange", 1, 2))
    for part, message in (
        (both, "has the shape"),
        (both[0], "expected a Function"),
        (both.sub(0), "expected a Function"),
    ):
        with pytest.raises(InputError, match=message):
            contact_pressure(part, lower=0.0, eps=1.0)
    with pytest.raises(InputError, match=r"eps = .*: expected a number"):
        contact_pressure(u, lower=0.0, eps=2 * fem.Constant(space.mesh, 1.0))
    others = ((triangle, "CR", 1), (dmesh.CellType.quadrilateral, "DPC", 1), (dmesh.CellType.quadrilateral, "S", 2))
    line, kind = releases.settle(dmesh.create_unit_interval(COMM, 4)), basix.LagrangeVariant.bernstein
    made = basix.ufl.element if hasattr(basix, "ufl") else importlib.import_module("basix.ufl_wrapper").create_element
    bernstein = releases.space_of(line, made("Lagrange", "interval", 2, kind))
    for V in (*(cells_of(*other) for other in others), bernstein):
        w = fem.Function(V)
        for term in (partial(penalty, w, ufl.TestFunction(V)), partial(contact_pressure, w)):
            with pytest.raises(InputError, match="whose dofs are not all values at the nodes"):
                term(lower=0.0, eps=1.0)
    V = cells_of(triangle, "Lagrange", 2)  # Simpson's rule on its edges has positive weights
    form = penalty(fem.Function(V), ufl.TestFunction(V), upper=-1.0, eps=1.0, measure=ufl.ds)
    assert total(COMM, assembled(form, V)) == pytest.approx(4)


def obstacle(own):
    """The lower one of these tests."""
    return -0.3 - 0.2 * ufl.SpatialCoordinate(own.mesh)[0]


def newton_of_own(own, eps, divergence, linesearch):
    """PETSc's reason from the Newton solver of demos/one_added_line.py, in 15 steps from u = 0 (collective)."""
    from one_added_line import newton

    settings = {"snes_divergence_tolerance": divergence, "snes_linesearch_type": linesearch, "snes_max_it": 15}
    with defaults("", settings):
        return newton(own.F + penalty(own.u, own.v, lower=obstacle(own), eps=eps), own.u, own.bc, 1e-10)


@pytest.mark.slow
def test_settings_for_a_solver_of_your_own():
    """Full steps and no divergence tolerance: SNES finds the u of ObstacleProblem. Its defaults do not."""
    own = Membrane(releases.settle(dmesh.create_unit_square(COMM, 40, 40)), load=-10.0)
    for eps in (1e-5, 1e-8):
        assert newton_of_own(own, eps, 1e100, "basic") > 0
        found, p = own.u.x.array.copy(), contact_pressure(own.u, lower=obstacle(own), eps=eps)
        theirs = own.problem(lower=obstacle(own)).solve(eps=eps)
        assert largest(COMM, np.abs(theirs.u.x.array - found)) < 1e-9
        assert np.isclose(total(COMM, fem.assemble_scalar(releases.form(p * ufl.dx))), theirs.force.lower, rtol=1e-6)
        assert newton_of_own(own, eps, 1e4, "bt") < 0
    assert newton_of_own(own, 1e-8, 1e4, "basic") == PETSc.SNES.ConvergedReason.DIVERGED_DTOL

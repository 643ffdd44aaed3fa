"""Parts of a problem, cells and units of very different size: none is lost beside the others."""

import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, PenetrationWarning, Scene, releases, solve, solve_system
from tests.conftest import COMM
from tests.helpers import Membrane


def string(end, n=40):
    """Strings on [0, 1] with 100 cells and on [1, end] with n; the second has an obstacle at half its sag."""
    mesh = dmesh.create_unit_interval(COMM, 100 + n)
    t = mesh.geometry.x[:, 0] * (100 + n)
    mesh.geometry.x[:, 0] = np.where(t <= 100, t / 100, 1 + (end - 1) * (t - 100) / n)
    own = Membrane(mesh, load=-1.0)
    x, lower = own.V.tabulate_dof_coordinates()[:, 0], fem.Function(own.V)
    held = np.flatnonzero((x < 1e-12) | (np.abs(x - 1) < 1e-12) | (x > end - 1e-12)).astype(np.int32)
    lower.x.array[:] = np.where(x < 1 + 1e-9, -np.inf, -((end - 1) ** 2) / 16)
    return own.problem(bcs=[fem.dirichletbc(own.edge, held)], lower=lower)


@pytest.mark.parametrize("short", [0.01, 0.003, 0.001])
def test_the_penalty_fits_a_short_string_beside_a_long_one(short):
    """Its range of u is the scale there: force 2 (L/2 - (2 g)^(1/2)) for a load of 1 and an obstacle at -g."""
    problem = string(1 + short)
    force = 2 * (short / 2 - (short**2 / 8) ** 0.5)
    found = problem.solve()
    assert found.force.lower == pytest.approx(force, rel=0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # then on all ranks
        with pytest.raises(PenetrationWarning, match="in a part of the domain that given values separate"):
            problem.solve(eps=1e3 * found.eps)


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize(("cell", "least"), [("triangle", 1e-7), ("quadrilateral", 1e-6), ("hexahedron", 1e-5)])
def test_nodes_of_tiny_cells_are_points_of_the_rule(cell, least, method):
    """On a mesh graded to a corner, with an obstacle on the first nodes there, u is that obstacle."""
    if cell == "hexahedron":
        n, dim, mesh = 6, 3, dmesh.create_unit_cube(COMM, 6, 6, 6, dmesh.CellType.hexahedron)
    else:
        n, dim, mesh = 14, 2, dmesh.create_unit_square(COMM, 14, 14, getattr(dmesh.CellType, cell))
    grades = np.append(0.0, least ** (1 - np.arange(n) / (n - 1)))
    mesh.geometry.x[:, :dim] = grades[np.rint(mesh.geometry.x[:, :dim] * n).astype(int)]
    own = Membrane(mesh, load=1.0)
    x, upper = own.V.tabulate_dof_coordinates()[:, :dim], fem.Function(own.V)
    far = np.flatnonzero(np.isclose(x, 1).any(axis=1)).astype(np.int32)
    upper.x.array[:] = np.where(x.max(axis=1) <= 3 * least, 0.1, np.inf)
    found = own.problem(bcs=[fem.dirichletbc(own.edge, far)], upper=upper).solve(method=method)
    assert found.force.upper > 0
    assert found.at([0.0] * dim) == pytest.approx(0.1, abs=1e-3 if method == "penalty" else 1e-12)


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize("beta", [1e6, 1e10, 1e12])
def test_penalised_boundary_values_of_a_nonlinear_form(beta, method):
    """They hide no force inside, in a first solve and in a second one with another load."""
    own = Membrane(cells=10, load=-20.0)
    u, v = own.u, own.v
    given = 0.5 + 0.2 * ufl.sin(4 * ufl.SpatialCoordinate(own.mesh)[0])
    F = (1 + 5 * u**2) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - own.f * v * ufl.dx
    problem = ObstacleProblem(F + fem.Constant(own.mesh, beta) * (u - given) * v * ufl.ds, u, lower=-0.3)
    assert problem.solve(method=method).force.lower == pytest.approx(1.0205, abs=3e-3)
    own.f.value = -6.0
    second = problem.solve(method=method)
    assert second.force.lower == 0 and second.verify()
    assert second.at([0.5, 0.5]) > 0.25


@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1.0, 1e9])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_functions_on_other_meshes_in_any_unit_of_length(cell, unit):
    """The search for points has no length of its own."""

    def made(n):
        kind = getattr(dmesh.CellType, cell)
        mesh = dmesh.create_unit_square(COMM, n, n, kind) if cell == "quadrilateral" else dmesh.create_unit_cube(
            COMM, n, n, n, kind)  # fmt: skip
        x = mesh.geometry.x
        x[:, 0], x[:, 1] = np.cos(0.3) * x[:, 0] - np.sin(0.3) * x[:, 1], np.sin(0.3) * x[:, 0] + np.cos(0.3) * x[:, 1]
        x *= unit
        return mesh

    own, lower = Membrane(made(8), load=-3 / unit**2), fem.Function(releases.functionspace(made(3), "Lagrange", 1))
    lower.interpolate(lambda x: -0.1 - 0.05 * (x[0] + 2 * x[1]) / unit)
    found = own.problem(lower=lower).solve(method="vi")
    x = own.V.tabulate_dof_coordinates().T / unit
    assert found.lower.x.array == pytest.approx(-0.1 - 0.05 * (x[0] + 2 * x[1]), abs=1e-12)


def test_a_stiff_part_does_not_make_a_form_symmetric():
    """Drift in one half, which the entries of a stiff boundary condition exceed by far: there is no energy."""
    own = Membrane(cells=8, load=-1.0)
    own.F += 30 * own.u.dx(0) * own.v * ufl.dx + 1e14 * own.u * own.v * ufl.ds
    assert own.problem(bcs=[], lower=-0.01).solve().energy is None


@pytest.mark.parametrize("kind", ["baij", "dense"])
def test_matrices_of_other_types(kind):
    """They are converted."""
    n = 12
    A = PETSc.Mat().createAIJ((n, n), nnz=3, comm=PETSc.COMM_SELF)
    for i in range(n):
        for j, value in ((i - 1, -1.0), (i, 2.0), (i + 1, -1.0)):
            if 0 <= j < n:
                A.setValue(i, j, value)
    A.assemble()
    plain = solve_system(A, np.full(n, -1.0), lower=-3.0)
    other = solve_system(A.convert(kind, PETSc.Mat()), np.full(n, -1.0), lower=-3.0)
    assert other.u == pytest.approx(plain.u, abs=1e-14) and plain.contact.any()


def test_no_warning_about_round_off_in_contact_everywhere(recwarn):
    """u is the obstacle and differs from the start by round-off, whose energy has either sign."""
    own = Membrane(dmesh.create_unit_interval(COMM, 12))
    u, v = own.u, own.v
    F = 1e-6 * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 0.5 * (u - 1.3) * v * ufl.ds - 7e7 * v * ufl.dx
    found = ObstacleProblem(F, u, upper=1.2173094325172513).solve(method="vi")
    assert found.contact.x.array.all()
    assert not any("positive definite" in str(one.message) for one in recwarn)


@pytest.mark.parametrize(("key", "value", "end"), [("flux", 0.5, 0.0), ("spring", 2.0, -1 / 6)])
def test_degree_2_on_intervals_with_a_term_at_its_end(key, value, end):
    """The facets are vertices, whose rule is the vertex: u'' = 1, u(0) = 0, and u' = q or u' = -k u at 1."""
    scene = Scene(mesh={"shape": "interval", "cells": 4}, tension=1, load=-1,
                  boundary=[{"on": "left", "value": 0}, {"on": "right", key: value}])  # fmt: skip
    assert solve(scene, element="Q2").at([1.0]) == pytest.approx(end, abs=1e-12)


@pytest.mark.ranks
def test_contact_on_a_curve_inside_with_a_nonlinear_form():
    """Its penalty couples the cells on both sides of facets, also where they are on two ranks."""
    mesh = dmesh.create_unit_square(COMM, 7, 6, ghost_mode=dmesh.GhostMode.shared_facet)
    V = releases.functionspace(mesh, "Lagrange", 1)
    u, v = fem.Function(V), ufl.TestFunction(V)
    facets = np.sort(dmesh.locate_entities(mesh, 1, lambda x: np.isclose(x[1], 0.5))).astype(np.int32)
    mesh.topology.create_connectivity(1, 2)
    curve = dmesh.meshtags(mesh, 1, facets, np.full(len(facets), 3, dtype=np.int32))
    held = fem.dirichletbc(0.05, fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0)), V)
    F = (1 + u**2) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - 3 * v * ufl.dx
    problem = ObstacleProblem(
        F, u, bcs=[held], upper=0.2, measure=ufl.Measure("dS", domain=mesh, subdomain_data=curve)(3)
    )
    found = [problem.solve(method=method).force.upper for method in ("penalty", "vi")]
    assert found[0] == pytest.approx(found[1], rel=0.01) and found[1] > 1


@pytest.mark.parametrize(("ratio", "method"), [(1e8, "vi"), (1e11, "vi"), (1e10, "penalty"), (1e12, "penalty")])
def test_a_part_that_given_values_separate_is_solved_beside_much_larger_loads(ratio, method):
    """Two strings of length 1/2 with a common end; the load of one is `ratio` times that of the other, which has an
    obstacle, and changes between solves: force q (1/2 - 2 (2 g/q)^(1/2)) for an obstacle at -g."""
    own = Membrane(dmesh.create_unit_interval(COMM, 400), load=-8.0)
    nodes, lower = own.V.tabulate_dof_coordinates()[:, 0], fem.Function(own.V)
    held = np.flatnonzero(np.min(np.abs(nodes - np.array([[0], [0.5], [1]])), axis=0) < 1e-12).astype(np.int32)
    lower.x.array[:] = np.where(nodes < 0.5 + 1e-12, -np.inf, -0.15)
    left = fem.Function(releases.functionspace(own.mesh, "DG", 0))
    left.interpolate(lambda x: np.where(x[0] < 0.5, 1.0, 0.0))
    own.F += (own.f - ratio) * left * own.v * ufl.dx
    problem = own.problem(bcs=[fem.dirichletbc(own.edge, held)], lower=lower)
    for q in (8.0, 16.0, 32.0, 1.0):
        own.f.value = -q
        found = problem.solve(method=method)
        force = q * (0.5 - 2 * (0.3 / q) ** 0.5) if q > 5 else 0.0
        assert found.force.lower == pytest.approx(force, rel=2e-3, abs=1e-12), q
        sag = min(q / 32, 0.15)
        assert found.at([0.75]) == pytest.approx(-sag, rel=1e-3)

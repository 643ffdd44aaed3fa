"""eps = "auto" fits the solution, in each part of the domain: values of the variational inequality, from any start."""

import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import InputError, NotConverged, ObstacleProblem, PenetrationWarning, Scene, solve
from fenicsx_obstacle.algebra.penalty_parameter import PENETRATION, _share_of_compliance
from fenicsx_obstacle.parallel import largest, smallest
from fenicsx_obstacle.releases import functionspace
from tests.conftest import COMM, membrane
from tests.helpers import Membrane, outline
from tests.test_elastic import Body, strain_of

NOTHING = 1e20  # no obstacle


class Form:
    """A form k(u, x) grad u . grad v - load v + reaction on the unit interval, square or cube; u = 0 around."""

    def __init__(self, dim, cells, k, load=1.0, reaction=None, degree=1):
        made = (dmesh.create_unit_interval, dmesh.create_unit_square, dmesh.create_unit_cube)[dim - 1]
        self.V = V = functionspace(made(COMM, *[cells] * dim), "Lagrange", degree)
        self.u, v, x = fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(V.mesh)
        self.F = (k(self.u, x) * ufl.inner(ufl.grad(self.u), ufl.grad(v)) - load * v) * ufl.dx
        if reaction is not None:
            self.F += reaction(self.u) * v * ufl.dx
        self.bc = fem.dirichletbc(0.0, outline(V), V)

    def problem(self, start=0.0, **obstacles):
        self.u.interpolate(lambda x: start * np.prod(np.sin(np.pi * x[: self.V.mesh.topology.dim]), axis=0))
        return ObstacleProblem(self.F, self.u, bcs=self.bc, **obstacles)


def squared(u):
    return ufl.inner(ufl.grad(u), ufl.grad(u))


def two_parts(place, contrast):
    return lambda u, x: ufl.conditional(ufl.lt(x[0], place), 1.0, contrast)


def only_left(place, height):
    return lambda x: np.where(x[0] < place - 1e-9, height, NOTHING)


CASES = {
    "porous medium": (Form(2, 8, lambda u, x: 1e-6 + u**2, 3.0), {"upper": 0.2}),
    "porous medium in space": (Form(3, 4, lambda u, x: 1e-8 + u**4, 2.0), {"lower": -0.01, "upper": 0.1}),
    "power law": (Form(1, 60, lambda u, x: 1e-8 + squared(u), 4.0), {"upper": 0.2}),
    "power law, P2": (Form(2, 6, lambda u, x: (1e-6 + squared(u)) ** 0.5, 3.0, degree=2), {"upper": 0.15}),
    "mostly soft": (Form(2, 16, two_parts(0.25, 1e-6)), {"upper": only_left(0.25, 2e-3)}),
    "somewhat soft": (Form(2, 16, two_parts(0.25, 2e-2)), {"upper": only_left(0.25, 2e-3)}),
    "mostly stiff": (Form(2, 16, two_parts(0.25, 1e6), -1.0), {"lower": -1e-8}),
    "soft rod": (Form(1, 64, two_parts(0.1, 1e-8)), {"upper": only_left(0.1, 1e-4)}),
    "a load that is large beside the height": (Form(2, 8, two_parts(0.5, 1.0), -1e12), {"lower": -0.05}),
    "reaction": (Form(2, 8, lambda u, x: 1e-4, 2.0, lambda u: 50 * u**3), {"lower": 0.0, "upper": 0.1}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_default_solve_is_the_inequality(name):
    """Forms that degenerate at the start, and forms of several materials: forces as by method="vi", penetration below
    the share that eps = "auto" promises, and the same values by a second solve."""
    form, obstacles = CASES[name]
    exact = form.problem(**obstacles).solve(method="vi")
    expected, force = form.u.x.array.copy(), exact.record["contact"]
    problem = form.problem(**obstacles)
    found = problem.solve()
    height = largest(COMM, expected) - smallest(COMM, expected)
    for side in obstacles:
        assert found.record["contact"][side]["force"] == pytest.approx(force[side]["force"], rel=0.01, abs=1e-12)
    assert 0 < found.penetration <= PENETRATION * height
    assert largest(COMM, np.abs(form.u.x.array - expected)) <= PENETRATION * height
    first = form.u.x.array.copy()
    again = problem.solve()
    assert again.eps == found.eps
    assert largest(COMM, np.abs(form.u.x.array - first)) <= 1e-8 * height


@pytest.mark.parametrize("element", ["Q1", "Q1-gauss"])
def test_contact_everywhere(element):
    """u is flat, and the penetration has no scale: load 8 less the foundation's 0.2."""
    scene = membrane(load=-8, lower=-0.2, foundation=1, boundary=[{"flux": 0}]).change({"solve.element": element})
    assert solve(scene).force.lower == pytest.approx(7.8, rel=1e-3)


@pytest.mark.parametrize("start", [1e-3, 1e-4])
def test_a_glacier_from_flat_starts(start):
    """-(|u'|^2 u')' = a, u >= 0; exact: max u = 0.119549 and a contact length of 0.4, whatever the start."""
    form = Form(1, 200, lambda u, x: squared(u))
    x, v = ufl.SpatialCoordinate(form.V.mesh), ufl.TestFunction(form.V)
    form.F += ufl.conditional(ufl.lt(abs(x[0] - 0.5), 0.15), 0.0, 2.0) * v * ufl.dx  # a = 1, and -1 outside
    solution = form.problem(start, lower=0.0).solve()
    assert largest(COMM, form.u.x.array) == pytest.approx(0.119549, rel=2e-3)
    assert solution.area == pytest.approx(0.4, abs=2e-3)


def test_eps_before_the_solve_is_of_the_median_node():
    """D_i/A_ii is h^2/2 at most nodes of the interval, and 1e6 times that in its soft quarter."""
    form = Form(1, 64, two_parts(0.75, 1e-6), 8.0)
    problem = form.problem(upper=0.3)._problem
    assert _share_of_compliance(problem, "form:") == pytest.approx(problem.eps_share / 64**2 / 2, rel=1e-9)


def test_eps_follows_changed_coefficients():
    """Another stiffness: eps is chosen anew."""
    form = Form(2, 8, lambda u, x: 0.0, 8.0)
    tension = fem.Constant(form.V.mesh, 1.0)
    form.F += tension * ufl.inner(ufl.grad(form.u), ufl.grad(ufl.TestFunction(form.V))) * ufl.dx
    problem = form.problem(upper=0.1)
    eps = problem.solve().eps
    tension.value = 4.0
    assert problem.solve().eps == pytest.approx(eps / 4)


def test_a_large_given_eps_warns():
    """It is used as it is; the warning and the remark say what penetration is against the range of u."""
    problem = Form(2, 8, lambda u, x: 1.0, 8.0).problem(upper=0.3)
    with warnings.catch_warnings(record=True, action="always") as caught:
        solution = problem.solve(eps=0.01)
    words = [str(one.message) for one in caught if one.category is PenetrationWarning]
    assert len(words) == (COMM.rank == 0)
    assert solution.eps == 0.01 and "% of the range of u" in solution.summary()
    assert any("range of u" in remark for remark in solution.record["remarks"])
    with warnings.catch_warnings(action="error", category=PenetrationWarning):
        assert "remarks" not in problem.solve().record and "range of u" not in problem.solve().summary()


@pytest.mark.parametrize("load", [10.0, 30.0])
@pytest.mark.parametrize("dim", [1, 2])
def test_the_remedy_where_nothing_converges(dim, load):
    """A film beyond its limit load has no solution. Nobody gave an eps, and a larger one is no remedy."""
    form = Form(dim, 8, lambda u, x: 1 / ufl.sqrt(1 + squared(u)), load)
    with pytest.raises(NotConverged) as caught:
        form.problem(lower=-1.0).solve()
    words = str(caught.value)
    assert "larger eps" not in words
    assert "start from another u, or take the method vi" in words or "round-off determines u" in words


@pytest.mark.slow
@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize(("dim", "degree"), [(1, 2), (2, 1)])
def test_contact_alone_in_any_unit(dim, degree, method):
    """Contact bears the whole load, and the start is at the obstacle: steps do not depend on the unit of u."""
    steps = []
    for size in (1e-3, 1.0, 1e3):
        form = Form(dim, 8, lambda u, x, size=size: ufl.exp(-u / fem.Constant(u.function_space.mesh, size)), -size,
                    degree=degree)  # fmt: skip
        problem = ObstacleProblem(form.F, form.u, lower=lambda x, size=size: 0.3 * size * (x[0] - 0.4) ** 2)
        solution = problem.solve(method=method)
        assert solution.force.lower == pytest.approx(size, rel=1e-6)
        steps.append(solution.iterations)
    assert steps[0] == steps[1] == steps[2] <= 12


@pytest.mark.parametrize(("options", "message"), [
    ({"snes_type": "ksponly"}, "penalty_snes_type = ksponly: it takes one linear step"),
    ({"snes_mf": None}, "vi_snes_mf = : SNES VI takes the rows without contact of the assembled matrix"),
    ({"snes_type": "vinewtonssls"}, "vi_snes_type = vinewtonssls: the method vi is made for vinewtonrsls alone"),
    ({"snes_type": "newtonls"}, "vi_snes_type = newtonls: the method vi is made for vinewtonrsls alone"),
    ({"pc_type": "gamg"}, "vi_pc_type = gamg: .* take hypre or lu"),
])  # fmt: skip
def test_options_that_a_method_refuses_by_name(options, message):
    """The stopping test is made for vinewtonrsls, and newtonls ignores bounds; with gamg PETSc's SNES VI ends with an
    error where an active set changes, and on several ranks the next solve hangs."""
    form = Form(2, 8, lambda u, x: 1.0, -10.0)
    problem = ObstacleProblem(form.F, form.u, bcs=form.bc, lower=-0.3, petsc_options=options)
    with pytest.raises(InputError, match=message):
        problem.solve(method=message.partition("_")[0])
    if "pc_type" in options:
        assert problem.solve().force.lower > 0


MOTIONS = {
    "rate": {"rate": 1, "load": "-6*t", "lower": -0.05},
    "inertia": {"inertia": 1, "rate": 0.5, "load": -4, "lower": "-0.08 - 0.05*x"},
}


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS)
def test_all_steps_in_time_have_the_same_eps(motion, folder):
    """A penetration that another eps makes smaller is no motion: a force of its own would grow with 1/dt."""

    def moved(end=1.0, saved=None, **how):
        scene = Scene(
            mesh={"shape": "rectangle", "cells": 6}, tension=1, time={"end": end, "steps": round(40 * end), "start": 0},
            **MOTIONS[motion],
        )  # fmt: skip
        return solve(scene, keep=saved, **how)

    def forces(solution):
        return np.nan_to_num(solution.time_history.column("force_lower"))

    found = moved()
    eps = found.record["eps"]
    assert eps < 0.5 * moved(end=0.1).record["eps"]  # it was lowered on the way
    same = moved(eps=eps)
    assert forces(found) == pytest.approx(forces(same), rel=1e-9, abs=1e-12)
    moved(end=0.9, saved=folder).save(folder)
    assert moved(restart=folder).force.lower == pytest.approx(found.force.lower, rel=1e-9)
    if motion == "rate":
        accurate = forces(moved(method="vi"))
        assert largest(COMM, abs(forces(found) - accurate)) <= 1e-3 * accurate.max()


MESHES = {
    "interval": lambda n: dmesh.create_unit_interval(COMM, 4 * n),
    "triangle": lambda n: dmesh.create_unit_square(COMM, n, n),
    "quadrilateral": lambda n: dmesh.create_unit_square(COMM, n, n, dmesh.CellType.quadrilateral),
    "tetrahedron": lambda n: dmesh.create_unit_cube(COMM, n // 2, n // 2, n // 2),
}
NEARBY = {1: 1.0, 2: 2.0, 3: 3.0}  # the first eigenvalue of -div grad on the unit cube, over pi^2


def warned(F, u, **options):
    """The words of all warnings of a solve, by each method."""
    found = []
    for method in ("penalty", "vi"):
        u.x.array[:] = 0.0
        with warnings.catch_warnings(record=True, action="always") as caught:
            ObstacleProblem(F, u, **options).solve(method=method)
        found.append([str(one.message) for one in caught if "positive definite" in str(one.message)])
    return found


@pytest.mark.parametrize("given", [0.0, 1.0])
@pytest.mark.parametrize(("kind", "degree"), [("interval", 2), ("triangle", 1), ("triangle", 2), ("quadrilateral", 1),
                                              ("tetrahedron", 1)])  # fmt: skip
def test_a_spring_that_pushes(kind, degree, given):
    """-div grad u - k u: the form is positive definite for k below the first eigenvalue alone."""
    mesh = MESHES[kind](8)
    V = functionspace(mesh, "Lagrange", degree)
    u, v, k = fem.Function(V), ufl.TestFunction(V), fem.Constant(mesh, 0.0)
    F = (ufl.inner(ufl.grad(u), ufl.grad(v)) - k * u * v - 8.0 * v) * ufl.dx
    for factor, some in ((0.5, 0), (1.5, 1), (2.5, 1)):
        k.value = factor * np.pi**2 * NEARBY[mesh.topology.dim]
        for words in warned(F, u, bcs=[fem.dirichletbc(given, outline(V), V)], upper=given + 0.3):
            assert len(words) == some * (COMM.rank == 0), factor
            assert all("F = a(u, v) - f(v) is not positive definite" in one for one in words)


CALM = {
    "contact alone": (lambda u, v, x: -3.0 * v * ufl.dx, {"given": None, "upper": 0.1}),
    "no load": (lambda u, v, x: -fem.Constant(u.function_space.mesh, 0.0) * v * ufl.dx, {"upper": 0.1}),
    "drift": (lambda u, v, x: (30 * (0.5 - x[0]) * u.dx(0) * v - 8 * v) * ufl.dx, {"upper": 0.1}),
    "far values": (lambda u, v, x: -8 * v * ufl.dx, {"given": 1e9, "upper": 1e9 + 0.1}),
    "soft": (lambda u, v, x: (-(1 - 1e-9) * ufl.inner(ufl.grad(u), ufl.grad(v)) - 1e-9 * v) * ufl.dx, {"upper": 0.1}),
}


@pytest.mark.parametrize("name", CALM)
def test_no_false_alarm(name):
    rest, options = CALM[name][0], dict(CALM[name][1])
    own = Membrane(MESHES["triangle"](10))
    u, v = own.u, own.v
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + rest(u, v, ufl.SpatialCoordinate(own.mesh))
    given = options.pop("given", 0.0)
    bcs = [] if given is None else [fem.dirichletbc(given, outline(own.V), own.V)]
    assert warned(F, u, bcs=bcs, **options) == [[], []]


def test_bodies_on_springs_that_push():
    """An elastic body on an obstacle has no warning; on springs that push beyond its stiffness it has."""
    body = Body(dmesh.CellType.triangle, 1, [8, 8])
    u, v, k = body.u, body.v, fem.Constant(body.mesh, 0.0)
    bcs = [body.held(lambda x: np.isclose(x[1], 1), axis) for axis in range(2)]
    F = (ufl.inner(strain_of(u), strain_of(v)) - k * ufl.inner(u, v) - 0.01 * v[0]) * ufl.dx
    for k.value, some in ((0.0, 0), (4.0, 1)):
        for words in warned(F, u, bcs=bcs, upper=1.0, of=-u[1], measure=ufl.ds):
            assert len(words) == some * (COMM.rank == 0)


@pytest.mark.parametrize("power", [3.0, 4.0])
def test_where_the_stiffness_is_a_function_of_u_a_penetration_moves_soft_parts_farther(power):
    """u is the obstacle on the left, and falls to 2/5 of it on the right, where the stiffness is 2.5^power times
    smaller: a penetration of d moves u there by 2.5^power d."""
    mesh = dmesh.create_unit_interval(COMM, 40)
    V = functionspace(mesh, "Lagrange", 1)
    x, v, given = ufl.SpatialCoordinate(mesh), ufl.TestFunction(V), fem.Function(V)
    given.x.array[:] = 0.5
    left = np.flatnonzero(V.tabulate_dof_coordinates()[:, 0] < 1e-9).astype(np.int32)
    through = (0.5 ** (power + 1) - 0.2 ** (power + 1)) / (power + 1)  # of the flux, from the obstacle to the end
    load = ufl.conditional(ufl.lt(x[0], 0.5), 200 * 0.5**power, -8 * through)
    found = {}
    for method in ("penalty", "vi"):
        u = fem.Function(V)
        u.x.array[:] = 0.5
        F = abs(u) ** power * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - load * v * ufl.dx
        problem = ObstacleProblem(F, u, bcs=[fem.dirichletbc(given, left)], upper=0.5)
        found[method] = problem.solve(method=method).at([1.0])
    assert 0.15 < found["vi"] < 0.25
    assert found["penalty"] == pytest.approx(found["vi"], abs=0.01 * 0.3)

"""Forms that are symmetric but not positive definite are solved with a warning; no other form causes it."""

import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import ObstacleProblem
from fenicsx_obstacle.releases import functionspace
from tests.conftest import COMM
from tests.helpers import Membrane, outline

MESHES = {
    "interval": lambda n: dmesh.create_unit_interval(COMM, 4 * n),
    "triangle": lambda n: dmesh.create_unit_square(COMM, n, n),
    "quadrilateral": lambda n: dmesh.create_unit_square(COMM, n, n, dmesh.CellType.quadrilateral),
    "tetrahedron": lambda n: dmesh.create_unit_cube(COMM, n // 2, n // 2, n // 2),
}
NEARBY = {1: 1.0, 2: 2.0, 3: 3.0}  # the first eigenvalue of -div grad on the unit cube, over pi^2


def warned(V, F, u, given=0.0, held=True, **options):
    """The words of all warnings of a solve, by each method."""
    bcs = [fem.dirichletbc(given, outline(V), V)] if held else []
    found = []
    for method in ("penalty", "vi"):
        u.x.array[:] = 0.0
        with warnings.catch_warnings(record=True, action="always") as caught:
            ObstacleProblem(F, u, bcs=bcs, **options).solve(method=method)
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
        for words in warned(V, F, u, given, upper=given + 0.3):
            assert len(words) == some * (COMM.rank == 0), factor
            assert all("F = a(u, v) - f(v) is not positive definite" in one for one in words)


CALM = {
    "contact alone": (lambda u, v, x: -3.0 * v * ufl.dx, {"held": False, "upper": 0.1}),
    "no load": (lambda u, v, x: -fem.Constant(u.function_space.mesh, 0.0) * v * ufl.dx, {"upper": 0.1}),
    "drift": (lambda u, v, x: (30 * (0.5 - x[0]) * u.dx(0) * v - 8 * v) * ufl.dx, {"upper": 0.1}),
    "far values": (lambda u, v, x: -8 * v * ufl.dx, {"given": 1e9, "upper": 1e9 + 0.1}),
    "soft": (lambda u, v, x: (-(1 - 1e-9) * ufl.inner(ufl.grad(u), ufl.grad(v)) - 1e-9 * v) * ufl.dx, {"upper": 0.1}),
}


@pytest.mark.parametrize("name", CALM)
def test_no_false_alarm(name):
    rest, options = CALM[name]
    own = Membrane(MESHES["triangle"](10))
    u, v = own.u, own.v
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + rest(u, v, ufl.SpatialCoordinate(own.mesh))
    assert warned(own.V, F, u, **options) == [[], []]


def test_bodies():
    """An elastic body on an obstacle has no warning; on springs that push beyond its stiffness it has."""
    mesh = MESHES["triangle"](8)
    V = functionspace(mesh, "Lagrange", 1, 2)
    u, v, k = fem.Function(V), ufl.TestFunction(V), fem.Constant(mesh, 0.0)
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 1))
    bc = fem.dirichletbc(np.zeros(2), top, V)
    F = (ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) - k * ufl.inner(u, v) - 0.01 * v[0]) * ufl.dx
    down = ufl.as_vector([0.0, -1.0])
    for k.value, some in ((0.0, 0), (4.0, 1)):
        u.x.array[:] = 0.0
        with warnings.catch_warnings(record=True, action="always") as caught:
            ObstacleProblem(F, u, bcs=bc, upper=1.0, of=ufl.dot(u, down), measure=ufl.ds).solve()
        words = [one for one in caught if "positive definite" in str(one.message)]
        assert len(words) == some * (COMM.rank == 0)

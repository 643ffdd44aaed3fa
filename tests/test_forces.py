"""Own forms whose parts have forces of very different size, none at u = 0, or other quadrature."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import ObstacleProblem, releases
from fenicsx_obstacle.discrete.assembly import assembled
from fenicsx_obstacle.parallel import largest
from tests.conftest import COMM
from tests.helpers import outline


def _plane(cells=24):
    mesh = dmesh.create_unit_square(COMM, cells, cells)
    V = releases.functionspace(mesh, "Lagrange", 1)
    return V, fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize(
    ("term", "lower", "force"),
    [
        (lambda u: 6 + ufl.ln(u), 0.7, 0.42973),
        (lambda u: 2 / u, 0.9, 0.24726),
        (lambda u: 9 - 1e-4 * u**-3, 0.5, 0.54923),
        (lambda u: 2 / (u + 1e-12), 0.9, 0.24726),
    ],
    ids=["ln", "1/u", "u^-3", "nearly 1/u"],
)
def test_forms_that_are_infinite_at_0(term, lower, force, method):
    """Their value at u = 0 is no load. The forces are those of active sets by hand."""
    V, u, v, _ = _plane()
    u.x.array[:] = 1.0
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + term(u) * v * ufl.dx
    solution = ObstacleProblem(F, u, bcs=[fem.dirichletbc(1.0, outline(V), V)], lower=lower).solve(method=method)
    assert np.isclose(solution.force.lower, force, rtol=5e-4)


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize("k", [1e6, 1e10, 1e12])
def test_penalised_boundary_values(k, method):
    """A stiff spring at the boundary: its own forces, of size k, say nothing of the balance elsewhere."""
    _, u, v, x = _plane(32)
    lower = 0.8 + 0.5 * x[0]
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 10 * v * ufl.dx + k * (u - 1 - x[0]) * v * ufl.ds
    problem = ObstacleProblem(F, u, lower=lower)
    solution = problem.solve(method=method)
    assert np.isclose(solution.force.lower, 1.4129, rtol=5e-4)
    assert solution.verify()


@pytest.mark.parametrize("k", [1.0, 1e6, 1e12])
def test_a_start_in_balance_with_a_stiff_spring(k):
    """u = 300 balances the spring alone, whose forces of 300 k outweigh the load."""
    _, u, v, _ = _plane()
    u.x.array[:] = 300.0
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 10 * v * ufl.dx + (10 + k) * (u - 300) * v * ufl.ds
    solution = ObstacleProblem(F, u, lower=299.8).solve(method="vi")
    assert largest(COMM, -u.x.array) > -299.801
    assert solution.force.lower > 2


@pytest.mark.parametrize("stiff", [1e6, 1e10])
def test_a_stiff_layer_beside_a_soft_one(stiff):
    """The force on the soft half is the same, however stiff the other half is."""
    V, u, v, x = _plane()
    tension = ufl.conditional(ufl.lt(x[1], 0.25), stiff, 1.0)
    load = ufl.conditional(ufl.gt(x[1], 0.25), 60.0, 0.0)
    sides = fem.locate_dofs_geometrical(V, lambda x: (x[0] < 1e-9) | (x[0] > 1 - 1e-9) | (x[1] > 1 - 1e-9))
    edge = fem.Function(V)
    edge.interpolate(lambda x: x[0])
    forces = []
    for one in (tension, ufl.conditional(ufl.lt(x[1], 0.25), 1e4, 1.0)):
        F = one * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + load * v * ufl.dx
        forces.append(
            ObstacleProblem(F, u, bcs=[fem.dirichletbc(edge, sides)], lower=x[0] - 0.2).solve(method="vi").force
        )
    assert np.isclose(forces[0].lower, forces[1].lower, rtol=1e-3)


def test_a_coefficient_that_jumps_inside_cells():
    """A u - f is F as it is assembled, whatever the degrees of the quadrature of its parts."""
    V, u, v, x = _plane(32)
    chi = ufl.conditional(ufl.lt((x[0] - 0.25) ** 2 + (x[1] - 0.5) ** 2, 0.01), 1e6, 0.0)
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 10 * v * ufl.dx + chi * (u - 1) * v * ufl.dx
    solution = ObstacleProblem(F, u, bcs=[fem.dirichletbc(0.0, outline(V), V)], lower=-10.0).solve()
    residual = assembled(F, V).x.array
    residual[outline(V)] = 0.0
    assert largest(COMM, np.abs(residual)) < 1e-6
    assert 1.0 < largest(COMM, u.x.array) < 1.02
    assert solution.force.lower == 0

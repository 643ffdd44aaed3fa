"""Bring your own: residuals of the caller, comparison of answers, values at points."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import InputError, ObstacleProblem, Scene, compare, releases, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import largest
from tests.conftest import COMM, DEMOS, membrane, slow_except


def square(cells=32):
    """Unit square, P1, u = 0 on the boundary."""
    mesh = dmesh.create_rectangle(COMM, [np.zeros(2), np.ones(2)], [cells, cells])
    V = releases.functionspace(mesh, "Lagrange", 1)
    mesh.topology.create_connectivity(1, 2)
    dofs = fem.locate_dofs_topological(V, 1, dmesh.exterior_facet_indices(mesh.topology))
    return V, fem.dirichletbc(fem.Function(V), dofs)


@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_own_poisson_equals_the_scene(method):
    """F = grad u . grad v - f v with an obstacle: the same figures as the scene, by penalty and by SNES VI."""
    V, bc = square()
    u, v = fem.Function(V), ufl.TestFunction(V)
    energy = 0.5 * ufl.inner(ufl.grad(u), ufl.grad(u)) * ufl.dx - 8 * u * ufl.dx
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - 8 * v * ufl.dx
    problem = ObstacleProblem(F, u, bcs=[bc], upper=0.3, energy=energy)
    answer = problem.solve(eps=1e-6, method=method)
    scene = membrane(mesh={"shape": "rectangle", "cells": 32}, load=8, upper=0.3)
    same = solve(scene, eps=1e-6, method=method)
    assert np.isclose(answer.area, same.area, rtol=1e-9)
    assert np.isclose(answer.force.upper, same.force.upper, rtol=1e-8)
    assert problem.u is u and np.array_equal(answer.u.x.array, u.x.array)
    assert largest(COMM, u.x.array) <= (0.3 + 8e-6) * (1 + 1e-12)  # eps max|p|, and p = f in contact
    assert largest(COMM, answer.pressure.x.array) <= 0


@pytest.mark.slow
def test_nonlinear_residual():
    """A minimal surface over a bump: no formula of ours, safeguarded by its energy; p >= 0 and complementary."""
    V, bc = square()
    u, v, bump = fem.Function(V), ufl.TestFunction(V), fem.Function(V)
    bump.interpolate(lambda x: 0.3 - 4 * ((x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2))
    area = ufl.sqrt(1 + ufl.inner(ufl.grad(u), ufl.grad(u))) * ufl.dx
    F = ufl.derivative(area, u, v)
    vi = ObstacleProblem(F, u, bcs=[bc], lower=bump, energy=area).solve(method="vi")
    exact, pressure = u.x.array.copy(), vi.pressure.x.array.copy()
    assert largest(COMM, bump.x.array - exact) <= 1e-14
    assert largest(COMM, -pressure) <= 0
    u.x.array[:] = 0
    penalty = ObstacleProblem(F, u, bcs=[bc], lower=bump, energy=area).solve(eps=1e-8)
    assert largest(COMM, np.abs(u.x.array - exact)) < 1e-8 * 2 * largest(COMM, pressure)
    assert np.isclose(penalty.force.lower, vi.force.lower, rtol=1e-6)


def test_unsymmetric_residual():
    """Drift has no energy: GMRES, and still contact at the nodes."""
    V, bc = square()
    u, v = fem.Function(V), ufl.TestFunction(V)
    drift = ufl.as_vector((5.0, 1.0))
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + ufl.inner(drift, ufl.grad(u)) * v * ufl.dx - 8 * v * ufl.dx
    answer = ObstacleProblem(F, u, bcs=[bc], upper=0.2).solve(eps=1e-9)
    assert largest(COMM, u.x.array) <= 0.2 + 1e-7
    assert answer.force.upper > 0 and answer.force.lower is None
    assert repr(answer).startswith(f"Solution('ObstacleProblem': penalty, eps = 1e-09, {answer.dofs} unknowns; ")
    assert "array" not in repr(answer)


def test_compare_on_one_mesh():
    """penalty against VI: the distances of the eps-study, sets that differ by a layer."""
    scene = Scene.read(DEMOS / "disk.toml").change({"solve.eps": 1e-4, "mesh.cells": 32})
    context = SolverContext(scene)
    penalty, vi = context.answer(), context.answer(scene.options_with(method="vi"))
    found = compare(penalty, vi)
    assert np.isclose(found["u"]["max"], 4e-4, rtol=1e-3)
    assert 0 < found["u"]["l2"] < found["u"]["h1"]
    assert np.isclose(found["u"]["energy"] ** 2 + found["u"]["l2"] ** 2, found["u"]["h1"] ** 2)
    assert 0.9 < found["contact"]["jaccard"] <= 1
    assert found["contact"]["hausdorff"] <= 2 * vi.level.h
    assert found["outside"] == 0
    assert compare(vi, vi)["u"]["max"] < 1e-15
    assert compare(vi, vi)["contact"] == {"jaccard": 1.0, "hausdorff": 0.0, "area": [vi.record["contact"]["area"]] * 2}


@pytest.mark.slow
def test_compare_on_two_meshes():
    """A coarse answer against a finer one: about the coarse error, in both orders of the arguments."""
    scene = Scene.read(DEMOS / "ball.toml")
    coarse, fine = solve(scene, cells=32, method="vi"), solve(scene, cells=64, method="vi")
    found = compare(coarse, fine)
    assert found["u"] == compare(fine, coarse)["u"]
    assert 0.5 < found["u"]["l2"] / coarse.record["errors"]["l2"] < 1.2
    assert 0.7 < found["contact"]["jaccard"] < 1
    assert found["contact"]["hausdorff"] < 2 * coarse.level.h


def test_floating_membrane_is_held_by_its_obstacle():
    """No boundary value anywhere: the load presses u onto the obstacle, whose force balances it."""
    shape = {"shape": "rectangle", "x": [-1, 1], "y": [-1, 1], "cells": 16}
    scene = Scene(mesh=shape, tension=1, load=-1, lower="-x^2-y^2", boundary=[])
    for method in ("penalty", "successive", "vi"):
        record = solve(scene, method=method, eps=1e-8).record
        assert np.isclose(record["contact"]["lower"]["force"], 4, rtol=1e-8)
        assert np.isclose(record["energy"], -1.048524, rtol=1e-5)
    with pytest.raises(InputError, match="given nowhere, and there is no obstacle"):
        solve(Scene(mesh=shape, tension=1, load=-1, boundary=[]))


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize("far", slow_except([1e9, 1e12, 1e18], 1e12))
def test_far_obstacles_do_not_blunt_the_answer(method, far):
    """'No obstacle here' written as -1e18: counted from there u would have no digit left."""
    near = membrane(load=-10, lower="where(hypot(x - 0.5, y - 0.5) < 0.2, -0.2, -1)")
    there = membrane(load=-10, lower=f"where(hypot(x - 0.5, y - 0.5) < 0.2, -0.2, -{far})")
    expected, found = (solve(scene, method=method, eps=1e-8).record["energy"] for scene in (near, there))
    assert np.isclose(found, expected, rtol=1e-9)


def test_discontinuous_data_on_grid_lines():
    """Points are those of the mesh to the last digit: no rank sees a step of the obstacle on another side."""
    stairs = "where(x < -0.5, -0.2, where(x < 0, -0.4, where(x < 0.5, -0.6, -0.8)))"
    shape = {"shape": "rectangle", "x": [-1, 1], "y": [-1, 1], "cells": 32}
    scene = Scene(mesh=shape, tension=1, load=-10, lower=stairs)
    energies = [solve(scene, eps=1e-8).record["energy"] for _ in range(2)]
    assert np.isclose(*energies, rtol=1e-9)


def test_numpy_numbers_are_numbers():
    scene = membrane(load=np.float32(8), upper=np.float64(0.3), tension=np.int64(1))
    assert solve(scene, eps=np.float64(1e-6), cells=np.int64(8)).record["cells"] == 8


def test_own_mesh_is_saved_and_read(folder):
    """An answer on the caller's mesh reads back: its scene then names the saved mesh."""
    from fenicsx_obstacle import Answer

    scene = Scene(mesh=dmesh.create_unit_square(COMM, 5, 5), tension=1, load=8, upper=0.3)
    answer = solve(scene)
    answer.save(folder / "own")
    again = Answer.read(folder / "own")
    assert np.isclose(solve(again.scene).record["energy"], answer.record["energy"])

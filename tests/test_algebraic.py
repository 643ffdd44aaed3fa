"""Algebraic coarse levels: an obstacle problem on a mesh without a hierarchy takes as few steps as on one with it."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import Scene, releases, solve
from fenicsx_obstacle.algebra import coarse as coarse_module
from fenicsx_obstacle.algebra import kernels
from fenicsx_obstacle.algebra.coarse import CoarseSystem
from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete import hierarchy
from fenicsx_obstacle.discrete.hierarchy import galerkin_systems
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem
from tests.conftest import COMM, ON_SEVERAL_RANKS, by_hand, slow_except
from tests.helpers import cut, grid, mesh_of

R = 0.6979651482233736  # of the contact set of the ball
BALL = {
    "tension": 1, "lower": "where(r < 0.9, sqrt(1 - r^2), sqrt(0.19) - 0.9/sqrt(0.19)*(r - 0.9))",
    "boundary": [{"value": f"{R}^2/sqrt(1 - {R}^2)*ln({R}*exp(1/{R}^2 - 1)/r)"}],
}  # fmt: skip


def shaken(mesh, share, cells, half=2.0):
    """Interior vertices of a box around 0 moved by a share of the width of a cell, the same on all ranks."""
    x, dim = mesh.geometry.x, mesh.geometry.dim
    inside = np.all(np.abs(x[:, :dim]) < half - 1e-9, axis=1)
    waves = np.stack([np.sin(1e4 * (k + 1) * (x @ [1.0, 1.7, 2.3]) + k) for k in range(dim)], axis=1)
    x[inside, :dim] += share * 2 * half / cells * waves[inside]
    return mesh


def square(cells, comm=COMM, kind=dmesh.CellType.triangle):
    return dmesh.create_rectangle(comm, [np.full(2, -2.0), np.full(2, 2.0)], [cells, cells], kind)


def cube(cells):
    return shaken(dmesh.create_box(COMM, [np.full(3, -1.0), np.full(3, 1.0)], [cells] * 3), 0.2, cells, 1.0)


def uneven(cells, comm=COMM):
    return shaken(square(cells, comm), 0.2, cells)


def sphere(cells):
    """Part of a sphere around the north pole, whose rim is four arcs."""
    points, triangles = grid(cells, cells, (-1, -1), (2, 2))
    points = np.column_stack([points, np.ones(len(points))])
    return mesh_of(points / np.linalg.norm(points, axis=1, keepdims=True), triangles)


def counts(answer):
    return answer.record["newton_iterations"], answer.record["krylov_iterations"]


def difference(one, other):
    """Of two solutions on one mesh, over the range of values."""
    u, v = one.u.x.array, other.u.x.array
    return largest(COMM, np.abs(u - v)) / (largest(COMM, u) + largest(COMM, -u))


@pytest.mark.slow
@pytest.mark.parametrize(("method", "eps"), [("penalty", "auto"), ("penalty", 1e-12), ("vi", "auto")])
def test_counts_do_not_grow_when_h_halves(method, eps):
    """O(1) Newton steps on a mesh that has no coarser one, from 1.7e3 to 2.6e4 unknowns."""
    found = [counts(solve(Scene(mesh=uneven(cells), **BALL), method=method, eps=eps)) for cells in (40, 80, 160)]
    newton, krylov = zip(*found, strict=True)
    assert max(newton) <= 6 and max(krylov) <= 20
    assert newton[-1] - newton[0] <= 2


SCENES = {
    "ball": lambda: Scene(mesh=uneven(48), **BALL),
    "both": lambda: Scene(mesh=uneven(48), tension=1, load="20*sin(2*x)", lower=-0.3, upper="0.4 - 0.05*x^2"),
    "spring and free boundary": lambda: Scene(
        mesh=uneven(48), tension=1, load=-1, lower="-0.4 - 0.1*x",
        boundary=[{"where": "x == -2", "value": 0}, {"where": "x == 2", "spring": 2}],
    ),
    "anisotropic": lambda: Scene(mesh=uneven(48), tension=[[4, 1], [1, 1]], load=-3, lower=-0.4),
    "boundary obstacle": lambda: Scene(
        mesh=uneven(48), tension=1, load=-0.3,
        boundary=[{"where": "x == -2", "value": 0}, {"where": "x == 2", "lower": "-2 + 0.5*y"}],
    ),
    "held by contact alone": lambda: Scene(
        mesh=uneven(48), tension=1, load=-1, lower="0.2*cos(2*x) + 0.1*y", boundary=[]
    ),
    "interval": lambda: Scene(
        mesh=shaken(dmesh.create_interval(COMM, 2000, [-1.0, 1.0]), 0.25, 2000, 1.0), tension=1, load=-8,
        lower="-1 - 0.2*x",
    ),
    "cube": lambda: Scene(mesh=cube(13), tension=1, load=-8, lower="-0.4 + 0.1*x*y"),
    "quadrilaterals": lambda: Scene(mesh=shaken(square(48, kind=dmesh.CellType.quadrilateral), 0.15, 48), **BALL),
    "surface": lambda: Scene(mesh=sphere(48), tension=1, load=-1, lower="0.9*z - 1.3", boundary=[{"value": "-x^2"}]),
    "P2": lambda: Scene(mesh=uneven(48), tension=1, load=8, upper="0.5 + 0.2*x").change({"solve.element": "P2"}),
    "P1-voronoi": lambda: Scene(mesh=square(48), tension=1, load=8, upper="0.5 + 0.2*x").change(
        {"solve.element": "P1-voronoi"}
    ),
    "ranks without cells": lambda: Scene(  # the last one, which runs on several ranks
        mesh=by_hand(*grid(48, 48, (-1, -1), (2, 2))), tension=1, load=-4, lower="-0.3 - 0.1*x"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", slow_except(SCENES, "ball", "boundary obstacle", "cube", "ranks without cells"))
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_the_solution_is_that_of_a_cold_start(name, method):
    """To the tolerance of the solver, whatever the data, in few steps on the finest level."""
    scene = SCENES[name]()
    ours, cold = solve(scene, method=method), solve(scene, method=method, start="cold")
    assert difference(ours, cold) <= 1e-9
    assert ours.record["contact"]["area"] == pytest.approx(cold.record["contact"]["area"], rel=1e-9)
    assert ours.record["newton_total"] > ours.record["newton_iterations"]  # it has levels
    assert counts(ours)[0] <= 6 and counts(ours)[1] <= 20


def levels_of(mesh, **data):
    """The problem of a scene, and its algebraic levels from the finest on."""
    context = SolverContext(Scene(mesh=mesh, **{"tension": 1, "lower": -1, **data}))
    return context.problem, galerkin_systems(context.problem)[::-1]


def test_given_values_are_interpolated_from_given_values():
    """So that a coarse correction is 0 where u is given; and no coarse weight is negative."""
    problem, levels = levels_of(uneven(60), boundary=[{"where": "x < 0", "value": 0}])
    for coarse in levels:
        transfer = coarse.finer.transfer
        leak = transfer.interpolate((~coarse.fixed).astype(float))
        assert largest(COMM, np.abs(leak[coarse.finer.fixed])) == 0
        assert largest(COMM, -coarse.weights) <= 0
        assert total(COMM, coarse.weights) == pytest.approx(total(COMM, problem.weights))


def test_coarse_levels_begin_in_contact_as_the_finest_does():
    """Where contact alone holds u, the first step of a start without contact would have no solution."""
    problem, levels = levels_of(uneven(60), boundary=[], load=-1, lower="0.2*cos(2*x) + 0.1*y")
    assert levels and largest(COMM, problem.cold_start() - problem.lower) < 0
    for coarse in levels:
        finer = coarse.finer
        theirs = finer.transfer.inject(finer.cold_start())
        assert largest(COMM, np.abs(coarse.cold_start() - theirs)) == 0


def test_weights_of_a_boundary_stay_there():
    """Of a boundary node that is interpolated from nodes inside as well, those on the boundary get all the weight."""
    problem, levels = levels_of(
        uneven(60), lower=None, boundary=[{"where": "x == -2", "value": 0}, {"where": "x == 2", "lower": -1}]
    )
    x = problem.level.points[0, : problem.level.owned]
    for coarse in levels:
        x = coarse.finer.transfer.inject(np.ascontiguousarray(x))
        assert total(COMM, coarse.weights) == pytest.approx(total(COMM, problem.weights))
        assert total(COMM, coarse.weights[x < 2]) == 0


def test_coarse_weights_are_not_negative():
    """Of a node that is interpolated with a negative share, 3/2 of one coarse node less 1/2 of another, the first one
    gets the whole weight."""
    P = PETSc.Mat().createDense((2, 2), array=np.array([[1.0, 0.0], [1.5, -0.5]]), comm=MPI.COMM_SELF).convert("aij")
    transfer = Transfer(P, inject=lambda fine: fine, of_means=False)
    assert np.allclose(coarse_module._weights(np.array([1.0, 4.0]), transfer, thin=False), [5.0, 0.0], atol=1e-15)


@ON_SEVERAL_RANKS
@pytest.mark.slow
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_counts_are_those_of_one_rank(method):
    """The coarse nodes and the Newton steps do not depend on the ranks; Krylov iterations hardly do.

    Gauss-Seidel smooths on each rank alone, so a linear solve may need one iteration more. DOLFINx cuts the mesh in
    another way in each run.
    """
    ours = solve(Scene(mesh=uneven(80), **BALL), method=method)
    alone = solve(Scene(mesh=uneven(80, MPI.COMM_SELF), **BALL), method=method)
    (steps, iterations), (steps_alone, iterations_alone) = counts(ours), counts(alone)
    assert steps == steps_alone
    assert abs(iterations - iterations_alone) <= steps
    assert ours.record["contact"]["area"] == pytest.approx(alone.record["contact"]["area"], rel=1e-9)
    assert ours.record["energy"] == pytest.approx(alone.record["energy"], rel=1e-9)
    levels = [[one.dofs for one in levels_of(uneven(80, comm))[1]] for comm in (COMM, MPI.COMM_SELF)]
    assert levels[0] == levels[1]


def test_levels_depend_on_neither_unit_nor_place():
    """Coarse nodes of a mesh in other units, elsewhere, are the same points."""
    factor = 2.0**-30
    meshes = uneven(60), uneven(60)
    meshes[1].geometry.x[:, :2] = factor * (meshes[1].geometry.x[:, :2] + 8)
    found = []
    for mesh in meshes:
        problem, levels = levels_of(mesh, boundary=[{"value": 0}])
        x = problem.level.points.T[: problem.level.owned, :2]
        for coarse in levels:
            x = np.stack([coarse.finer.transfer.inject(np.ascontiguousarray(axis)) for axis in x.T], axis=1)
            points = np.concatenate(COMM.allgather(x))
            found.append(points[np.lexsort(points.T)])
    half = len(found) // 2
    assert half > 1
    for ours, theirs in zip(found[:half], found[half:], strict=True):
        assert ours.shape == theirs.shape
        assert np.allclose(theirs / factor - 8, ours, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_slit():
    """Nodes at one place are different nodes: u jumps across the slit, and takes few steps to be found."""
    points, cells = grid(64, 64, (-1, -1), (2, 2))
    along = (np.abs(points[:, 1]) < 1e-9) & (points[:, 0] < -1e-9)
    points, cells = cut(points, cells, along, points[cells].mean(axis=1)[:, 1] > 0)
    scene = Scene(mesh=by_hand(points, cells), tension=1, load="where(y > 0, 6, -6)", lower="-0.3 - 0.1*x",
                  boundary=[{"where": "x == 1", "value": 0}])  # fmt: skip
    ours, cold = solve(scene), solve(scene, start="cold")
    assert difference(ours, cold) <= 1e-9
    assert counts(ours)[0] <= 6
    points, u = ours.level.points, ours.u.x.array
    tip = (np.abs(points[1]) < 1e-9) & (np.abs(points[0] + 1) < 1e-9)
    assert largest(COMM, u[tip]) - -largest(COMM, -u[tip]) > 1


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2])
def test_own_form(degree):
    """From u = 0 on coarse levels, later from u; with coefficients that change, and the answers of a new problem."""
    V = releases.functionspace(uneven(60), "Lagrange", degree)
    mesh = releases.settle(V.mesh)
    mu, f = fem.Constant(mesh, 1.0), fem.Constant(mesh, -1.0)
    facets = np.asarray(dmesh.exterior_facet_indices(mesh.topology))
    bcs = [fem.dirichletbc(fem.Function(V), fem.locate_dofs_topological(V, 1, facets))]

    def problem():
        u, v = fem.Function(V), ufl.TestFunction(V)
        F = mu * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - f * v * ufl.dx
        return ObstacleProblem(F, u, bcs=bcs, lower=lambda x: -0.3 - 0.1 * x[0] ** 2)

    kept, seen = problem(), []
    first = kept.solve(monitor=lambda number, step: seen.append(number))
    assert first.iterations <= 6 and seen == list(range(first.iterations + 1))
    assert kept.solve(eps=1e-9).iterations <= 3
    for mu.value, f.value, method in ((1.0, -1.02, "penalty"), (3.0, -2.0, "penalty"), (2.0, -4.0, "vi")):
        again, new = kept.solve(method=method), problem().solve(method=method)
        assert new.iterations <= 6
        assert largest(COMM, np.abs(kept.u.x.array - new.u.x.array)) <= 1e-9
        assert again.iterations <= 11  # five from u, should it be a bad start


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0, 1])
def test_in_time(rate):
    """Levels keep step with loads, obstacles and masses that change."""
    moments = {"end": 1, "steps": 2, **({"start": 0} if rate else {})}
    changing = {"tension": 1, "load": "-3*t", "lower": "-0.5 - 0.1*t*x", **({"rate": rate} if rate else {})}
    scene = Scene(mesh=uneven(48), **changing, time=moments)
    ours, cold = solve(scene), solve(scene, start="cold")
    assert difference(ours, cold) <= 1e-9
    assert rate or ours.record["newton_iterations"] <= 6  # with a rate the start is the last moment


def test_where_levels_do_not_help_a_cold_start_does(monkeypatch):
    """What the levels make of a problem decides nothing but the start."""

    def spoiled(self, *given, **how):
        made(self, *given, **how)
        self.matrices.stiffness.scale(np.nan)

    made = CoarseSystem.__init__
    scene = Scene(mesh=uneven(48), tension=1, load=8, upper=0.3)
    cold = solve(scene, start="cold")
    monkeypatch.setattr(CoarseSystem, "__init__", spoiled)
    assert difference(solve(scene), cold) <= 1e-9


def test_without_a_compiler(monkeypatch):
    """There are no algebraic levels then, and a cold start instead."""
    monkeypatch.setattr(hierarchy, "kernels", lambda comm: None)
    scene = Scene(mesh=uneven(48), tension=1, load=8, upper=0.3)
    ours, cold = solve(scene), solve(scene, start="cold")
    assert counts(ours) == counts(cold)
    assert difference(ours, cold) <= 1e-12


@pytest.mark.slow
@pytest.mark.serial
def test_the_loops_are_compiled_once(tmp_path, monkeypatch):
    """Into the cache of DOLFINx's forms; what is there already is taken."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for _ in range(2):
        kernels._compiled.cache_clear()
        assert kernels._compiled() is not None
        made = list((tmp_path / "fenics").iterdir())
        assert len(made) == 1
        monkeypatch.setattr(kernels, "_compile", None)
    kernels._compiled.cache_clear()

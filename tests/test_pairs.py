"""The pairs of Examples 1-3: weights, duality, answers of each element, and what is made of them."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import InputError, Scene, releases, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.forms.pairs import Pair, _register, pairs, register
from fenicsx_obstacle.forms.rules import Rule, nodal_rule
from fenicsx_obstacle.mesh.cells import volumes
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes import meshes
from tests.conftest import COMM, DEMOS, slow_except

DISK = Scene.read(DEMOS / "disk.toml")
SQUARE = {"shape": "rectangle", "cells": 6}
BOX = {"shape": "box", "cells": 3}
LINE = {"shape": "interval", "cells": 9}
CASES = [(name, {**mesh, "cell": cell, "perturb": 0.2}) for name, pair in pairs().items() for cell, mesh in
         {"triangle": SQUARE, "quadrilateral": SQUARE, "tetrahedron": BOX, "hexahedron": BOX}.items()
         if cell in pair.rules] + [("P1", LINE)]  # fmt: skip


def level_of(name, mesh, **more):
    scene = Scene(mesh={**mesh, **more}, tension=1, upper=1).change({"solve.element": name})
    return meshes.build(scene, COMM)


@pytest.mark.parametrize("name, mesh", CASES)
def test_lumped_mass_is_diagonal_and_sums_to_the_volume(name, mesh):
    """Invariant (a), (3.5)-(3.6): I(q, r) is diagonal in Q_h with positive entries that sum to |Omega|."""
    level = level_of(name, mesh)
    Q, rule = level.Q, level.pair.rule(releases.cell_name(level.mesh))
    q, r = ufl.TrialFunction(Q), ufl.TestFunction(Q)
    form = releases.form(q * r * rule.on(ufl.Measure("dx", domain=level.mesh)))
    M = fem.petsc.create_matrix(form)
    fem.petsc.assemble_matrix(M, form)
    M.assemble()
    diagonal = M.getDiagonal()
    assert smallest(COMM, diagonal.array) > 0
    assert np.isclose(total(COMM, diagonal.array), 1.0)
    if releases.cell_name(level.mesh) in ("interval", "triangle", "tetrahedron"):  # on which the rule is exact for x
        x = Q.tabulate_dof_coordinates()[: len(diagonal.array), 0]
        assert np.isclose(total(COMM, diagonal.array * x), 0.5)
    M.setDiagonal(PETSc.Vec().createWithArray(np.zeros(len(diagonal.array)), comm=COMM))
    assert M.norm(PETSc.NormType.FROBENIUS) < 1e-12


@pytest.mark.parametrize("cell", ["interval", "quadrilateral", "hexahedron"])
def test_simpson_weights(cell):
    """Example 1, Q2: Simpson's rule integrates x^3 exactly with positive weights."""
    rule = nodal_rule(cell, 2)
    points, weights = np.array(rule.points), np.array(rule.weights)
    assert weights.min() > 0
    assert abs(weights.sum() - 1) < 1e-15
    assert abs(weights @ points[:, 0] ** 3 - 1 / 4) < 1e-15


def test_cells_without_a_rule():
    """What is not the name of a cell is rejected, with the names."""
    with pytest.raises(InputError, match="cell = 'prism': expected the name of a cell, one of interval, triangle"):
        nodal_rule("prism")


@pytest.mark.parametrize("name", slow_except(pairs(), "P2", "Q1"))
def test_reference_of_each_pair(name):
    """Theorem 3.1: u_eps tends to the solution of the inequality, whose constraints hold at the points of I alone."""
    context = SolverContext(DISK.change({"mesh.cells": 12, "solve.element": name}))
    scene = context.scene
    reference = context.answer(scene.options_with(method="vi"))
    distance = []
    for eps in (1e-5, 1e-7):
        answer = context.answer(scene.options_with(eps=eps))
        distance.append(largest(COMM, np.abs(answer.u.x.array - reference.u.x.array)))
    assert distance[0] < 1e-3 and abs(np.log10(distance[0] / distance[1]) / 2 - 1) < 0.1
    assert reference.record["penetration"] < 1e-9
    assert np.isclose(
        reference.record["contact"]["upper"]["force"], answer.record["contact"]["upper"]["force"], rtol=1e-4
    )
    context.close()


@pytest.mark.parametrize(
    "mesh", [{**SQUARE, "diagonal": "crossed"}, {**SQUARE, "diagonal": "union-jack"}, {**SQUARE, "perturb": 0.1}, BOX]
)
def test_voronoi_areas_are_consistent(mesh):
    """(5.7) and its cure: for |x|^2 the lumped Laplacian is -2 dim at each inner node; the D_i sum to |Omega|."""
    scene = Scene(mesh=mesh, tension=1, upper=9).change({"solve.element": "P1-voronoi"})
    problem = SolverContext(scene).problem
    assert total(COMM, problem.weights) == pytest.approx(1.0, rel=1e-12)
    x = problem.vector()
    x.array[:] = (problem.level.points[:, : problem.level.owned] ** 2).sum(axis=0)
    out = x.duplicate()
    problem.matrices.stiffness.mult(x, out)
    inner = ~problem.fixed
    lumped = out.array[inner] / problem.weights[inner]
    assert largest(COMM, np.abs(lumped + 2 * problem.level.mesh.topology.dim)) < 1e-9
    pressed = solve(scene.change({"effects.load": "1 + x", "obstacle.upper": 0.01, "report.force": "-integral(p)"}))
    assert pressed.report["force"] == pytest.approx(pressed.force.upper, rel=1e-12)


def test_obtuse_meshes_have_no_voronoi_areas():
    """(3.6): weights must be positive; a mesh that is not Delaunay is refused."""
    mesh = level_of("P1", SQUARE).mesh
    mesh.geometry.x[:, 0] += 2 * mesh.geometry.x[:, 1]
    scene = Scene(mesh=mesh, tension=1, upper=9).change({"solve.element": "P1-voronoi"})
    with pytest.raises(InputError, match="not Delaunay"):
        SolverContext(scene)


def test_mistakes():
    """Weights must be positive; elements that do not exist, or are for other cells, are among tests/cli/broken."""
    with pytest.raises(InputError, match="not positive"):
        register(Pair("bad", 1, {"triangle": Rule(((0.0, 0.0), (1.0, 0.0)), (0.5, 0.0))}, ("Lagrange", 1)))


class Barycentric(Pair):
    """A third of each triangle at its vertices: what the vertex rule gives, said as weights."""

    def cell_weights(self, corners):
        return np.repeat(volumes(corners)[:, None] / corners.shape[1], corners.shape[1], axis=1)


def test_a_pair_with_weights_of_its_own():
    """A subclass says what weights the cells give to their nodes; nothing else asks which pair it is."""
    register(Barycentric("mine", 1, {"triangle": nodal_rule("triangle")}, ("Lagrange", 1)))
    try:
        scene = DISK.change({"mesh.cells": 8, "mesh.perturb": 0.2, "effects.load": -4})
        mine, theirs = (solve(scene, element=name, bound=True).record for name in ("mine", "P1"))
        assert mine["energy"] == pytest.approx(theirs["energy"], rel=1e-10) and mine["element"] == "mine"
        assert mine["bound"]["total"] == pytest.approx(theirs["bound"]["total"], rel=1e-6)
        with pytest.raises(InputError, match="element mine is for tension and load, not for foundation"):
            solve(scene.change({"effects.foundation": 1}), element="mine")
    finally:
        _register.pop("mine")


@pytest.mark.parametrize("name", ["Q1", "Q2", "P2", "Q1-gauss"])
def test_linear_view(name):
    """What is drawn keeps all nodal values, and a chessboard stays one; what is saved is in test_saved.py."""
    answer = solve(DISK, cells=8, element=name, eps=1e-4)
    plain = answer.plain
    for key in ("u", "upper", "error"):
        mine, theirs = answer.functions()[key].x.array, plain.functions()[key].x.array
        assert np.isclose(largest(COMM, mine), largest(COMM, theirs), atol=1e-14)
    assert np.isclose(smallest(COMM, answer.pressure.x.array), smallest(COMM, plain.pressure.x.array))


def test_perturbed_meshes_are_the_same_on_all_ranks():
    """The random shift of a vertex is a function of its place."""
    level = level_of("P1", SQUARE, perturb=0.25)
    scene = Scene(mesh={**SQUARE, "perturb": 0.25}, tension=1, upper=1)
    alone = meshes.build(scene, MPI.COMM_SELF)
    points = {tuple(x) for x in np.round(alone.points.T, 12)}
    assert all(tuple(x) in points for x in np.round(level.points.T, 12))
    grid = meshes.build(Scene(mesh=SQUARE, tension=1, upper=1), MPI.COMM_SELF)
    assert 0.15 / 6 < np.abs(alone.points - grid.points).max() <= 0.25 / 6

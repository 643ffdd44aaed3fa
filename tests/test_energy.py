"""The energy and the forces of affine effects, by matrices, are those of the forms."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, Scene, releases
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.assembly import Forms, Nodal
from fenicsx_obstacle.parallel import largest, total
from tests.conftest import COMM, DEMOS

SQUARE = {"shape": "rectangle", "cells": 6}
SUPPORTS = [
    {"on": "left", "value": "y"},
    {"on": "right", "spring": 3, "flux": "1 + y"},
    {"on": "top", "flux": -1},
]
SCENES = {
    "membrane": {"tension": "1 + x*y", "load": "sin(3*x) - y"},
    "no load": {"tension": 2},
    "foundation": {"tension": 1, "foundation": "1 + x", "load": -1},
    "spring and flux": {"tension": 1, "boundary": SUPPORTS},
}


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize("name", SCENES)
def test_by_matrices_as_by_forms(name, element):
    """a(u, u)/2 - f(u), a(u, .) - f, the penalty and the Jacobian, of a u that is no solution."""
    compare(Scene(mesh=SQUARE, lower=-1, **SCENES[name]).change({"solve.element": element}))


@pytest.mark.parametrize(
    ("name", "more"), [("ball", {}), ("disk", {}), ("two_sided", {}), ("string", {}), ("wall", {"mesh.x": [0, 1.5]})]
)
def test_demos_by_matrices_as_by_forms(name, more):
    """The same with curved, upper and two obstacles, and one on the boundary."""
    compare(Scene.read(DEMOS / f"{name}.toml").change({"mesh.cells": 16, **more}))


def test_with_a_point_force():
    """It is in no form."""
    compare(Scene(mesh=SQUARE, lower=-1, tension=1, point_load=[{"at": [0.5, 0.5], "force": -2}]))


def compare(scene):
    problem = SolverContext(scene, COMM).problem
    forms, x = problem.law, problem.level.points
    assert isinstance(forms, Nodal)
    problem.eps = 1e-3
    u_values = (2 * np.cos(3 * x[0]) + 2 * x[1] ** 2)[: problem.owned]
    problem.set_reference(u_values)
    for penalised in (False, True):
        exact = Forms.energy(forms, penalised=penalised)
        assert forms.energy(penalised=penalised) == pytest.approx(exact, rel=1e-12)
    kept = problem.w.copy(), problem.state.r.copy()
    pairs = [(forms.forces_at(given), Forms.forces_at(forms, given)) for given in (0.0, u_values)]
    for now, then in zip((problem.w, problem.state.r), kept, strict=True):
        assert np.array_equal(now, then)
    problem.w[:] += np.sin(7 * x[0] + 3 * x[1])[: problem.owned]  # also where u is given
    problem.state.share()
    for ours, theirs in ((forms.elastic, Forms.elastic), (forms.reaction, Forms.reaction)):
        out = forms.vector(), forms.vector()
        ours(out[0])
        theirs(forms, out[1])
        pairs.append(tuple(one.array_r for one in out))
    for ours, exact in pairs:
        assert largest(COMM, np.abs(ours - exact)) <= 1e-12 * largest(COMM, np.abs(exact))
    assert all(largest(COMM, np.abs(exact)) > 0 for _, exact in pairs[1:])
    A = problem.jacobian(problem.vector())
    B = A.duplicate()
    Forms.jacobian(forms, B, penalised=True)
    scale = B.norm(PETSc.NormType.INFINITY)
    B.axpy(-1.0, A)
    assert B.norm(PETSc.NormType.INFINITY) <= 1e-13 * scale


def test_added_forces_act_at_once():
    """a(u, .) - f of the present state, not of the next one alone."""
    problem = SolverContext(Scene(mesh=SQUARE, lower=-1, tension=1, load=-1), COMM).problem
    forces = np.cos(3 * problem.level.points[0, : problem.level.owned])
    before, after = problem.law.vector(), problem.law.vector()
    problem.law.elastic(before)
    problem.nodal_forms.add_forces(forces)
    problem.law.elastic(after)
    assert largest(COMM, np.abs(before.array_r - forces - after.array_r)) <= 1e-14


@pytest.mark.parametrize("given", [False, True])
def test_of_a_form(given):
    """The energy of F is that of its quadratic functional, up to its value at 0; a given functional is taken itself."""
    mesh = dmesh.create_unit_square(COMM, 8, 8)
    u = fem.Function(releases.functionspace(mesh, "Lagrange", 1))
    x = ufl.SpatialCoordinate(mesh)
    functional = (ufl.inner(ufl.grad(u), ufl.grad(u)) / 2 + 3 * (u - x[0]) ** 2 + u) * ufl.dx
    F = ufl.derivative(functional, u)
    answer = ObstacleProblem(F, u, lower=0.2, energy=functional if given else None).solve(method="vi")
    values = [total(COMM, fem.assemble_scalar(fem.form(form))) for form in (functional, 3 * x[0] ** 2 * ufl.dx(mesh))]
    assert answer.record["energy"] == pytest.approx(values[0] - (0 if given else values[1]), rel=1e-12)

"""Friedrichs' constant by paths of cells is above the true one, also on domains that slits cut."""

from contextlib import closing

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from scipy.linalg import eigh

from fenicsx_obstacle import Scene, releases, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.friedrichs import friedrichs_by_paths
from fenicsx_obstacle.mesh.cells import cell_facets
from fenicsx_obstacle.mesh.levels import Level, of_mesh
from tests.conftest import COMM, by_hand, slow_except
from tests.helpers import cut, grid

BOXES = {1: dmesh.create_unit_interval, 2: dmesh.create_unit_square, 3: dmesh.create_unit_cube}


def constant(level: Level, where) -> float:
    """Friedrichs' constant by paths, of functions that are 0 on a part of the boundary."""
    dim = level.mesh.topology.dim
    facets = dmesh.locate_entities_boundary(level.mesh, dim - 1, where)
    own = level.mesh.topology.index_map(dim).size_local
    # facet i of an interval is vertex i, which is opposite to the other one
    return friedrichs_by_paths(level, np.isin(cell_facets(level.mesh)[:own], facets)[:, :: -1 if dim == 1 else 1])


def box(dim: int, cells: int, comm=COMM) -> Level:
    return of_mesh(releases.settle(BOXES[dim](comm, *[cells] * dim)), "box")


def left(x: np.ndarray) -> np.ndarray:
    return np.isclose(x[0], 0)


@pytest.mark.parametrize("cells", [1, 5, 40])
def test_on_an_interval(cells):
    """c_T^2 = h, so that s_T is the distance of the far end of T: c^2 = h^2/pi^2 + (1 + h)/2, and (2/pi)^2 is exact."""
    h = 1 / cells
    assert constant(box(1, cells), left) == pytest.approx(np.sqrt(h**2 / np.pi**2 + (1 + h) / 2), rel=1e-12)


@pytest.mark.parametrize(("dim", "cells"), slow_except([(2, 1), (2, 2), (2, 8), (3, 1), (3, 4)], (2, 8), (3, 4)))
def test_it_is_above_the_constant_of_a_box(dim, cells):
    """||v|| <= 2/pi ||grad v|| for v = 0 on one face. The constant grows no faster than paths and cells allow, and does
    not depend on the partition."""
    found = constant(box(dim, cells), left)
    assert found == pytest.approx(constant(box(dim, cells, MPI.COMM_SELF), left), rel=1e-12)
    assert 2 / np.pi <= found <= 3 * cells ** ((dim - 1) / 2)


@pytest.mark.parametrize("where", [lambda x: x[0] + x[1] < 0.26, left])
@pytest.mark.parametrize("l_shape", [True, False])
def test_it_is_above_eigenvalues(l_shape, where):
    """1/c^2 is below the least eigenvalue in P1 on a square with a slit, which is no box, and on such an L-shape."""
    points, cells = grid(8, 8)
    points, cells = cut(points, cells, (np.abs(points[:, 1] - 0.25) < 1e-9) & (points[:, 0] < 0.49),
                         points[cells].mean(axis=1)[:, 1] > 0.25)  # fmt: skip
    kept = ~np.all(points[cells].mean(axis=1) > 0.5, axis=1) | (not l_shape)
    used, cells = np.unique(cells[kept], return_inverse=True)
    level = of_mesh(by_hand(points[used], cells.reshape(-1, 3), MPI.COMM_SELF), "polygon")
    K, M = _matrices(level, where)
    exact = 1 / np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=[0, 0])[0])
    found = constant(level, where)
    assert exact <= found < 20 * exact
    held = "x < 1e-9" if where is left else "(x < 1e-9 or y < 1e-9) and x + y < 0.26"
    scene = Scene(mesh=level.mesh, tension=1, load=-1, boundary=[{"where": held, "value": 0}])
    with closing(SolverContext(scene, MPI.COMM_SELF)) as context:  # the bound takes this constant
        assert context.estimator.element.friedrichs == pytest.approx(found, rel=1e-12)


def _matrices(level: Level, where) -> tuple[np.ndarray, np.ndarray]:
    u, v = ufl.TrialFunction(level.V), ufl.TestFunction(level.V)
    facets = dmesh.locate_entities_boundary(level.mesh, 1, where)
    free = np.setdiff1d(np.arange(level.owned), fem.locate_dofs_topological(level.V, 1, facets))
    found = []
    for form in (ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, u * v * ufl.dx):
        A = fem.petsc.assemble_matrix(releases.form(form))
        A.assemble()
        found.append(A.convert("dense").getDenseArray()[np.ix_(free, free)].copy())
    return found[0], found[1]


@pytest.mark.variant
@pytest.mark.slow
def test_an_undecided_load_does_not_change_the_solution():
    """A load that intervals do not decide at any depth keeps its samples; its bounds only add to the error bound."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 16}, tension=1, report={"sum": "integral(u)"},
                  load="where(sin(2000*x)^2 + cos(2000*x)^2 > 1/2, -1, 0)")  # fmt: skip
    plain, bounded = solve(scene), solve(scene, bound=True)
    assert bounded.report["sum"] == pytest.approx(plain.report["sum"], rel=1e-9)
    assert bounded.bound.guaranteed
    least, most = bounded.bound.energy
    assert least < solve(scene.change({"effects.load": -1}), cells=64).record["energy"] < most


def test_paths_are_the_shortest():
    """With one rank or several, s_T of a strip of squares is the number of cells that lead to it."""
    n = 6
    mesh = releases.settle(dmesh.create_rectangle(COMM, [[0, 0], [n, 1]], [n, 1]))
    level = of_mesh(mesh, "strip")
    # c_T^2 = 2/(4/2) = 1; the sum of |T| s_T over pairs of cells: 1/2 (1 + 2 + ... + 2n) at most
    squared = constant(level, left) ** 2 - 2 / np.pi**2
    assert squared == pytest.approx(0.5 * sum(range(1, 2 * n + 1)), rel=1e-12)

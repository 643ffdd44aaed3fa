"""Local refinement: nested meshes without hanging nodes, the same on any number of ranks, and solves on them."""

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import InputError, Scene
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.simplex_geometry import sizes
from fenicsx_obstacle.mesh import levels
from fenicsx_obstacle.mesh.cells import corners, facet_vertices, longest_edges, own_cells, sides, volumes
from fenicsx_obstacle.mesh.transfer import downward
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes import meshes
from tests.conftest import COMM, slow_except

MESHES = {
    "rectangle": {"shape": "rectangle", "cells": 8},
    "crossed": {"shape": "rectangle", "cells": 6, "diagonal": "crossed", "perturb": 0.1},
    "disk": {"shape": "disk", "cells": 12},
    "l-shape": {"shape": "l-shape", "cells": 8},
    "interval": {"shape": "interval", "cells": 20},
    "box": {"shape": "box", "cells": 3},
    "perturbed box": {"shape": "box", "cells": 3, "perturb": 0.2},
}


def near_a_point(level, radius):
    """Marks the owned cells near a point."""
    middles = corners(level.mesh)[: own_cells(level.mesh)].mean(axis=1)
    dim = level.mesh.topology.dim
    return np.linalg.norm(middles[:, :dim] - [0.3, 0.2, 0.4][:dim], axis=1) < radius


def refined(comm, mesh, times=4):
    level = meshes.build(Scene(mesh=mesh, tension=1, upper=1), comm)
    for k in range(times):
        level = levels.refined_where(level, near_a_point(level, 0.1 + 0.4 * 0.5**k))
    return level


@pytest.mark.ranks
@pytest.mark.parametrize("name", MESHES)
def test_meshes_fit_and_are_the_same_on_all_ranks(name):
    """Cells fill the domain, vertices are those of one rank, and angles stay away from 0."""
    level, alone = refined(COMM, MESHES[name]), refined(MPI.COMM_SELF, MESHES[name])
    assert (level.cells, level.dofs) == (alone.cells, alone.dofs)
    own = own_cells(level.mesh)
    area = volumes(corners(alone.mesh)).sum()
    assert np.isclose(total(COMM, volumes(corners(level.mesh))[:own]), area, rtol=1e-13)
    places = {tuple(x) for x in np.round(alone.points.T, 10) + 0.0}
    assert all(tuple(x) in places for x in np.round(level.points.T, 10) + 0.0)
    # a hanging node would leave a facet with one cell inside the domain
    if level.mesh.topology.dim > 1 and name != "disk":
        assert np.isclose(extent(level, level.boundary_facets), 4.0 if level.mesh.topology.dim == 2 else 6.0)


def extent(level, facets):
    """Length or area of local facets on the boundary, of all ranks together."""
    cells, numbers, _ = sides(level.mesh, facets)
    x = corners(level.mesh)[cells[:, None], np.array(facet_vertices(level.mesh.topology.dim))[numbers]]
    return total(COMM, sizes(x))


@pytest.mark.parametrize("name", sorted(MESHES.keys() - {"disk"}))  # whose new vertices move onto the circle
def test_prolongation_keeps_linear_functions(name):
    """A new vertex is the middle of an edge of the coarser mesh, or one of its vertices."""
    fine = refined(COMM, MESHES[name])
    P = next(downward(fine)).P
    x, y = P.createVecs()
    linear = np.array([1.0, 2.0, 3.0])
    x.array[:] = (linear @ fine.coarse.points)[: fine.coarse.owned]
    P.mult(x, y)
    assert largest(COMM, np.abs(y.array - (linear @ fine.points)[: fine.owned])) < 1e-14


def test_names_are_inherited():
    """Named parts of the boundary keep their length or area."""
    for mesh, names in (("rectangle", ("left", "right", "top", "bottom")), ("box", ("left", "top", "front", "back"))):
        level = refined(COMM, MESHES[mesh])
        for name in names:
            assert np.isclose(extent(level, level.facets[name]), 1.0)


@pytest.mark.slow
def test_angles_stay_bounded():
    """Right triangles are cut into right triangles, however often: 45 degrees at least."""
    corner = corners(refined(COMM, MESHES["rectangle"], times=7).mesh)
    a, b = corner[:, [1, 2, 0]] - corner, corner[:, [2, 0, 1]] - corner
    cosines = (a * b).sum(axis=2) / np.linalg.norm(a, axis=2) / np.linalg.norm(b, axis=2)
    assert smallest(COMM, np.degrees(np.arccos(cosines))) > 44.9


def shapes_of(level):
    """Volume over the cube of the longest edge of all tetrahedra, times 6."""
    x = corners(level.mesh)[: own_cells(level.mesh)]
    return 6 * volumes(x) / longest_edges(x) ** 3


def test_tetrahedra_of_boxes_have_children_of_three_shapes():
    """Kuhn's tetrahedra are bisected into Maubach's three classes, however often."""
    level = refined(COMM, MESHES["box"])
    expected = np.array([3**-1.5, 0.5 * 2**-1.5, 0.25])
    # of the whole, its half and its quarter, the longest edges 3^(1/2), 2^(1/2) and 1
    nearest = np.abs(shapes_of(level)[:, None] - expected).min(axis=1)
    assert largest(COMM, nearest) < 1e-12
    assert smallest(COMM, longest_edges(corners(level.mesh)[: own_cells(level.mesh)])) < 3**0.5 / 3 / 2**4 + 1e-12


def test_other_tetrahedra_keep_their_quality():
    """Volume over the cube of the longest edge falls to no less than a fourth of what it was, however often."""
    first = refined(COMM, MESHES["perturbed box"], times=0)
    least = smallest(COMM, shapes_of(first))
    assert smallest(COMM, shapes_of(refined(COMM, MESHES["perturbed box"]))) > least / 4


def test_other_cells_are_refused():
    """Quadrilaterals are not cut here: a message, no wrong mesh."""
    scene = Scene(mesh={"shape": "rectangle", "cell": "quadrilateral", "cells": 2}, tension=1, upper=1)
    level = meshes.build(scene.change({"solve.element": "Q1"}), COMM)
    with pytest.raises(InputError, match="intervals, triangles or tetrahedra"):
        levels.refined_where(level, np.ones(own_cells(level.mesh), dtype=bool))


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(["penalty", "vi"], "penalty"))
def test_solves_go_on_from_the_coarser_mesh(ball, method):
    """Nested iteration on local meshes: a few steps on each, and the answer that a cold solve finds."""
    context = SolverContext(ball.change({"mesh.cells": 16, "solve.eps": 1e-6, "solve.method": method}))
    context.answer()
    for _ in range(4):
        level = context.problem.level
        middles = corners(level.mesh)[: own_cells(level.mesh)].mean(axis=1)
        context = context.refined(np.abs(np.linalg.norm(middles[:, :2], axis=1) - 0.7) < 0.2)
        answer = context.answer()
        assert answer.record["newton_iterations"] <= 6
    cold = SolverContext(context.scene.change({"solve.start": "cold"}), level=context.problem.level).answer()
    assert cold.record["dofs"] == answer.record["dofs"] > 1500
    assert np.isclose(cold.record["energy"], answer.record["energy"], rtol=1e-11)
    assert np.isclose(cold.record["contact"]["lower"]["force"], answer.record["contact"]["lower"]["force"], rtol=1e-9)
    assert answer.record["krylov_iterations"] < cold.record["krylov_iterations"]

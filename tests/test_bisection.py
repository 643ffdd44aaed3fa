"""Local refinement: nested meshes without hanging nodes, the same on any number of ranks, and solves on them."""

import numpy as np
import pytest
from conftest import COMM, slow_except
from mpi4py import MPI

from fenicsx_obstacle import InputError, Scene
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete import levels, parents
from fenicsx_obstacle.discrete.cells import corners, facet_vertices, own_cells, sides, volumes
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes import meshes

MESHES = {
    "rectangle": {"shape": "rectangle", "cells": 8},
    "crossed": {"shape": "rectangle", "cells": 6, "diagonal": "crossed", "perturb": 0.1},
    "disk": {"shape": "disk", "cells": 12},
    "l-shape": {"shape": "l-shape", "cells": 8},
    "interval": {"shape": "interval", "cells": 20},
}


def near_a_point(level, radius):
    """Marks the owned cells near a point."""
    middles = corners(level.mesh)[: own_cells(level.mesh)].mean(axis=1)
    dim = level.mesh.topology.dim
    return np.linalg.norm(middles[:, :dim] - [0.3, 0.2][:dim], axis=1) < radius


def refined(comm, mesh, times=4):
    level = meshes.build(Scene(mesh=mesh, tension=1, upper=1), comm)
    for k in range(times):
        level = levels.refined_where(level, near_a_point(level, 0.1 + 0.4 * 0.5**k))
    return level


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
    if level.mesh.topology.dim == 2 and name != "disk":
        assert np.isclose(length(level, level.boundary_facets), 4.0)


def length(level, facets):
    """Length of local facets on the boundary, of all ranks together."""
    cells, numbers, _ = sides(level.mesh, facets)
    ends = corners(level.mesh)[cells[:, None], np.array(facet_vertices(2))[numbers]]
    return total(COMM, np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))


@pytest.mark.parametrize("name", sorted(MESHES.keys() - {"disk"}))  # whose new vertices move onto the circle
def test_prolongation_keeps_linear_functions(name):
    """A new vertex is the middle of an edge of the coarser mesh, or one of its vertices."""
    fine = refined(COMM, MESHES[name])
    P = parents.prolongation(fine.ends, fine.V, fine.coarse.V)
    x, y = P.createVecs()
    linear = np.array([1.0, 2.0, 0.0])
    x.array[:] = (linear @ fine.coarse.points)[: fine.coarse.owned]
    P.mult(x, y)
    assert largest(COMM, np.abs(y.array - (linear @ fine.points)[: fine.owned])) < 1e-14


def test_names_are_inherited():
    """Named parts of the boundary keep their length."""
    level = refined(COMM, MESHES["rectangle"])
    for name in ("left", "right", "top", "bottom"):
        assert np.isclose(length(level, level.facets[name]), 1.0)


def test_angles_stay_bounded():
    """Right triangles are cut into right triangles, however often: 45 degrees at least."""
    corner = corners(refined(COMM, MESHES["rectangle"], times=7).mesh)
    a, b = corner[:, [1, 2, 0]] - corner, corner[:, [2, 0, 1]] - corner
    cosines = (a * b).sum(axis=2) / np.linalg.norm(a, axis=2) / np.linalg.norm(b, axis=2)
    assert smallest(COMM, np.degrees(np.arccos(cosines))) > 44.9


def test_solids_are_refused():
    """Tetrahedra are not cut here: a message, no wrong mesh."""
    level = meshes.build(Scene(mesh={"shape": "box", "cells": 2}, tension=1, upper=1), COMM)
    with pytest.raises(InputError, match="intervals or triangles"):
        levels.refined_where(level, np.ones(own_cells(level.mesh), dtype=bool))


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

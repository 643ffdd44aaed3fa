"""What error bounds sum around nodes, and the small systems of vertex patches."""

from contextlib import closing

import numpy as np
import pytest

from fenicsx_obstacle import Scene
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.patch_systems import PatchSystems
from fenicsx_obstacle.estimation.simplices import Simplices
from tests.conftest import COMM


@pytest.mark.parametrize("shape", ["interval", "rectangle", "box"])
def test_sums_and_extrema_around_vertices(shape):
    """They are those over all cells with the vertex, on whatever ranks these are."""
    scene = Scene(mesh={"shape": shape, "cells": 3}, tension=1, lower=-1, boundary=[{"value": 0}])
    with closing(SolverContext(scene)) as context:
        simplices = Simplices(context.problem.data)
    dofs, around, index_map = simplices.dofs, simplices.around, simplices.data.level.V.dofmap.index_map
    values = np.random.default_rng(COMM.rank).random(dofs.shape)
    local = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    numbers, size = np.asarray(index_map.local_to_global(local)), index_map.size_global
    every = np.concatenate(COMM.allgather(numbers[dofs].ravel()))
    of_all = np.concatenate(COMM.allgather(values.ravel()))
    most, least = np.zeros(size), np.full(size, np.inf)
    np.maximum.at(most, every, of_all)
    np.minimum.at(least, every, of_all)
    np.testing.assert_allclose(around.sums(values), np.bincount(every, of_all, size)[numbers], rtol=1e-13)
    np.testing.assert_array_equal(around.largest(values), most[numbers])
    np.testing.assert_array_equal(around.smallest(values), least[numbers])


@pytest.mark.serial
def test_systems_of_patches():
    """Their unknowns solve the sums of the matrices at the corners, those that are 0 left out."""
    rng = np.random.default_rng(1)
    owner = np.array([0, 0, 1, 2, 2, 2])  # systems of 2, 1 and 3 unknowns
    numbers = np.array([[0, 1], [1, 0], [2, 2], [3, 4], [4, 5], [5, 3]])
    zero = np.array([False, False, False, False, True, False])
    at_corners = rng.random((len(numbers), 2, 2)) / 4
    at_corners += at_corners.transpose(0, 2, 1) + 2 * np.eye(2)
    right, full, sums = rng.random((2, len(numbers))), np.zeros((6, 6)), np.zeros(6)
    for row, matrix, side in zip(numbers, at_corners, right.T, strict=True):
        np.add.at(full, np.ix_(row, row), matrix)
        np.add.at(sums, row, side)
    free = np.flatnonzero(~zero)
    expected = np.zeros(6)
    expected[free] = np.linalg.solve(full[np.ix_(free, free)], sums[free])
    products = ((i, j, at_corners[:, i, j]) for i in range(2) for j in range(i, 2))
    found = PatchSystems(numbers, owner, zero, products).solve(right)
    np.testing.assert_allclose(found, expected[numbers].T, rtol=1e-12)

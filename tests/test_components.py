"""Connected components of meshes, and parts that touch without shared nodes."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import InputError, Scene, releases, solve
from fenicsx_obstacle.mesh.checks import components
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes.meshes import build
from tests.conftest import COMM
from tests.helpers import Membrane, cut, grid, mesh_of

KINDS = {2: "interval", 3: "triangle", 4: "tetrahedron"}


def box(n, corner=(0.0, 0.0, 0.0), reverse=False):
    """Points and tetrahedra of a cube of n^3 cubes; reversed, its faces have the other diagonals."""
    axes = np.meshgrid(*[np.linspace(0, 1, n + 1)] * 3, indexing="ij")
    number = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    cells = []
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        steps = np.concatenate([np.zeros((1, 3), int), np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)])
        cells.append(np.column_stack([number[tuple(slice(i, i + n) for i in step)].ravel() for step in steps]))
    points = np.column_stack([axis.ravel() for axis in axes])
    if reverse:
        points[:, 1] = 1 - points[:, 1]
    return points + np.array(corner), np.concatenate(cells)


def union(*bodies, scale=1.0):
    """The mesh of several bodies, each with nodes of its own, spread over the ranks."""
    shift, cells = 0, []
    for points, body in bodies:
        cells.append(body + shift)
        shift += len(points)
    points, cells = np.concatenate([points for points, _ in bodies]) * scale, np.concatenate(cells)
    return mesh_of(points, cells, KINDS[cells.shape[1]])


def level(mesh):
    return build(Scene(mesh=mesh, tension=1), COMM, 0)


LEFT, RIGHT = grid(4, 4), grid(4, 4, (1, 0))
TOUCHING = {
    "alike": (LEFT, RIGHT),
    "other diagonals": (LEFT, grid(4, 4, (1, 0), flip=True)),
    "other sizes": (LEFT, grid(3, 5, (1, 0))),
    "part of a side": (LEFT, grid(2, 2, (1, 0.3), (1, 0.4))),
    "a corner's width of one edge": (grid(1, 1), grid(1, 1, (1, 0.8))),
    "overlap": (LEFT, grid(4, 4, (0.6, 0.3))),
    "a thin overlap": (LEFT, grid(4, 4, (0.997, 0))),
    "one inside the other": (grid(8, 8), grid(2, 2, (0.3, 0.3), (0.2, 0.2))),
    "twice the same": (LEFT, LEFT),
    "digits lost": (LEFT, grid(4, 4, (1 + 4e-7, 0))),
    "cubes": (box(2), box(2, (1, 0, 0))),
    "cubes, other diagonals": (box(1), box(1, (1, 0, 0), reverse=True)),
    "cubes, part of a side": (box(2), box(1, (1, 0.5, 0.4))),
}


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e6])
@pytest.mark.parametrize("name", TOUCHING)
def test_parts_that_touch_without_shared_nodes_are_rejected(name, scale):
    """Bodies that were not fragmented are no solution's domain, whatever their meshes and the unit of length."""
    with pytest.raises(InputError, match=r"(touch without shared nodes|overlap).*BooleanFragments"):
        level(union(*TOUCHING[name], scale=scale))


APART = {
    "a gap": (LEFT, grid(4, 4, (1.5, 0))),
    "a narrow gap": (LEFT, grid(4, 4, (1.001, 0))),
    "a corner": (LEFT, grid(4, 4, (1, 1))),
    "a corner on a side": (LEFT, (np.array([[1.0, 0.4], [2.0, 0.0], [2.0, 1.0]]), np.array([[0, 1, 2]]))),
    "cubes at an edge": (box(2), box(2, (1, 1, 0))),
    "cubes at a corner": (box(2), box(2, (1, 1, 1))),
    "intervals": ((np.array([[0.0], [1.0]]), np.array([[0, 1]])), (np.array([[2.0], [3.0]]), np.array([[0, 1]]))),
}


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e6])
@pytest.mark.parametrize("name", APART)
def test_parts_that_are_apart_are_counted(name, scale):
    """Two bodies with a gap, or that meet in less than a facet, are two components, which the answer says."""
    mesh = union(*APART[name], scale=scale)
    assert level(mesh).remarks == ("2 parts that are not connected: u must be supported in each",)
    found = components(mesh)
    assert found.count == 2
    middles = dmesh.compute_midpoints(mesh, mesh.topology.dim, np.arange(len(found.of_cells), dtype=np.int32))
    second = APART[name][1][0].min(axis=0) * scale
    inside = (middles[:, : len(second)] >= second - 1e-9 * scale).all(axis=1)
    assert np.array_equal(found.of_cells, inside.astype(int))
    V = releases.functionspace(mesh, "Lagrange", 1)
    assert (found.of_dofs(V)[releases.cell_dofs(V)] == inside[:, None]).all()


def test_corner_node_that_two_parts_share():
    """A shared vertex is no connection of two membranes."""
    points = np.array([[0.0, 0], [1, 0], [1, 1], [2, 1], [2, 2]])
    mesh = mesh_of(points, [[0, 1, 2], [2, 3, 4]])
    found = components(mesh)
    assert found.count == 2
    V = releases.functionspace(mesh, "Lagrange", 1)
    owned = V.dofmap.index_map.size_local
    assert total(COMM, found.of_dofs(V)[:owned]) == 3


def test_two_parts_are_solved_and_counted():
    """Two squares apart, each held: the solution of one twice, and the answer says that there are two."""
    one, two = (solve(Scene(mesh=union(*bodies), tension=1, load=-1)) for bodies in ((LEFT,), APART["a gap"]))
    assert np.isclose(two.record["energy"], 2 * one.record["energy"], rtol=1e-12)
    assert "mesh_remarks" not in one.record
    assert "\n  mesh: 2 parts that are not connected: u must be supported in each" in two.summary()


def test_many_components_have_the_same_numbers_on_any_number_of_ranks():
    """Components are numbered by their place, not by the partition."""
    mesh = union(*(grid(3, 2, (2.0 * i, 3.0 * j)) for j in range(3) for i in range(4)))
    found = components(mesh)
    assert found.count == 12
    middles = dmesh.compute_midpoints(mesh, 2, np.arange(len(found.of_cells), dtype=np.int32))
    assert np.array_equal(found.of_cells, 3 * (middles[:, 0] // 2) + middles[:, 1] // 3)


def test_slit_is_no_fault():
    """Both sides of a crack have nodes of their own: solved, and said."""
    points, cells = grid(4, 4)
    crack = (points[:, 1] == 0.5) & (points[:, 0] < 0.3)  # ends within the square
    found = level(union(cut(points, cells, crack, points[cells].mean(axis=1)[:, 1] > 0.5)))
    assert found.remarks == ("a slit at (0.125, 0.5, 0): 2 pairs of sides without shared nodes",)


def test_hanging_nodes_are_rejected():
    """A vertex within another cell's edge, in one connected mesh: u would be torn there."""
    points = np.array([[0.0, 0], [2, 0], [1, 1.5], [1, 0], [1, -1], [3, 0]])
    cells = np.array([[0, 1, 2], [0, 3, 4], [3, 1, 4], [1, 5, 2], [1, 5, 4]])
    with pytest.raises(InputError, match="hanging nodes"):
        level(union((points, cells)))


def test_cells_of_the_callers_own_mesh():
    """A cell without area and cells on top of each other are rejected with their place, also by ObstacleProblem."""
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0.5, 0.5], [0, 1], [1, 0.5]])
    for cells, words in (
        ([[0, 1, 2], [0, 2, 3]], r"the triangle at \(0.5, 0.5, 0\) has no area"),
        ([[0, 1, 2], [0, 2, 4], [0, 2, 5]], "cells lie on each other"),
        ([[0, 1, 2], [0, 2, 5]], "cells lie on each other"),
    ):
        mesh = union((points, np.array(cells)))
        with pytest.raises(InputError, match="scene: .*" + words):
            level(mesh)
        own = Membrane(mesh)
        with pytest.raises(InputError, match="ObstacleProblem: .*" + words):
            own.problem(bcs=[], lower=-1)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_vertex_that_was_moved_too_far(dim):
    """A vertex beyond a neighbour turns cells inside out, so that they lie on others; a smaller move is allowed."""
    create = (dmesh.create_unit_interval, dmesh.create_unit_square, dmesh.create_unit_cube)[dim - 1]
    for shift, expected in ((0.7, nullcontext()), (1.5, pytest.raises(InputError, match="cells lie on each other"))):
        mesh = create(COMM, *[4] * dim)
        mesh.geometry.x[np.abs(mesh.geometry.x[:, :dim] - 0.5).max(axis=1) < 1e-9, 0] += shift / 4
        with expected:
            level(releases.settle(mesh))


def test_networks_and_surfaces_in_space():
    """Wires and plates that meet in a shared node or edge are connected; without it they are rejected."""
    wire = (np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]]), np.array([[0, 1], [1, 2], [1, 3]]))
    assert components(union(wire)).count == 1 and level(union(wire)).remarks == ()
    branch = (np.array([[1.0, 0, 0], [1, 1, 1]]), np.array([[0, 1]]))
    straight = (np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([[0, 1]]))
    plane = LEFT[0] @ np.eye(2, 3), LEFT[1]
    wall = LEFT[0] @ np.array([[1.0, 0, 0], [0, 0, 1]]) + np.array([0, 0.5, 0]), LEFT[1]
    for bodies in ((straight, branch), (plane, wall)):
        with pytest.raises(InputError, match="touch without shared nodes"):
            level(union(*bodies))

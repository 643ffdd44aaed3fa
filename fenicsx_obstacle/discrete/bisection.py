"""Local refinement: marked triangles are cut into four, and neighbours are bisected for conformity.

A triangle with a marked edge has its longest edge marked too, so that angles stay bounded (Rivara). DOLFINx's own
refinement gives no parents in 0.5, and omits ghosts in 0.9.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.discrete.parents import EDGES, numbers
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import before, total

ALIKE = 1e-9  # relative difference of lengths that are the same
# children of a cell with vertices and, after them, middles of edges, by the edges that are marked. A triangle is turned
# so that its first edge, opposite to vertex 0, is the longest one
_CHILDREN: dict[int, dict[tuple[bool, ...], list[tuple[int, ...]]]] = {
    1: {(False,): [(0, 1)], (True,): [(0, 2), (2, 1)]},
    2: {
        (False, False, False): [(0, 1, 2)],
        (True, False, False): [(0, 1, 3), (0, 3, 2)],
        (True, False, True): [(5, 1, 3), (0, 5, 3), (0, 3, 2)],
        (True, True, False): [(0, 1, 3), (0, 3, 4), (4, 3, 2)],
        (True, True, True): [(0, 5, 4), (5, 1, 3), (4, 3, 2), (3, 4, 5)],
    },
}


def refined_where(V: fem.FunctionSpace, marked: np.ndarray) -> tuple[dmesh.Mesh, np.ndarray, np.ndarray]:
    """The mesh with all edges of marked cells halved, and few others for conformity; cells stay on their rank
    (collective).

    Args:
        V: P1 space on intervals or triangles.
        marked: Whether to refine each owned cell.

    Returns:
        The mesh, the parent of each of its owned cells, and where in the parent the corners of the cell are: numbers of
        vertices and, after these, of edges.

    Raises:
        InputError: For other cells.
    """
    mesh = V.mesh
    comm, dim, gdim, own = mesh.comm, mesh.topology.dim, mesh.geometry.dim, own_cells(mesh)
    if dim not in _CHILDREN:
        raise InputError("adaptive meshes need intervals or triangles; use uniform refinement, 'refine'")
    marks, halves, turned = _marks(mesh, marked)
    vertices, edges = V.dofmap.index_map, mesh.topology.index_map(1)
    count, mine = vertices.size_local, marks.array_r[: edges.size_local] > 0
    # points in the order of ranks, of each its vertices and then the middles of its marked edges
    first = before(comm, count + np.count_nonzero(mine))
    place = marks.duplicate()
    place.array[mine] = first + count + np.arange(np.count_nonzero(mine))
    place.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
    with place.localForm() as local:
        middles = local.array_r[halves[:own]].astype(np.int64)
    number = np.hstack([numbers(comm, vertices, releases.cell_dofs(V)[:own], first), middles])
    x = mesh.geometry.x[:, :gdim]
    corner, sides = x[releases.geometry_dofs(mesh)], np.array(EDGES[dim])
    middle = np.empty((edges.size_local + edges.num_ghosts, gdim))
    middle[halves] = corner[:, sides].mean(axis=2)
    points = np.vstack([x[releases.dof_nodes(V)[:count]], middle[: edges.size_local][mine]])
    with marks.localForm() as local:
        pattern = np.take_along_axis(local.array_r[halves[:own]] > 0, turned[:own, dim + 1 :] - dim - 1, axis=1)
    parents, places = _cut(turned[:own], pattern)
    new = releases.create_mesh(comm, number[parents[:, None], places], points, releases.cell_name(mesh), stay=True)
    kept = np.asarray(new.topology.original_cell_index)[: own_cells(new)] - before(comm, len(parents))
    for owner in (marks, place):
        owner.destroy()
    return new, parents[kept].astype(np.int32), places[kept].astype(np.int8)


def _marks(mesh: dmesh.Mesh, marked: np.ndarray) -> tuple[PETSc.Vec, np.ndarray, np.ndarray]:
    """Marked edges as a ghosted vector, edges of local cells, and how each cell is turned (collective).

    A cell is turned by a permutation of its vertices and edges, shape (cells, vertices + edges).
    """
    dim, own = mesh.topology.dim, own_cells(mesh)
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(dim, 1)
    edges = mesh.topology.index_map(1)
    if dim == 1:
        halves = np.arange(edges.size_local + edges.num_ghosts, dtype=np.int32).reshape(-1, 1)
    else:
        halves = mesh.topology.connectivity(dim, 1).array.reshape(-1, len(EDGES[dim]))
    turned = _longest_first(mesh)
    size = edges.size_local, edges.size_global
    marks = PETSc.Vec().createGhost(np.asarray(edges.ghosts, dtype=PETSc.IntType), size, comm=mesh.comm)
    _mark(marks, halves[:own][marked])
    longest = np.take_along_axis(halves[:own], turned[:own, dim + 1 : dim + 2] - dim - 1, axis=1)[:, 0]
    while True:
        with marks.localForm() as local:
            missing = (local.array_r[halves[:own]] > 0).any(axis=1) & (local.array_r[longest] == 0)
        if total(mesh.comm, np.count_nonzero(missing)) == 0:
            return marks, halves, turned
        _mark(marks, longest[missing])


def _mark(marks: PETSc.Vec, edges: np.ndarray) -> None:
    """Mark local edges, on all ranks that have them (collective)."""
    new = marks.duplicate()
    with new.localForm() as local:
        local.set(0.0)
        local.array[edges.ravel()] = 1.0
    new.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    marks.axpy(1.0, new)
    marks.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
    new.destroy()


def _longest_first(mesh: dmesh.Mesh) -> np.ndarray:
    """Vertices and edges of each local cell in turn, so that the first edge is the longest."""
    dim = mesh.topology.dim
    corner = mesh.geometry.x[releases.geometry_dofs(mesh)]
    if dim == 1:
        return np.tile([0, 1, 2], (len(corner), 1))
    ends = corner[:, np.array(EDGES[dim])]
    length = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)
    # of edges alike the one farthest in some direction: the same whatever the order of the vertices
    farthest = ends.mean(axis=2) @ np.array([1.0, np.sqrt(2.0), np.sqrt(3.0)])
    alike = length >= (1 - ALIKE) * length.max(axis=1, keepdims=True)
    first = np.where(alike, farthest, -np.inf).argmax(axis=1)
    turn = (first[:, None] + np.arange(3)) % 3
    return np.hstack([turn, 3 + turn])


def _cut(turned: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parents of all children, and the places of their corners in them."""
    dim = 1 if pattern.shape[1] == 1 else 2
    parents, places = [np.empty(0, dtype=np.int64)], [np.empty((0, dim + 1), dtype=np.int64)]
    for marked, pieces in _CHILDREN[dim].items():
        cells = np.flatnonzero((pattern == marked).all(axis=1))
        for piece in pieces:
            parents.append(cells)
            places.append(turned[cells][:, piece])
    order = np.argsort(np.concatenate(parents), kind="stable")
    return np.concatenate(parents)[order], np.concatenate(places)[order]

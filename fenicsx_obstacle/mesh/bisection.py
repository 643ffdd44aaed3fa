"""Local refinement: marked triangles are cut into four, tetrahedra into eight; neighbours are bisected for conformity.

A triangle with a marked edge has its longest edge marked too, also one that is a face of a tetrahedron, so that angles
stay bounded (Rivara 1984; Plaza and Carey 2000). Tetrahedra are bisected at their longest marked edge, and the halves
at theirs, until no marked edge is left: so a face is cut alike from both sides. The tetrahedra of our boxes have
children of three shapes only, which are Maubach's (1995). DOLFINx's own refinement gives no parents in 0.5, and omits
ghosts in 0.9.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.around_nodes import over_ranks
from fenicsx_obstacle.mesh.cells import cell_edges, given_cells, own_cells
from fenicsx_obstacle.mesh.halving import Numbers
from fenicsx_obstacle.mesh.shared_dofs import points_of_nodes
from fenicsx_obstacle.parallel import before, total
from fenicsx_obstacle.polynomials import EDGES

ALIKE = 1e-9  # relative difference of lengths that are the same
# edges of the faces of a cell
_FACES: dict[int, list[tuple[int, ...]]] = {1: [(0,)], 2: [(0, 1, 2)], 3: [(0, 1, 2), (0, 3, 4), (1, 3, 5), (2, 4, 5)]}
# children of a triangle with vertices and, after them, middles of edges, by the edges that are marked. It is turned so
# that its first edge, opposite to vertex 0, is the longest one
_CHILDREN: dict[tuple[bool, ...], list[tuple[int, ...]]] = {
    (False, False, False): [(0, 1, 2)],
    (True, False, False): [(0, 1, 3), (0, 3, 2)],
    (True, False, True): [(5, 1, 3), (0, 5, 3), (0, 3, 2)],
    (True, True, False): [(0, 1, 3), (0, 3, 4), (4, 3, 2)],
    (True, True, True): [(0, 5, 4), (5, 1, 3), (4, 3, 2), (3, 4, 5)],
}


def refined_where(V: fem.FunctionSpace, marked: np.ndarray) -> tuple[dmesh.Mesh, np.ndarray, np.ndarray]:
    """The mesh with all edges of marked cells halved, and few others for conformity; cells stay on their rank
    (collective).

    Args:
        V: P1 space on intervals, triangles or tetrahedra.
        marked: Whether to refine each owned cell.

    Returns:
        The mesh, the parent of each of its owned cells, and where in the parent the corners of the cell are: numbers of
        vertices and, after these, of edges.

    Raises:
        InputError: For other cells.
    """
    mesh = V.mesh
    comm, dim, gdim, own = mesh.comm, mesh.topology.dim, mesh.geometry.dim, own_cells(mesh)
    if releases.cell_name(mesh) not in SIMPLICES:
        raise InputError("adaptive meshes need intervals, triangles or tetrahedra; use uniform refinement, 'refine'")
    marks, halves, order = _marks(mesh, marked)
    vertices, edges = V.dofmap.index_map, mesh.topology.index_map(1)
    count, mine = vertices.size_local, marks[: edges.size_local]
    # points in the order of ranks, of each its vertices and then the middles of its marked edges
    first = before(comm, count + np.count_nonzero(mine))
    place = la.vector(edges)
    place.array[np.flatnonzero(mine)] = first + count + np.arange(np.count_nonzero(mine))
    place.scatter_forward()
    middles = place.array[halves[:own]].astype(np.int64)
    kept = Numbers.of(comm, vertices).moved(np.array(comm.allgather(first)))
    number = np.hstack([kept[releases.cell_dofs(V)[:own]], middles])
    x = mesh.geometry.x[:, :gdim]
    corner, sides = x[releases.geometry_dofs(mesh)], np.array(EDGES[dim])
    middle = np.empty((edges.size_local + edges.num_ghosts, gdim))
    middle[halves] = corner[:, sides].mean(axis=2)
    points = np.vstack([points_of_nodes(V)[:count, :gdim], middle[: edges.size_local][mine]])
    chosen = np.where(marks[halves[:own]], order[halves[:own]], -1)
    parents, places = _cut(order[halves[:own]], chosen >= 0) if dim == 2 else _bisected(chosen, dim)
    new = releases.create_mesh(comm, number[parents[:, None], places], points, releases.cell_name(mesh), stay=True)
    rows = given_cells(new) - before(comm, len(parents))
    return new, parents[rows].astype(np.int32), places[rows].astype(np.int8)


def _marks(mesh: dmesh.Mesh, marked: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether each local edge is marked, edges of local cells, and the place of each local edge in order of length
    (collective)."""
    dim, own = mesh.topology.dim, own_cells(mesh)
    halves, edges = cell_edges(mesh), mesh.topology.index_map(1)
    count = edges.size_local + edges.num_ghosts
    order, marks, found = _by_length(mesh, halves, count), np.zeros(count, dtype=bool), halves[:own][marked]
    faces = halves[:own][:, np.array(_FACES[dim])].reshape(-1, len(_FACES[dim][0]))
    longest = np.take_along_axis(faces, order[faces].argmax(axis=1)[:, None], axis=1)[:, 0]
    while True:
        marks[found] = True  # on all ranks that have them
        marks = over_ranks(edges, mesh.comm, marks.astype(float), PETSc.InsertMode.MAX) > 0
        missing = marks[faces].any(axis=1) & ~marks[longest]
        if total(mesh.comm, np.count_nonzero(missing)) == 0:
            return marks, halves, order
        found = longest[missing]


def _by_length(mesh: dmesh.Mesh, halves: np.ndarray, count: int) -> np.ndarray:
    """The place of each local edge among all in order of length, the same on all ranks.

    Of edges alike the one farther in some direction is the longer one: the same whatever the order of the vertices.
    """
    ends = np.zeros((count, 2, 3))
    ends[halves] = mesh.geometry.x[releases.geometry_dofs(mesh)][:, np.array(EDGES[mesh.topology.dim])]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    alike = np.round(np.log(np.maximum(length, 1e-300)) / ALIKE)
    farther = ends.sum(axis=1) @ np.array([1.0, np.sqrt(2.0), np.sqrt(3.0)])
    order = np.empty(count, dtype=np.int64)
    order[np.lexsort((farther, alike))] = np.arange(count)
    return order


def _bisected(order: np.ndarray, dim: int) -> tuple[np.ndarray, np.ndarray]:
    """Parents of all children of intervals or tetrahedra, and the places of their corners in them.

    Args:
        order: Of edges by length where they are marked, otherwise -1, shape (cells, edges).
        dim: Of the cells.
    """
    sides, edge = np.array(EDGES[dim]), np.zeros((dim + 1, dim + 1), dtype=np.int64)
    for number, (i, j) in enumerate(EDGES[dim]):
        edge[i, j] = edge[j, i] = number
    parents, places = np.arange(len(order)), np.tile(np.arange(dim + 1), (len(order), 1))
    done = []
    while len(parents):
        ends = places[:, sides]
        whole, number = ends.max(axis=2) <= dim, edge[tuple(np.minimum(ends, dim).transpose(2, 0, 1))]
        here = np.where(whole, order[parents[:, None], number], -1)
        first = here.argmax(axis=1)
        cut = np.flatnonzero(here.max(axis=1) >= 0)
        kept = np.setdiff1d(np.arange(len(parents)), cut, assume_unique=True)
        done.append((parents[kept], places[kept]))
        halves = np.repeat(places[cut], 2, axis=0)
        for k in range(2):  # the middle in place of one end
            halves[np.arange(k, len(halves), 2), sides[first[cut], k]] = dim + 1 + number[cut, first[cut]]
        parents, places = np.repeat(parents[cut], 2), halves
    all_parents = np.concatenate([order[:0, 0], *(part[0] for part in done)])
    all_places = np.concatenate([places[:0], *(part[1] for part in done)])
    by_parent = np.argsort(all_parents, kind="stable")
    return all_parents[by_parent], all_places[by_parent]


def _cut(order: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parents of all children of triangles, and the places of their corners in them.

    Args:
        order: Of edges by length, shape (cells, 3).
        pattern: Whether they are marked.
    """
    turn = (order.argmax(axis=1)[:, None] + np.arange(3)) % 3
    turned, pattern = np.hstack([turn, 3 + turn]), np.take_along_axis(pattern, turn, axis=1)
    parents, places = list[np.ndarray](), list[np.ndarray]()
    for marked, pieces in _CHILDREN.items():
        cells = np.flatnonzero((pattern == marked).all(axis=1))
        for piece in pieces:
            parents.append(cells)
            places.append(turned[cells][:, piece])
    order = np.argsort(np.concatenate(parents), kind="stable")
    return np.concatenate(parents)[order], np.concatenate(places)[order]

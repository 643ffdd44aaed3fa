"""Refinement: parent cells of a refined mesh, and the interpolation that follows from them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import barycentric, cell_facets, corners, facet_vertices
from fenicsx_obstacle.parallel import before, on_root

Name = TypeVar("Name", str, tuple[int, int])
ToCad: TypeAlias = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
STAYS = 1e-12  # of its distance from 0: such a move is round-off


def ends_of(V: fem.FunctionSpace, coarse: fem.FunctionSpace, parents: np.ndarray, places: np.ndarray) -> np.ndarray:
    """For each owned dof of V the two local dofs of `coarse` of which it is the mean, shape (owned dofs, 2).

    A vertex of a refined cell is a vertex of its parent or the middle of one of its edges; `places` says which.
    """
    owned = V.dofmap.index_map.size_local
    dofs = releases.cell_dofs(V)[: len(parents)]
    one = np.empty(owned + V.dofmap.index_map.num_ghosts, dtype=np.int32)  # one corner of a cell of each dof
    one[dofs.ravel()] = np.arange(dofs.size, dtype=np.int32)
    one = one[:owned]
    rows = releases.cell_dofs(coarse)[parents[one // dofs.shape[1]]]
    dim = V.mesh.topology.dim
    of = np.array([(i, i) for i in range(dim + 1)] + EDGES[dim])[places.ravel()[one]]
    return np.take_along_axis(rows, of, axis=1)


def prolongation(ends: np.ndarray, fine: fem.FunctionSpace, coarse: fem.FunctionSpace) -> PETSc.Mat:
    """P1 interpolation from a mesh to its refinement as a matrix (collective)."""
    numbering = coarse.dofmap.index_map
    same = ends[:, 0] == ends[:, 1]
    starts = np.zeros(len(ends) + 1, dtype=PETSc.IntType)
    np.cumsum(2 - same, out=starts[1:])
    columns, values = np.empty(starts[-1], dtype=np.int32), np.full(starts[-1], 0.5)
    columns[starts[:-1]] = ends.min(axis=1)
    columns[starts[1:] - 1] = ends.max(axis=1)
    values[starts[:-1][same]] = 1.0
    columns = np.asarray(numbering.local_to_global(columns))
    size = [(space.dofmap.index_map.size_local, space.dofmap.index_map.size_global) for space in (fine, coarse)]
    return PETSc.Mat().createAIJ(size, csr=(starts, columns.astype(PETSc.IntType), values), comm=fine.mesh.comm)


def halved(mesh: dmesh.Mesh, V: fem.FunctionSpace) -> tuple[dmesh.Mesh, np.ndarray, np.ndarray]:
    """The mesh with all edges halved (collective).

    Triangles are cut into four of their own shape, so that a grid stays a grid; DOLFINx's own refinement bisects
    longest edges, which turns every other diagonal.

    Returns:
        The mesh, the parent of each of its owned cells, and where in the parent the corners of the cell are: numbers of
        vertices and, after these, of edges.
    """
    comm, dim, gdim = mesh.comm, mesh.topology.dim, mesh.geometry.dim
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(dim, 1)
    vertices, edges = V.dofmap.index_map, mesh.topology.index_map(1)
    own = mesh.topology.index_map(dim).size_local
    dofs = releases.cell_dofs(V)[:own]
    sides = EDGES[dim]
    if dim == 1:
        halves = np.arange(edges.size_local + edges.num_ghosts, dtype=np.int32).reshape(-1, 1)
    else:
        halves = mesh.topology.connectivity(dim, 1).array.reshape(-1, len(sides))
    # points in the order of ranks, of each its vertices and then the middles of its edges
    first = before(comm, vertices.size_local + edges.size_local)
    number = np.hstack(
        [numbers(comm, vertices, dofs, first), numbers(comm, edges, halves[:own], first + vertices.size_local)]
    )
    points = np.empty((vertices.size_local + edges.size_local, gdim))
    points[: vertices.size_local] = mesh.geometry.x[releases.dof_nodes(V)[: vertices.size_local], :gdim]
    corner = mesh.geometry.x[releases.geometry_dofs(mesh), :gdim]
    middle = np.empty((edges.size_local + edges.num_ghosts, gdim))
    for side, (i, j) in enumerate(sides):
        middle[halves[:, side]] = (corner[:, i] + corner[:, j]) / 2
    points[vertices.size_local :] = middle[: edges.size_local]
    children = np.array([_CORNERS[dim] + [(*d, *edge) for edge in ring] for d, ring in _RING[dim].items()])
    pattern = _inner_diagonal(corner[:own]) if dim == 3 else np.zeros(own, dtype=int)
    patterns = children.reshape(len(children), -1)
    cells = number[:, patterns[0]] if len(patterns) == 1 else np.take_along_axis(number, patterns[pattern], axis=1)
    cells = cells.reshape(-1, dim + 1)
    new = releases.create_mesh(comm, cells, points, releases.cell_name(mesh), stay=True)
    start = before(comm, len(cells))
    kept = np.asarray(new.topology.original_cell_index)[: new.topology.index_map(dim).size_local] - start
    parents = (kept // 2**dim).astype(np.int32)
    return new, parents, children.astype(np.int8)[pattern[parents], kept % 2**dim]


# a simplex with vertices 0..dim and the middles of its edges after them: edges, children at the corners, the rest
EDGES = {
    1: [(0, 1)],
    2: [(1, 2), (0, 2), (0, 1)],
    3: [(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)],
}
_CORNERS: dict[int, list[tuple[int, ...]]] = {
    1: [(0, 2), (2, 1)],
    2: [(0, 5, 4), (5, 1, 3), (4, 3, 2)],
    3: [(0, 9, 8, 7), (9, 1, 6, 5), (8, 6, 2, 4), (7, 5, 4, 3)],
}
# children inside: the diagonal they share, and the ring of edges around it; of a tetrahedron there are three choices
_RING: dict[int, dict[tuple[int, ...], list[tuple[int, ...]]]] = {
    1: {(): []},
    2: {(): [(3, 4, 5)]},
    3: {
        (4, 9): [(5, 6), (6, 8), (8, 7), (7, 5)],
        (5, 8): [(4, 6), (6, 9), (9, 7), (7, 4)],
        (6, 7): [(4, 5), (5, 9), (9, 8), (8, 4)],
    },
}


def _inner_diagonal(corner: np.ndarray) -> np.ndarray:
    """Which of the three diagonals cuts the inner octahedron of each tetrahedron, by its place in `_RING[3]`.

    The shortest; of two alike the one along the longest edge: then the six tetrahedra of a cube become those of its
    eight parts.
    """
    ends = [[(corner[:, i] + corner[:, j]) / 2 for i, j in (EDGES[3][m - 4] for m in pair)] for pair in _RING[3]]
    edges = np.stack([corner[:, j] - corner[:, i] for i, j in EDGES[3]], axis=1)
    longest = edges[np.arange(len(edges)), (edges**2).sum(axis=2).argmax(axis=1)]
    score = []
    for a, b in ends:
        along = np.abs(((a - b) * longest).sum(axis=1))
        score.append(((a - b) ** 2).sum(axis=1) - 1e-6 * along)
    return np.argmin(score, axis=0)


def numbers(comm: MPI.Comm, entities: Any, local: np.ndarray, first: int) -> np.ndarray:
    """Global numbers of local entities where those of each rank begin at its `first` (collective)."""
    starts = np.array(comm.allgather((entities.local_range[0], first)), dtype=np.int64).reshape(-1, 2)
    place = np.asarray(entities.local_to_global(local.astype(np.int32).ravel()), dtype=np.int64)
    # ranks that own none share their start with the next: take the last
    rank = np.searchsorted(starts[:, 0], place, side="right") - 1
    return (place - starts[rank, 0] + starts[rank, 1]).reshape(local.shape)


def inherited(
    named: dict[Name, np.ndarray], mesh: dmesh.Mesh, new: dmesh.Mesh, parents: np.ndarray
) -> dict[Name, np.ndarray]:
    """Named facets of a refined mesh: those that lie within a named facet of their parent cell (local)."""
    dim = new.topology.dim
    members = facet_vertices(dim)
    old_facets, new_facets = cell_facets(mesh), cell_facets(new)
    found: dict[Name, np.ndarray] = {}
    for name, facets in named.items():
        marked = np.zeros(old_facets.max(initial=-1) + 1, dtype=bool)
        marked[facets] = True
        # nearly all cells lie inside: look at the children of those that have such a facet only
        children = np.flatnonzero(marked[old_facets].any(axis=1)[parents])
        on_facet = marked[old_facets[parents[children]]]
        weights = barycentric(corners(new, children), corners(mesh, parents[children]))
        inside = []
        for i, of_new in enumerate(members):
            for k, of_old in enumerate(members):
                outside = [j for j in range(dim + 1) if j not in of_old]
                on_old = np.all(weights[:, of_new][:, :, outside] < 0.25, axis=(1, 2))
                inside.append(new_facets[children[on_old & on_facet[:, k]], i])
        found[name] = np.unique(np.concatenate(inside)).astype(np.int32)
    return found


def snap(V: fem.FunctionSpace, facets: np.ndarray, project: Callable[[np.ndarray], np.ndarray]) -> None:
    """Move new boundary vertices onto the curved boundary: a refined polygon never becomes a circle."""
    mesh = V.mesh
    dofs = fem.locate_dofs_topological(V, mesh.topology.dim - 1, facets)
    nodes, gdim = releases.dof_nodes(V)[dofs], mesh.geometry.dim
    mesh.geometry.x[nodes, :gdim] = project(mesh.geometry.x[nodes, :gdim])


def snap_to_cad(V: fem.FunctionSpace, parts: dict[tuple[int, int], np.ndarray], to_cad: ToCad) -> None:
    """Move vertices onto the curves or surfaces that their facets or cells come from (collective).

    Args:
        V: P1 on a new mesh.
        parts: As for `on_cad`.
        to_cad: As `Level.to_cad`.
    """
    x, nodes, gdim = V.mesh.geometry.x, releases.dof_nodes(V), V.mesh.geometry.dim
    moved = on_cad(V, x[nodes], parts, to_cad)
    x[nodes, :gdim] = moved[:, :gdim]


def on_cad(
    V: fem.FunctionSpace, points: np.ndarray, parts: dict[tuple[int, int], np.ndarray], to_cad: ToCad
) -> np.ndarray:
    """Points of the dofs of V, those on facets or cells of curves or surfaces moved to these (collective).

    A point that would be moved by more than the size of its cells stays: the nearest one is on the other side of a
    body.

    Args:
        V: Lagrange elements.
        points: Of its local dofs, shape (dofs, 3).
        parts: Local facets or owned cells on each curve or surface, by its dimension and number, for every rank.
        to_cad: As `Level.to_cad`.
    """
    mesh, comm = V.mesh, V.mesh.comm
    for dim in sorted({dim for dim, _ in parts}):
        mesh.topology.create_connectivity(dim, mesh.topology.dim)  # of cells to themselves too: newer DOLFINx wants it
    dofs = {key: fem.locate_dofs_topological(V, key[0], some.astype(np.int32)) for key, some in parts.items()}
    mine = np.unique(np.concatenate([np.empty(0, np.int64), *dofs.values()])).astype(np.int64)
    rows = np.concatenate([np.empty(0, np.int64), *(np.searchsorted(mine, some) for some in dofs.values())])
    entities = np.repeat(np.array(list(dofs)).reshape(-1, 2), [len(some) for some in dofs.values()], axis=0)
    first = before(comm, len(mine))
    pairs = comm.gather((points[mine], rows + first, entities))
    found = on_root(comm, lambda: to_cad(*(np.concatenate(part) for part in zip(*pairs, strict=True))))
    old, new = points[mine], found[first : first + len(mine)]
    distance, size, corner = np.linalg.norm(new - old, axis=1), np.full(len(points), np.inf), corners(mesh)
    longest = np.linalg.norm(corner[:, :, None] - corner[:, None], axis=3).max(axis=(1, 2))
    np.minimum.at(size, releases.cell_dofs(V), longest[:, None])
    far = (distance > STAYS * np.linalg.norm(old, axis=1)) & (distance < size[mine])
    moved = points.copy()
    moved[mine[far]] = new[far]
    return moved

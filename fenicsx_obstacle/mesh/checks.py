"""Connected components of a mesh, and checks that parts that touch are connected and that none overlap.

CAD bodies that were not fragmented are meshed one by one. Where they touch, each has nodes of its own, so that they are
separate membranes: no error shows in the solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, combinations

import numpy as np
from dolfinx import fem, la
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import TENSORS
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import (
    barycentric,
    cell_facets,
    corner_simplices,
    corners,
    edge_lengths,
    facet_corners,
    facet_vertices,
    longest_edges,
    own_cells,
    shapes,
    signed_volumes,
    spanned,
)
from fenicsx_obstacle.mesh.validation import place
from fenicsx_obstacle.parallel import first_given, on_root
from fenicsx_obstacle.text import counted

# of the local length: what is nearer touches; at least what six digits of coordinates resolve, where cells are larger
NEAR, FEW_DIGITS, LARGEST = 1e-5, 1e-6, 1e-2
FLAT = 1e-13  # of its longest edge to the power of the dimension: what a cell's volume must exceed
OVERLAP = 1e-3  # of a facet's width
INSIDE = 1e-4  # barycentric coordinate of a point that is inside a cell
_REMEDY = (
    "in a .geo add, before the physical groups, BooleanFragments{ Volume{:}; Delete; }{} with "
    'SetFactory("OpenCASCADE") (of plane parts Surface{:}), and otherwise Coherence; then make the mesh again'
)


@dataclass(frozen=True, eq=False)
class Components:
    """The connected components, numbered alike on any number of ranks.

    Attributes:
        count: How many there are on all ranks.
        of_cells: Component of each local cell, ghosts included.
    """

    count: int
    of_cells: np.ndarray

    def of_dofs(self, V: fem.FunctionSpace) -> np.ndarray:
        """Component of each local dof, ghosts included (collective).

        Of a dof in several components, which meet in it, it is the one with the highest number.
        """
        dofs = releases.cell_dofs(V)
        values = np.broadcast_to(self.of_cells[:, None], dofs.shape).astype(float)
        return AroundNodes(V, dofs).largest(values).astype(np.int32)


def components(mesh: dmesh.Mesh) -> Components:
    """The connected components of a mesh of simplices (collective).

    Cells that meet in less than a facet are not connected: a membrane does not hold at a point, nor a solid at an edge.
    They are numbered by their cells' midpoints, the smallest in lexicographic order first.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    def connected(nodes: int, pairs: np.ndarray) -> tuple[int, np.ndarray]:
        graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(nodes, nodes))
        return connected_components(graph, directed=False)

    comm, dim = mesh.comm, mesh.topology.dim
    table = cell_facets(mesh)
    mesh.topology.create_connectivity(dim - 1, dim)
    beside = mesh.topology.connectivity(dim - 1, dim)
    same_facet = np.ones(max(len(beside.array) - 1, 0), dtype=bool)
    ends = np.asarray(beside.offsets)[1:-1] - 1
    same_facet[ends[(ends >= 0) & (ends < len(same_facet))]] = False
    neighbours = np.column_stack([beside.array[:-1], beside.array[1:]])[same_facet]
    local, labels = connected(len(table), neighbours) if len(table) else (0, np.empty(0, np.int32))

    # labels on all ranks, joined through the facets that ranks share
    counts = comm.allgather(local)
    labels = labels + sum(counts[: comm.rank])
    facets = mesh.topology.index_map(dim - 1)
    of_facets = la.vector(facets)
    of_facets.array[:] = -1.0
    of_facets.array[table] = labels[:, None]
    mine = of_facets.array[facets.size_local :].copy()
    of_facets.scatter_forward()
    links = np.column_stack([mine, of_facets.array[facets.size_local :]]).astype(np.int64)
    joined = np.concatenate(comm.allgather(links[(links >= 0).all(axis=1)]))
    count, merged = connected(sum(counts), joined)
    if count < 2:
        return Components(count, np.zeros(len(table), np.int32))
    labels = merged[labels]
    middles = corners(mesh).mean(axis=1)
    order = np.lexsort((*middles.T[::-1], labels))
    present, start = np.unique(labels[order], return_index=True)
    first = zip(middles[order][start].tolist(), present.tolist(), strict=True)
    by_place = dict.fromkeys(label for _, label in sorted(chain(*comm.allgather(list(first)))))
    return Components(count, np.argsort(list(by_place)).astype(np.int32)[labels])


def check_degree(mesh: dmesh.Mesh, source: str, most: int) -> None:
    """Reject curved cells of a degree above `most`, 1 for straight ones."""
    if (degree := releases.geometry_degree(mesh)) > most:
        raise InputError(f"{source}: the mesh has curved cells, of degree {degree}: make one with degree {most}")


def check_mesh(mesh: dmesh.Mesh, source: str) -> tuple[Components, tuple[str, ...]]:
    """Reject invalid meshes; curved cells are checked by their vertices (collective).

    Args:
        mesh: From a file, or the caller's own.
        source: Where it is from, for messages.

    Returns:
        The connected components, and what the user should know.

    Raises:
        InputError: If a cell has no volume, cells of simplices overlap, or parts of these touch without shared nodes;
            naming a place.
    """
    wrong = _wrong_cell(mesh)
    if wrong is not None:
        raise InputError(f"{source}: {wrong}")
    found = components(mesh)
    if releases.cell_name(mesh) in TENSORS:
        return found, ()
    try:
        return found, tuple(_check_contact(mesh, found))
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _wrong_cell(mesh: dmesh.Mesh) -> str | None:
    """A message about an invalid cell, such as one without volume or three cells at a facet (collective)."""
    dim, every = mesh.topology.dim, corners(mesh)
    vertices = every[: own_cells(mesh)]
    if releases.cell_name(mesh) in TENSORS:
        parts = corner_simplices(vertices, dim)
        simplices = parts.reshape(-1, dim + 1, 3)
        sound = (shapes(simplices) > FLAT).reshape(parts.shape[:2]).all(axis=1)
        if dim == mesh.geometry.dim:
            sides = np.sign(signed_volumes(simplices[..., :dim])).reshape(parts.shape[:2])
            sound &= np.abs(sides.sum(axis=1)) == sides.shape[1]
        flat = np.flatnonzero(~sound)
    else:
        flat = np.flatnonzero(~(shapes(vertices) > FLAT))
    mine = None
    if len(flat):
        word = {1: "length", 2: "area", 3: "volume"}[dim]
        wrong = f"has no {word}" if vertices.shape[1] == dim + 1 else f"has no {word} at a corner, or is not convex"
        mine = f"the {releases.cell_name(mesh)} at {place(vertices[flat[0]].mean(axis=0))} {wrong}"
    elif dim == mesh.geometry.dim:
        beside = np.diff(mesh.topology.connectivity(dim - 1, dim).offsets)
        if beside.max(initial=0) > 2:
            cell = int(mesh.topology.connectivity(dim - 1, dim).links(int(np.argmax(beside)))[0])
        else:
            cell = _folded(mesh, every)
        if cell >= 0:
            mine = f"at {place(every[cell].mean(axis=0))} cells lie on each other"
    return first_given(mesh.comm, mine)


def _folded(mesh: dmesh.Mesh, vertices: np.ndarray) -> int:
    """A local cell that lies on the same side of a facet as its neighbour, as after a vertex was moved too far; -1 if
    there is none. Hexahedra are not checked (local)."""
    dim, rows = mesh.topology.dim, releases.geometry_dofs(mesh)
    turn = signed_volumes(vertices[:, : dim + 1, :dim])
    # the orientation of each facet, vertices by their numbers, as seen from its cell: two neighbours must differ
    facets, table = facet_corners(mesh), cell_facets(mesh)
    if releases.cell_name(mesh) in TENSORS:
        if dim > 2:
            return -1
        along = [1, -1, 1, -1]  # of the edges 01, 02, 13, 23, where the vertices go round as 0, 1, 3, 2
    else:
        along = [(-1) ** (dim - next(i for i in range(dim + 1) if i not in facet)) for facet in facets]
    seen = np.empty(table.shape)
    for number, facet in enumerate(facets):
        swaps = sum((rows[:, j] > rows[:, k]).astype(int) for j, k in combinations(facet, 2))
        seen[:, number] = np.sign(turn) * along[number] * (-1) ** swaps
    sums = np.bincount(table.ravel(), seen.ravel())
    folded = np.flatnonzero((np.abs(sums[table]) > 1) & (np.bincount(table.ravel())[table] == 2))
    return int(folded[0]) // table.shape[1] if len(folded) else -1


def _check_contact(mesh: dmesh.Mesh, found: Components) -> list[str]:
    """Reject parts of a mesh that touch without shared nodes, and parts that overlap (collective).

    Two sides of a slit within one component may lie on each other; parts that meet in a point (solids in an edge) are
    not connected anyway.

    Returns:
        What the user should know.

    Raises:
        InputError: Naming a place and the remedy.
    """
    remarks, samples, component = on_root(mesh.comm, _touching, mesh.comm.gather(_rim(mesh, found)))
    if found.count > 1:
        _check_overlap(mesh, found, samples, component)
        remarks.insert(0, f"{found.count} parts that are not connected: u must be supported in each")
    return remarks


def _rim(mesh: dmesh.Mesh, found: Components) -> tuple[np.ndarray, ...]:
    """Owned exterior facets: their vertices, component and local length."""
    dim, table = mesh.topology.dim, cell_facets(mesh)
    cells, numbers = np.nonzero(np.isin(table, dmesh.exterior_facet_indices(mesh.topology)))
    _, first = np.unique(table[cells, numbers], return_index=True)
    cells, numbers = cells[first], numbers[first]
    rows = releases.geometry_dofs(mesh)[cells]
    members = np.array(facet_vertices(dim))[numbers]
    all_vertices = mesh.geometry.x[rows]
    # the height over the facet: what is thin across may be long along it
    volume = spanned(all_vertices[:, 1:] - all_vertices[:, :1])
    vertices = mesh.geometry.x[np.take_along_axis(rows, members, axis=1)]
    base = spanned(vertices[:, 1:] - vertices[:, :1]) if dim > 1 else 1.0
    width = edge_lengths(vertices).min(axis=1) if dim > 1 else np.inf
    size = np.minimum(volume / base, width)
    return vertices, found.of_cells[cells], size


def _touching(rim: Sequence[tuple[np.ndarray, ...]]) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Reject exterior facets that lie on each other, but the two sides of a slit (one rank).

    Args:
        rim: What `_rim` found on each rank.

    Returns:
        Remarks; and where there are several components the vertices and the middle of each facet, shape (facets,
        points, 3), and its component.
    """
    vertices, component, size = map(np.concatenate, zip(*rim, strict=True))
    extent = np.ptp(vertices.reshape(-1, 3), axis=0).max() if len(vertices) else 0.0
    near = np.minimum(LARGEST * size, np.maximum(NEAR * size, FEW_DIGITS * extent))
    f, g = _pairs(vertices, near)
    allowed = np.minimum(near[f], near[g])
    apart = np.linalg.norm(vertices[f][:, :, None] - vertices[g][:, None], axis=3)
    same = (apart.min(axis=2) <= allowed[:, None]).all(axis=1) & (apart.min(axis=1) <= allowed[:, None]).all(axis=1)
    other = component[f] != component[g]
    middles, remarks = vertices.mean(axis=1), list[str]()
    for bad, what in (
        (other, "two parts of the mesh touch without shared nodes"),
        (~other & ~same, "cells touch along a part of their sides only (hanging nodes)"),
    ):
        if bad.any():
            at = _first(np.concatenate([middles[f[bad]], middles[g[bad]]]))
            raise InputError(f"{what}: {counted(int(bad.sum()), 'pair')} of sides, one at {at}; {_REMEDY}")
    if len(f):
        remarks.append(f"a slit at {_first(middles[f])}: {counted(len(f), 'pair')} of sides without shared nodes")
    if not component.any():
        return remarks, vertices[:0], component[:0]
    points = [middles[:, None]] if vertices.shape[1] == 1 else [vertices, middles[:, None]]
    return remarks, np.concatenate(points, axis=1), component


def _first(points: np.ndarray) -> str:
    """The first of some points, shape (n, 3), by their coordinates."""
    return place(points[np.lexsort(points.T[::-1])[0]])


def _pairs(vertices: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of facets that lie on each other over more than a point, or for triangles an edge."""
    from scipy.spatial import cKDTree

    middles = vertices.mean(axis=1)
    reach = np.linalg.norm(vertices - middles[:, None], axis=2).max(axis=1, initial=0.0) + near
    found = [np.empty((0, 2), np.int64)]
    classes = np.floor(np.log2(np.maximum(reach, np.finfo(float).tiny))).astype(int)
    for one in np.unique(classes):  # of facets of very different sizes, each looks among the smaller ones only
        here, smaller = np.flatnonzero(classes == one), np.flatnonzero(classes <= one)
        hits = cKDTree(middles[smaller]).query_ball_point(middles[here], reach[here] + reach[smaller].max())
        counts = np.array([len(hit) for hit in hits])
        pairs = np.column_stack([np.repeat(here, counts), smaller[np.concatenate(hits).astype(np.int64)]])
        found.append(pairs[(classes[pairs[:, 1]] < one) | (pairs[:, 1] < pairs[:, 0])])
    f, g = np.concatenate(found).T
    gap = np.linalg.norm(middles[f] - middles[g], axis=1)
    keep = gap <= reach[f] + reach[g]
    f, g = f[keep], g[keep]
    keep = _lie_on(vertices[f], vertices[g], np.minimum(near[f], near[g]))
    return f[keep], g[keep]


def _lie_on(one: np.ndarray, other: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Whether facets (n, vertices, 3) lie on each other over more than a point, or for triangles an edge."""
    if one.shape[1] == 1:
        return np.linalg.norm(one[:, 0] - other[:, 0], axis=1) <= near
    meets = np.minimum(_away(one, other), _away(other, one)) <= near
    pairs = list(combinations(range(one.shape[1]), 2))
    for facet in (one, other):
        for i, j in pairs if one.shape[1] == 3 else pairs * (facet is one):
            # convex sets have no common interior if they lie apart along one of these axes
            some = np.flatnonzero(meets)
            axis = facet[some, i] - facet[some, j]
            if one.shape[1] == 3:
                axis = np.cross(axis, _normals(one[some]))
            a, b = (np.einsum("nvi,ni->nv", side[some], axis) for side in (one, other))
            common = np.minimum(a.max(axis=1), b.max(axis=1)) - np.maximum(a.min(axis=1), b.min(axis=1))
            meets[some] = common > OVERLAP * np.minimum(np.ptp(a, axis=1), np.ptp(b, axis=1))
    return meets


def _away(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The largest distance of the vertices of one facet from the line or plane of the other."""
    there = one - other[:, :1]
    if one.shape[1] == 3:
        return np.abs(np.einsum("nvi,ni->nv", there, _normals(other))).max(axis=1)
    along = _unit(other[:, 1] - other[:, 0])
    return np.linalg.norm(np.cross(there, along[:, None]), axis=2).max(axis=1)


def _normals(triangles: np.ndarray) -> np.ndarray:
    return _unit(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.finfo(float).tiny)


def _check_overlap(mesh: dmesh.Mesh, found: Components, samples: np.ndarray, component: np.ndarray) -> None:
    """Reject components with boundary points inside another one, or sides that lie on its cells (collective)."""
    comm, dim = mesh.comm, mesh.topology.dim
    points = samples.reshape(-1, 3)
    owner = np.repeat(component, samples.shape[1])
    extent = float(np.ptp(points, axis=0).max())
    solid = dim == mesh.geometry.dim
    rows, cells = releases.cells_near(mesh, points, FEW_DIGITS * extent)
    other = found.of_cells[cells] != owner[rows]
    rows, cells = rows[other], cells[other]
    vertices = corners(mesh)[cells]
    weights = barycentric(points[rows][:, None], vertices)[:, 0]
    if solid:
        inside = weights.min(axis=1, initial=np.inf) > INSIDE
    else:  # a side of one part that lies on cells of another, not in their plane only
        away = np.linalg.norm(np.einsum("nv,nvi->ni", weights, vertices) - points[rows], axis=1)
        inside = (weights.min(axis=1, initial=np.inf) > -INSIDE) & (away <= NEAR * longest_edges(vertices))
    facet, sample = np.divmod(rows[inside], samples.shape[1])
    hits = np.concatenate(comm.allgather(np.column_stack([facet, found.of_cells[cells[inside]], sample])))
    facets = np.unique(hits[:, 0])
    if not solid:  # all samples of a facet on the same component
        on, times = np.unique(np.unique(hits, axis=0)[:, :2], axis=0, return_counts=True)
        facets = on[times == samples.shape[1], 0]
    if len(facets):
        what = "overlap" if solid else "touch without shared nodes"
        raise InputError(f"two parts of the mesh {what}, at {_first(samples[facets, 0])}; {_REMEDY}")

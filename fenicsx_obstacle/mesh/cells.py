"""Cells as arrays: corners, facets, sizes, barycentric coordinates. All functions are local unless they say more."""

from __future__ import annotations

from itertools import combinations
from math import factorial

import basix
import numpy as np
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.around_nodes import over_ranks


def corners(mesh: dmesh.Mesh, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Coordinates of the vertices of local cells, shape (cells, vertices, 3)."""
    return mesh.geometry.x[releases.geometry_dofs(mesh)[cells]]


def corner_simplices(corners: np.ndarray, dim: int) -> np.ndarray:
    """Of quadrilaterals or hexahedra the simplices that each vertex spans with its neighbours, all turned alike.

    Args:
        corners: Vertices in DOLFINx's order, shape (cells, 2^dim, 3).
        dim: Dimension.

    Returns:
        Shape (cells, 2^dim, dim + 1, 3).
    """
    found = []
    for vertex in range(2**dim):
        beside = [vertex ^ (1 << axis) for axis in range(dim)]
        if vertex.bit_count() % 2:
            beside[:2] = beside[1::-1]
        found.append([vertex, *beside])
    return corners[:, found]


def duals(corners: np.ndarray) -> np.ndarray:
    """Gradients of the barycentric coordinates after the first, shape (cells, dim, 3)."""
    edges = corners[:, 1:] - corners[:, :1]
    return np.linalg.solve(edges @ edges.transpose(0, 2, 1), edges)


def barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric coordinates, shape (cells, points, vertices), of points (cells, points, 3) in cells."""
    inner = (points - corners[:, :1]) @ duals(corners).transpose(0, 2, 1)
    return np.concatenate([1 - inner.sum(axis=2, keepdims=True), inner], axis=2)


def cell_volumes(mesh: dmesh.Mesh, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Length, area or volume of local cells; of quadrilaterals and hexahedra as if they were parallelepipeds."""
    vertices, dim = corners(mesh, cells), mesh.topology.dim
    if releases.cell_name(mesh) in SIMPLICES:
        return volumes(vertices)
    parts = corner_simplices(vertices, dim)
    return factorial(dim) * volumes(parts.reshape(-1, dim + 1, 3)).reshape(parts.shape[:2]).mean(axis=1)


def cell_facets(mesh: dmesh.Mesh) -> np.ndarray:
    """Facets of each local cell, shape (cells, facets)."""
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim, dim - 1)
    count = dim + 1 if releases.cell_name(mesh) in SIMPLICES else 2 * dim
    return mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, count)


def cell_edges(mesh: dmesh.Mesh) -> np.ndarray:
    """Edges of each local simplex, in DOLFINx's order, shape (cells, edges) (collective on first use)."""
    dim = mesh.topology.dim
    mesh.topology.create_entities(1)
    if dim == 1:
        edges = mesh.topology.index_map(1)
        return np.arange(edges.size_local + edges.num_ghosts, dtype=np.int32).reshape(-1, 1)
    mesh.topology.create_connectivity(dim, 1)
    return mesh.topology.connectivity(dim, 1).array.reshape(-1, dim * (dim + 1) // 2)


def facet_vertices(dim: int) -> list[list[int]]:
    """Vertices of each facet of a simplex: facet i is opposite to vertex i, except that of an interval, vertex i."""
    return [[i] if dim == 1 else [j for j in range(dim + 1) if j != i] for i in range(dim + 1)]


def facet_corners(mesh: dmesh.Mesh) -> list[list[int]]:
    """Vertices of each facet of a cell of any kind, in DOLFINx's order."""
    return basix.topology(getattr(basix.CellType, releases.cell_name(mesh)))[-2]


def own_cells(mesh: dmesh.Mesh) -> int:
    """Number of owned cells; they are the first ones."""
    return mesh.topology.index_map(mesh.topology.dim).size_local


def given_cells(mesh: dmesh.Mesh) -> np.ndarray:
    """The number of each owned cell among the cells of all ranks that `create_mesh` was given."""
    return np.asarray(mesh.topology.original_cell_index, dtype=np.int64)[: own_cells(mesh)]


def sides(mesh: dmesh.Mesh, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sides of owned cells that make up given facets (collective).

    A facet within the domain has two, maybe on two ranks, and where surfaces or wires branch off more; all count alike.

    Returns:
        Cell, number of the facet in it, and share in the facet, of each side.
    """
    table = cell_facets(mesh)[: own_cells(mesh)]
    cells, numbers = np.nonzero(np.isin(table, facets))
    return cells, numbers, 1.0 / cells_at_facets(mesh)[table[cells, numbers]]


def cells_at_facets(mesh: dmesh.Mesh) -> np.ndarray:
    """How many cells of all ranks meet at each local facet (collective)."""
    index_map = mesh.topology.index_map(mesh.topology.dim - 1)
    count = index_map.size_local + index_map.num_ghosts
    mine = np.bincount(cell_facets(mesh)[: own_cells(mesh)].ravel(), minlength=count).astype(float)
    return over_ranks(index_map, mesh.comm, mine, PETSc.InsertMode.ADD)


def volumes(corners: np.ndarray) -> np.ndarray:
    """Lengths, areas or volumes of simplices given by their corners (n, vertices, 3); 1 for points."""
    edges = corners[:, 1:] - corners[:, :1]
    dim = edges.shape[1]
    return spanned(edges) / factorial(dim) if dim else np.ones(len(corners))


def spanned(edges: np.ndarray) -> np.ndarray:
    """What 1 to 3 vectors span, shape (n, vectors, 3): their length, or area or volume of a parallelepiped.

    Accurate for vectors that are nearly parallel, which a determinant of their inner products is not.
    """
    if edges.shape[1] == 1:
        return lengths(edges[:, 0])
    across = np.stack(cross(edges[:, 0], edges[:, 1]), axis=1)
    return lengths(across) if edges.shape[1] == 2 else np.abs(np.einsum("ni,ni->n", across, edges[:, 2]))


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Of the last axis."""
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def signed_volumes(x: np.ndarray) -> np.ndarray:
    """Lengths, areas or volumes of simplices that fill their space, negative where the determinant of the corners is.

    Args:
        x: Corners, shape (n, d + 1, d).
    """
    edges = [x[:, k] - x[:, 0] for k in range(1, x.shape[1])]
    if len(edges) == 1:
        return edges[0][:, 0]
    if len(edges) == 2:
        return (edges[0][:, 0] * edges[1][:, 1] - edges[0][:, 1] * edges[1][:, 0]) / 2
    return sum(part * edges[2][:, k] for k, part in enumerate(cross(edges[0], edges[1]))) / 6


def cross(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, ...]:
    """The vector products of the rows, by coordinates."""
    (u, v, w), (x, y, z) = a.T, b.T
    return v * z - w * y, w * x - u * z, u * y - v * x


def edge_lengths(corners: np.ndarray) -> np.ndarray:
    """Lengths of the edges of simplices given by their corners (n, vertices, d), shape (n, edges)."""
    pairs = combinations(range(corners.shape[1]), 2)
    return np.stack([lengths(corners[:, i] - corners[:, j]) for i, j in pairs], axis=1)


def longest_edges(corners: np.ndarray) -> np.ndarray:
    """The longest edge of each simplex; 0 of points."""
    found = np.zeros(len(corners))
    for i, j in combinations(range(corners.shape[1]), 2):
        np.maximum(found, lengths(corners[:, i] - corners[:, j]), out=found)
    return found


def shapes(corners: np.ndarray) -> np.ndarray:
    """dim! times the volume over the longest edge to the power dim, dimensionless."""
    edges, longest = corners[:, 1:] - corners[:, :1], longest_edges(corners)
    return spanned(edges / np.maximum(longest, np.finfo(float).tiny)[:, None, None])


def chains(edges: np.ndarray, count: int) -> list[np.ndarray]:
    """Connected points in their order along each curve, from an end of it, where there is one.

    Args:
        edges: Pairs of points, shape (n, 2).
        count: Of all points; one without an edge is a curve of its own.
    """
    beside: dict[int, set[int]] = {point: set() for point in range(count)}
    for a, b in edges.tolist():
        beside[a].add(b)
        beside[b].add(a)
    found, left = list[np.ndarray](), dict.fromkeys(sorted(beside, key=lambda point: len(beside[point])))
    while left:
        curve = [next(iter(left))]
        del left[curve[0]]
        while further := sorted(beside[curve[-1]] & left.keys()):
            curve.append(further[0])
            del left[further[0]]
        found.append(np.array(curve))
    return found

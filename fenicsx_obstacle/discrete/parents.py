"""How a refined mesh hangs on the one it came from: each new cell knows its parent, everything else follows."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.parallel import before


def ends_of(V: fem.FunctionSpace, coarse: fem.FunctionSpace, parents: np.ndarray) -> np.ndarray:
    """For each owned dof of V the two local dofs of `coarse` of which it is the mean, shape (owned dofs, 2).

    A vertex of a refined cell is a vertex of its parent or the middle of one of its edges, so looking at the
    parent's vertices two by two finds it. Vertices moved onto a curved boundary stay nearest to their edge's middle.
    """
    owned, gdim = V.dofmap.index_map.size_local, V.mesh.geometry.dim
    dofs = releases.cell_dofs(V)[: len(parents)]
    cell = np.empty(owned + V.dofmap.index_map.num_ghosts, dtype=np.int32)  # one cell of each dof
    cell[dofs.ravel()] = np.repeat(np.arange(len(parents), dtype=np.int32), dofs.shape[1])
    parent = parents[cell[:owned]]
    points = V.mesh.geometry.x[releases.dof_nodes(V)[:owned]]
    corners, nodes = coarse.mesh.geometry.x, releases.geometry_dofs(coarse.mesh)[parent]
    nearest = np.full(owned, np.inf)
    first, last = np.zeros(owned, dtype=np.int32), np.zeros(owned, dtype=np.int32)
    for i, j in combinations_with_replacement(range(nodes.shape[1]), 2):
        distance = np.zeros(owned)
        for axis in range(gdim):
            distance += (corners[nodes[:, i], axis] + corners[nodes[:, j], axis] - 2 * points[:, axis]) ** 2
        nearer = distance < nearest
        nearest[nearer], first[nearer], last[nearer] = distance[nearer], i, j
    rows = releases.cell_dofs(coarse)[parent]
    every = np.arange(owned)
    return np.column_stack([rows[every, first], rows[every, last]])


def prolongation(ends: np.ndarray, fine: fem.FunctionSpace, coarse: fem.FunctionSpace) -> PETSc.Mat:
    """P1 interpolation from a mesh to its refinement as a matrix (collective)."""
    numbering = coarse.dofmap.index_map
    same = ends[:, 0] == ends[:, 1]
    keep = np.column_stack([np.ones(len(ends), dtype=bool), ~same])
    columns = np.asarray(numbering.local_to_global(np.sort(ends, axis=1).astype(np.int32).ravel()))
    values = np.repeat(np.where(same, 1.0, 0.5), 2)
    starts = np.concatenate([[0], np.cumsum(keep.sum(axis=1))]).astype(PETSc.IntType)
    size = [(space.dofmap.index_map.size_local, space.dofmap.index_map.size_global) for space in (fine, coarse)]
    kept = keep.ravel()
    csr = starts, columns[kept].astype(PETSc.IntType), values[kept]
    return PETSc.Mat().createAIJ(size, csr=csr, comm=fine.mesh.comm)


def halved(mesh: dmesh.Mesh, V: fem.FunctionSpace) -> tuple[dmesh.Mesh, np.ndarray]:
    """Refined interval and parents of its cells (collective): DOLFINx refines intervals only from 0.9 on."""
    owned, own_cells = V.dofmap.index_map.size_local, mesh.topology.index_map(1).size_local
    dofs = releases.cell_dofs(V)
    first = before(mesh.comm, owned + own_cells)
    number = fem.Function(V)  # of each vertex among the new points; ghosts learn theirs from the owner
    number.x.array[:owned] = first + np.arange(owned)
    number.x.scatter_forward()
    ends = number.x.array[dofs[:own_cells]].real.astype(np.int64)
    middle = first + owned + np.arange(own_cells)
    cells = np.column_stack([ends[:, 0], middle, middle, ends[:, 1]]).reshape(-1, 2)
    gdim = mesh.geometry.dim
    points = np.vstack([V.tabulate_dof_coordinates()[:owned], corners(mesh)[:own_cells].mean(axis=1)])[:, :gdim]
    new = releases.create_mesh(mesh.comm, cells, points, "interval", stay=True)
    start = before(mesh.comm, len(cells))
    own = new.topology.index_map(1).size_local
    return new, (np.asarray(new.topology.original_cell_index)[:own] - start) // 2


def inherited(
    named: dict[str, np.ndarray], mesh: dmesh.Mesh, new: dmesh.Mesh, parents: np.ndarray
) -> dict[str, np.ndarray]:
    """Named facets of a refined mesh: those that lie within a named facet of their parent cell (local)."""
    dim = new.topology.dim
    # facet i of a simplex is opposite to its vertex i, except that facet i of an interval is its vertex i
    members = [[i] if dim == 1 else [j for j in range(dim + 1) if j != i] for i in range(dim + 1)]
    old_facets, new_facets = _cell_facets(mesh), _cell_facets(new)
    found: dict[str, np.ndarray] = {}
    for name, facets in named.items():
        marked = np.zeros(old_facets.max(initial=-1) + 1, dtype=bool)
        marked[facets] = True
        # nearly all cells lie inside: look at the children of those that have such a facet only
        children = np.flatnonzero(marked[old_facets].any(axis=1)[parents])
        on_facet = marked[old_facets[parents[children]]]
        weights = _barycentric(corners(new, children), corners(mesh, parents[children]))
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


def corners(mesh: dmesh.Mesh, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Coordinates of the vertices of local cells, shape (cells, vertices, 3)."""
    return mesh.geometry.x[releases.geometry_dofs(mesh)[cells]]


def _barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric coordinates, shape (cells, points, vertices), of points (cells, points, 3) in cells."""
    edges = corners[:, 1:] - corners[:, :1]
    gram = edges @ edges.transpose(0, 2, 1)
    inner = np.linalg.solve(gram, edges @ (points - corners[:, :1]).transpose(0, 2, 1)).transpose(0, 2, 1)
    return np.concatenate([1 - inner.sum(axis=2, keepdims=True), inner], axis=2)


def _cell_facets(mesh: dmesh.Mesh) -> np.ndarray:
    """Facets of each local cell, shape (cells, facets)."""
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim, dim - 1)
    return mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)

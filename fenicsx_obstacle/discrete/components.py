"""Connected components of a mesh: sets of cells that are connected through facets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import cell_facets, corners


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
        found = fem.Function(V)
        if self.count > 1:
            found.x.array[:] = -1.0
            np.maximum.at(found.x.array, releases.cell_dofs(V), self.of_cells[:, None].astype(float))
            releases.vec(found).ghostUpdate(addv=PETSc.InsertMode.MAX, mode=PETSc.ScatterMode.REVERSE)
            found.x.scatter_forward()
        return np.rint(found.x.array).astype(np.int32)


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
    of_facets = np.full(facets.size_local + facets.num_ghosts, -1)
    of_facets[table] = labels[:, None]
    theirs = np.column_stack([np.asarray(facets.ghosts, np.int64), of_facets[facets.size_local :]])
    links = np.concatenate(comm.allgather(theirs))
    first, last = facets.local_range
    here = links[(links[:, 0] >= first) & (links[:, 0] < last)]
    joined = np.concatenate(comm.allgather(np.column_stack([of_facets[here[:, 0] - first], here[:, 1]])))
    joined = joined[(joined >= 0).all(axis=1)]
    count, merged = connected(sum(counts), joined)
    if count < 2:
        return Components(count, np.zeros(len(table), np.int32))
    labels = merged[labels]
    mine = _first_midpoints(mesh, labels, count)
    firsts = np.array(_smallest_rows(comm.allgather(mine)))
    rank_of = np.empty(count, np.int32)
    rank_of[np.lexsort(firsts.T[::-1])] = np.arange(count)
    return Components(count, rank_of[labels])


def _first_midpoints(mesh: dmesh.Mesh, labels: np.ndarray, count: int) -> np.ndarray:
    """The first midpoint of the local cells of each component in lexicographic order, inf where there are none."""
    found = np.full((count, 3), np.inf)
    middles = corners(mesh).mean(axis=1)
    order = np.lexsort((*middles.T[::-1], labels))
    present, start = np.unique(labels[order], return_index=True)
    found[present] = middles[order][start]
    return found


def _smallest_rows(tables: list[np.ndarray]) -> list[tuple[float, ...]]:
    """The lexicographically smallest of each row of tables of the same shape."""
    return [min(map(tuple, rows)) for rows in zip(*(table.tolist() for table in tables), strict=True)]

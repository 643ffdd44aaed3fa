"""The cells around each vertex, on the rank that owns the vertex, whatever ranks the cells are on.

A corner is a vertex a of an owned cell with the d others, of a triangle counter-clockwise, of a tetrahedron so that
(a, b, c, d) has a positive determinant. It has d facets with a, each opposite to one of the others. The corners of a
vertex form patches: cells that are next to each other across facets with that vertex. Patches end at the boundary, and
where u is given on facets inside the domain. Values travel between a corner's cell and its patch by one exchange over
all ranks; everything that depends on the mesh alone is found once.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.estimation.patch_trees import PatchTrees, Sides
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.mesh.cells import cell_edges, own_cells
from fenicsx_obstacle.parallel import total

# the other vertices of a cell after each one
OTHERS = {1: ((1,), (0,)), 2: ((1, 2), (2, 0), (0, 1)), 3: ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))}


class Patches:
    """The corners of all owned vertices, in arrays ordered by depth in the trees of the patches.

    Attributes:
        trees: Along which fluxes in balance are found, with values in the order of `gather`.
        free_boundary: Whether a facet with the vertex is on the boundary and u is not given on it, shape (corners, d).
        patch: The patch of each corner.
        vertex: Owned dof of each patch.
        apart: Whether cells around a vertex that nothing may leave are more than the one patch of a free vertex, on any
            rank: then cells overlap, or meet in this vertex only, and forces there are in no balance.
    """

    def __init__(self, simplices: Simplices):
        """See which rank has which vertex, and find the trees (collective)."""
        data, dofs = simplices.data, simplices.dofs
        self.comm, self._corners = data.level.comm, dofs.shape[1]
        index_map = data.level.V.dofmap.index_map
        self._number = np.asarray(index_map.local_to_global(dofs.astype(np.int32).ravel()), dtype=np.int64).reshape(
            dofs.shape
        )
        starts = np.array(self.comm.allgather(index_map.local_range[0]))
        self._first = starts[self.comm.rank]
        if self.comm.size > 1:
            # ranks that own none share their start with the next: take the last
            owner = np.searchsorted(starts, self._number, side="right").ravel() - 1
            self._send = np.argsort(owner, kind="stable")
            self._sent = np.bincount(owner, minlength=self.comm.size)
            self._received = np.array(self.comm.alltoall(self._sent.tolist()), dtype=np.int64)
        sides = self._sides(simplices)
        self.trees = trees = PatchTrees(sides, data.level.owned)
        self._order, self.patch, self.vertex = trees.order, trees.patch, trees.vertex
        self.free_boundary = ((sides.beside < 0) & ~sides.held)[self._order]
        closed, patches_at = trees.closed, np.bincount(self.vertex, minlength=data.level.owned)
        self.apart = total(self.comm, np.count_nonzero((patches_at[closed] > 1) | simplices.given[closed])) > 0

    def gather(self, *values: np.ndarray) -> np.ndarray:
        """Values at the corners of owned cells, each of shape (cells, vertices), patch by patch (collective).

        Returns:
            Shape (len(values), corners).
        """
        found = np.empty((len(values), len(self._order)))
        for row, part in zip(found, self._to_owners(*values), strict=True):
            np.take(part, self._order, out=row, mode="clip")  # without a copy
        return found

    def scatter(self, *values: np.ndarray) -> list[np.ndarray]:
        """Values patch by patch at the corners of their cells, each of shape (cells, vertices) (collective)."""
        found = []
        for part in values:
            ordered = np.empty(len(self._order))
            ordered[self._order] = part
            found.append(ordered)
        if self.comm.size > 1:
            back = self._exchange(np.stack(found, axis=1), self._received, self._sent)
            ordered = np.empty_like(back)
            ordered[self._send] = back
            found = list(ordered.T)
        return [part.reshape(-1, self._corners) for part in found]

    def _to_owners(self, *values: np.ndarray) -> list[np.ndarray]:
        """Values at corners, each of shape (cells, vertices), in the order in which owners get them (collective)."""
        if self.comm.size == 1:
            return [part.ravel() for part in values]
        rows = np.stack(values, axis=2).reshape(-1, len(values))[self._send]
        return list(self._exchange(rows, self._sent, self._received).T)

    def _exchange(self, rows: np.ndarray, sent: np.ndarray, received: np.ndarray) -> np.ndarray:
        """Send rows in the order of their ranks; returns the received rows in the order of ranks (collective)."""
        kind, width = (MPI.DOUBLE if rows.dtype == np.float64 else MPI.INT64_T), rows.shape[1]
        out = np.empty((received.sum(), width), dtype=rows.dtype)
        send = [np.ascontiguousarray(rows), (sent * width).tolist(), None, kind]
        self.comm.Alltoallv(send, [out, (received * width).tolist(), None, kind])
        return out

    def _sides(self, simplices: Simplices) -> Sides:
        """Pair the facets of the corners of each vertex (collective)."""
        dim, mesh = simplices.dim, simplices.data.level.mesh
        others, index_map = np.array(OTHERS[dim]), mesh.topology.index_map(dim - 1)
        facets = np.asarray(index_map.local_to_global(simplices.facets.astype(np.int32).ravel()), dtype=np.int64)
        facets = facets.reshape(simplices.facets.shape)
        keys = []
        for j in range(dim):
            facet = np.take(facets, others[:, j], axis=1) * dim
            for k in range(dim):  # which of the vertices of the facet this is
                if k != j:
                    facet += np.take(self._number, others[:, k], axis=1) < self._number
            keys.append(2 * facet + np.take(simplices.held, others[:, j], axis=1))
        vertex, *keys = self._to_owners(self._number, *keys)
        key = np.stack(keys, axis=1).ravel()
        is_held = key % 2 > 0
        beside = pairs(*dense(key // 2, dim * index_map.size_global))
        shape = len(vertex), dim
        return Sides(vertex - self._first, beside.reshape(shape), is_held.reshape(shape))

    def facets(self, simplices: Simplices) -> tuple[np.ndarray, np.ndarray]:
        """The facets of each patch (collective).

        Returns:
            Their numbers at the corners, shape (corners, d), the same on both sides of a facet unless u is given on it;
            the patch of each.
        """
        sides = self._sides(simplices)
        every = np.arange(sides.beside.size).reshape(sides.beside.shape)
        beside = np.where((sides.beside >= 0) & ~sides.held, sides.beside, every)
        return self._numbered(np.minimum(every, beside), every.size)

    def edges(self, simplices: Simplices) -> tuple[np.ndarray, np.ndarray]:
        """The edges from each vertex to the others of its corners, of tetrahedra (collective).

        Facets on which u is given may divide the cells around an edge: each patch has edges of its own.

        Returns:
            Their numbers at the corners, shape (corners, 3), which begin anew at each rank and are different for the
            two ends of an edge; the patch of each.
        """
        mesh = simplices.data.level.mesh
        local = cell_edges(mesh)[: own_cells(mesh)]
        index_map = mesh.topology.index_map(1)
        number = np.asarray(index_map.local_to_global(local.astype(np.int32).ravel()), dtype=np.int64).reshape(-1, 6)
        between, others, every, keys = simplices.edges(number), np.array(OTHERS[3]), np.arange(4), []
        for there in others.T:
            upper = self._number > self._number[:, there]
            keys.append(2 * between[:, every, there] + upper)
        return self._numbered(np.stack(self._to_owners(*keys), axis=1), 2 * index_map.size_global)

    def _numbered(self, keys: np.ndarray, limit: int) -> tuple[np.ndarray, np.ndarray]:
        """What has a key below a limit, given as corners come to their owners: numbers at the corners, and the patch of
        each (local)."""
        numbers, count = dense(keys[self._order].ravel(), limit)
        numbers = numbers.reshape(keys.shape)
        patch = np.empty(count, dtype=np.int64)
        patch[numbers] = self.patch[:, None]
        if np.any(patch[numbers] != self.patch[:, None]):  # patches with a common edge
            both = numbers.astype(np.int64) * len(self.vertex) + self.patch[:, None]
            every, numbers = np.unique(both, return_inverse=True)
            numbers, patch = numbers.reshape(both.shape), every % len(self.vertex)
        return numbers, patch


def dense(keys: np.ndarray, limit: int) -> tuple[np.ndarray, int]:
    """Numbers from 0 on for keys below a limit, and how many are different (local)."""
    present = np.zeros(limit, dtype=bool)
    present[keys] = True
    numbers = np.cumsum(present, dtype=np.int32)
    return numbers[keys] - 1, int(numbers[-1]) if limit else 0


def pairs(keys: np.ndarray, count: int) -> np.ndarray:
    """Of each of the numbers below `count` the place where the same one stands once more, -1 if it does not."""
    every = np.arange(1, len(keys) + 1)
    places = np.bincount(keys, every, count).astype(np.int64)  # the sum of both
    return places[keys] - every - 1

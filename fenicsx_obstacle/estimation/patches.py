"""The cells around each vertex, on the rank that owns the vertex, whatever ranks the cells are on.

A corner is a vertex of an owned cell. The corners of a vertex form patches: cells that are next to each other across
facets with that vertex. Patches end at the boundary, and where u is given on facets inside the domain. Values travel
between a corner's cell and its patch by one exchange over all ranks; everything that depends on the mesh alone is found
once.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.estimation.simplices import Simplices


class Patches:
    """The corners of all owned vertices, patch by patch; `VertexPatches` and `TreePatches` say in which order.

    Attributes:
        held: Whether u is given on the side opposite to each vertex, shape (owned cells, vertices).
        free: Whether u is not given at an owned vertex.
        area: The share of the corner in its cell, |T|/(d + 1).
        mass: int phi_i at owned vertices.
        vertex: Owned dof of each patch.
    """

    area: np.ndarray
    mass: np.ndarray
    vertex: np.ndarray
    _order: np.ndarray
    _patch: np.ndarray  # of each corner

    def __init__(self, simplices: Simplices):
        """See where u is given, and which rank has which vertex (collective)."""
        data, dofs = simplices.data, simplices.dofs
        self.comm, self.owned, self._corners = data.level.comm, data.level.owned, dofs.shape[1]
        is_held = np.zeros(simplices.facets.max(initial=-1) + 1, dtype=bool)
        for facets in data.held:
            is_held[facets[facets < len(is_held)]] = True
        self.held = is_held[simplices.facets]
        self.free = np.ones(self.owned, dtype=bool)
        fixed = data.fixed[0]
        self.free[fixed[fixed < self.owned]] = False
        index_map = data.level.V.dofmap.index_map
        self._vertices = index_map.size_global
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

    def _weigh(self, simplices: Simplices) -> None:
        """Find `area` and `mass` once the order is known (collective)."""
        share = simplices.area / self._corners
        self.area = self.gather(np.repeat(share[:, None], self._corners, axis=1))[0]
        self.mass = self.at_vertices(self.area)

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

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Sums over the corners of each owned vertex (local)."""
        return np.bincount(self.vertex, weights=self.sums(values), minlength=self.owned)

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums over the corners of each patch (local)."""
        return np.bincount(self._patch, weights=values, minlength=len(self.vertex))

    def largest(self, values: np.ndarray) -> np.ndarray:
        """The largest of the values around each owned vertex, 0 if that is more (local)."""
        found = np.zeros(self.owned)
        np.maximum.at(found, self.vertex[self._patch], values)
        return found

    def smallest(self, values: np.ndarray) -> np.ndarray:
        """The smallest value over the corners of each owned vertex, infinite without one (local)."""
        found = np.full(self.owned, np.inf)
        np.minimum.at(found, self.vertex[self._patch], values)
        return found

    def along(self, values: np.ndarray) -> np.ndarray:
        """One value for each patch at all of its corners (local)."""
        return values[self._patch]

    def _to_owners(self, *values: np.ndarray) -> list[np.ndarray]:
        """Values at corners, each of shape (cells, vertices), in the order in which owners get them (collective)."""
        if self.comm.size == 1:
            return [part.ravel() for part in values]
        rows = np.stack(values, axis=2).reshape(-1, len(values))[self._send]
        return list(self._exchange(rows, self._sent, self._received).T)

    def _at_owners(self, corners: np.ndarray) -> np.ndarray:
        """For each corner a corner of the same vertex, cell by cell, or -1: both by their places in the order in which
        owners get them (collective)."""
        if self.comm.size == 1:
            return corners
        place = np.empty(len(corners), dtype=np.int64)
        place[self._send] = np.arange(len(corners)) - np.repeat(np.cumsum(self._sent) - self._sent, self._sent)
        found = self._to_owners(np.where(corners >= 0, place[corners], -1).reshape(-1, self._corners))[0]
        return np.where(found >= 0, found + np.repeat(np.cumsum(self._received) - self._received, self._received), -1)

    def _exchange(self, rows: np.ndarray, sent: np.ndarray, received: np.ndarray) -> np.ndarray:
        """Send rows in the order of their ranks; returns the received rows in the order of ranks (collective)."""
        kind, width = (MPI.DOUBLE if rows.dtype == np.float64 else MPI.INT64_T), rows.shape[1]
        out = np.empty((received.sum(), width), dtype=rows.dtype)
        send = [np.ascontiguousarray(rows), (sent * width).tolist(), None, kind]
        self.comm.Alltoallv(send, [out, (received * width).tolist(), None, kind])
        return out

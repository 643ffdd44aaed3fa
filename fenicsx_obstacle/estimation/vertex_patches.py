"""The cells around each vertex in their order, on the rank that owns the vertex, whatever ranks the cells are on.

A corner is a vertex a of an owned triangle with the other two, b and c, counter-clockwise after it. The corners of a
vertex form fans: the corner after (a, b, c) is the one across its edge a-c, which begins with (a, c). Fans end at the
boundary, and on curves inside the domain where u is given. Values travel between a corner's cell and its fan by one
exchange over all ranks; everything that depends on the mesh alone is found once.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.estimation.simplices import Simplices, next_, previous
from fenicsx_obstacle.parallel import largest


class VertexPatches:
    """The fans of all owned vertices, in arrays ordered by step: the first corners of all fans, then the second ones.

    Fans stand in order of decreasing length, so that step k is one slice, and a walk along all fans at once is a loop
    over slices.

    Attributes:
        held: Whether u is given on the side opposite to each vertex, shape (owned cells, 3).
        free: Whether u is not given at an owned vertex.
        area: A third of the cell's area at each corner.
        mass: int phi_i at owned vertices.
        steps: Slice of each step.
        vertex: Owned dof of each fan.
        closed: Whether a fan goes all the way round.
        last: Place of the last corner of each fan.
        entry_held: Whether u is given on the edge where a fan begins; open fans only.
        exit_held: Whether u is given on the edge where a fan ends; open fans only.
    """

    def __init__(self, simplices: Simplices):
        """Sort the corners (collective)."""
        data, dofs = simplices.data, simplices.dofs
        self.comm, self.owned = data.level.comm, data.level.owned
        is_held = np.zeros(simplices.facets.max(initial=-1) + 1, dtype=bool)
        for facets in data.held:
            is_held[facets[facets < len(is_held)]] = True
        self.held = is_held[simplices.facets]
        self.free = np.ones(self.owned, dtype=bool)
        fixed = data.fixed[0]
        self.free[fixed[fixed < self.owned]] = False
        index_map = data.level.V.dofmap.index_map
        number = np.asarray(index_map.local_to_global(dofs.astype(np.int32).ravel()), dtype=np.int64).reshape(-1, 3)
        starts = np.array(self.comm.allgather(index_map.local_range[0]))
        if self.comm.size > 1:
            # ranks that own none share their start with the next: take the last
            owner = np.searchsorted(starts, number, side="right").ravel() - 1
            self._send = np.argsort(owner, kind="stable")
            self._sent = np.bincount(owner, minlength=self.comm.size)
            self._received = np.array(self.comm.alltoall(self._sent.tolist()), dtype=np.int64)
        entry, exit_ = (number * index_map.size_global + other for other in (next_(number), previous(number)))
        ends = previous(self.held) + 2 * next_(self.held)
        a, entry, exit_, ends = self._to_owners(number, entry, exit_, ends)
        a = a - starts[self.comm.rank]
        entry_held, exit_held = ends % 2 > 0, ends > 1
        self._sort(a, self._links(entry, exit_, entry_held, exit_held), entry_held, exit_held)
        self.area = self.gather(np.repeat(simplices.area[:, None] / 3, 3, axis=1))[0]
        self.mass = self.at_vertices(self.area)

    def _links(self, entry: np.ndarray, exit_: np.ndarray, entry_held: np.ndarray, exit_held: np.ndarray) -> np.ndarray:
        """The corner after each, -1 where its fan ends (local)."""
        if not len(entry):
            return np.empty(0, dtype=np.int64)
        order, wanted, after = np.argsort(entry), np.argsort(exit_), np.empty(len(entry), dtype=np.int64)
        # looking for sorted numbers is several times faster
        after[wanted] = order[np.minimum(np.searchsorted(entry[order], exit_[wanted]), len(order) - 1)]
        found = entry[after] == exit_
        # the ranks of its two cells need not both know that u is given on an edge
        cut = found & (exit_held | entry_held[after])
        exit_held[cut] = entry_held[after[cut]] = True
        return np.where(found & ~cut, after, -1)

    def _sort(self, a: np.ndarray, after: np.ndarray, entry_held: np.ndarray, exit_held: np.ndarray) -> None:
        """Walk along all fans at once and lay their corners out by step (local)."""
        first = np.ones(len(after), dtype=bool)
        first[after[after >= 0]] = False
        unseen, patches, steps = np.ones(len(after), dtype=bool), 0, list[tuple[np.ndarray, np.ndarray, int]]()
        starts, closed = np.flatnonzero(first), list[np.ndarray]()
        while True:
            here, fan, step = starts, patches + np.arange(len(starts)), 0
            patches += len(starts)
            while len(here):
                steps.append((fan, here, step))
                unseen[here] = False
                here, step = after[here], step + 1
                go_on = here >= 0
                go_on[go_on] = unseen[here[go_on]]
                here, fan = here[go_on], fan[go_on]
            closed.append(np.full(len(starts), len(closed) > 0))
            left = np.flatnonzero(unseen)
            if not len(left):
                break
            # what goes round begins anywhere, one fan of each vertex at a time
            starts = left[np.unique(a[left], return_index=True)[1]]
        length = np.zeros(patches, dtype=np.int64)
        for fan, _, _ in steps:
            length[fan] += 1
        rank = np.empty(patches, dtype=np.int64)
        by_length = np.argsort(-length, kind="stable")
        rank[by_length] = np.arange(patches)
        counts = [np.count_nonzero(length > k) for k in range(length.max(initial=0))]
        ends = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self.steps = [slice(start, end) for start, end in pairwise(ends.tolist())]
        self._order = np.empty(len(after), dtype=np.int64)
        for fan, here, step in steps:
            self._order[ends[step] + rank[fan]] = here
        self.closed = np.concatenate(closed)[by_length]
        self.last = ends[length[by_length] - 1] + np.arange(patches)
        head = self._order[:patches]
        self.vertex = a[head]
        self.entry_held, self.exit_held = entry_held[head], exit_held[self._order[self.last]]

    def gather(self, *values: np.ndarray) -> np.ndarray:
        """Values at the corners of owned cells, each of shape (cells, 3), along the fans (collective).

        Returns:
            Shape (len(values), corners).
        """
        return np.stack([rows[self._order] for rows in self._to_owners(*values)])

    def scatter(self, *values: np.ndarray) -> list[np.ndarray]:
        """Values along the fans at the corners of their cells, each of shape (cells, 3) (collective)."""
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
        return [part.reshape(-1, 3) for part in found]

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Sums over the corners of each owned vertex (local)."""
        return np.bincount(self.vertex, weights=self.sums(values), minlength=self.owned)

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums over the corners of each fan (local)."""
        sums = np.zeros(len(self.vertex))
        for step in self.steps:
            sums[: step.stop - step.start] += values[step]
        return sums

    def largest(self, values: np.ndarray) -> np.ndarray:
        """The largest of the values around each owned vertex, 0 if that is more (local)."""
        patches, found = np.zeros(len(self.vertex)), np.zeros(self.owned)
        for step in self.steps:
            count = step.stop - step.start
            np.maximum(patches[:count], values[step], out=patches[:count])
        np.maximum.at(found, self.vertex, patches)
        return found

    def smallest(self, values: np.ndarray) -> np.ndarray:
        """The smallest value over the corners of each owned vertex, infinite without one (local)."""
        patches, found = np.full(len(self.vertex), np.inf), np.full(self.owned, np.inf)
        for step in self.steps:
            count = step.stop - step.start
            np.minimum(patches[:count], values[step], out=patches[:count])
        np.minimum.at(found, self.vertex, patches)
        return found

    def walk(self, drops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Running sums of -drops along each fan (local).

        Returns:
            Before and after each corner; what is after one is before the next, the same number.
        """
        before, after = np.zeros(len(drops)), np.empty(len(drops))
        for k, step in enumerate(self.steps):
            if k:
                start = self.steps[k - 1].start
                before[step] = after[start : start + step.stop - step.start]
            after[step] = before[step] - drops[step]
        return before, after

    def left_over(self, after: np.ndarray) -> float:
        """The largest sum that is left after the fan of a free vertex (collective).

        Args:
            after: Running sums after each corner.
        """
        ends = np.abs(after[self.last])[self.closed | ~(self.entry_held | self.exit_held)]
        return max(largest(self.comm, ends), 0.0)

    def along(self, values: np.ndarray) -> np.ndarray:
        """One value for each fan at all of its corners (local)."""
        return np.concatenate([values[:0], *(values[: step.stop - step.start] for step in self.steps)])

    def _to_owners(self, *values: np.ndarray) -> list[np.ndarray]:
        """Values at corners, each of shape (cells, 3), in the order in which they come to their owners (collective)."""
        if self.comm.size == 1:
            return [part.ravel() for part in values]
        rows = np.stack(values, axis=2).reshape(-1, len(values))[self._send]
        return list(self._exchange(rows, self._sent, self._received).T)

    def _exchange(self, rows: np.ndarray, sent: np.ndarray, received: np.ndarray) -> np.ndarray:
        """Rows in the order of the ranks they go to; those that came, likewise (collective)."""
        kind, width = (MPI.DOUBLE if rows.dtype == np.float64 else MPI.INT64_T), rows.shape[1]
        out = np.empty((received.sum(), width), dtype=rows.dtype)
        send = [np.ascontiguousarray(rows), (sent * width).tolist(), None, kind]
        self.comm.Alltoallv(send, [out, (received * width).tolist(), None, kind])
        return out

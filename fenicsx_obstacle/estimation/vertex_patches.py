"""Vertex patches of triangles, ordered around the vertex.

A corner is a vertex a of an owned triangle with the other two, b and c, in counter-clockwise order. In a patch the
corner after (a, b, c) is the one across the edge a-c. Patches are open at the boundary, and on curves inside the domain
where u is given.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from fenicsx_obstacle.estimation.patches import Patches
from fenicsx_obstacle.estimation.quadrature import blocks
from fenicsx_obstacle.estimation.simplices import Simplices, next_, previous
from fenicsx_obstacle.parallel import largest


class VertexPatches(Patches):
    """The patches of all owned vertices, in arrays ordered by step: the first corners of all patches, then the second
    ones.

    Patches are sorted by decreasing length, so that step k is one slice, and running sums over all patches are a loop
    over slices.

    Attributes:
        steps: Slice of each step.
        closed: Whether the patch surrounds its vertex.
        last: Place of the last corner of each patch.
        entry_held: Whether u is given on the edge where a patch begins; open patches only.
        exit_held: Whether u is given on the edge where a patch ends; open patches only.
    """

    def __init__(self, simplices: Simplices):
        """Sort the corners (collective)."""
        super().__init__(simplices)
        number = self._number
        ends = previous(self.held) + np.int8(2) * next_(self.held)
        after = self._at_owners(_corners_after(simplices.facets, number))
        a, b, c, ends = self._to_owners(number, next_(number), previous(number), ends)
        entry_held, exit_held = ends % 2 > 0, ends > 1
        after = self._links(a, b, c, after, entry_held, exit_held)
        self._sort(a - self._first, after, entry_held, exit_held)
        del self._number  # not needed again
        self._weigh(simplices)

    def _links(
        self, a: np.ndarray, b: np.ndarray, c: np.ndarray, after: np.ndarray, entry_held: np.ndarray,
        exit_held: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """The corner after each, -1 where its patch ends (local).

        Args:
            a: Numbers of the vertices of corners.
            b: Of the next vertices of their cells.
            c: Of the others.
            after: The corner after each, -1 where it is not in a cell of the same rank.
            entry_held: Whether u is given on the edge from a to b.
            exit_held: Whether it is given on the edge from a to c.
        """
        entered = np.zeros(len(after) + 1, dtype=bool)
        entered[after] = True  # the last one stands for -1
        left, starts = np.flatnonzero(after < 0), np.flatnonzero(~entered[:-1])
        if len(left) and len(starts):  # the cells beside them may be of another rank
            entry, exit_ = a[starts] * self._vertices + b[starts], a[left] * self._vertices + c[left]
            starts = starts[np.argsort(entry)]
            place = np.minimum(np.searchsorted(np.sort(entry), exit_), len(starts) - 1)
            found = (a[starts[place]] == a[left]) & (b[starts[place]] == c[left])
            after[left[found]] = starts[place[found]]
        # the ranks of its two cells need not both know that u is given on an edge
        cut = np.flatnonzero((after >= 0) & (exit_held | np.append(entry_held, False)[after]))
        exit_held[cut] = entry_held[after[cut]] = True
        after[cut] = -1
        return after

    def _sort(self, a: np.ndarray, after: np.ndarray, entry_held: np.ndarray, exit_held: np.ndarray) -> None:
        """Walk along all patches at once and lay their corners out by step (local)."""
        first = np.ones(len(after), dtype=bool)
        first[after[after >= 0]] = False
        unseen, patches, steps = np.ones(len(after), dtype=bool), 0, list[tuple[np.ndarray, np.ndarray, int]]()
        starts, closed = np.flatnonzero(first), list[np.ndarray]()
        while True:
            here, patch, step = starts, patches + np.arange(len(starts)), 0
            patches += len(starts)
            while len(here):
                steps.append((patch, here, step))
                unseen[here] = False
                here, step = after[here], step + 1
                go_on = here >= 0
                go_on[go_on] = unseen[here[go_on]]
                here, patch = here[go_on], patch[go_on]
            closed.append(np.full(len(starts), len(closed) > 0))
            left = np.flatnonzero(unseen)
            if not len(left):
                break
            # what goes round begins anywhere, one patch of each vertex at a time
            place = np.full(self.owned, -1)
            place[a[left[::-1]]] = left[::-1]  # the first one of each vertex is written last
            starts = place[place >= 0]
        length = np.zeros(patches, dtype=np.int64)
        for patch, _, _ in steps:
            length[patch] += 1
        rank = np.empty(patches, dtype=np.int64)
        by_length = np.argsort(-length, kind="stable")
        rank[by_length] = np.arange(patches)
        counts = [np.count_nonzero(length > k) for k in range(length.max(initial=0))]
        ends = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self.steps = [slice(start, end) for start, end in pairwise(ends.tolist())]
        self._order = np.empty(len(after), dtype=np.int64)
        for patch, here, step in steps:
            self._order[ends[step] + rank[patch]] = here
        self.closed = np.concatenate(closed)[by_length]
        self.last = ends[length[by_length] - 1] + np.arange(patches)
        head = self._order[:patches]
        self.vertex = a[head]
        self.entry_held, self.exit_held = entry_held[head], exit_held[self._order[self.last]]

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums over the corners of each patch (local)."""
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
        """Running sums of -drops along each patch (local).

        Returns:
            Before and after each corner; what is after one is before the next, the same number.
        """
        before, after = np.zeros(len(drops)), np.empty(len(drops))
        for k, step in enumerate(self.steps):
            if k:
                start = self.steps[k - 1].start
                before[step] = after[start : start + step.stop - step.start]
            np.subtract(before[step], drops[step], out=after[step])
        return before, after

    def left_over(self, after: np.ndarray) -> float:
        """The largest sum that is left after the patch of a free vertex (collective).

        Args:
            after: Running sums after each corner.
        """
        ends = np.abs(after[self.last])[self.closed | ~(self.entry_held | self.exit_held)]
        return max(largest(self.comm, ends), 0.0)

    def along(self, values: np.ndarray) -> np.ndarray:
        """One value for each patch at all of its corners (local)."""
        return np.concatenate([values[:0], *(values[: step.stop - step.start] for step in self.steps)])


def _corners_after(facets: np.ndarray, number: np.ndarray) -> np.ndarray:
    """For each corner the one after it in the cell across its last edge, cell by cell; -1 where there is none (local).

    Args:
        facets: Local facet opposite to each vertex.
        number: Of the vertices.
    """
    sides, every = facets.ravel(), np.arange(facets.size).reshape(facets.shape)
    last, first = (np.empty(facets.max(initial=-1) + 1, dtype=np.int64) for _ in range(2))
    last[sides], first[sides[::-1]] = every.ravel(), every.ravel()[::-1]
    found = np.empty(facets.shape, dtype=np.int64)
    for block in blocks(len(facets)):
        across = last[facets[block]]
        # the same side where there is no other cell
        across = np.where(across == every[block], first[facets[block]], across)
        # of a corner (a, b, c) it is across the side opposite to b; there a comes after the vertex opposite to the side
        across = next_(across)
        after = across + np.where(across % 3 == 2, -2, 1)
        found[block] = np.where(number.ravel()[after] == number[block], after, -1)
    return found.ravel()

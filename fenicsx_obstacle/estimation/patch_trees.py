"""Spanning trees of vertex patches, along which a flux is found that is in balance.

Two corners are neighbours across a facet with their vertex, unless u is given there. A spanning tree of each patch,
found breadth first, takes what cells gather from the leaves to the root, where it leaves through a facet on which u is
given, if the patch has one; otherwise nothing is left there, if residual and multipliers are in balance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class Sides:
    """Corners with their facets, as they come to their owners.

    Attributes:
        vertex: Owned vertex of each corner.
        beside: Of each facet of each corner the place of the same facet in the flat array of all, seen from the other
            side; -1 on the boundary, shape (corners, d).
        held: Whether u is given on it.
    """

    vertex: np.ndarray
    beside: np.ndarray
    held: np.ndarray


class PatchTrees:
    """The trees of all patches of this rank; nothing here is collective.

    Attributes:
        order: The corners ordered by depth, the roots first.
        patch: The patch of each, in this order.
        vertex: Owned vertex of each patch.
        closed: The vertices of the patches that nothing may leave.
    """

    def __init__(self, sides: Sides, owned: int):
        """Find all trees together, breadth first.

        Args:
            sides: Of the corners.
            owned: Number of vertices.
        """
        count, dim = self._shape = sides.held.shape
        linked = np.where(sides.held, -1, sides.beside).ravel()
        exit_ = sides.held.any(axis=1)
        depth, parent, patch = np.full(count, -1), np.full(count, -1), np.empty(count, dtype=np.int64)
        up, down = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        claims, patches, level = np.empty(count, dtype=np.int64), 0, 0
        while len(left := np.flatnonzero(depth < 0)):
            # one patch of each vertex at a time; it begins where something may leave, if that is anywhere
            root_of = np.full(owned, -1)
            root_of[sides.vertex[left]] = left
            out = left[exit_[left]]
            root_of[sides.vertex[out]] = out
            here, level = root_of[root_of >= 0], 0
            depth[here], patch[here] = 0, patches + np.arange(len(here))
            patches += len(here)
            while len(here):
                level += 1
                source = (here[:, None] * dim + np.arange(dim)).ravel()
                away = linked[source]
                corner = away // dim
                new = (away >= 0) & (depth[corner] < 0)
                source, away, corner = source[new], away[new], corner[new]
                claims[corner] = source
                first = claims[corner] == source  # one of those that reach it
                source, away, here = source[first], away[first], corner[first]
                there = source // dim
                depth[here], parent[here], patch[here] = level, there, patch[there]
                up[here], down[here] = away, source
        self.order = np.argsort(depth.astype(np.int16), kind="stable")
        ends = np.cumsum(np.concatenate([[0], np.bincount(depth, minlength=1)])).tolist()
        self._levels = [slice(start, end) for start, end in pairwise(ends)]
        place = np.empty(count, dtype=np.int64)
        place[self.order] = np.arange(count)
        self.patch = patch[self.order]
        self.vertex = np.empty(patches, dtype=np.int64)
        self.vertex[self.patch] = sides.vertex[self.order]
        parent = parent[self.order]
        self._parent = np.where(parent >= 0, place[parent], -1)
        roots = self._levels[0]
        self._exits = exit_[self.order][roots]
        self.closed = self.vertex[self.patch[roots][~self._exits]]
        out = np.arange(roots.stop) * dim + np.argmax(sides.held[self.order][roots], axis=1)
        self._up = np.arange(count) * dim + up[self.order] % dim
        self._up[roots] = out
        self._down = self._parent * dim + down[self.order] % dim

    def walk(self, drops: np.ndarray) -> np.ndarray:
        """Fluxes out of the corners with sums of -drops in each, shape (corners, d), opposite on both sides of a facet;
        of a patch that nothing may leave the drops have the sum 0."""
        gathered = -drops
        for before, level in zip(self._levels[-2::-1], self._levels[:0:-1], strict=True):
            count = before.stop - before.start
            gathered[before] += np.bincount(self._parent[level] - before.start, gathered[level], count)
        fluxes, roots = np.zeros(self._shape), self._levels[0]
        flat = fluxes.ravel()
        flat[self._up[roots][self._exits]] = gathered[roots][self._exits]
        others = slice(roots.stop, len(drops))
        flat[self._up[others]] = gathered[others]
        flat[self._down[others]] = -gathered[others]
        return fluxes

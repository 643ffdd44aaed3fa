"""Vertex patches of intervals or tetrahedra with spanning trees.

A corner is a vertex a of an owned cell with the d others, of a tetrahedron so that (a, b, c, d) has a positive
determinant. It has d facets with a, each opposite to one of the others; two corners are neighbours across such a facet,
unless u is given there. A spanning tree of each patch, found breadth first, takes what cells gather from the leaves to
the root, where it leaves through a facet on which u is given, if the patch has one; otherwise nothing is left there, if
residual and multipliers are in balance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.estimation.patches import Patches
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest

# the other vertices of a cell after each one
OTHERS = {1: ((1,), (0,)), 3: ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))}


@dataclass(frozen=True)
class _Sides:
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


class TreePatches(Patches):
    """The patches of all owned vertices, in arrays ordered by depth in the trees: the roots first.

    Attributes:
        levels: Slice of each depth.
        parent: Corner nearer to the root, -1 of roots.
        free_boundary: Whether a facet with the vertex is on the boundary and u is not given on it, shape (corners, d).
    """

    def __init__(self, simplices: Simplices):
        """Find the trees (collective)."""
        super().__init__(simplices)
        self.dim = simplices.dim
        sides = self._sides(simplices)
        self._grow(sides)
        self.free_boundary = ((sides.beside < 0) & ~sides.held)[self._order]
        self._weigh(simplices)

    def _sides(self, simplices: Simplices) -> _Sides:
        """Pair the facets of the corners of each vertex (collective)."""
        dim, mesh = self.dim, simplices.data.level.mesh
        others, index_map = np.array(OTHERS[dim]), mesh.topology.index_map(dim - 1)
        facets = np.asarray(index_map.local_to_global(simplices.facets.astype(np.int32).ravel()), dtype=np.int64)
        facets = facets.reshape(simplices.facets.shape)
        keys = []
        for j in range(dim):
            facet, key = facets[:, others[:, j]], np.zeros(facets.shape, dtype=np.int64)
            for k in range(dim):  # which of the vertices of the facet this is
                if k != j:
                    key += self._number[:, others[:, k]] < self._number
            keys.append(facet * dim + key)
        held = [self.held[:, others[:, j]] for j in range(dim)]
        vertex, *found = self._to_owners(self._number, *keys, *(part.astype(np.int64) for part in held))
        key, is_held = np.stack(found[:dim], axis=1).ravel(), np.stack(found[dim:], axis=1).ravel() > 0
        beside = _pairs(*dense(key, dim * index_map.size_global))
        # the ranks of its two cells need not both know that u is given on a facet
        is_held[beside >= 0] |= is_held[beside[beside >= 0]]
        shape = len(vertex), dim
        return _Sides(vertex - self._first, beside.reshape(shape), is_held.reshape(shape))

    def _grow(self, sides: _Sides) -> None:
        """Find a tree of each patch, breadth first, all together (local)."""
        dim, count = self.dim, len(sides.vertex)
        linked = np.where(sides.held, -1, sides.beside)
        exit_ = sides.held.any(axis=1)
        depth, parent, patch = np.full(count, -1), np.full(count, -1), np.empty(count, dtype=np.int64)
        up, down = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        claims, root_of, patches, level = np.empty(count, dtype=np.int64), np.empty(self.owned, dtype=np.int64), 0, 0
        while len(left := np.flatnonzero(depth < 0)):
            # one patch of each vertex at a time; it begins where something may leave, if that is anywhere
            root_of[sides.vertex[left]] = left
            out = left[exit_[left]]
            root_of[sides.vertex[out]] = out
            here, level = np.unique(root_of[sides.vertex[left]]), 0
            depth[here], patch[here] = 0, patches + np.arange(len(here))
            patches += len(here)
            while len(here):
                level += 1
                away = linked[here].ravel()
                source = np.repeat(here * dim, dim) + np.tile(np.arange(dim), len(here))
                source, away = source[away >= 0], away[away >= 0]
                new = depth[away // dim] < 0
                source, away = source[new], away[new]
                claims[away // dim] = source
                first = claims[away // dim] == source  # one of those that reach it
                source, away = source[first], away[first]
                here, there = away // dim, source // dim
                depth[here], parent[here], patch[here] = level, there, patch[there]
                up[here], down[here] = away, source
        self._order = np.argsort(depth.astype(np.int16), kind="stable")
        ends = np.cumsum(np.concatenate([[0], np.bincount(depth, minlength=1)])).tolist()
        self.levels = [slice(start, end) for start, end in pairwise(ends)]
        place = np.empty(count, dtype=np.int64)
        place[self._order] = np.arange(count)
        self._patch = patch[self._order]
        self.vertex = np.empty(patches, dtype=np.int64)
        self.vertex[self._patch] = sides.vertex[self._order]
        parent = parent[self._order]
        self.parent = np.where(parent >= 0, place[parent], -1)
        roots = self.levels[0]
        self._exits = exit_[self._order][roots]
        out = np.arange(roots.stop) * dim + np.argmax(sides.held[self._order][roots], axis=1)
        self._up = np.arange(count) * dim + up[self._order] % dim
        self._up[roots] = out
        self._down = self.parent * dim + down[self._order] % dim

    def walk(self, drops: np.ndarray) -> tuple[np.ndarray, float]:
        """Fluxes out of the corners through their facets with sums of -drops in each (collective).

        Args:
            drops: At the corners.

        Returns:
            Shape (corners, d), the same number with opposite signs on both sides of a facet; and the largest flux that
            is left at a root where nothing may leave.
        """
        gathered = -drops
        for before, level in zip(self.levels[-2::-1], self.levels[:0:-1], strict=True):
            count = before.stop - before.start
            gathered[before] += np.bincount(self.parent[level] - before.start, gathered[level], count)
        fluxes, roots = np.zeros((len(drops), self.dim)), self.levels[0]
        flat = fluxes.ravel()
        flat[self._up[roots][self._exits]] = gathered[roots][self._exits]
        others = slice(roots.stop, len(drops))
        flat[self._up[others]] = gathered[others]
        flat[self._down[others]] = -gathered[others]
        left_over = np.abs(gathered[roots][~self._exits])
        return fluxes, max(largest(self.comm, left_over), 0.0)

    def edges(self, simplices: Simplices) -> tuple[np.ndarray, np.ndarray, int]:
        """The edges from each vertex to the others of its corners, of tetrahedra (collective).

        Returns:
            Their numbers at the corners, shape (corners, 3), which begin anew at each rank and are different for the
            two ends of an edge; the owned vertex of each; how many there are.
        """
        mesh = simplices.data.level.mesh
        mesh.topology.create_entities(1)
        mesh.topology.create_connectivity(3, 1)
        count = own_cells(mesh)
        local = mesh.topology.connectivity(3, 1).array.reshape(-1, 6)[:count]
        index_map = mesh.topology.index_map(1)
        number = np.asarray(index_map.local_to_global(local.astype(np.int32).ravel()), dtype=np.int64).reshape(-1, 6)
        between = simplices.edges(number)
        others = np.array(OTHERS[3])
        every = np.arange(4)
        keys = []
        for j in range(3):
            there = others[:, j]
            upper = self._number > self._number[:, there]
            keys.append(2 * between[:, every, there] + upper)
        found = np.stack([part[self._order] for part in self._to_owners(*keys)], axis=1)
        numbers, total = dense(found.ravel(), 2 * index_map.size_global)
        numbers = numbers.reshape(found.shape)
        vertex = np.empty(total, dtype=np.int64)
        vertex[numbers] = self.vertex[self._patch][:, None]
        return numbers, vertex, total


def dense(keys: np.ndarray, limit: int) -> tuple[np.ndarray, int]:
    """Numbers from 0 on for keys below a limit, and how many are different (local)."""
    present = np.zeros(limit, dtype=bool)
    present[keys] = True
    numbers = np.cumsum(present, dtype=np.int32)
    return numbers[keys] - 1, int(numbers[-1]) if limit else 0


def _pairs(keys: np.ndarray, count: int) -> np.ndarray:
    """Of each of the numbers below `count` the place where the same one stands once more, -1 if it does not."""
    every, last, first = np.arange(len(keys)), np.full(count, -1), np.full(count, -1)
    last[keys] = every
    ahead = last[keys] != every
    first[keys[ahead]] = every[ahead]
    return np.where(ahead, last[keys], first[keys])

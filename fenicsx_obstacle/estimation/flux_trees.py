"""Equilibrated P1 fluxes on vertex patches of intervals and tetrahedra, by spanning trees.

On intervals there is one flux on each patch. On tetrahedra the fluxes without divergence are those of stream functions,
one number for each edge at the vertex a: with the corner (a, b, c, d) of a cell T turned to the right hand,

    sigma^a = tree + sum_b psi_b C_b,   C_b|_T = (x_d - x_c)/(3 |T|),

C_b flows 1 out of T opposite to c and into it opposite to d. psi is determined by the nearest flux up to a constant,
which no flux depends on: a matrix with as many rows as a has neighbours, some fifteen. Where nothing may leave through
the boundary psi is 0. Any psi gives a flux in balance, so that nothing depends on how accurate it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.estimation.tree_patches import OTHERS, TreePatches

FLAT = (
    1e-13  # of the mean diagonal: keeps matrices of flat cells, and of vertices where parts of the mesh meet, regular
)
AT_ONCE = 20_000  # vertices


@dataclass(frozen=True, eq=False)
class _Streams:
    """The stream functions of all owned vertices; those of vertices with the same number of edges follow each other.

    Attributes:
        place: Of the three functions at each corner, shape (corners, 3).
        matrices: One for each number of edges, shape (vertices, edges, edges).
        count: How many functions there are.
        zero: Functions that are 0.
    """

    place: np.ndarray = field(repr=False)
    matrices: list[np.ndarray] = field(repr=False)
    count: int
    zero: np.ndarray = field(repr=False)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The stream functions from the right sides, shape (functions,) (local)."""
        found, start = np.empty(self.count), 0
        right[self.zero] = 0.0
        for matrix in self.matrices:
            vertices, edges = matrix.shape[:2]
            for first in range(0, vertices, AT_ONCE):
                part = matrix[first : first + AT_ONCE]
                end = start + len(part) * edges
                rows = right[start:end].reshape(len(part), edges)
                found[start:end] = np.linalg.solve(part, rows[..., None]).ravel()
                start = end
        return found


class TreeEquilibration(EquilibrationP1):
    """Flux and multipliers on intervals and tetrahedra."""

    patches: TreePatches

    def __init__(self, simplices: Simplices, of_state: np.ndarray | None = None):
        """Find the trees, and on tetrahedra the matrices of stream functions (collective); the arguments are those of
        `EquilibrationP1`."""
        super().__init__(simplices, TreePatches(simplices), of_state)
        self._streams: _Streams | None = None
        if simplices.dim == 3:
            x = np.moveaxis(simplices.x - simplices.middle[:, None], 2, 0)
            self._from_middle = [[np.ascontiguousarray(x[axis, :, k]) for axis in range(3)] for k in range(4)]
            self._scale = 1 / (9 * simplices.area)
            self._streams = self._matrices()

    def _on_patches(self, drops: np.ndarray, beta: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, float]:
        """See `EquilibrationP1._on_patches` (collective)."""
        patches, parts = self.patches, self.parts
        fluxes, left_over = patches.walk(drops)
        at_corners = patches.scatter(*fluxes.T)
        for a, others in enumerate(OTHERS[self.simplices.dim]):
            for flux, k in zip(at_corners, others, strict=True):
                there = parts.sides == k
                np.add.at(flux[:, a], parts.cells[there], force[there, a])
        if self._streams is not None:
            right = patches.gather(*self._products(at_corners, beta))
            place = self._streams.place
            sums = np.bincount(place.ravel(), right.T.ravel(), self._streams.count)
            psi = self._streams.solve(sums)[place]
            curls = (psi[:, (j + 2) % 3] - psi[:, (j + 1) % 3] for j in range(3))
            at_corners = [flux + curl for flux, curl in zip(at_corners, patches.scatter(*curls), strict=True)]
        normal = np.zeros(beta.shape)
        for a, others in enumerate(OTHERS[self.simplices.dim]):
            for flux, k in zip(at_corners, others, strict=True):
                normal[:, k] += flux[:, a]
        return normal, left_over

    def _products(self, fluxes: list[np.ndarray], beta: np.ndarray) -> list[np.ndarray]:
        """-int mu^(-1) C_b . (sigma^a - target) for the three b of each corner, each of shape (cells, 4) (local)."""
        y, found = self._from_middle, [np.empty(beta.shape) for _ in range(3)]
        target = [sum(beta[:, k] * y[k][axis] for k in range(4)) for axis in range(3)]
        for a, others in enumerate(OTHERS[3]):
            # 3 |T| times the mean of sigma^a - target in the cell
            mean = [target[axis] - beta[:, a] * y[a][axis] for axis in range(3)]
            for flux, k in zip(fluxes, others, strict=True):
                for axis in range(3):
                    mean[axis] -= flux[:, a] * y[k][axis]
            weighted = self.weighted(np.stack(mean))
            along = [y[k][0] * weighted[0] + y[k][1] * weighted[1] + y[k][2] * weighted[2] for k in others]
            for j in range(3):
                found[j][:, a] = (along[(j + 1) % 3] - along[(j + 2) % 3]) * self._scale
        return found

    def _matrices(self) -> _Streams:
        """int mu^(-1) C_b . C_c of all vertices, their edges in order (collective)."""
        patches, y = self.patches, self._from_middle
        numbers, vertex, count = patches.edges(self.simplices)
        edges = np.bincount(vertex, minlength=patches.owned)
        # by the number of edges of the vertex, then by vertex
        order = np.lexsort((vertex, edges[vertex]))
        place = np.empty(count, dtype=np.int64)
        place[order] = np.arange(count)
        sizes, many = np.unique(edges[edges > 0], return_counts=True)
        starts = np.concatenate([[0], np.cumsum(sizes * many)]).astype(np.int64)
        group = np.searchsorted(sizes, edges[vertex])
        size = edges[vertex]
        within = place - starts[group]  # among the functions of vertices with as many edges
        blocks = np.concatenate([[0], np.cumsum(sizes**2 * many)]).astype(np.int64)
        row = blocks[group] + within * size  # of the matrices, one after the other
        column = within % np.maximum(size, 1)
        products = []
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            # C_k . C_m, e_k = y_j - y_m and e_m = y_k - y_j
            part = np.empty((len(self.mu), 4))
            for a, others in enumerate(OTHERS[3]):
                one, other, third = (np.stack(y[others[n]]) for n in (j, k, m))
                part[:, a] = np.sum((one - third) * self.weighted(other - one), axis=0)
            products.append(part * self._scale[:, None])
        values = np.zeros(blocks[-1])
        for j, gathered in enumerate(patches.gather(*products)):
            one_edge, other_edge = numbers[:, (j + 1) % 3], numbers[:, (j + 2) % 3]
            values += np.bincount(row[one_edge] + column[other_edge], gathered, len(values))
        zero = np.zeros(count, dtype=bool)
        for j in range(3):
            chosen = patches.free_boundary[:, j]
            zero[place[numbers[chosen][:, [(j + 1) % 3, (j + 2) % 3]]]] = True
        matrices = []
        for g, edges_there in enumerate(sizes.tolist()):
            half = values[blocks[g] : blocks[g + 1]].reshape(many[g], edges_there, edges_there)
            matrices.append(_regular(half, zero[starts[g] : starts[g + 1]].reshape(many[g], edges_there)))
        return _Streams(place[numbers], matrices, count, zero)


def _regular(half: np.ndarray, zero: np.ndarray) -> np.ndarray:
    """Matrices of stream functions from products of different ones, each pair at one of its two places; with what makes
    them regular.

    Args:
        half: Shape (vertices, edges, edges).
        zero: Functions that are 0, shape (vertices, edges).
    """
    matrix = half + half.transpose(0, 2, 1)
    diagonal = np.arange(matrix.shape[1])
    matrix[:, diagonal, diagonal] = -matrix.sum(axis=2)  # the functions of a patch add up to no flux
    mean = matrix[:, diagonal, diagonal].mean(axis=1)
    matrix[:, diagonal, diagonal] += FLAT * mean[:, None]
    held = zero.any(axis=1)
    matrix[~held] += (mean[~held] / len(diagonal))[:, None, None]  # the same constant for all is no flux
    rows = np.flatnonzero(held)
    kept = ~zero[rows]
    matrix[rows] *= kept[:, :, None] & kept[:, None]
    matrix[rows[:, None], diagonal, diagonal] += zero[rows] * mean[rows, None]
    return matrix

"""Equilibrated fluxes in RT0 on vertex patches: the nearest ones to given targets.

A flux sigma^a in balance is found along a spanning tree of the patch of the vertex a. All fluxes in balance differ from
it by fluxes without divergence. On intervals there are none. On triangles (a, b, c) it is one that flows around a, on
tetrahedra (a, b, c, d) there is one around each edge at a:

    sigma^a = tree + psi C,        C|_T = (x_c - x_b)/(2 |T|)       on triangles,
    sigma^a = tree + sum psi_b C_b,  C_b|_T = (x_d - x_c)/(3 |T|)   on tetrahedra,

psi being the values of a stream function. C_b flows 1 out of T opposite to c and into it opposite to d. The psi of the
nearest flux, in the norm of mu^(-1/2), solve a small symmetric system; on tetrahedra, with some fifteen unknowns, up to
a constant, which no flux depends on. Where nothing may leave through the boundary psi is 0. Any psi gives a flux in
balance, so that nothing depends on how accurate it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import reduce

import numpy as np

from fenicsx_obstacle.estimation.part_forces import PartForces
from fenicsx_obstacle.estimation.patch_systems import PatchSystems
from fenicsx_obstacle.estimation.patches import OTHERS, Patches
from fenicsx_obstacle.estimation.simplices import Simplices

# of each function without divergence at a corner the facets through which it flows out of the cell and into it
STREAMS: dict[int, tuple[tuple[int, int], ...]] = {1: (), 2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}


class PatchFlux:
    """What depends on mesh and tension alone.

    Attributes:
        apart: Of the patches.
    """

    def __init__(
        self,
        simplices: Simplices,
        parts: PartForces,
        weighted: Callable[[np.ndarray], np.ndarray],
    ):
        """Sum the matrices of stream functions (collective).

        Args:
            simplices: The owned cells.
            parts: The facets with forces.
            weighted: Divides vectors of shape (d, cells) by the tension.
        """
        self._parts, self._weighted = parts, weighted
        dim, patches = simplices.dim, Patches(simplices)
        self._patches, self.apart = patches, patches.apart
        self._others, self._streams = OTHERS[dim], STREAMS[dim]
        if not self._streams:
            return
        self._gram = self._weigh(simplices)
        if dim == 2:
            numbers, owner = patches.patch[:, None], np.arange(len(patches.vertex))
        else:
            numbers, owner = patches.edges(simplices)
        zero = np.zeros(len(owner), dtype=bool)
        for k in range(dim):  # functions that flow through a facet
            through = [j for j, both in enumerate(self._streams) if k in both]
            zero[numbers[patches.free_boundary[:, k]][:, through]] = True
        self._systems = PatchSystems(numbers, owner, zero, self._products(), up_to_constants=dim == 3)

    def nearest(self, drops: np.ndarray, beta: np.ndarray, force: np.ndarray) -> np.ndarray:
        """The sum of the fluxes on all patches, (E11) (collective).

        Args:
            drops: What is to leave each corner less what flows out of it, with the sign changed: -int div sigma^a over
                its cell, shape (cells, d + 1).
            beta: Fluxes of the targets phi_a mu grad u_h out of each cell, through the facet opposite to each of its
                vertices if that has the vertex a: the same for all a, shape (cells, d + 1).
            force: What flows out through the facets of `parts` besides, by vertices of the cell; `drops` contain it.

        Returns:
            The fluxes out of cells, as `FluxP1` has them.
        """
        patches, parts = self._patches, self._parts
        at_corners = patches.scatter(*patches.trees.walk(patches.gather(drops)[0]).T)
        for a, others in enumerate(self._others):
            for flux, k in zip(at_corners, others, strict=True):
                there = parts.sides == k
                np.add.at(flux[:, a], parts.cells[there], force[there, a])
        if self._streams:
            psi = self._systems.solve(patches.gather(*self._against(at_corners, beta)))
            for (out, into), values in zip(self._streams, patches.scatter(*psi), strict=True):
                at_corners[out] += values
                at_corners[into] -= values
        normal = np.zeros(beta.shape)
        for a, others in enumerate(self._others):
            for flux, k in zip(at_corners, others, strict=True):
                normal[:, k] += flux[:, a]
        return normal

    def _weigh(self, simplices: Simplices) -> np.ndarray:
        """int mu^(-1) tau_i . tau_j of the fluxes tau_i that flow 1 out opposite to vertex i, up to one number in each
        cell, shape (d + 1, d + 1, cells) (local)."""
        from_middle, count = np.moveaxis(simplices.x - simplices.middle[:, None], 2, 0), len(self._others)
        y = [np.ascontiguousarray(from_middle[:, :, k]) for k in range(count)]
        found = np.empty((count, count, len(simplices.area)))
        for i in range(count):
            weighted = self._weighted(y[i]) / (simplices.dim**2 * simplices.area)
            for j in range(i + 1):
                found[i, j] = found[j, i] = np.einsum("xc,xc->c", y[j], weighted)
        return found

    def _target(self, beta: np.ndarray, a: int, k: int) -> np.ndarray:
        """The flux of the target at the corners of vertices a through the facets opposite to vertices k (local)."""
        return beta[:, k]

    def _against(self, fluxes: list[np.ndarray], beta: np.ndarray) -> list[np.ndarray]:
        """-int mu^(-1) C . (sigma^a - target) for each C at a corner, each of shape (cells, d + 1) (local)."""
        found, gram = [np.empty(beta.shape) for _ in self._streams], self._gram
        for a, others in enumerate(self._others):
            away = [(k, self._target(beta, a, k) - flux[:, a]) for flux, k in zip(fluxes, others, strict=True)]
            for right, (out, into) in zip(found, self._streams, strict=True):
                i, j = others[out], others[into]
                right[:, a] = reduce(np.add, ((gram[i, k] - gram[j, k]) * one for k, one in away))
        return found

    def _products(self) -> Iterator[tuple[int, int, np.ndarray]]:
        """int mu^(-1) C . C of two functions at the corners (collective)."""
        streams, gram = self._streams, self._gram
        for i in range(len(streams)):
            for j in range(i, len(streams)):
                part = np.empty((gram.shape[2], len(self._others)))
                for a, others in enumerate(self._others):
                    (out, into), (there, back) = ([others[k] for k in streams[m]] for m in (i, j))
                    part[:, a] = gram[out, there] - gram[out, back] - gram[into, there] + gram[into, back]
                yield i, j, self._patches.gather(part)[0]

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

import numpy as np

from fenicsx_obstacle.estimation.part_forces import PartForces
from fenicsx_obstacle.estimation.patch_systems import PatchSystems
from fenicsx_obstacle.estimation.patches import OTHERS, Patches
from fenicsx_obstacle.estimation.simplices import Simplices

# of each function without divergence at a corner the facets through which it flows out of the cell and into it
STREAMS: dict[int, tuple[tuple[int, int], ...]] = {1: (), 2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}


class PatchFlux:
    """What depends on mesh and tension alone."""

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
        self._patches = patches
        self._others, self._streams = OTHERS[dim], STREAMS[dim]
        if not self._streams:
            return
        x = np.moveaxis(simplices.x - simplices.middle[:, None], 2, 0)
        self._from_middle = [np.ascontiguousarray(x[:, :, k]) for k in range(dim + 1)]
        self._scale = 1 / (dim**2 * simplices.area)
        if dim == 2:
            numbers, owner, count = patches.patch[:, None], np.arange(len(patches.vertex)), len(patches.vertex)
        else:
            numbers, owner, count = patches.edges(simplices)
        zero = np.zeros(count, dtype=bool)
        for k in range(dim):  # functions that flow through a facet
            through = [j for j, both in enumerate(self._streams) if k in both]
            zero[numbers[patches.free_boundary[:, k]][:, through]] = True
        self._systems = PatchSystems(numbers, owner, zero, self._products(), up_to_constants=dim == 3)

    def nearest(self, drops: np.ndarray, beta: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, float]:
        """The sum of the fluxes on all patches, (E11) (collective).

        Args:
            drops: What is to leave each corner less what flows out of it, with the sign changed: -int div sigma^a over
                its cell, shape (cells, d + 1).
            beta: Fluxes of the targets phi_a mu grad u_h out of each cell, through the facet opposite to each of its
                vertices if that has the vertex a: the same for all a, shape (cells, d + 1).
            force: What flows out through the facets of `parts` besides, by vertices of the cell; `drops` contain it.

        Returns:
            The fluxes out of cells, and what patches of free vertices leave over, as `FluxP1` has them.
        """
        patches, parts = self._patches, self._parts
        fluxes, left_over = patches.walk(patches.gather(drops)[0])
        at_corners = patches.scatter(*fluxes.T)
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
        return normal, left_over

    def _against(self, fluxes: list[np.ndarray], beta: np.ndarray) -> list[np.ndarray]:
        """-int mu^(-1) C . (sigma^a - target) for each C at a corner, each of shape (cells, d + 1) (local)."""
        y, found = self._from_middle, [np.empty(beta.shape) for _ in self._streams]
        target = sum(beta[:, k] * y[k] for k in range(len(y)))
        for a, others in enumerate(self._others):
            # d |T| times the mean of sigma^a - target in the cell
            mean = target - beta[:, a] * y[a]
            for flux, k in zip(fluxes, others, strict=True):
                mean -= flux[:, a] * y[k]
            weighted = self._weighted(mean)
            along = [np.einsum("xc,xc->c", y[k], weighted) for k in others]
            for right, (out, into) in zip(found, self._streams, strict=True):
                right[:, a] = (along[out] - along[into]) * self._scale
        return found

    def _products(self) -> Iterator[tuple[int, int, np.ndarray]]:
        """int mu^(-1) C . C of two functions at the corners (collective)."""
        y, streams = self._from_middle, self._streams
        for i in range(len(streams)):
            for j in range(i, len(streams)):
                part = np.empty((len(self._scale), len(self._others)))
                for a, others in enumerate(self._others):
                    one, other = (y[others[streams[k][1]]] - y[others[streams[k][0]]] for k in (i, j))
                    part[:, a] = np.einsum("xc,xc->c", one, self._weighted(other)) * self._scale
                yield i, j, self._patches.gather(part)[0]

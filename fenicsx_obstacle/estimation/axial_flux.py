"""The equilibrated flux with the weight r of axial symmetry, the distance from the axis.

All integrals have the factor r. The flux is r tau, with tau in RT0 on each cell: its normal part on a facet is r times
a number, so that it is determined by what flows out of each facet, and it is 0 on the axis. With c_j, what flows out
opposite to vertex j divided by the mean of r there,

    tau = sum_j c_j (x - x_j)/(d |T|),   div(r tau)/r = (d + 1) b + a/r,   b = sum_j c_j/(d |T|),   a = -sum_j r_j b_j,

b_j being the terms of b. The first is the load that the flux is in balance with, in the mean of each cell. What a/r is
beyond its mean, a (1/r - 1/r_T), is weighed by Poincare's constant. In a cell with a facet on the axis a is 0.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.estimation.cell_data import Tension
from fenicsx_obstacle.estimation.part_forces import PartForces
from fenicsx_obstacle.estimation.patch_flux import PatchFlux
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.estimation.simplices import Simplices, integrals, reciprocals, sums


class AxialFlux:
    """The flux with the weight, (E21): what depends on the mesh alone.

    Attributes:
        variation: A bound of ||1/r - 1/r_T||_T in each cell, 0 where a is 0.
    """

    def __init__(self, simplices: Simplices):
        """Weigh the facets (local).

        Args:
            simplices: The cells of a mesh with the weight.
        """
        assert simplices.radius is not None
        self._simplices, self._radius = simplices, simplices.radius
        radius, dim = simplices.radius, simplices.dim
        mean = sums(radius) / (dim + 1)
        facets = (sums(radius)[:, None] - radius) / dim
        self._inverse = reciprocals(np.where(np.count_nonzero(radius, axis=1)[:, None] == 0, 0.0, facets))
        # the integral of r (1/r - 1/mean)^2, which is |T| times the mean of 1/r less 1/mean
        spread = sums((radius - mean[:, None]) ** 2) / ((dim + 1) * (dim + 2))
        beyond = spread * reciprocals(radius.min(axis=1, initial=np.inf) * mean**2)
        beyond[np.any(radius == 0, axis=1)] = np.inf
        if dim == 2:
            # the mean of 1/r is less if the least r is replaced by 0: then it is 2 log(q/p)/(q - p) <= 2 (p q)^(-1/2)
            _, p, q = np.sort(radius, axis=1).T
            beyond = np.minimum(beyond, np.where(p > 0, 2 * reciprocals(np.sqrt(np.abs(p * q))) - 1 / mean, np.inf))
        at_axis = np.count_nonzero(radius == 0, axis=1) == dim  # where a is 0
        self.variation = np.sqrt(simplices.area * np.where(at_axis, 0.0, np.maximum(beyond, 0.0)))

    def beyond(self, normal: np.ndarray) -> np.ndarray:
        """The norm of a (1/r - 1/r_T) in each cell (local).

        Args:
            normal: What flows out of each cell opposite to its vertices.
        """
        simplices = self._simplices
        a = sums(normal * self._inverse * self._radius) / (simplices.dim * simplices.area)
        return np.abs(a) * self.variation

    def distances(self, gradient: np.ndarray, normal: np.ndarray, tension: Tension) -> np.ndarray:
        """A bound of ||mu^(1/2) g - mu^(-1/2) tau||_T^2 in each cell (local).

        Args:
            gradient: One vector g per cell, shape (d, cells).
            normal: What flows out of each cell opposite to its vertices.
            tension: mu.
        """
        simplices, dim = self._simplices, self._simplices.dim
        squares = np.empty(len(simplices.area))

        def fields(cells: np.ndarray | slice, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            tau = simplices.flux_fields(normal[cells] * self._inverse[cells], points, cells)
            return np.broadcast_to(gradient[:, cells].T[:, None], tau.shape), tau

        points, weights = rule(dim, 3)
        for block in blocks(len(squares)):
            g, tau = fields(block, points[None])
            mu = tension.least[block][:, None, None]
            density = np.einsum("cpx,cpx->cp", mu * g - tau, mu * g - tau)
            with_weight = weights * polynomials.combined(points[None], self._radius[block])
            squares[block] = simplices.area[block] * integrals(density, with_weight) / tension.least[block]
        tension.integrate_distances(squares, fields, degree=1)
        return squares


class AxialPatchFlux(PatchFlux):
    """The nearest fluxes on vertex patches of triangles, with the weight."""

    def __init__(self, simplices: Simplices, parts: PartForces, mu: np.ndarray):
        """Weigh the products of fluxes (collective).

        Args:
            simplices: The owned cells.
            parts: The facets with forces.
            mu: Tension of each cell.
        """
        assert simplices.radius is not None
        radius, (points, weights) = simplices.radius, rule(2, 3)
        per_edge = reciprocals((sums(radius)[:, None] - radius) / 2)
        weights = weights * polynomials.combined(points[None], radius)
        arms = [points @ simplices.x - simplices.x[:, k, None] for k in range(3)]
        # int mu^(-1) tau_i . tau_j of the fluxes tau_i with r tau_i flowing 1 out opposite to vertex i
        self._of_fluxes = np.empty((3, 3, len(radius)))
        for i in range(3):
            for j in range(i + 1):
                found = integrals(np.einsum("cpx,cpx->cp", arms[i], arms[j]), weights)
                self._of_fluxes[i, j] = self._of_fluxes[j, i] = found * per_edge[:, i] * per_edge[:, j]
        self._of_fluxes /= 4 * simplices.area * mu
        self._radius = radius
        super().__init__(simplices, parts, lambda vectors: vectors / mu)

    def _weigh(self, simplices: Simplices) -> np.ndarray:
        """See `PatchFlux._weigh`."""
        return self._of_fluxes

    def _target(self, beta: np.ndarray, a: int, k: int) -> np.ndarray:
        """See `PatchFlux._target`: the shares that the ends of an edge have."""
        return beta[:, k] * (1 + (self._radius[:, a] - self._radius[:, k]) / sums(self._radius))

"""The error bound for P2 with contact at midpoints of edges.

The multiplier lambda, linear in each cell, may be negative near the free boundary. lambda_+ >= 0 has the same cell
means and smaller slopes; the difference is bounded like the oscillation of the load. The admissible v is u_h raised to
the obstacle on a lattice in each cell (`lattice_obstacle`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.estimation.element import Element, Terms
from fenicsx_obstacle.estimation.flux_p2 import EquilibrationP2, FluxP2
from fenicsx_obstacle.estimation.lattice_obstacle import LatticeObstacle
from fenicsx_obstacle.estimation.rt1 import GRAMS, MASS, metric, reference_fields
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.estimation.triangle_lattice import MEANS, NODES, POINTS, PRODUCTS, SLOPES, SMALL
from fenicsx_obstacle.mesh.around_nodes import AroundNodes, with_ghosts


class ElementP2(Element):
    """P2 on one mesh: what depends on mesh and data alone is made once."""

    equilibration: EquilibrationP2
    obstacles: list[LatticeObstacle]
    has_samples = True

    def __init__(self, problem: Problem):
        """Sample the data, sort the corners around the vertices (collective)."""
        assert problem.level.coarse is not None
        simplices = Simplices(problem.data.on(problem.level.coarse))
        equilibration = EquilibrationP2(simplices, problem.data)
        super().__init__(equilibration, problem.data.fixed[1].x.array[equilibration.nodes[:, 3:]])
        self.problem = problem
        self.obstacles = [LatticeObstacle(simplices, self.dirichlet, *obstacle) for obstacle in self.given_obstacles]
        self._metric = metric(simplices.x[:, 1] - simplices.x[:, 0], simplices.x[:, 2] - simplices.x[:, 0],
                              simplices.area, np.ones(len(simplices.area)))  # fmt: skip

    def terms(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> Terms:
        """See `Element.terms` (collective)."""
        equilibration, area = self.equilibration, self.simplices.area
        gaps = {side.sign: self._gap(u, side) for side in self.obstacles}
        flux = equilibration.flux(u, touches_lower, touches_upper, (gaps.get(1.0), gaps.get(-1.0)))
        added, contact, reduced, crossing = self._lifted(u[equilibration.nodes], flux)
        lifted = np.flatnonzero(added.any(axis=1))
        slopes = (added[lifted] @ SLOPES.reshape(-1, len(POINTS)).T).reshape(-1, len(SMALL), 2)
        moved, product = np.zeros(len(area)), np.zeros(len(area))
        moved[lifted] = self._energy_on_lattice(slopes, lifted)
        difference = flux.moments - equilibration.membrane(u)
        means = (difference[lifted] @ MEANS.reshape(-1, 8).T).reshape(slopes.shape)
        product[lifted] = np.einsum("csx,csx->c", slopes, means) / (2 * len(SMALL))
        distance = self._distance(u, flux, difference)
        of_v = np.where(self.tension.varies, (np.sqrt(distance) + np.sqrt(moved)) ** 2, distance - 2 * product + moved)
        v = u.copy()
        v[equilibration.nodes] += added[:, NODES]
        rest = area * np.einsum("cj,cj->c", flux.rest @ MASS, flux.rest)
        none = np.zeros(len(area))
        cover = sum((side.cover_energy for side in self.obstacles), none)
        oscillation = (self.oscillation.norm + self.oscillation.poincare * reduced) / np.sqrt(self.tension.least)
        return Terms(
            flux=flux, distance=distance, balanced=(np.sqrt(distance) + oscillation) ** 2,
            admissible_balanced=(np.sqrt(np.maximum(of_v, 0.0)) + oscillation) ** 2,
            oscillation=oscillation, contact=contact,
            moved=moved, cover=self.tension.most * cover, raised=none, penetration=self._energy(self._penetration()),
            rest=rest, solver_rest=rest, energy=self._least_energy(u), admissible=v, crossing=crossing,
            lacking=none,
        )  # fmt: skip

    def _gap(self, u: np.ndarray, side: LatticeObstacle) -> np.ndarray:
        """Mean of the distances of u to an obstacle at the nodes of each cell."""
        return np.maximum(side.sign * (u - side.heights(self.problem.data)), 0.0)[self.equilibration.nodes].mean(axis=1)

    def _lifted(self, nodal: np.ndarray, flux: FluxP2) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """The function on the lattice that is added to u so that it is above the obstacles, and lambda_+, (E18)
        (collective).

        Args:
            nodal: Values of u at the nodes of cells.
            flux: With the multipliers.

        Returns:
            The function; int lambda_+ (v - obstacle); ||lambda - lambda_+||_T; and by how much an obstacle may be
            beyond v, but at the boundary.
        """
        area, count = self.simplices.area, len(self.simplices.area)
        added, contact, reduced = np.zeros((count, len(POINTS))), np.zeros(count), np.zeros(count)
        largest_of, moved = [], None
        for side in self.obstacles:
            pressure = flux.lower if side.sign > 0 else flux.upper
            mean = pressure.mean(axis=1)
            at_vertices = pressure.sum(axis=1)[:, None] - 2 * pressure
            least = at_vertices.min(axis=1)
            kept = np.where(least < 0, mean / np.maximum(mean - least, 1e-300), 1.0)
            reduced += (1 - kept) * np.sqrt(area / 3 * ((pressure - mean[:, None]) ** 2).sum(axis=1))
            at_nodes = side.heights(self.problem.data)[self.equilibration.nodes] if self.sampled else None
            positive = np.maximum(mean[:, None] + kept[:, None] * (at_vertices - mean[:, None]), 0.0)
            largest_of.append(positive.max(axis=1, initial=0.0))
            cells, gap, raised, between = side.above(nodal, added, positive, at_nodes)
            lift, moved = np.maximum(raised, 0.0), np.zeros(count, dtype=bool)
            added[cells] += side.sign * lift
            moved[cells] = lift.any(axis=1)
            weight = np.maximum(positive[cells] @ POINTS.T, 0.0)
            # int lambda_+ (v - obstacle), v - obstacle is linear on the small triangles up to `between`
            products = np.einsum("cp,cp->c", weight @ PRODUCTS, gap + lift)
            products += between
            contact[cells] += area[cells] / len(SMALL) * np.where(weight.any(axis=1), products, 0.0)
        beyond = []
        for side, multiplier in zip(self.obstacles, largest_of, strict=True):
            # the last obstacle has moved the state away from the first
            later = None if self.sampled or side is self.obstacles[-1] else moved
            beyond.append(side.beyond(nodal, added, later))
            contact += multiplier * side.cover_volume
        return added, contact, reduced, self.crossing(beyond, nodal)

    def _energy_on_lattice(self, slopes: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad||_T^2, mu being the largest tension, from derivatives along the reference axes."""
        area = self.simplices.area[cells]
        g = self._metric[:, cells] * 2 * area  # J^T J / det J, times det J
        squares = (g[2] * (slopes[..., 0] ** 2).sum(1) - 2 * g[1] * (slopes[..., 0] * slopes[..., 1]).sum(1)
                   + g[0] * (slopes[..., 1] ** 2).sum(1)) / (2 * area) ** 2  # fmt: skip
        return self.tension.most[cells] * squares * area / len(SMALL)

    def _distance(self, u: np.ndarray, flux: FluxP2, difference: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad u_h - mu^(-1/2) sigma||_T^2, from the moments of the difference with the mean tension."""
        simplices, mu = self.simplices, self.equilibration.mu
        slopes_at = self._slopes_of(u)
        products = (np.einsum("ci,ci->c", difference @ gram, difference) for gram in GRAMS)
        squares = reduce(np.add, (along * product for along, product in zip(self._metric, products, strict=True))) / mu

        def fields(cells: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            x = simplices.x[cells]
            J = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=2)
            basis = reference_fields(points.reshape(-1, 3)).reshape(8, *points.shape[:2], 2)
            reference = np.einsum("icpx,ci->cpx", np.broadcast_to(basis, (8, len(cells), *basis.shape[2:])),
                                  flux.moments[cells])  # fmt: skip
            sigma = np.einsum("cyx,cpx->cpy", J, reference) / (2 * simplices.area[cells])[:, None, None]
            return slopes_at(cells, points), sigma

        self.tension.integrate_distances(squares, fields, degree=2)
        return squares

    def _slopes_of(self, u: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """grad u at barycentric points, shape (cells or 1, points, 3), of cells."""
        gradient = self.equilibration.gradients(u)
        return lambda cells, points: np.matmul(points, np.moveaxis(gradient[:, cells], 0, 2))

    def _energy(self, e: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad e||_T^2 with the mean tension."""
        gradient = self.equilibration.gradients(e)
        products = np.einsum("xcj,xcj->c", gradient @ MASS, gradient)
        return self.equilibration.mu * self.simplices.area * products

    def _least_energy(self, u: np.ndarray) -> np.ndarray:
        """A lower bound of ||mu^(1/2) grad u||_T^2."""
        squares = self._energy(u)
        self.tension.least_energy(squares, self._slopes_of(u))
        return squares

    def _penetration(self) -> np.ndarray:
        """Penetration at the midpoints of edges, at vertices the mean of those around: the part that a smaller eps
        reduces."""
        gaps, equilibration = self.problem.gaps(), self.equilibration
        below, above = (np.maximum(-np.where(np.isfinite(gap), gap, 0.0), 0.0) for gap in gaps)
        beyond = with_ghosts(self.problem.level.V, below - above)
        middles = beyond[equilibration.nodes[:, 3:]]
        around = AroundNodes(self.problem.level.V, equilibration.nodes[:, :3])
        sums = around.sums((middles.sum(axis=1, keepdims=True) - middles) / 2)
        counts = around.sums(np.ones(middles.shape))
        found = np.where(counts > 0, sums / np.maximum(counts, 1.0), beyond)
        found[self.problem.data.fixed[0]] = 0.0
        return found

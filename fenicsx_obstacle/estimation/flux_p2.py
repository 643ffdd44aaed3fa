"""Multipliers and equilibrated flux of a P2 solution with contact at midpoints of edges.

The multiplier is the Crouzeix-Raviart function lambda with nodal values at these middles, so that int lambda psi_a is
what the rule makes of it for every hat psi_a: patches of free vertices are compatible but for rho_a, the force that is
out of balance. The flux is in RT1, again a sum over vertices,

    div sigma = -(Pi_1 f + lambda + rho)   in each cell, rho = sum of rho_a psi_a,

of fluxes on the patches that are nearest to the broken RT1 interpolant of psi_a mu grad u_h.
Divergence and normal parts leave few unknowns: what goes round the vertex, and a first moment on each edge from it; the
moments inside follow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.estimation.cell_data import Load, of_solver, tension_of
from fenicsx_obstacle.estimation.multipliers import Multipliers, pushes
from fenicsx_obstacle.estimation.patch_systems import PatchSystems
from fenicsx_obstacle.estimation.patches import Patches
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.rt1 import FORMS, MASS, MIDDLES, PULLS, against_nodes, metric
from fenicsx_obstacle.estimation.simplices import Simplices, next_, previous
from fenicsx_obstacle.mesh.around_nodes import AroundNodes, with_ghosts


@dataclass(frozen=True)
class FluxP2:
    """Multipliers and flux; arrays over owned cells, counter-clockwise.

    Attributes:
        lower: lambda at the middles of the edges opposite to each vertex, shape (cells, 3).
        upper: nu there, of the upper obstacle, shape (cells, 3).
        rest: rho at the vertices, shape (cells, 3).
        moments: Of sigma, shape (cells, 8).
        normal: Fluxes out of the edges, shape (cells, 3).
    """

    lower: np.ndarray
    upper: np.ndarray
    rest: np.ndarray
    moments: np.ndarray
    normal: np.ndarray


class EquilibrationP2:
    """Equilibrated flux and multipliers; parts that depend on mesh and data only are computed once.

    Attributes:
        simplices: The owned cells, with the dofs of P1.
        patches: Their corners around the vertices.
        apart: Of the patches.
        nodes: Local dofs of P2 at the vertices of each cell and at the middles opposite to them, shape (cells, 6).
        mu: Mean tension of each cell, as the solver has it.
        load: Its moments are int f psi_j psi_k, shape (cells, 3, 3), its oscillation ||f - Pi_1 f||_T.
        missing: Force at owned nodes that the load gives more than what the solver makes of it.
    """

    def __init__(self, simplices: Simplices, data: Data):
        """Sample the load, sort the corners (collective).

        Args:
            simplices: Of P1 on the same mesh.
            data: Of P2.
        """
        self.simplices, self.level = simplices, data.level
        self.nodes = simplices.turned_nodes(releases.cell_dofs(self.level.V)[: len(simplices.area)])
        self._sample_tension(data)
        self.load = Load(simplices, data, tests=lambda points: points[:, :, None] * points[:, None])
        around = AroundNodes(self.level.V, self.nodes)
        self.missing = around.sums(against_nodes(self.load.missing))[: self.level.owned]
        self.patches = Patches(simplices)
        self.apart = self.patches.apart
        self._middles = AroundNodes(self.level.V, self.nodes[:, 3:])
        given = np.zeros(len(data.fixed[1].x.array), dtype=bool)
        given[data.fixed[0]] = True
        self._multipliers = Multipliers(self._middles, simplices.area, self.mu, given, 1)
        self._mass = simplices.around.sums(self._multipliers.share)
        self._prepare_patches()

    def _sample_tension(self, data: Data) -> None:
        """The mean of mu, and int mu psi_j psi_k."""
        points, weights = rule(2)
        tension = tension_of(data)
        assert tension is not None  # by `check_bound_exists`
        mu = of_solver(self.simplices, data, tension, points, positive=True)
        mu = np.broadcast_to(mu, (len(mu), len(points)))
        self.mu = mu @ weights
        products = np.einsum("pj,pk->pjk", points, points)
        self._mu_products = self.simplices.area[:, None, None] * np.einsum("cp,p,pjk->cjk", mu, weights, products)

    def _prepare_patches(self) -> None:
        """Metric of each corner, and the systems of the patches (collective)."""
        simplices, patches, x = self.simplices, self.patches, self.simplices.x
        self._metrics = [
            metric(x[:, (i + 1) % 3] - x[:, i], x[:, (i + 2) % 3] - x[:, i], simplices.area, self.mu) for i in range(3)
        ]
        form = np.stack([np.einsum("kc,kuv->cuv", one, FORMS) for one in self._metrics], axis=1)
        entries = {(u, v): patches.gather(form[:, :, u, v])[0] for u in range(3) for v in range(u, 3)}
        self._of_first = np.stack([entries[0, u] for u in range(3)])
        # the circulation around the vertex, and the moments on the edges through which it enters and leaves
        edges, patch = patches.facets(simplices)
        around = np.arange(len(patches.vertex))
        numbers = np.column_stack([patches.patch, len(around) + edges[:, 1], len(around) + edges[:, 0]])
        zero = np.zeros(len(around) + len(patch), dtype=bool)
        zero[patches.patch[patches.free_boundary.any(axis=1)]] = True
        zero[len(around) + edges[patches.free_boundary]] = True
        products = ((u, v, values) for (u, v), values in entries.items())
        self._systems = PatchSystems(numbers, np.concatenate([around, patch]), zero, products)

    def flux(
        self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray,
        gaps: tuple[np.ndarray | None, np.ndarray | None] = (None, None),
    ) -> FluxP2:  # fmt: skip
        """Multipliers and flux of a state (collective).

        Args:
            u: Values at local nodes of P2.
            touches_lower: Whether u is at the lower obstacle or beyond it, at owned nodes.
            touches_upper: Whether it is at the upper one or beyond it.
            gaps: Mean distance to the lower obstacle in each cell, and to the upper one.
        """
        simplices, patches = self.simplices, self.patches
        area, gradient = simplices.area, self.gradients(u)
        slopes = np.einsum("xck,xca->cak", gradient, simplices.normal) / (2 * area)[:, None, None]  # grad psi_a at k
        K = slopes @ self._mu_products  # int mu grad u . grad psi_a psi_j
        touches = [with_ghosts(self.level.V, owned) > 0.5 for owned in (touches_lower, touches_upper)]
        lower, upper = (
            self._multipliers.in_cells(values, there, gap)
            for values, there, gap in zip(pushes(self._residual(K), *touches), touches, gaps, strict=True)
        )
        inside = self.load.moments + area[:, None, None] * np.einsum("cm,mjk->cjk", lower - upper, MIDDLES)
        drops = (inside - K).sum(axis=2)
        rest = np.where(simplices.given, 0.0, -simplices.around.sums(drops) / self._mass)[simplices.dofs]
        inside = inside + rest[:, :, None] * (area[:, None, None] * MASS)
        drops = (inside - K).sum(axis=2)
        R = K - inside  # int div sigma^a psi_j
        pulls = self._pulls(gradient, K, R, drops)
        drops, *pulls = patches.gather(drops, *pulls)
        fluxes = patches.trees.walk(drops)
        before, after = -fluxes[:, 1], fluxes[:, 0]
        round_, entering, leaving = self._systems.solve(-np.array(pulls) - self._of_first * before)
        parts = patches.scatter(before + round_, after + round_, entering, leaving)
        return FluxP2(lower, upper, rest, *self._joined(R, *parts))

    def gradients(self, u: np.ndarray) -> np.ndarray:
        """grad u_h at the vertices of each cell, shape (2, cells, 3)."""
        values, normal = u[self.nodes], self.simplices.normal
        found = np.einsum("cj,xcj->xc", -values[:, :3], normal)[:, :, None].repeat(3, axis=2)
        # phi_j = psi_j (2 psi_j - 1): slope 3 at its vertex, -1 elsewhere; of a middle 4 psi at the two ends
        found = found + 4 * values[None, :, :3] * normal
        middle = values[:, 3:]
        for k in range(3):
            j, m = (k + 1) % 3, (k + 2) % 3
            found[:, :, k] += 4 * (middle[:, m] * normal[:, :, j] + middle[:, j] * normal[:, :, m])
        return found / (2 * self.simplices.area)[None, :, None]

    def _residual(self, K: np.ndarray) -> np.ndarray:
        """The residual at middles where u is not given, as a multiplier, at local nodes (collective)."""
        j, k = [1, 2, 0], [2, 0, 1]
        forces = 4 * (K[:, j, k] + K[:, k, j] - self.load.moments[:, j, k])
        return np.where(self._multipliers.given, 0.0, self._middles.sums(forces) / self._multipliers.weights)

    def _pulls(self, gradient: np.ndarray, K: np.ndarray, R: np.ndarray, drops: np.ndarray) -> list[np.ndarray]:
        """Products of the difference of each corner's flux and its target with the function of each unknown."""
        normal, mu = self.simplices.normal, self.mu
        found = []
        for i in range(3):
            b, c = (i + 1) % 3, (i + 2) % 3
            target = []
            for other, opposite in ((b, c), (c, b)):
                ends = [-mu * (gradient[0, :, k] * normal[0, :, opposite] + gradient[1, :, k] * normal[1, :, opposite])
                        for k in (i, other)]  # fmt: skip
                target += [ends[0] / 3 + ends[1] / 6, -ends[0] / 6]
            target += [K[:, b, i], K[:, c, i]]
            out = -drops[:, i]
            zero = np.zeros_like(out)
            given = [zero, zero, out, zero, -R[:, i, b], out / 2 - R[:, i, c]]
            e = np.stack([one - other for one, other in zip(given, target, strict=True)])
            found.append(np.einsum("kc,kuj,jc->uc", self._metrics[i], PULLS, e))
        stacked = np.stack(found, axis=2)  # unknowns, cells, corners
        return [stacked[k] for k in range(3)]

    def _joined(
        self, R: np.ndarray, before: np.ndarray, after: np.ndarray, entering: np.ndarray, leaving: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The moments of the sum of all corners' fluxes in each cell, and the fluxes out of its edges."""
        # edge i is a-b of the corner before its start i + 1, and a-c of the one at its end i + 2
        F = -next_(before) + previous(after)
        G = -next_(entering) - previous(leaving)
        inside = np.zeros((len(R), 3))
        for i in range(3):
            b, c = (i + 1) % 3, (i + 2) % 3
            along_b = (-before[:, i] - entering[:, i]) / 2 - R[:, i, b]
            along_c = (after[:, i] + leaving[:, i]) / 2 - R[:, i, c]
            inside[:, b] += along_b
            inside[:, c] += along_c
            inside[:, i] -= along_b + along_c
        moments = np.stack([F[:, 0], G[:, 0], F[:, 1], G[:, 1], F[:, 2], G[:, 2], inside[:, 1], inside[:, 2]], axis=1)
        return moments, F

    def membrane(self, u: np.ndarray) -> np.ndarray:
        """The moments of mu grad u_h with the mean tension, shape (cells, 8)."""
        gradient, normal, mu = self.gradients(u), self.simplices.normal, self.mu
        found = np.empty((len(mu), 8))
        for i in range(3):
            ends = [-mu * (gradient[0, :, k] * normal[0, :, i] + gradient[1, :, k] * normal[1, :, i])
                    for k in ((i + 1) % 3, (i + 2) % 3)]  # fmt: skip
            found[:, 2 * i], found[:, 2 * i + 1] = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 6
        mean = gradient.mean(axis=2) * mu / 2
        for k in (1, 2):
            found[:, 5 + k] = mean[0] * normal[0, :, k] + mean[1] * normal[1, :, k]
        return found

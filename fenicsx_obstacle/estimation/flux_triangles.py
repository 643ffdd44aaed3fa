"""Equilibrated P1 fluxes on vertex patches of triangles: running sums around the vertex, plus one free number."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.estimation.simplices import Simplices, integrals, next_, previous, reciprocals, sums
from fenicsx_obstacle.estimation.vertex_patches import VertexPatches


class TriangleEquilibration(EquilibrationP1):
    """Flux and multipliers on triangles."""

    patches: VertexPatches

    def __init__(self, simplices: Simplices, of_state: np.ndarray | None = None):
        """Sort the corners (collective); the arguments are those of `EquilibrationP1`."""
        super().__init__(simplices, VertexPatches(simplices), of_state)
        self._A, self._B, G = (np.empty(simplices.dofs.shape) for _ in range(3))
        for block in blocks(len(G)):
            # the edge opposite to a vertex, and from each vertex to the middle of the cell
            scale = 1 / (4 * simplices.area[block])[:, None]
            normal, middle, x = simplices.normal[:, block], simplices.middle[block], simplices.x[block]
            to_x, to_y = (middle[:, k : k + 1] - x[..., k] for k in range(2))
            edge = np.stack([normal[1], -normal[0]])
            edge_x, edge_y = self.weighted(edge, block) * scale
            self._A[block] = edge_x * next_(to_x) + edge_y * next_(to_y)
            self._B[block] = edge_x * previous(to_x) + edge_y * previous(to_y)
            G[block] = edge[0] * edge_x + edge[1] * edge_y
        self._factors: tuple[np.ndarray, np.ndarray] | None = None
        if simplices.radius is not None:
            G[:] = self._with_weight(simplices.radius)
        self._patch_A, self._patch_B = self.patches.gather(self._A, self._B)
        self._patch_G = self.patches.sums(self.patches.gather(G)[0])

    def _with_weight(self, radius: np.ndarray) -> np.ndarray:
        """The products with the weight of integrals, for fluxes as `ElementP1.weighted_flux` has them; and the shares
        that the ends of an edge have of the flux of a target.

        Args:
            radius: The weight at the vertices.

        Returns:
            The product of the difference of both functions with itself.
        """
        simplices, (points, weights) = self.simplices, rule(2, 3)
        per_edge = reciprocals((next_(radius) + previous(radius)) / 2)
        weights = simplices.weights(weights, points[None])
        arms = [points @ simplices.x - simplices.x[:, k, None] for k in range(3)]
        products = np.empty((3, 3, len(radius)))
        for i in range(3):
            for j in range(i + 1):
                found = integrals(np.einsum("cpx,cpx->cp", arms[i], arms[j]), weights)
                products[i, j] = products[j, i] = found * per_edge[:, i] * per_edge[:, j]
        products /= 4 * simplices.area * self.mu
        for i, (b, c) in enumerate(((1, 2), (2, 0), (0, 1))):
            self._A[:, i] = products[b, b] - products[b, c]
            self._B[:, i] = products[b, c] - products[c, c]
        mean = sums(radius)[:, None]
        self._factors = (2 * radius + previous(radius)) / mean, (2 * radius + next_(radius)) / mean
        return self._A - self._B

    def _on_patches(self, drops: np.ndarray, beta: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, float]:
        """See `EquilibrationP1._on_patches` (collective)."""
        patches, parts = self.patches, self.parts
        (rest,) = patches.gather(self._targets(beta, force))
        before, after = patches.walk(drops)
        left_over = patches.left_over(after)
        for block in blocks(len(rest)):
            rest[block] += before[block] * self._patch_B[block]
            rest[block] -= after[block] * self._patch_A[block]
        shift = patches.sums(rest) / self._patch_G
        # nothing leaves through the free boundary
        open_ = ~patches.closed
        shift[open_ & ~patches.exit_held] = -after[patches.last[open_ & ~patches.exit_held]]
        shift[open_ & ~patches.entry_held] = 0.0
        for step in patches.steps:
            after[step] += shift[: step.stop - step.start]
            before[step] += shift[: step.stop - step.start]
        del rest
        to_b, to_c = patches.scatter(after, before)
        for block in blocks(len(to_b)):
            to_b[block] = previous(to_b[block]) - next_(to_c[block])
        np.add.at(to_b, (parts.cells, parts.sides), force.sum(axis=1))
        return to_b, left_over

    def _targets(self, beta: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Products of the targets with the fluxes around a vertex, at the corners of cells (local)."""
        parts, targets = self.parts, np.empty(beta.shape)
        for block in blocks(len(beta)):
            to_b, to_c = next_(beta[block]), previous(beta[block])
            if self._factors is not None:
                to_b, to_c = to_b * self._factors[0][block], to_c * self._factors[1][block]
            targets[block] = to_b * self._A[block]
            targets[block] += to_c * self._B[block]
        rows = np.arange(len(parts.cells))
        for step, weight in ((2, self._A), (1, self._B)):  # a side is opposite to the vertex after, or before
            corner = (parts.sides + step) % 3
            np.subtract.at(targets, (parts.cells, corner), force[rows, corner] * weight[parts.cells, corner])
        return targets

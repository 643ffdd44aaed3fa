"""Equilibrated P1 fluxes on vertex patches of triangles: running sums around the vertex, plus one free number."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1
from fenicsx_obstacle.estimation.quadrature import blocks
from fenicsx_obstacle.estimation.simplices import Simplices, next_, previous
from fenicsx_obstacle.estimation.vertex_patches import VertexPatches


class TriangleEquilibration(EquilibrationP1):
    """Flux and multipliers on triangles."""

    patches: VertexPatches

    def __init__(self, simplices: Simplices):
        """Sort the corners (collective)."""
        super().__init__(simplices, VertexPatches(simplices))
        self._A, self._B, G = (np.empty(simplices.dofs.shape) for _ in range(3))
        for block in blocks(len(G)):
            # the edge opposite to a vertex, and from each vertex to the middle of the cell
            scale = 1 / (4 * simplices.area[block] * self.mu[block])[:, None]
            normal, middle, x = simplices.normal[:, block], simplices.middle[block], simplices.x[block]
            to_x, to_y = (middle[:, k : k + 1] - x[..., k] for k in range(2))
            edge_x, edge_y = normal[1] * scale, -normal[0] * scale
            self._A[block] = edge_x * next_(to_x) + edge_y * next_(to_y)
            self._B[block] = edge_x * previous(to_x) + edge_y * previous(to_y)
            G[block] = scale * (normal[0] ** 2 + normal[1] ** 2)
        self._patch_A, self._patch_B, patch_G = self.patches.gather(self._A, self._B, G)
        self._patch_G = self.patches.sums(patch_G)

    def _on_patches(self, drops: np.ndarray, beta: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, float]:
        """See `EquilibrationP1._on_patches` (collective)."""
        patches, parts = self.patches, self.parts
        targets = next_(beta)
        targets *= self._A
        targets += previous(beta) * self._B
        rows = np.arange(len(parts.cells))
        for step, weight in ((2, self._A), (1, self._B)):  # a side is opposite to the vertex after, or before
            corner = (parts.sides + step) % 3
            np.subtract.at(targets, (parts.cells, corner), force[rows, corner] * weight[parts.cells, corner])
        (rest,) = patches.gather(targets)
        before, after = patches.walk(drops)
        left_over = patches.left_over(after)
        rest += before * self._patch_B
        rest -= after * self._patch_A
        shift = patches.sums(rest) / self._patch_G
        # nothing leaves through the free boundary
        open_ = ~patches.closed
        shift[open_ & ~patches.exit_held] = -after[patches.last[open_ & ~patches.exit_held]]
        shift[open_ & ~patches.entry_held] = 0.0
        shift = patches.along(shift)
        after += shift
        before += shift
        to_b, to_c = patches.scatter(after, before)
        found = previous(to_b)
        found -= next_(to_c)
        np.add.at(found, (parts.cells, parts.sides), force.sum(axis=1))
        return found, left_over

"""Fluxes of P1 on the patches of triangles: fans, around which they are known up to a number."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1
from fenicsx_obstacle.estimation.simplices import Simplices, next_, previous
from fenicsx_obstacle.estimation.vertex_patches import VertexPatches


class FanEquilibration(EquilibrationP1):
    """Flux and multipliers on triangles."""

    patches: VertexPatches

    def __init__(self, simplices: Simplices):
        """Sort the corners (collective)."""
        super().__init__(simplices, VertexPatches(simplices))
        x, y = simplices.x[..., 0], simplices.x[..., 1]
        scale = 1 / (4 * simplices.area * self.mu)[:, None]
        # the edge opposite to a vertex, and from each vertex to the middle of the cell
        to_x, to_y = x.mean(axis=1, keepdims=True) - x, y.mean(axis=1, keepdims=True) - y
        edge_x, edge_y = simplices.normal[1] * scale, -simplices.normal[0] * scale
        self._A = edge_x * next_(to_x) + edge_y * next_(to_y)
        self._B = edge_x * previous(to_x) + edge_y * previous(to_y)
        G = scale * (simplices.normal[0] ** 2 + simplices.normal[1] ** 2)
        self._fan_A, self._fan_B, fan_G = self.patches.gather(self._A, self._B, G)
        self._fan_G = self.patches.sums(fan_G)

    def _on_patches(self, drops: np.ndarray, beta: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, float]:
        """See `EquilibrationP1._on_patches` (collective)."""
        patches, parts = self.patches, self.parts
        targets, rows = next_(beta) * self._A + previous(beta) * self._B, np.arange(len(parts.cells))
        for step, weight in ((2, self._A), (1, self._B)):  # a side is opposite to the vertex after, or before
            corner = (parts.sides + step) % 3
            np.subtract.at(targets, (parts.cells, corner), force[rows, corner] * weight[parts.cells, corner])
        correction = patches.gather(targets)[0]
        before, after = patches.walk(drops)
        shift = -(patches.sums(after * self._fan_A - before * self._fan_B - correction)) / self._fan_G
        # nothing leaves through the free boundary
        open_ = ~patches.closed
        shift[open_ & ~patches.exit_held] = -after[patches.last[open_ & ~patches.exit_held]]
        shift[open_ & ~patches.entry_held] = 0.0
        shift = patches.along(shift)
        to_b, to_c = patches.scatter(after + shift, before + shift)
        normal = previous(to_b) - next_(to_c)
        np.add.at(normal, (parts.cells, parts.sides), force.sum(axis=1))
        return normal, patches.left_over(after)

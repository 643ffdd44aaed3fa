"""Equilibrated P1 fluxes on vertex patches of triangles: running sums around the vertex, plus one free number."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1
from fenicsx_obstacle.estimation.simplices import Simplices, next_, previous
from fenicsx_obstacle.estimation.vertex_patches import VertexPatches


class TriangleEquilibration(EquilibrationP1):
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
        self._patch_A, self._patch_B, patch_G = self.patches.gather(self._A, self._B, G)
        self._patch_G = self.patches.sums(patch_G)

    def _on_patches(self, drops: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, float]:
        """See `EquilibrationP1._on_patches` (collective)."""
        patches = self.patches
        correction = patches.gather(next_(beta) * self._A + previous(beta) * self._B)[0]
        before, after = patches.walk(drops)
        shift = -(patches.sums(after * self._patch_A - before * self._patch_B - correction)) / self._patch_G
        # nothing leaves through the free boundary
        open_ = ~patches.closed
        shift[open_ & ~patches.exit_held] = -after[patches.last[open_ & ~patches.exit_held]]
        shift[open_ & ~patches.entry_held] = 0.0
        shift = patches.along(shift)
        to_b, to_c = patches.scatter(after + shift, before + shift)
        return previous(to_b) - next_(to_c), patches.left_over(after)

"""Contact forces at nodes, and the multipliers in the cells around them that have these forces.

Of the force at a node only its sum over the cells around it is needed. Where the obstacle falls off steeply the force
is put into those of the cells in which u is near it: the error bound has force times distance.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.parallel import total

NEAR = 0.5  # of force/tension: a larger distance costs more than what moving the force to other cells does to the flux


def pushes(residual: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """lambda and nu: what of a residual pushes away from an obstacle that is touched, the lower and the upper one."""
    lower = np.where(touches_lower, np.maximum(residual, 0.0), 0.0)
    return lower, np.where(touches_upper, np.maximum(-residual, 0.0), 0.0)


class Multipliers:
    """Nodes with contact forces; arrays of nodes have values at local dofs.

    Attributes:
        share: Of the area, each node's in its cells, shape (cells, n).
        weights: Its sum over the cells around each node, 1 at other dofs.
        given: Whether u is given.
    """

    def __init__(
        self,
        around: AroundNodes,
        area: np.ndarray,
        tension: np.ndarray,
        given: np.ndarray,
        sweeps: int,
    ):
        """Weigh the nodes (collective).

        Args:
            around: The cells around the nodes.
            area: |T| of the owned cells.
            tension: In each, times the mean weight of integrals.
            given: Whether u is given at each local dof.
            sweeps: Along the boundary, to find a pressure where u is given and touches.
        """
        count = around.nodes.shape[1]
        self.given, self._around, self._sweeps = given, around, sweeps
        self.share = np.repeat(area[:, None] / count, count, axis=1)
        weights = around.sums(self.share)
        self.weights = np.where(weights > 0, weights, 1.0)
        self._softness = around.sums(self.share / tension[:, None])

    def in_cells(self, values: np.ndarray, touches: np.ndarray, gap: np.ndarray | None) -> np.ndarray:
        """Multipliers at the nodes of cells, shape (cells, n), with the same force at each node where u is not given,
        (E10) (collective).

        Args:
            values: Multipliers at the nodes, >= 0.
            touches: Whether u touches there.
            gap: Mean distance to the obstacle in each cell; None: it plays no part.
        """
        nodes = self._around.nodes
        values = self._along_the_boundary(values, touches)[nodes]
        if gap is None:
            return values
        own = np.broadcast_to(gap[:, None], nodes.shape)
        nearest = self._around.smallest(np.where(values > 0, own, np.inf))[nodes]
        near = own <= nearest + NEAR * values * self._softness[nodes]
        kept = self._around.sums(np.where(near, self.share, 0.0))[nodes]
        return np.where(near, values * self.weights[nodes] / np.maximum(kept, 1e-300), 0.0)

    def _along_the_boundary(self, values: np.ndarray, touches: np.ndarray) -> np.ndarray:
        """At contact nodes where u is given the mean of the cells' other nodes; any value >= 0 is admissible."""
        nodes, wanted = self._around.nodes, self.given & touches
        if total(self._around.V.mesh.comm, np.count_nonzero(wanted)) == 0:
            return values
        cells = np.maximum(self._around.sums(np.ones(nodes.shape)), 1.0)
        for _ in range(self._sweeps):
            corner = values[nodes]
            others = (corner.sum(axis=1, keepdims=True) - corner) / (nodes.shape[1] - 1)
            values = np.where(wanted, self._around.sums(others) / cells, values)
        return values

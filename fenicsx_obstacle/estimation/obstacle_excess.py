"""The excess of an obstacle over its nodal interpolant.

The largest excess in the cells at a node is added to the nodal value. Bernstein coefficients of polynomials that
approximate the obstacle bound the excess; cells are subdivided for this where the obstacle is not smooth. This is
done in cells in which u may touch the obstacle; elsewhere bounds of the obstacle are enough.
"""

from __future__ import annotations

from functools import reduce

import numpy as np

from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.boundary_data import BoundaryData
from fenicsx_obstacle.estimation.boundary_values import ROUND_OFF
from fenicsx_obstacle.estimation.cell_data import in_cells
from fenicsx_obstacle.estimation.covered_obstacle import CoveredObstacle, negligible
from fenicsx_obstacle.estimation.enclosed_data import Division
from fenicsx_obstacle.estimation.pieces import LOWEST, Pieces
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, total

# where u may touch; what counts is the distance to the nodal interpolant
SHARPER = (Division(0, 2e-3, degree=2), Division(4, 2e-3, 1e-3, 2))
BESIDE = 4  # how often cells beside the boundary are divided where the obstacle may be above the state


class ObstacleExcess(CoveredObstacle):
    """The excess of one obstacle over its nodal interpolant, times -1 for an upper obstacle.

    Attributes:
        nodal: sign times what it is compared with at local dofs, here its nodal values.
        floor: sign times its nodal values.
        least_height: Smaller heights above what it is compared with are not told apart.
        mean: A lower bound of the mean of the obstacle above its nodal interpolant in each cell, with the weight of
            integrals if they have one.
        divisions: Where u may touch, the second one in cells where the first leaves something rough.
    """

    divisions, least_height = SHARPER, 0.0

    def __init__(self, simplices: Simplices, dirichlet: BoundaryData, sign: float, field: Field, known: Pieces):
        """Compare it with its interpolant (collective); the arguments are those of `CoveredObstacle`."""
        super().__init__(simplices, dirichlet, sign, field, known)
        self.floor = self.nodal = sign * self.heights(simplices.data)
        self._size = 0.0  # of the state
        self._flat = self._field.uniform
        self._compare(known)

    def _compare(self, known: Pieces) -> None:
        """Heights and means from bounds alone (local)."""
        sign, simplices = self.sign, self.simplices
        low, high = _least(self.nodal, simplices.dofs), -_least(-self.nodal, simplices.dofs)
        bottom = known.lower if sign > 0 else -known.upper
        self.mean, self._height = np.maximum(bottom - high, LOWEST), np.maximum(self._top - low, self.least_height)
        # how many of `divisions` are done in each cell
        self._done = np.full(len(simplices.area), len(self.divisions) if self._flat else 0)

    def _take(self, cells: np.ndarray, pieces: Pieces) -> None:
        """Heights and means in some cells; above the interpolant, and in all."""
        nodal, radius = self.nodal[self.simplices.dofs[cells]], self.simplices.radius
        self._height[cells] = np.maximum(
            pieces.highest_above(nodal, self.sign, ROUND_OFF * self._size), self.least_height
        )
        self.mean[cells] = pieces.mean_above(nodal, self.sign, None if radius is None else radius[cells])
        self._top[cells] = pieces.upper if self.sign > 0 else -pieces.lower

    def lift(self, u: np.ndarray) -> np.ndarray:
        """The state raised at nodes where it is not given, so that the obstacle is nowhere above it in cells without
        nodes where it is, (E13) (collective).

        Args:
            u: sign times the state at local dofs.
        """
        raised = np.where(self.simplices.given, u, np.maximum(u, self.floor))
        if self._flat:
            return raised
        # nowhere below the obstacle: its interpolant and its height above that, or its highest value everywhere
        dofs = self.simplices.dofs
        cells, needed = np.flatnonzero(self._near(u) & (self._height > 0)), np.zeros(dofs.shape)
        state = np.maximum(u, self.floor)[dofs[cells]]
        shifted, level = self.nodal[dofs[cells]] + self._height[cells, None], self._top[cells, None]
        to_shifted, to_level = np.maximum(shifted - state, 0.0), np.maximum(level - state, 0.0)
        cheaper = to_level.sum(axis=1, keepdims=True) < to_shifted.sum(axis=1, keepdims=True)
        needed[cells] = np.where(cheaper, to_level, to_shifted)
        return raised + np.where(self.simplices.given, 0.0, self.simplices.around.largest(needed))

    def beyond(self, v: np.ndarray) -> float:
        """By how much the obstacle may be above the final state, on any rank, but beside nodes where it is given
        (collective).

        There it is covered (`CoveredObstacle`), and elsewhere if it may be round-off.

        Args:
            v: sign times the state at local dofs.
        """
        dofs, comm = self.simplices.dofs, self.simplices.data.level.comm
        at_nodes = largest(comm, self.floor - v)
        rounded, limit = negligible(comm, v)
        if self._flat and not self.dirichlet.twice and at_nodes <= rounded:
            return at_nodes
        near, outside = self._near(v), self.dirichlet.leaves
        if not self._flat:
            outside = self.simplices.given[dofs].any(axis=1) | (self.dirichlet.deviation > 0)
        above = np.minimum(self._height - _least(v - self.nodal, dofs), self._top - _least(v, dofs))
        most = max(at_nodes, largest(comm, above[near & ~outside]))
        covered = outside | (above > rounded) if most <= limit else outside
        owner, count = np.flatnonzero(near & covered), dofs.shape[1]
        whole = np.broadcast_to(np.eye(count), (len(owner), count, count))
        unbounded = self._cover(owner, whole, v[dofs[owner]], BESIDE, size=self._size)
        self.sampled = self._of_samples or total(comm, int(unbounded)) > 0
        return most

    def _near(self, u: np.ndarray) -> np.ndarray:
        """Cells in which u may touch the obstacle, whose excess becomes known sharper there (collective)."""
        self._size = largest(self.simplices.data.level.comm, np.abs(u))
        for done, division in enumerate(self.divisions):
            near = self._may_touch(u)
            new = np.flatnonzero(near & (self._done == done))
            pieces = in_cells(self.simplices, self._field, division, new)
            self._take(new, pieces)
            self._done[new] = np.where(pieces.rough, done + 1, len(self.divisions))
        return near

    def _may_touch(self, u: np.ndarray) -> np.ndarray:
        """Whether u may touch the obstacle in each cell (local)."""
        dofs = self.simplices.dofs
        near = (
            _least(u - self.nodal, dofs) <= np.maximum(self._height, ROUND_OFF * self._size) + self.dirichlet.deviation
        )
        return near & (_least(u, dofs) <= self._top + self.dirichlet.deviation)


def _least(nodal: np.ndarray, dofs: np.ndarray) -> np.ndarray:
    """The least value at the vertices of each cell."""
    return reduce(np.minimum, (nodal[column] for column in dofs.T))

"""The excess of an obstacle over its nodal interpolant.

The largest excess in the cells at a node is added to the nodal value. Bernstein coefficients of polynomials that
approximate the obstacle bound the excess; cells are subdivided for this where the obstacle is not smooth. This is
done in cells in which u may touch the obstacle; elsewhere bounds of the obstacle are enough.
"""

from __future__ import annotations

from functools import reduce

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.boundary_values import ROUND_OFF, BoundaryValues
from fenicsx_obstacle.estimation.cell_data import in_cells
from fenicsx_obstacle.estimation.clipped import Clipped
from fenicsx_obstacle.estimation.piece_integrals import LOWEST, highest_above, mean_above
from fenicsx_obstacle.estimation.pieces import Division, Pieces, Range, pieces_of
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, total

# where u may touch; what counts is the distance to the nodal interpolant
SHARPER = (Division(0, 2e-3, degree=2), Division(4, 2e-3, 1e-3, 2))
BESIDE = 4  # how often cells beside the boundary are divided where the obstacle may be above the state,
FEW = 20_000  # while there are so few parts: on fine meshes they matter less


class ObstacleExcess:
    """The excess of one obstacle over its nodal interpolant, times -1 for an upper obstacle.

    Attributes:
        sign: 1 for a lower obstacle, -1 for an upper one.
        nodal: sign times its nodal values at local dofs.
        mean: A lower bound of the mean of the obstacle above its nodal interpolant in each cell, with the weight of
            integrals if they have one.
        cover_energy: ||grad||^2 in each cell of what is added to the state beside the boundary (see `beyond`).
        cover_volume: Its integral.
        cover_height: A bound of it.
        sampled: Whether the bound rests on samples of it, on any rank: no bounds of it are known; or it is above the
            state beside the boundary and may jump.
        unbounded: Whether it may be infinite in each cell, on the side of the state.
    """

    def __init__(
        self,
        simplices: Simplices,
        dirichlet: BoundaryValues,
        sign: float,
        field: Field,
        known: Range,
    ):
        """Compare it with its interpolant (collective).

        Args:
            simplices: The cells.
            dirichlet: Boundary values between the nodes.
            sign: See the attributes.
            field: The obstacle.
            known: Bounds of it in the cells.
        """
        data = simplices.data
        self.simplices, self.dirichlet, self.sign, self._field = simplices, dirichlet, sign, field
        heights = data.heights(sign)
        self.nodal = sign * (field.clip(heights) if isinstance(field, Clipped) else heights)
        comm, cells = data.level.comm, len(simplices.area)
        self._size = 0.0  # of the state
        self._flat = self._field.uniform
        low, high = _least(self.nodal, simplices.dofs), -_least(-self.nodal, simplices.dofs)
        bottom, top = (known.lower, known.upper.copy()) if sign > 0 else (-known.upper, -known.lower)
        self._top = top
        self.unbounded = ~np.isfinite(self._top)
        self.mean, self._height = np.maximum(bottom - high, LOWEST), np.maximum(self._top - low, 0.0)
        # how many of SHARPER are done in each cell
        self._done = np.full(cells, len(SHARPER) if self._flat else 0)
        self.cover_energy, self.cover_volume, self.cover_height = (np.zeros(cells) for _ in range(3))
        self.sampled = self._of_samples = total(comm, int(known.sampled)) > 0

    def _take(self, cells: np.ndarray, pieces: Pieces) -> None:
        """Heights and means in some cells; above the interpolant, and in all."""
        nodal, radius = self.nodal[self.simplices.dofs[cells]], self.simplices.radius
        self._height[cells] = np.maximum(highest_above(pieces, nodal, self.sign, ROUND_OFF * self._size), 0.0)
        self.mean[cells] = mean_above(pieces, nodal, self.sign, None if radius is None else radius[cells])
        self._top[cells] = pieces.upper if self.sign > 0 else -pieces.lower

    def lift(self, u: np.ndarray) -> np.ndarray:
        """The state raised at nodes where it is not given, so that the obstacle is nowhere above it in cells without
        nodes where it is (collective).

        Args:
            u: sign times the state at local dofs.
        """
        raised = np.where(self.simplices.given, u, np.maximum(u, self.nodal))
        if self._flat and not self.dirichlet.twice:
            return raised
        # nowhere below the obstacle: its interpolant and its height above that, or its highest value everywhere
        dofs = self.simplices.dofs
        cells, needed = np.flatnonzero(self._near(u) & (self._height > 0)), np.zeros(dofs.shape)
        state = np.maximum(u, self.nodal)[dofs[cells]]
        shifted, level = self.nodal[dofs[cells]] + self._height[cells, None], self._top[cells, None]
        to_shifted, to_level = np.maximum(shifted - state, 0.0), np.maximum(level - state, 0.0)
        cheaper = to_level.sum(axis=1, keepdims=True) < to_shifted.sum(axis=1, keepdims=True)
        needed[cells] = np.where(cheaper, to_level, to_shifted)
        return raised + np.where(self.simplices.given, 0.0, self.simplices.around.largest(needed))

    def beyond(self, v: np.ndarray) -> float:
        """By how much the obstacle may be above the final state, on any rank, but beside nodes where it is given
        (collective).

        There `cover_energy` and `cover_volume` become those of the function that makes up for it.

        Args:
            v: sign times the state at local dofs.
        """
        dofs, comm = self.simplices.dofs, self.simplices.data.level.comm
        at_nodes = largest(comm, self.nodal - v)
        if self._flat and not self.dirichlet.twice:
            return at_nodes
        near = self._near(v)
        beside = near & (self.simplices.given[dofs].any(axis=1) | (self.dirichlet.deviation > 0))
        self._cover(v, beside)
        above = np.minimum(self._height - _least(v - self.nodal, dofs), self._top - _least(v, dofs))
        return max(at_nodes, largest(comm, above[near & ~beside]))

    def _near(self, u: np.ndarray) -> np.ndarray:
        """Cells in which u may touch the obstacle, whose excess becomes known sharper there (collective)."""
        self._size = largest(self.simplices.data.level.comm, np.abs(u))
        for done, division in enumerate(SHARPER):
            near = self._may_touch(u)
            new = np.flatnonzero(near & (self._done == done))
            pieces = in_cells(self.simplices, self._field, division, new)
            self._take(new, pieces)
            self._done[new] = np.where(pieces.rough, done + 1, len(SHARPER))
        return near

    def _may_touch(self, u: np.ndarray) -> np.ndarray:
        """Whether u may touch the obstacle in each cell (local)."""
        dofs = self.simplices.dofs
        near = (
            _least(u - self.nodal, dofs) <= np.maximum(self._height, ROUND_OFF * self._size) + self.dirichlet.deviation
        )
        return near & (_least(u, dofs) <= self._top + self.dirichlet.deviation)

    def _cover(self, state: np.ndarray, beside: np.ndarray) -> None:
        """The excess of the obstacle in cells at nodes where u is given, which cannot be raised (collective).

        It is the positive part of obstacle - state - cones of boundary values, which is 0 on the boundary. Its gradient
        is bounded on those parts of the cells where it may be positive: with the largest slope of the cones there, or
        with their energy in the whole cell.
        """
        simplices, comm = self.simplices, self.simplices.data.level.comm
        self.cover_volume[:] = self.cover_energy[:] = self.cover_height[:] = 0.0
        owner, without = np.flatnonzero(beside), np.zeros(len(simplices.area))  # the cones
        count, times = simplices.dim + 1, 2**simplices.dim
        corners, inside = simplices.x[owner], np.broadcast_to(np.eye(count), (len(owner), count, count))
        for split in range(BESIDE + 1):
            pieces = pieces_of(simplices.data, self._field, corners, owner, Division(0))
            linear = (inside @ state[simplices.dofs[owner]][..., None])[..., 0]
            cones, steep = self.dirichlet.on_parts(owner, inside, self.sign)
            above, last = np.zeros(len(owner), dtype=bool), split == BESIDE or len(owner) > FEW
            for group in (one.no_less(self.sign) for one in pieces.groups):
                degree, coefficient, margin = group.above(linear, self.sign)
                beyond, margin = group.rest - cones[group.rows], margin + ROUND_OFF * self._size
                open_ = np.flatnonzero(polynomials.largest(coefficient, count, degree) + beyond > margin)
                rows = group.rows[open_]
                above[rows] = True
                if last:
                    measure = simplices.area[owner[rows]] * group.share[open_] / times**split
                    height = np.maximum(coefficient[open_] + beyond[open_, None], 0.0)
                    steepness = group[open_].steepness(coefficient[open_], corners, steep[rows])
                    np.add.at(self.cover_volume, owner[rows], measure * height.mean(axis=1))
                    np.maximum.at(self.cover_height, owner[rows], height.max(axis=1, initial=0.0))
                    np.add.at(self.cover_energy, owner[rows], measure * steepness)
                    steepness = group[open_].steepness(coefficient[open_], corners, np.zeros(len(rows)))
                    np.add.at(without, owner[rows], measure * steepness)
            uncovered = np.count_nonzero(above)
            if last:
                break
            owner = np.repeat(owner[above], times)
            corners, inside = polynomials.halved(corners[above]), polynomials.halved(inside[above])
        of_cones = self.dirichlet.energy(np.ones(len(without)))
        self.cover_energy = np.minimum(self.cover_energy, (np.sqrt(without) + np.sqrt(of_cones)) ** 2)
        jumps = total(comm, uncovered) > 0 and not self._field.continuous
        self.sampled = self._of_samples or jumps


def _least(nodal: np.ndarray, dofs: np.ndarray) -> np.ndarray:
    """The least value at the vertices of each cell."""
    return reduce(np.minimum, (nodal[column] for column in dofs.T))

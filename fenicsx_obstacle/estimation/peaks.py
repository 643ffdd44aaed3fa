"""Obstacles between the nodes.

The highest point of an obstacle above its nodal interpolant is added at the nodes around. Where the obstacle is a
polynomial in a cell, its Bernstein coefficients bound that height; elsewhere it is sampled, densely in cells where u
may touch it, with a margin for what lies between the samples.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.exactness import in_cells, number
from fenicsx_obstacle.estimation.fans import Fans
from fenicsx_obstacle.estimation.polynomials import MAX_DEGREE, coefficients, inner_points, round_off
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.estimation.rim import Rim
from fenicsx_obstacle.estimation.triangles import Triangles, lattice, lattice_cells, with_ghosts
from fenicsx_obstacle.parallel import largest, total

SPARE = 1.5  # times the height that a few points of a cell have found,
SPARE_DENSE = 1.1  # and that of a dense lattice
NEAR = 4.0  # times that height: how near u may come before a cell is sampled densely
DENSE = 8  # parts of an edge
ROUND_OFF = 1e-14  # of the heights


class Peaks:
    """One obstacle between its nodes; heights count away from it: times -1 for an upper one.

    Attributes:
        sign: 1 for a lower obstacle, -1 for an upper one.
        nodal: sign times its nodal values at local dofs.
        cover_energy: ||grad||^2 in each cell of what is added to the state beside the boundary (see `lift`).
        cover_volume: Its integral.
        surprise: By how much dense samples found it higher than all the others let expect: it may have peaks narrower
            than either.
        sampled: Whether the bound rests on samples of it, on any rank: it is no polynomial in some cell, or it is above
            the state beside the boundary.
        unbounded: Whether it may be infinite in each cell, on the side of the state.
    """

    def __init__(self, triangles: Triangles, fans: Fans, rim: Rim, sign: float, field: Field):
        """Sample it at a few points of each cell (collective)."""
        data = triangles.data
        self.triangles, self.fans, self.rim, self.sign, self._field = triangles, fans, rim, sign, field
        nodal = data.lower if sign > 0 else data.upper
        assert nodal is not None
        self.nodal = sign * nodal.x.array
        comm, cells = data.level.comm, len(triangles.area)
        self._heights = largest(comm, np.abs(self.nodal))
        self._flat = self._field.uniform
        points, weights = rule(2)
        self.mean, self._height = np.zeros(cells), np.zeros(cells)
        self._known = number(cells) if self._flat else in_cells(triangles, self._field)
        self.unbounded = ~np.isfinite(self._known.upper if self.sign > 0 else self._known.lower)
        self._no_polynomial = self.sampled = total(comm, np.count_nonzero(~self._known.exact)) > 0
        if not self._flat:
            sampled = np.flatnonzero(~self._known.exact)
            for block in blocks(len(sampled)):
                above = self._above(points, sampled[block])
                self.mean[sampled[block]] = above @ weights  # of the obstacle above its nodal interpolant
                self._height[sampled[block]] = SPARE * self._clean(above.max(axis=1, initial=0.0))
            for degree, exact in self._known.degrees():
                coefficient, room = self._coefficients(max(degree, 1), exact)
                self.mean[exact] = coefficient.mean(axis=1)
                highest = coefficient.max(axis=1)
                self._height[exact] = np.where(highest <= room, 0.0, highest + room)
        self._is_dense = self._known.exact.copy()
        self.surprise = 0.0
        self.cover_energy, self.cover_volume = np.zeros(cells), np.zeros(cells)

    def lift(self, u: np.ndarray) -> np.ndarray:
        """Nodal heights of an obstacle that is nowhere below this one where u may touch it (collective).

        Beside nodes where u is given it may be below; there `cover_energy` and `cover_volume` are those of the function
        that makes up for it.

        Args:
            u: sign times the state at local dofs.

        Returns:
            At local dofs; where u is given, the nodal height.
        """
        if self._flat and not self.rim.twice:
            return self.nodal
        dofs = self.triangles.dofs
        slack = (u - self.nodal)[dofs].min(axis=1) - self.rim.dip
        near = slack <= np.maximum(NEAR * self._height, ROUND_OFF * self._heights)
        new = np.flatnonzero(near & ~self._is_dense)
        above = self._clean(self._above(lattice(DENSE), new).max(axis=1, initial=0.0))
        expected = self._height[new] + max(largest(self.triangles.data.level.comm, self._height), 0.0)
        self.surprise = max(self.surprise, largest(self.triangles.data.level.comm, above - expected))
        self._height[new] = SPARE_DENSE * above
        self._is_dense[new] = True
        given = np.zeros(len(u), dtype=bool)
        given[self.triangles.data.fixed[0]] = True
        lifted = self.nodal + np.where(given, 0.0, self._at_nodes(np.where(near, self._height, 0.0)))
        self._cover(np.where(given, u, np.maximum(u, lifted)), near & (given[dofs].any(axis=1) | (self.rim.dip > 0)))
        return lifted

    def _cover(self, state: np.ndarray, beside: np.ndarray) -> None:
        """What is still above the state beside nodes that cannot be raised, because u is given there (collective).

        It is taken to be linear on a lattice, so that cells fit together.
        """
        triangles, where, cells = self.triangles, lattice(DENSE), self._uncovered(state, np.flatnonzero(beside))
        self.sampled = self._no_polynomial or total(triangles.data.level.comm, len(cells)) > 0
        gap = (state - self.nodal)[triangles.dofs[cells]] @ where.T + self.sign * self.rim.cones(cells, where)
        cover = self._clean(np.maximum(self._above(where, cells) - gap, 0.0))
        parts = np.array(lattice_cells(DENSE))
        share = triangles.area[cells] / len(parts)
        self.cover_volume[:], self.cover_energy[:] = 0.0, 0.0
        self.cover_volume[cells] = cover[:, parts].mean(axis=2).sum(axis=1) * share
        # every part is the cell over again, DENSE times smaller and maybe turned round
        normal = DENSE * triangles.normal[:, cells] / (2 * triangles.area[cells])[:, None]
        gradient = np.einsum("cpi,xci->xcp", cover[:, parts], normal)
        self.cover_energy[cells] = (1 + 1 / DENSE) ** 2 * np.einsum("xcp,xcp->c", gradient, gradient) * share

    def _uncovered(self, state: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """Those of some cells where the obstacle may be above the state."""
        clear = np.zeros(len(cells), dtype=bool)
        for degree in np.unique(self._known.degree[cells]):
            if degree <= MAX_DEGREE:
                own = np.flatnonzero(self._known.degree[cells] == degree)
                coefficient, room = self._coefficients(max(int(degree), 1), cells[own], state)
                clear[own] = coefficient.max(axis=1) + self.rim.dip[cells[own]] <= room
        return cells[~clear]

    def _coefficients(
        self, degree: int, cells: np.ndarray, state: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bernstein coefficients of the obstacle above a nodal function, by default its own; their round-off."""
        points = inner_points(3, degree)
        inside = self.sign * self.triangles.values(self._field, points, cells)
        linear = (self.nodal if state is None else state)[self.triangles.dofs[cells]] @ points.T
        room = round_off(np.maximum(np.abs(inside), np.abs(linear)), 3, degree)
        return coefficients(inside - linear, 3, degree), room + ROUND_OFF * self._heights

    def _at_nodes(self, heights: np.ndarray) -> np.ndarray:
        """The largest value in the cells around each local dof (collective)."""
        owned, level = np.zeros(self.fans.owned), self.triangles.data.level
        if total(level.comm, np.count_nonzero(heights)) > 0:
            owned = self.fans.largest(self.fans.gather(np.repeat(heights[:, None], 3, axis=1))[0])
        return with_ghosts(level.V, owned)

    def _above(self, where: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """How far the obstacle is above its nodal interpolant, shape (cells, points)."""
        inside = self.sign * self.triangles.values(self._field, where, cells)
        return inside - self.nodal[self.triangles.dofs[cells]] @ where.T

    def _clean(self, heights: np.ndarray) -> np.ndarray:
        return np.where(heights <= ROUND_OFF * self._heights, 0.0, heights)

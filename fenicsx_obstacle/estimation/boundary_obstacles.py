"""Obstacles on parts of the boundary, or along curves and surfaces inside.

There the contact force is a force on facets, and in the equilibrated flux like a load there: at a node it is
distributed to the facets around it, and on a facet E with the force F the multiplier is F/|E|. Its part of the bound is
F times the mean of the distance of v_h to the obstacle on E. v_h is raised at the vertices of a facet by what the
obstacle is above its nodal interpolant there; not at vertices where u is given.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.enclosed_data import pieces_of
from fenicsx_obstacle.estimation.part_forces import DIVISION, PartForces
from fenicsx_obstacle.estimation.pieces import joined
from fenicsx_obstacle.estimation.simplices import Simplices, reciprocals
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.parallel import total


class BoundaryObstacle:
    """One obstacle on facets, times -1 for an upper obstacle.

    Attributes:
        sign: 1 for a lower obstacle, -1 for an upper one.
        rows: Its facets among those of `parts`.
        nodal: sign times its nodal values at local dofs, minus infinity at the others.
        lifted: The same of a P1 obstacle that is nowhere below it, but beside vertices where u is given.
        sampled: Whether it is known at samples only, on any rank.
        unbounded: Whether it may be infinite on a facet of each cell.
    """

    def __init__(self, sign: float, parts: PartForces, which: np.ndarray, fields: list[Field]):
        """Enclose it (collective).

        Args:
            sign: See the attributes.
            parts: Has its facets.
            which: The number of the field on the side opposite to each vertex, -1 where there is none, shape (cells,
                vertices).
            fields: The obstacle on parts of the boundary.
        """
        self.sign, self._parts = sign, parts
        simplices, data = parts.simplices, parts.simplices.data
        self._dim, comm = simplices.dim, data.level.comm
        self.nodal = sign * data.heights(sign)
        number = which[parts.cells, parts.sides]
        self.rows = np.flatnonzero(number >= 0)
        self._dofs, cells = parts.dofs[self.rows], parts.cells[self.rows]
        self._share = (parts.share * parts.size * parts.ratio)[self.rows] / self._dim
        around, facets = AroundNodes(data.level.V, self._dofs), np.ones(self._dofs.shape)
        self._inverse = reciprocals(around.sums(self._share[:, None] * facets))  # of the size of facets around nodes
        self.unbounded, self.sampled = np.zeros(len(simplices.area), dtype=bool), False
        self.lifted, self._pieces = self.nodal, joined([], len(cells))
        if self._dim == 1:  # facets are points
            return
        x, found = simplices.x[cells[:, None], parts.corners[self.rows]], []
        for k, field in enumerate(fields):
            there = np.flatnonzero(number[self.rows] == k)
            found.append((there, pieces_of(data, field, x[there], cells[there], DIVISION[self._dim])))
        self._pieces = pieces = joined(found, len(cells))
        self.sampled = total(comm, int(pieces.sampled)) > 0
        self.unbounded[cells[~np.isfinite(pieces.upper if sign > 0 else pieces.lower)]] = True
        above = np.maximum(self._highest(self.nodal), 0.0)
        self.lifted = self.nodal + around.largest(above[:, None] * facets)

    def forces(self, at_nodes: np.ndarray) -> np.ndarray:
        """Contact forces by vertices of the cell of each facet of `parts`, shape (facets, d + 1) (local).

        Args:
            at_nodes: The forces at local dofs, >= 0.
        """
        found = np.zeros((len(self._parts.cells), self._dim + 1))
        share = (at_nodes * self._inverse)[self._dofs] * self._share[:, None]
        found[self.rows[:, None], self._parts.corners[self.rows]] = share
        return found

    def gaps(self, v: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, float]:
        """Bounds of the mean distance of a function above the obstacle on each facet, and of how far it is below it
        anywhere, on this rank, (E23) (local).

        Args:
            v: sign times the values of a P1 function at local dofs.
            other: Bound of what the function is besides, on the facets of each owned cell.
        """
        corner = v[self._dofs]
        if self._dim == 1:
            gap = corner[:, 0] - self.nodal[self._dofs[:, 0]]
            return np.maximum(gap, 0.0), float(np.max(-gap, initial=0.0))
        parts = self._parts
        radius = None if parts.radius is None else parts.radius[self.rows]
        mean, away = -self._pieces.mean_above(corner, self.sign, radius), other[parts.cells[self.rows]]
        return np.maximum(mean, 0.0) + away, float(np.max(self._highest(v) + away, initial=0.0))

    def _highest(self, linear: np.ndarray) -> np.ndarray:
        """Bounds of the obstacle above a P1 function on each facet (local)."""
        return self._pieces.highest_above(linear[self._dofs], self.sign)


def boundary_obstacles(simplices: Simplices) -> list[tuple[float, np.ndarray, list[Field]]]:
    """The obstacles on facets of owned cells (collective).

    Returns:
        1 for the lower one and -1 for the upper one, if they are there; the number of its field on the side opposite to
        each vertex, -1 where there is none, shape (cells, vertices); and its fields.
    """
    data, found = simplices.data, list[tuple[float, np.ndarray, list[Field]]]()
    for sign, key in ((1.0, "lower"), (-1.0, "upper")) if data.thin else ():
        which, fields = np.full(simplices.facets.shape, -1), list[Field]()
        for number, part in enumerate(data.model.boundary):
            field = getattr(part, key)
            if field is not None:
                which[simplices.on_sides(data.facets[number])] = len(fields)
                fields.append(field)
        if fields:
            found.append((sign, which, fields))
    return found

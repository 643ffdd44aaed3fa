"""Forces at points on intervals, where their energy is finite.

A force F at a point p of a cell T, at the share t of its length, is the force F/|T| per length, which the
equilibrated flux is in balance with, and F (delta_p - 1/|T|), which has mean zero in T and a flux of its own in T, as
the oscillation of a load is (see `oscillation`): tau = F ((x - x_0)/|T| - [x > p]),

    ||tau||_T^2 = F^2 |T| (t^3 + (1 - t)^3)/3,   (tau, Q') = F (Q(p) - mean of Q) for every Q.

At a vertex it is a jump of the flux. A point so near to one that they are not told apart is moved there, at a distance
t |T|: |F e(p) - F e(vertex)| <= |F| (t |T|)^(1/2) ||e'||_T.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.mesh.points import locate

AT_VERTEX = 1e-9  # of the length of a cell


class PointForces:
    """All forces at points, (E22).

    Attributes:
        given: Whether there are any; the others are None or empty if not.
        moments: int test for each vertex of the owned cells, as the solver has it, shape (cells, 2).
        middle: The same of the function 4 phi_0 phi_1.
        norm: Bound of ||tau||_T.
        first: int g (x - middle), g = F (delta_p - 1/|T|), shape (1, cells).
        second: int g |x - middle|^2.
        moved: Of forces that are moved to vertices, their sum with the roots of the distances as factors.
        at_vertices: Cells, the vertices of them opposite to those loaded, and the share of the force that the cell has.
    """

    def __init__(self, simplices: Simplices, effects: list[Effect]):
        """Find the cells (collective).

        Args:
            simplices: The owned cells.
            effects: On meshes of more dimensions none has such forces.
        """
        given = [one for effect in effects if effect.role == "point forces" for one in cast(Any, effect.value)]
        self.given, count = len(given) > 0, len(simplices.area)
        self.moments = np.zeros((count, simplices.dim + 1))
        self.norm, self.second, self.moved, self.middle = (np.zeros(count) for _ in range(4))
        self.first = np.zeros((simplices.dim, count))
        empty = np.empty(0, dtype=int)
        self.at_vertices = empty, empty, np.empty(0)
        if not given:
            return
        level, points = simplices.data.level, np.zeros((len(given), 3))
        points[:, 0] = [at[0] for at, _ in given]
        rows, cells, _ = locate(level, points)
        found = np.bincount(rows, minlength=len(points))
        level.comm.Allreduce(MPI.IN_PLACE, found, MPI.SUM)
        whole = np.array([force for _, force in given])[rows]
        force = whole / found[rows]
        x, length = simplices.x[cells, :, 0], simplices.area[cells]
        t = np.clip((points[rows, 0] - x[:, 0]) / (x[:, 1] - x[:, 0]), 0.0, 1.0)
        away = np.abs(x - points[rows, :1]).min(axis=1)
        outside = np.maximum(x.min(axis=1) - points[rows, 0], points[rows, 0] - x.max(axis=1)).clip(0.0)

        def largest_of_each_point(values: np.ndarray) -> np.ndarray:
            most = np.full(len(points), -np.inf)
            np.maximum.at(most, rows, values)
            level.comm.Allreduce(MPI.IN_PLACE, most, MPI.MAX)
            return most[rows]

        near = largest_of_each_point((away <= AT_VERTEX * length).astype(float)) > 0
        self.at_vertices = cells[near], np.where(t[near] < 0.5, 1, 0), force[near]
        # of the cells that are found only one may have the point: the whole force is moved in it
        moves = near & (-outside == largest_of_each_point(-outside))
        np.add.at(self.moved, cells, np.where(moves, np.abs(whole) * np.sqrt(away), 0.0))
        force = np.where(near, 0.0, force)
        np.add.at(self.moments, cells, np.stack([force * (1 - t), force * t], axis=1))
        np.add.at(self.middle, cells, 4 * force * t * (1 - t))
        np.add.at(self.norm, cells, np.abs(force) * np.sqrt(length * (t**3 + (1 - t) ** 3) / 3))
        from_middle = (points[rows] - simplices.middle[cells, 0, None])[:, 0]
        np.add.at(self.first[0], cells, force * from_middle)
        np.add.at(self.second, cells, force * (from_middle**2 - length**2 / 12))

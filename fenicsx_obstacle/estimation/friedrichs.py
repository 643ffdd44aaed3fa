"""Friedrichs' constant: ||v||_0 <= c ||grad v||_0 for functions that are 0 where u is given."""

from __future__ import annotations

from math import pi

import numpy as np

from fenicsx_obstacle.estimation.triangles import Triangles
from fenicsx_obstacle.parallel import largest, smallest, total


def friedrichs(triangles: Triangles, held_sides: np.ndarray) -> tuple[float, bool]:
    """Friedrichs' constant of functions that are 0 where u is given, and whether it is exact (collective).

    Of a box by its first eigenvalue, a side after the other; of any other domain held all around by that of the
    box around it. Otherwise no constant is known, and twice the longer side stands for it.

    Args:
        triangles: The owned cells.
        held_sides: Whether u is given on the side opposite to each vertex, shape (cells, 3).
    """
    level, x = triangles.data.level, triangles.x
    comm = level.comm
    lower = np.array([smallest(comm, x[..., axis]) for axis in range(2)])
    upper = np.array([largest(comm, x[..., axis]) for axis in range(2)])
    sides = upper - lower
    outer = np.zeros(triangles.facets.max(initial=-1) + 1, dtype=bool)
    facets = level.boundary_facets
    outer[facets[facets < len(outer)]] = True
    cells, opposite = np.nonzero(outer[triangles.facets])
    held = held_sides[cells, opposite]
    ends = np.stack([x[cells, (opposite + 1) % 3], x[cells, (opposite + 2) % 3]], axis=1)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    around = total(comm, length)
    everywhere = total(comm, length[held]) >= around * (1 - 1e-9)
    is_box = total(comm, triangles.area) >= np.prod(sides) * (1 - 1e-9)
    wave = np.zeros(2)
    for axis in range(2):
        faces = 0
        for at in (lower[axis], upper[axis]):
            on = held & np.all(np.abs(ends[..., axis] - at) < 1e-9 * sides[axis], axis=1)
            faces += total(comm, length[on]) >= sides[1 - axis] * (1 - 1e-9)
        wave[axis] = (2 if everywhere else faces) * pi / (2 * sides[axis])
    if everywhere or (is_box and np.any(wave > 0)):
        return 1 / float(np.linalg.norm(wave)), True
    return 2 * float(sides.max()), False

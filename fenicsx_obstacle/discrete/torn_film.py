"""Films beyond their limit load that an obstacle catches."""

from __future__ import annotations

from math import sqrt

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.discrete.mesh_system import MeshSystem
from fenicsx_obstacle.parallel import largest, smallest, total

FINE = 8  # cells across the domain from which a slope in one cell is no slope of the film


def torn(problem: System, active: np.ndarray) -> str | None:
    """A film beyond its limit load that falls on an obstacle: u jumps within one cell at the boundary.

    Where a film is vertical at the boundary, and its radius of curvature there is R, it falls by (2 R h)^(1/2) within
    a cell of size h, and by less in the next. With R up to half of the domain that is less than the limit here.
    Concentrated loads make a film steep that is not curved, but then it falls as far in its other cells.
    """
    assert isinstance(problem, MeshSystem)
    comm, level, data = problem.comm, problem.level, problem.data
    across = 2 * largest(comm, level.points[0]) if data.axial else data.extent
    if level.h * FINE > across:
        return None
    dofs, values = data.fixed
    given, u = values.x.array[dofs], problem.solution().x.array
    low, high = smallest(comm, given), largest(comm, given)
    fixed = np.zeros(len(u), dtype=bool)
    fixed[dofs] = True
    cells = releases.cell_dofs(level.V)
    outer = fixed[cells].any(axis=1)
    for side, fall in ((-1, low - u), (1, u - high)):
        if total(comm, np.count_nonzero(active == side)) == 0:
            continue
        fallen = np.maximum(fall, 0.0)
        falls = np.ptp(fallen[cells], axis=1)
        jump, others = largest(comm, falls[outer]), largest(comm, falls[~outer])
        if jump > sqrt(across * level.h) and jump > min(2 * others, largest(comm, fallen) / 2):
            return (
                f"u falls by {jump:.4g} within one cell where it is given, farther than a film can: the load is beyond "
                "its limit, and no solution has these boundary values; take a smaller load"
            )
    return None

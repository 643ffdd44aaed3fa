"""Validation of meshes from files: finite coordinates, no invalid vertices, no cell twice.

DOLFINx takes such files as they come, and the first to notice is a solver, or the system that ends the process.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fenicsx_obstacle.errors import InputError


def validate_mesh(points: np.ndarray, cells: np.ndarray) -> None:
    """Reject what DOLFINx cannot make a mesh of; `checks.check_mesh` looks at the mesh (one rank).

    Args:
        points: Shape (points, 1 to 3).
        cells: Numbers of the points of each cell, shape (cells, vertices).

    Raises:
        InputError: Naming the place.
    """
    if cells.min(initial=0) < 0 or cells.max(initial=-1) >= len(points):
        raise InputError("a cell has a vertex that is not in the file")
    used = np.unique(cells)
    lost = used[~np.isfinite(points[used]).all(axis=1)]
    if len(lost):
        raise InputError(f"a vertex lies at {place(points[lost[0]])}: not a finite number")
    rows = np.sort(cells, axis=1)
    order = np.lexsort(rows.T)
    repeated = order[1:][(rows[order][1:] == rows[order][:-1]).all(axis=1)]
    for wrong, what in (
        (np.flatnonzero((rows[:, 1:] == rows[:, :-1]).any(axis=1)), "has a vertex twice"),
        (repeated, "occurs twice"),
    ):
        if len(wrong):
            places = ", ".join(place(corner) for corner in points[cells[wrong[0]]])
            raise InputError(f"the cell with the corners {places} {what}")


def place(point: Iterable[float]) -> str:
    """A point, for messages."""
    return f"({', '.join(f'{x:.4g}' for x in point)})"

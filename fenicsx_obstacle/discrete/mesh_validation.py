"""Validation of meshes from files: finite coordinates, cells with a volume, no duplicate and no invalid vertices.

DOLFINx takes such files as they come, and the first to notice is a solver, or the system that ends the process.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fenicsx_obstacle.discrete.simplex_sizes import sizes
from fenicsx_obstacle.errors import InputError

FLAT = 1e-13  # of its longest edge to the power of the dimension: what a cell's volume must exceed
_SIZES = {"interval": "length", "triangle": "area", "quadrilateral": "area", "tetrahedron": "volume",
          "hexahedron": "volume"}  # fmt: skip
_SIMPLICES = {2: "interval", 3: "triangle", 4: "tetrahedron"}  # by vertices
# in each of these simplices the sizes have the same sign, if the cell is convex
_CORNERS = {"quadrilateral": [[0, 1, 2], [1, 3, 0], [3, 2, 1], [2, 0, 3]],
            "hexahedron": [[0, 1, 2, 4], [3, 2, 1, 7], [5, 4, 7, 1], [6, 7, 4, 2]]}  # fmt: skip


def validate_mesh(points: np.ndarray, cells: np.ndarray, cell: str = "") -> None:
    """Reject invalid cells (one rank).

    Args:
        points: Shape (points, 1 to 3).
        cells: Numbers of the points of each cell, in DOLFINx's order, shape (cells, vertices).
        cell: Their kind; by default simplices.

    Raises:
        InputError: Naming the place.
    """
    cell = cell or _SIMPLICES[cells.shape[1]]
    size = _SIZES[cell]
    if cells.min(initial=0) < 0 or cells.max(initial=-1) >= len(points):
        raise InputError(f"a {cell} has a vertex that is not in the file")
    used = np.unique(cells)
    lost = used[~np.isfinite(points[used]).all(axis=1)]
    if len(lost):
        raise InputError(f"a vertex lies at {place(points[lost[0]])}: not a finite number")
    corners = np.zeros((*cells.shape, 3))
    corners[:, :, : points.shape[1]] = points[cells]
    parts = _CORNERS.get(cell, [list(range(cells.shape[1]))])
    flat = np.flatnonzero(np.min([sizes(corners[:, part]) for part in parts], axis=0) <= FLAT)
    if len(flat):
        places = ", ".join(place(corner) for corner in corners[flat[0]])
        raise InputError(f"the {cell} with the corners {places} has no {size}")
    twice = _twice(cells)
    if twice is not None:
        places = ", ".join(place(corner) for corner in corners[twice])
        raise InputError(f"the {cell} with the corners {places} occurs twice")


def _twice(cells: np.ndarray) -> int | None:
    """Number of a cell whose vertices another one has too."""
    rows = np.sort(cells, axis=1)
    order = np.lexsort(rows.T)
    same = np.flatnonzero((rows[order][1:] == rows[order][:-1]).all(axis=1))
    return int(order[same[0]]) if len(same) else None


def place(point: Iterable[float]) -> str:
    """A point, for messages."""
    return f"({', '.join(f'{x:.4g}' for x in point)})"

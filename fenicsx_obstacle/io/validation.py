"""Validation of saved solutions, which others may have changed: they have the form that `save` gives them.

DOLFINx takes meshes as they come: with an index out of range it waits for ever, or ends the process.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.hdf5 import check_finite
from fenicsx_obstacle.io.paraview import BY_CELL, SIMPLEX
from fenicsx_obstacle.parallel import agree
from fenicsx_obstacle.problems.summary import summary
from fenicsx_obstacle.problems.values import Adaptive, Errors, Quantity, Seconds

VERTICES = {"interval": 2, "triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}
_DIMENSION = {"interval": 1, "triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}

Arrays = Mapping[str, np.ndarray]


class _Record(msgspec.Struct):
    """The values of answer.json that are read as something other than text."""

    scene: str
    title: str
    method: str
    eps: float | None
    h: float
    dofs: int
    element: str
    newton_iterations: int
    penetration: float
    energy: float | None
    seconds: Seconds
    contact: dict[str, Any]
    report: dict[str, float | None] = {}
    errors: Errors | None = None
    adaptive: Adaptive | None = None
    goal: Quantity | None = None
    time: dict[str, Any] | None = None


def check_record(record: Any) -> None:
    """Reject what is no record of a solution.

    Raises:
        ValueError: With what is wrong.
    """
    try:
        found = msgspec.convert(record, _Record)
        if not (np.isfinite(found.h) and found.h > 0):
            raise ValueError("h is no length")
        if found.newton_iterations < 0:
            raise ValueError("a negative number of steps")
        summary(record, "")
    except (LookupError, TypeError, AttributeError, msgspec.ValidationError) as error:
        raise ValueError(f"it has wrong fields ({type(error).__name__}: {error})") from None


def check_arrays(arrays: Arrays, element: Arrays, parts: Arrays, pair: Pair, comm: MPI.Comm) -> None:
    """Reject arrays that are those of no solution; each rank looks at its share (collective).

    Args:
        arrays: Of fields.h5, the same on every rank.
        element: Of its group `element`.
        parts: Of its group of named parts.
        pair: Element of the solution.
        comm: The ranks.

    Raises:
        InputError: On every rank, with what is wrong.
    """
    with agree(comm):
        try:
            _check_forms(arrays, element, pair)
            count = len(arrays["points"])
            for name, values in (*arrays.items(), *element.items(), *parts.items()):
                if values.ndim:
                    check_finite(name, values[share(comm, len(values))])
            vertices = VERTICES[element["cell"].item().decode()] if element else arrays["cells"].shape[1]
            _check_indices("cells", arrays["cells"][share(comm, len(arrays["cells"]))], count, arrays["cells"].shape[1])
            cells = len(arrays["cells"])
            if element:
                cells = len(element["cells"])
                _check_indices("element/cells", element["cells"][share(comm, cells)], count, vertices)
            for name, values in parts.items():
                if name != "names":
                    _check_indices(f"parts/{name}", values, count if values.ndim == 2 else cells, 0)
        except (LookupError, TypeError, AttributeError) as error:
            raise InputError(f"wrong arrays ({type(error).__name__}: {error})") from None
        except ValueError as error:
            raise InputError(str(error)) from None


def share(comm: MPI.Comm, count: int) -> slice:
    """The rows that a rank passes on, of so many."""
    return slice(count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size)


def _check_forms(arrays: Arrays, element: Arrays, pair: Pair) -> None:
    """Shapes, kinds of numbers and sizes."""
    points, cells, gdim = arrays["points"], arrays["cells"], int(arrays["gdim"])
    if points.dtype.kind != "f" or points.ndim != 2 or points.shape[1] != 3 or not 1 <= gdim <= 3:
        raise ValueError(f"points have shape {points.shape} of {points.dtype} in {gdim} dimensions")
    if cells.ndim != 2 or cells.shape[1] not in SIMPLEX or cells.shape[1] > gdim + 1:
        raise ValueError(f"cells have shape {cells.shape} in {gdim} dimensions")
    cell = SIMPLEX[cells.shape[1]]
    if element:
        cell, nodes = element["cell"].item().decode(), element["cells"]
        if _DIMENSION[cell] > gdim or nodes.ndim != 2 or nodes.shape[1] < VERTICES[cell]:
            raise ValueError(f"element/cells have shape {nodes.shape}, and are called {cell}")
        wrong = [name for name, one in element.items() if name != "cell" and (one.ndim != 2 or len(one) != len(nodes))]
        if wrong:
            raise ValueError(f"element/{wrong[0]} does not have {len(nodes)} rows")
    pair.rule("triangle" if cell == "tetrahedron" and "u0" in arrays else cell)
    for name, values in arrays.items():
        rows = len(cells) if name in BY_CELL else len(points)
        if name not in ("points", "cells", "gdim") and (values.dtype.kind != "f" or values.shape[:1] != (rows,)):
            raise ValueError(f"'{name}' has shape {values.shape} of {values.dtype}, not {rows} numbers")


def _check_indices(name: str, values: np.ndarray, count: int, distinct: int) -> None:
    """Reject indices that are out of range, or cells whose first vertices are not distinct."""
    if values.dtype.kind not in "iu":
        raise ValueError(f"{name} holds {values.dtype}, not whole numbers")
    if values.size and (values.min() < 0 or values.max() >= count):
        raise ValueError(f"{name} has an index that is not among 0 to {count - 1}")
    if distinct and (np.diff(np.sort(values[:, :distinct], axis=1), axis=1) == 0).any():
        raise ValueError(f"{name} has a cell with a vertex twice")

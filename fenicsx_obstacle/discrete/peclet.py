"""Cell Peclet numbers, and sources of the drift."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners, own_cells
from fenicsx_obstacle.discrete.fields import array_of
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.parallel import largest

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.data import Data


LEAK = 0.1  # of what flows out of a patch of cells: less that flows in is due to where its midpoints are

Velocity: TypeAlias = tuple[Field, ...]


def peclet(data: Data, velocity: Velocity) -> float:
    """The largest |drift| h/(2 tension), by the largest tension of each cell (collective).

    Args:
        data: Of the problem.
        velocity: Components of the drift.
    """
    ratio = _speeds(data, velocity) / (2 * _of_cells(data, data.model.elastic.stiffness(data)))  # type: ignore[arg-type]
    size = array_of(data.cell_size)
    size = size[: own_cells(data.level.mesh)] if len(size) > 1 else size
    return largest(data.level.comm, (ratio * size[:, None]).ravel())


def depth_of_sources(data: Data, velocity: Velocity) -> np.ndarray:
    """The mean of drift . (x - x_i)/tension over the cells at a vertex x_i from which drift flows away on all sides.

    u grows by the exponential of it, and of what follows downstream. At midpoints x of cells; 0 at vertices into whose
    cells drift flows as well, beyond LEAK of what flows out, and at dofs that are no vertices.

    Args:
        data: Of the problem.
        velocity: Components of the drift.

    Returns:
        Values at owned dofs of V (collective).
    """
    V, mesh = data.level.V, data.level.mesh
    at = corners(mesh)[: own_cells(mesh)]
    dofs = releases.cell_dofs(V)[: len(at), : at.shape[1]]  # those of the vertices are first
    middle = at.mean(axis=1)
    flow = [np.broadcast_to(_of_cells(data, data.values(part)).mean(axis=1), len(at)) for part in velocity]
    elastic = data.model.elastic
    tension = _of_cells(data, elastic.stiffness(data)).mean(axis=1)  # type: ignore[arg-type]
    way = sum(b[:, None] * (middle[:, None, axis] - at[:, :, axis]) for axis, b in enumerate(flow)) / tension[:, None]
    sums = []
    for values in (np.maximum(way, 0.0), np.maximum(-way, 0.0), np.ones_like(way)):
        part = fem.Function(V)
        np.add.at(part.x.array, dofs, values)
        releases.add_ghosts(part)
        sums.append(part.x.array[: data.level.owned])
    out, back, cells = sums
    return np.where(back <= LEAK * out, out / np.maximum(cells, 1.0), 0.0)


def speed(data: Data, velocity: Velocity) -> float:
    """The largest |drift| (collective)."""
    return largest(data.level.comm, _speeds(data, velocity).ravel())


def _speeds(data: Data, velocity: Velocity) -> np.ndarray:
    return np.sqrt(sum(_of_cells(data, data.values(part)) ** 2 for part in velocity))


def _of_cells(data: Data, values: np.ndarray) -> np.ndarray:
    """Values at local dofs of W, or the one there is, in owned cells, shape (cells or 1, dofs of W in a cell or 1)."""
    if len(values) == 1:
        return values[:, None]
    return values[releases.cell_dofs(data.level.W)[: own_cells(data.level.mesh)]]

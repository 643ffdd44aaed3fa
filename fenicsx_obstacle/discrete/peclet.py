"""Cell Peclet numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.discrete.fields import array_of
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.parallel import largest

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.data import Data


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


def mean_stiffness(data: Data) -> np.ndarray:
    """The mean tension of owned cells, shape (cells or 1,)."""
    return _of_cells(data, data.model.elastic.stiffness(data)).mean(axis=1)  # type: ignore[arg-type]


def in_cells(data: Data, value: Field) -> np.ndarray:
    """The mean of a datum in owned cells, shape (cells or 1,)."""
    return _of_cells(data, data.values(value)).mean(axis=1)


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

"""How strong drift is beside tension, cell by cell."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.samples import array_of
from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.parallel import largest


def peclet(data: Data, drift: Effect) -> float:
    """The largest |drift| h/(2 tension), by the largest tension of each cell (collective).

    Args:
        data: Of the problem.
        drift: Its effect of that name.
    """
    elastic = next(effect for effect in data.scene.effects if effect.elastic)
    squared = sum(_of_cells(data, data.values(part)) ** 2 for part in drift.formulas)
    ratio = np.sqrt(squared) / (2 * _of_cells(data, elastic.stiffness(data)))  # type: ignore[arg-type]
    size = array_of(data.cell_size)
    size = size[: own_cells(data.level.mesh)] if len(size) > 1 else size
    return largest(data.level.comm, (ratio * size[:, None]).ravel())


def _of_cells(data: Data, values: np.ndarray) -> np.ndarray:
    """Values at local dofs of W, or the one there is, in owned cells, shape (cells or 1, dofs of W in a cell or 1)."""
    if len(values) == 1:
        return values[:, None]
    return values[releases.cell_dofs(data.level.W)[: own_cells(data.level.mesh)]]

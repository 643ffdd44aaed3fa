"""Data that jump inside cells: a mesh has their jump somewhere else, by up to a cell."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fenicsx_obstacle.discrete.cells import corners, own_cells
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.effects.field import Field, fields_in
from fenicsx_obstacle.parallel import largest, smallest, total

HALVINGS = 30  # a Lipschitz function differs by 1e-9 of what it did, a root by 3e-5
JUMP = 1e-3  # of the range of the datum, from which on a difference that is left is a jump
INSIDE = 1e-6  # of the way from a vertex to the midpoint: a jump on facets is none inside cells


def jump_inside(data: Data) -> Field | None:
    """The first datum of effects and obstacles in the domain that jumps inside a cell; None if none does
    (collective)."""
    comm = data.level.comm
    return next((field for field, cells in _jumps(data) if total(comm, np.count_nonzero(cells)) > 0), None)


def cells_with_jumps(data: Data) -> np.ndarray:
    """Whether a datum of effects and obstacles in the domain jumps inside each owned cell (collective)."""
    none = np.zeros(own_cells(data.level.mesh), dtype=bool)
    return np.logical_or.reduce([none, *(cells for _, cells in _jumps(data))])


def _jumps(data: Data) -> Iterator[tuple[Field, np.ndarray]]:
    """Each datum that may jump, and whether it does in each owned cell (collective)."""
    level, model = data.level, data.model
    count = own_cells(level.mesh)
    for field in fields_in([model.lower, model.upper, *(effect.inputs for effect in model.effects)]):
        for name, part in (field.parts or {"": field}).items():
            cells = level.groups[name] if field.parts is not None else np.arange(count)
            if not (part.uniform or part.continuous):
                yield part, np.bincount(_jumping(data, part, cells), minlength=count) > 0


def _jumping(data: Data, field: Field, cells: np.ndarray) -> np.ndarray:
    """Those of some owned cells in which a datum jumps (collective).

    From the midpoint of each cell to each of its vertices a segment is halved, and the half is kept at whose ends the
    datum differs more. A jump between them is left.
    """
    level = data.level
    ends = corners(level.mesh, cells)
    middle = np.broadcast_to(ends.mean(axis=1, keepdims=True), ends.shape)
    which = np.repeat(cells, ends.shape[1])
    low, high = middle.reshape(-1, 3), (ends + INSIDE * (middle - ends)).reshape(-1, 3)
    at_low, at_high = (data.at(field, x.T, which) for x in (low, high))
    values = np.concatenate([at_low, at_high])
    values = values[np.isfinite(values)]
    limit = JUMP * (largest(level.comm, values) - smallest(level.comm, values))
    apart = np.abs(at_high - at_low) > limit
    which, low, high, at_low, at_high = (part[apart] for part in (which, low, high, at_low, at_high))
    for _ in range(HALVINGS):  # as many on all ranks
        x = (low + high) / 2
        at_x = data.at(field, x.T, which)
        first = np.abs(at_x - at_low) >= np.abs(at_high - at_x)
        low, at_low = np.where(first[:, None], low, x), np.where(first, at_low, at_x)
        high, at_high = np.where(first[:, None], x, high), np.where(first, at_x, at_high)
    return which[np.abs(at_high - at_low) > limit]

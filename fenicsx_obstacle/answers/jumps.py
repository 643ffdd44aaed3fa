"""Data that jump inside cells or in time, and parts of the boundary that end inside facets: a mesh has their jump
somewhere else, by up to a cell, time steps by up to a step."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, permutations

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.time_discretization import EQUILIBRIA
from fenicsx_obstacle.effects.field import Field, fields_in
from fenicsx_obstacle.estimation.edges import cut_parts
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.cells import corners, own_cells
from fenicsx_obstacle.parallel import largest, smallest, total

JUMPS = "jumps inside cells; lay edges of cells along the jump"  # of a datum, in messages
IN_TIME = "jumps in time, perhaps within a step"
HALVINGS = 30  # of lengths: a Lipschitz function differs by 1e-9 of what it did, a root by 3e-5
JUMP = 1e-3  # of the range of the datum, from which on a difference that is left is a jump
INSIDE = 1e-6  # of the way from a vertex to the midpoint: a jump on facets is none inside cells


def unresolved(data: Data) -> str | None:
    """The first datum of effects and obstacles that jumps inside a cell or in time, or part of the boundary that ends
    inside a facet, in words; None if there is none (collective)."""
    comm, mesh = data.level.comm, data.level.mesh
    moments = data.model.time
    steps = moments is not None and moments.order > EQUILIBRIA  # of which each depends on those before
    for field in _data(data) if steps else ():
        if field.moves and not field.continuous:
            return f"{field.source} {IN_TIME}"
    for field, cells in _jumps(data):
        if total(comm, np.count_nonzero(cells)) > 0:
            return f"{field.source} {JUMPS}"
    flat = mesh.geometry.dim == mesh.topology.dim and releases.cell_name(mesh) in SIMPLICES
    if flat and any(part.where is not None for part in data.model.boundary):
        of_p1 = data.level.coarse if data.level.pair.degree > 1 else None
        return next(iter(cut_parts(Simplices(data if of_p1 is None else data.on(of_p1)))), None)
    return None


def cells_with_jumps(data: Data) -> np.ndarray:
    """Whether a datum of effects and obstacles jumps inside each owned cell (collective)."""
    none = np.zeros(own_cells(data.level.mesh), dtype=bool)
    return np.logical_or.reduce([none, *(cells for _, cells in _jumps(data))])


def _data(data: Data) -> list[Field]:
    """The data of effects and obstacles."""
    model = data.model
    on_parts = [obstacle for part in model.boundary for obstacle in (part.lower, part.upper)]
    return list(fields_in([model.lower, model.upper, *on_parts, *map(vars, model.effects)]))


def _jumps(data: Data) -> Iterator[tuple[Field, np.ndarray]]:
    """Each datum that may jump, and whether it does in each owned cell (collective)."""
    level = data.level
    count = own_cells(level.mesh)
    for field in _data(data):
        for name, part in (field.parts or {"": field}).items():
            cells = level.groups[name] if field.parts is not None else np.arange(count)
            if not (part.uniform or part.continuous):
                yield part, np.bincount(_jumping(data, part, cells), minlength=count) > 0


def _jumping(data: Data, field: Field, cells: np.ndarray) -> np.ndarray:
    """Those of some owned cells in which a datum jumps (collective).

    Each simplex is bisected, and the half is kept in which the datum differs more. A jump is a difference that is left.
    """
    level, here, names = data.level, data.here(field), data.names(field)
    dim, gdim = level.mesh.topology.dim, level.mesh.geometry.dim
    x = corners(level.mesh, cells)
    simplices = _simplices(x + INSIDE * (x.mean(axis=1, keepdims=True) - x), dim)
    which, x = np.repeat(cells, simplices.shape[1]), simplices.reshape(-1, dim + 1, 3)
    values = here.at(x.reshape(-1, 3).T, names, np.repeat(which, dim + 1))
    values = values[np.isfinite(values)]
    limit = JUMP * (largest(level.comm, values) - smallest(level.comm, values))

    def differs(x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """By how much, where it has no condition that holds in a part of a simplex: 0."""
        known = None if field.moves else here.over(x[..., :gdim], names, which)
        if known is not None:
            bounds = known.once()
            return np.where(bounds.whole, 0.0, np.asarray(bounds.upper) - bounds.lower)
        points = np.concatenate([x, x.mean(axis=1, keepdims=True)], axis=1)
        there = here.at(points.reshape(-1, 3).T, names, np.repeat(which, dim + 2)).reshape(-1, dim + 2)
        return np.ptp(there, axis=1)

    left = differs(x, which)
    for _ in range(HALVINGS * dim):  # as many on all ranks
        there = ~(left <= limit)
        x, which = x[there], which[there]
        first, second = _halves(x)
        of_first, of_second = differs(first, which), differs(second, which)
        take = ~(of_first < of_second)
        x, left = np.where(take[:, None, None], first, second), np.where(take, of_first, of_second)
    return which[np.isfinite(left) & (left > limit)]


def _simplices(x: np.ndarray, dim: int) -> np.ndarray:
    """Cells divided into simplices, shape (cells, simplices, dim + 1, 3); quadrilaterals and hexahedra along a
    diagonal."""
    if x.shape[1] == dim + 1:
        return x[:, None]
    ways = [[0, *np.cumsum([1 << axis for axis in order])] for order in permutations(range(dim))]
    return x[:, ways]


def _halves(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Simplices bisected at their longest edges."""
    pairs = np.array(list(combinations(range(x.shape[1]), 2)))
    lengths = ((x[:, pairs[:, 0]] - x[:, pairs[:, 1]]) ** 2).sum(axis=2)
    (i, j), rows = pairs[lengths.argmax(axis=1)].T, np.arange(len(x))
    middle = (x[rows, i] + x[rows, j]) / 2
    first, second = x.copy(), x.copy()
    first[rows, i], second[rows, j] = middle, middle
    return first, second

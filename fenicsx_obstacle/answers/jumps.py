"""Data that jump inside cells or in time, and parts of the boundary that end inside facets: a mesh has their jump
somewhere else, by up to a cell, time steps by up to a step. A change within a small part of a cell is a jump to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import permutations
from typing import Any

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.time_discretization import EQUILIBRIA
from fenicsx_obstacle.effects.field import Field, fields_in
from fenicsx_obstacle.estimation.edges import cut_parts
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.cells import barycentric, corners, own_cells
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.polynomials import halved

JUMPS = "jumps inside cells; lay edges of cells along the jump"  # of a datum, in messages
STEEP = "changes within a small part of a cell; refine there, or lay edges of cells along it"
IN_TIME = "jumps in time, perhaps within a step"
HALVINGS = 30  # of lengths: a Lipschitz function differs by 1e-9 of what it did, a root by 3e-5
JUMP = 1e-3  # of the range of the datum, from which on a difference that is left is a jump
LAYER, WITHIN = 0.25, 5  # of the range of the datum, after so many halvings: a line has 1/32, a root 0.18
ROUND_OFF = 1e-12  # of the values of a datum
PEAK, HIDDEN = 10, 0.01  # halvings of lengths, and part of the range of u, for obstacles above u between the nodes
BETWEEN = "an obstacle is beyond u between the nodes of the finest mesh; refine there"
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
    for field, cells, what in _jumps(data):
        if total(comm, np.count_nonzero(cells)) > 0:
            return f"{field.source} {what}"
    flat = mesh.geometry.dim == mesh.topology.dim and releases.cell_name(mesh) in SIMPLICES
    if flat and any(part.where is not None for part in data.model.boundary):
        of_p1 = data.level.coarse if data.level.pair.degree > 1 else None
        return next(iter(cut_parts(Simplices(data if of_p1 is None else data.on(of_p1)))), None)
    return None


def cells_with_jumps(data: Data) -> np.ndarray:
    """Whether a datum of effects and obstacles jumps inside each owned cell, or nearly so (collective)."""
    none = np.zeros(own_cells(data.level.mesh), dtype=bool)
    return np.logical_or.reduce([none, *(cells for _, cells, _ in _jumps(data))])


def hidden_contact(data: Data, u: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """Whether an obstacle in the domain is beyond u of P1 inside each owned cell without contact at nodes (collective).

    Args:
        data: Of the problem.
        u: Local values.
        touching: Whether each node is in contact.
    """
    level, mesh, dim = data.level, data.level.mesh, data.level.mesh.topology.dim
    count, dofs, given = own_cells(mesh), releases.cell_dofs(level.V), np.zeros(len(u), dtype=bool)
    given[data.fixed[0]] = True
    # along facets where u is given an obstacle may be beyond the interpolant of equal values
    free = ~touching[dofs].any(axis=1) & ((dim == 1) | (given[dofs].sum(axis=1) < dim))
    cells, limit = np.flatnonzero(free[:count]), HIDDEN * (largest(level.comm, u) - smallest(level.comm, u))
    found = np.zeros(count, dtype=bool)
    for sign, field in ((1.0, data.model.lower), (-1.0, data.model.upper)):
        if field is None:
            continue
        here, names = data.here(field), data.names(field)

        def beyond(x: np.ndarray, which: np.ndarray, sign: float = sign, here: Field = here, names: Any = names) -> Any:
            state = np.einsum("cij,cj->ci", barycentric(x, corners(mesh, which)), sign * u[dofs[which]])
            bounds = here.over(x[..., : mesh.geometry.dim], names, which)
            if bounds is None:
                heights = here.at(x.reshape(-1, 3).T, names, np.repeat(which, dim + 1)).reshape(-1, dim + 1)
                return (sign * heights - state).max(axis=1)
            return (bounds.once().upper if sign > 0 else -bounds.once().lower) - state.min(axis=1)

        found[_changing(corners(mesh, cells), cells, beyond, PEAK, limit)] = True
    return found


def _data(data: Data) -> list[Field]:
    """The data of effects and obstacles."""
    model = data.model
    on_parts = [obstacle for part in model.boundary for obstacle in (part.lower, part.upper)]
    return list(fields_in([model.lower, model.upper, *on_parts, *map(vars, model.effects)]))


def _jumps(data: Data) -> Iterator[tuple[Field, np.ndarray, str]]:
    """Each datum that may jump or be steep, whether it is so in each owned cell, and which of both (collective)."""
    level = data.level
    count = own_cells(level.mesh)
    for field in _data(data):
        for name, part in (field.parts or {"": field}).items():
            cells = level.groups[name] if field.parts is not None else np.arange(count)
            if not part.uniform:
                for found, what in _jumping(data, part, cells):
                    yield part, np.bincount(found, minlength=count) > 0, what


def _jumping(data: Data, field: Field, cells: np.ndarray) -> Iterator[tuple[np.ndarray, str]]:
    """Those of some owned cells in which a datum jumps, and those in which it is steep (collective)."""
    level, here, names = data.level, data.here(field), data.names(field)
    dim, gdim = level.mesh.topology.dim, level.mesh.geometry.dim
    x = corners(level.mesh, cells)
    simplices = _simplices(x + INSIDE * (x.mean(axis=1, keepdims=True) - x), dim)
    which, x = np.repeat(cells, simplices.shape[1]), simplices.reshape(-1, dim + 1, 3)

    def samples(x: np.ndarray, which: np.ndarray) -> np.ndarray:
        points = np.concatenate([x, x.mean(axis=1, keepdims=True)], axis=1)
        return here.at(points.reshape(-1, 3).T, names, np.repeat(which, dim + 2)).reshape(-1, dim + 2)

    def sampled(x: np.ndarray, which: np.ndarray) -> np.ndarray:
        return np.ptp(samples(x, which), axis=1)

    values = samples(x, which)
    values = values[np.isfinite(values)]
    range_of_values = largest(level.comm, values) - smallest(level.comm, values)
    varies = range_of_values > ROUND_OFF * largest(level.comm, np.abs(values))

    def known(x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """By how much it differs, where it has no condition that holds in a part of a simplex: 0."""
        found = None if field.moves else here.over(x[..., :gdim], names, which)
        if found is None:
            return sampled(x, which)
        bounds = found.once()
        return np.where(bounds.whole, 0.0, np.asarray(bounds.upper) - bounds.lower)

    if not field.continuous:
        yield _changing(x, which, known, HALVINGS, JUMP * range_of_values), JUMPS
    if varies:
        yield _changing(x, which, sampled, WITHIN, LAYER * range_of_values), STEEP


def _changing(
    x: np.ndarray,
    which: np.ndarray,
    differs: Callable[[np.ndarray, np.ndarray], np.ndarray],
    halvings: int,
    limit: float,
) -> np.ndarray:
    """Those of some cells in which a datum changes by more than a limit within a part (a number of collective calls
    that is the same on all ranks).

    The edges of each simplex are halved, and the part is kept in which the datum differs most.

    Args:
        x: Simplices, shape (n, dim + 1, 3).
        which: Their cells.
        differs: By how much the datum differs in each simplex.
        halvings: How often they are halved.
        limit: The change.
    """
    left = differs(x, which)
    for _ in range(halvings):  # as many on all ranks
        there, shape = ~(left <= limit), x.shape[1:]
        x, which, count = halved(x[there]), which[there], 2 ** (shape[0] - 1)
        differences = differs(x, np.repeat(which, count)).reshape(-1, count)
        rows, best = np.arange(len(which)), np.where(np.isnan(differences), -1.0, differences).argmax(axis=1)
        x, left = x.reshape(-1, count, *shape)[rows, best], differences[rows, best]
    return which[np.isfinite(left) & (left > limit)]


def _simplices(x: np.ndarray, dim: int) -> np.ndarray:
    """Cells divided into simplices, shape (cells, simplices, dim + 1, 3); quadrilaterals and hexahedra along a
    diagonal."""
    if x.shape[1] == dim + 1:
        return x[:, None]
    ways = [[0, *np.cumsum([1 << axis for axis in order])] for order in permutations(range(dim))]
    return x[:, ways]

"""Cell means of a tension that jumps within cells.

Of all numbers in a cell the mean makes the energy error least: with it the solution in P1 is that of Galerkin's method.
A soft value in a cell that is partly hard is the worst, its error is not bounded as the contrast grows.
"""

from __future__ import annotations

import basix
import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.samples import Samples
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.mesh.cells import corners
from fenicsx_obstacle.mesh.reference_cell import Reference
from fenicsx_obstacle.parallel import agree

JUMP = 1.1  # ratio of values in a cell: a datum that varies less counts as smooth
STEEP = 3.0  # of quadratics: positive values up to 4 on triangles, 4.5 on squares, 3.09 on cubes make them positive
INSET = 1e-6  # of the way to the middle: on the boundary of a cell the datum may be that of its neighbour
PARTS = {1: 64, 2: 8, 3: 4}  # of an edge, by dimension: powers of 2, so that coordinates are exact


def average(data: Samples, tension: Field, made: fem.Function) -> None:
    """Replace the values of a positive datum by its mean in cells in which it jumps (collective).

    Args:
        data: Of the mesh.
        tension: The datum.
        made: Its values in the cells, at one or more points of each.
    """
    dofs = releases.cell_dofs(made.function_space)
    at_dofs, x = made.x.array[dofs], corners(data.level.mesh)
    limit = JUMP if dofs.shape[1] == 1 else STEEP
    if not tension.everywhere:  # such as Functions of other meshes: only the given samples are used
        steep = at_dofs.max(axis=1, initial=0.0) > limit * at_dofs.min(axis=1, initial=np.inf)
        made.x.array[dofs[steep]] = at_dofs[steep].mean(axis=1)[:, None]
        return
    places, weights = _lattice(Reference(data.level.mesh))
    places = (1 - INSET) * places + INSET / x.shape[1]
    ends = (1 - INSET) * x + INSET * x.mean(axis=1, keepdims=True)
    with agree(data.level.comm):
        for cells, part in _by_material(data, tension, len(x)):
            values = np.column_stack([at_dofs[cells], _values(data, part, ends[cells], cells)])
            values = np.where(np.isfinite(values) & (values > 0), values, at_dofs[cells].mean(axis=1)[:, None])
            steep = cells[values.max(axis=1, initial=0.0) > limit * values.min(axis=1, initial=np.inf)]
            within = _values(data, part, places @ x[steep], steep)
            usable = np.isfinite(within) & (within > 0)  # others are rejected where they are used
            if limit == JUMP:
                jumps = _jumps(np.where(usable, within, at_dofs[steep]))
                steep, within, usable = steep[jumps], within[jumps], usable[jumps]
            mean = np.where(usable, within, 0.0) @ weights / np.maximum(usable @ weights, 1e-300)
            known = usable.any(axis=1)
            made.x.array[dofs[steep[known]]] = mean[known, None]
    made.x.scatter_forward()


def _jumps(values: np.ndarray) -> np.ndarray:
    """Whether positive values at many points of a cell form two separate groups, so that the datum jumps."""
    ordered = np.log(np.sort(values, axis=1))
    return np.diff(ordered, axis=1).max(axis=1, initial=0.0) > 0.5 * np.ptp(ordered, axis=1)


def _by_material(data: Samples, tension: Field, count: int) -> list[tuple[np.ndarray, Field]]:
    """Local cells, and the datum there."""
    if tension.parts is None:
        return [] if tension.uniform else [(np.arange(count), tension)]
    parts = [(np.unique(data.level.groups[name]), part) for name, part in tension.parts.items()]
    return [(cells, part) for cells, part in parts if not part.uniform]


def _values(data: Samples, datum: Field, points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """At points (cells, n, 3) of some cells, shape (cells, n)."""
    return data.at(datum, points.reshape(-1, 3).T, np.repeat(cells, points.shape[1])).reshape(points.shape[:2])


def _lattice(reference: Reference) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the vertices at points of a lattice, shape (points, vertices), and of these points in a mean.

    It is the vertex rule on equal parts of the cell, in tetrahedra nearly: a point has weight where it belongs to many
    parts, but those at the vertices of the cell have some too, so that no line or plane that cuts the cell is missed.
    """
    dim = reference.dim
    points = basix.create_lattice(reference.kind, PARTS[dim], basix.LatticeType.equispaced, True)
    places = reference.weights(points)
    if reference.simplex:
        share = {1: (1, 1 / 2), 2: (1, 1 / 2, 1 / 6), 3: (1, 1 / 2, 5 / 24, 1 / 24)}[dim]
        weights = np.array(share)[(places == 0).sum(axis=1)]
    else:
        weights = 0.5 ** ((points == 0) | (points == 1)).sum(axis=1)
    return places, weights / weights.sum()

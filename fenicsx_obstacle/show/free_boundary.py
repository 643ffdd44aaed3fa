"""The free boundary of nodal fields on simplices, by NumPy alone: the zero set of a nodal level function.

Off contact the gap grows like q d^2 / (2 tension) with the distance d to the free boundary, so its square root is
nearly linear there. At the nodes in contact it is continued beyond zero, and then averaged over neighbours: the line
between the nodes becomes smooth. It always runs between the nodes in contact and the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations
from typing import NamedTuple

import numpy as np

SIDES = {"lower": 1.0, "upper": -1.0}  # sign of the pressure of each obstacle
LEVELS = {"lower": "level lower", "upper": "level upper"}  # names of the level functions among the fields
AVERAGED = 2  # times that each value is replaced by the mean with its neighbours
CORNERS = 2  # edges from a pressed node to a corner of a solid whose faces are held: the first leads to an edge
# the level at a node knows the nodes so many edges away: one to tell contact, those of corners, two for the rise beside
# it, and means
RINGS = 3 + CORNERS + AVERAGED
FARTHEST = 1e20  # height of an obstacle in a picture where there is none
MIN_LEVEL = 0.02  # level of a node next to the line, in units of the level's usual rise from node to node


class Patch(NamedTuple):
    """Simplices with nodal fields.

    Attributes:
        points: Coordinates, shape (n, 3).
        cells: Nodes of each cell, shape (cells, k + 1): points, lines, triangles or tetrahedra.
        fields: Nodal values by name, each of shape (n,).
    """

    points: np.ndarray
    cells: np.ndarray
    fields: dict[str, np.ndarray]


def patch_of(arrays: Mapping[str, np.ndarray]) -> Patch:
    """A gathered answer with its nodal fields, and with the level function of each obstacle among them."""
    fields = {name: values for name, values in arrays.items() if name not in ("points", "cells", "gdim")}
    return with_levels(Patch(arrays["points"], arrays["cells"], fields))


def with_levels(patch: Patch, range_of_u: float | None = None) -> Patch:
    """The same with the level function of each obstacle: negative at nodes in contact with it, otherwise positive.

    At nodes in contact where u is given no pressure is known: it becomes the mean of the pressed neighbours.

    Args:
        patch: The whole mesh, or all cells within `RINGS` of the free boundary.
        range_of_u: Of part of a mesh, the difference of the largest and the least u on the whole of it.
    """
    names = [name for name in (*SIDES, "gap") if name in patch.fields]
    finite = {name: np.clip(patch.fields[name], -FARTHEST, FARTHEST) for name in names}
    fields, edges = {**patch.fields, **finite}, _edges(patch.cells)
    size = np.ptp(fields["u"]) if range_of_u is None else range_of_u
    for side in (side for side in SIDES if side in names):
        known = pressed(fields, side)
        given, corner = _given(fields, side, patch.cells, edges, size)
        for there in (given, *[corner] * CORNERS):
            a, b = edges[:, known[edges[1]]]
            near, has = _mean(a, fields["pressure"][b], len(known))
            held = has & ~known & there
            fields["pressure"] = np.where(held & (fields["pressure"] == 0), near, fields["pressure"])
            known = known | held
        fields[LEVELS[side]] = _level(np.minimum(gap(fields, side), size), known, edges)
    return Patch(patch.points, patch.cells, fields)


def free_boundary(patch: Patch) -> list[Patch]:
    """The free boundary of each obstacle that is touched, with all fields on it; levels are among the fields."""
    found = [zero(patch, patch.fields[level]) for level in LEVELS.values() if level in patch.fields]
    return [line for line in found if len(line.cells)]


def zero(patch: Patch, level: np.ndarray) -> Patch:
    """Where a nodal function vanishes: points in lines, lines in triangles, triangles in tetrahedra.

    Args:
        patch: Intervals, triangles or tetrahedra.
        level: Nodal values, none of them 0.

    Returns:
        The simplices of the zero set, one dimension lower, with interpolated fields; neighbours share their corners.
    """
    inside = level[patch.cells] < 0
    size, found = patch.cells.shape[1], list[np.ndarray]()
    for count in range(1, size):
        cut = np.flatnonzero(inside.sum(axis=1) == count)
        # the nodes inside first
        nodes = np.take_along_axis(patch.cells[cut], np.argsort(~inside[cut], axis=1, kind="stable"), axis=1)
        edges = np.stack([nodes[:, [i, j]] for i in range(count) for j in range(count, size)], axis=1)
        # a tetrahedron with two nodes inside is cut in a quadrilateral: two triangles
        found += [edges] if edges.shape[1] == size - 1 else [edges[:, [0, 1, 2]], edges[:, [1, 2, 3]]]
    corners, shape = np.sort(np.concatenate(found), axis=2), (len(level), len(level))
    names, cells = np.unique(np.ravel_multi_index(tuple(np.moveaxis(corners, 2, 0)), shape), return_inverse=True)
    a, b = np.unravel_index(names, shape)
    t = level[a] / (level[a] - level[b])
    fields = {name: values[a] + t * (values[b] - values[a]) for name, values in patch.fields.items()}
    points = patch.points[a] + t[:, None] * (patch.points[b] - patch.points[a])
    return Patch(points, cells.reshape(-1, corners.shape[1]), fields)


def rim(cells: np.ndarray) -> np.ndarray:
    """The sides that belong to one cell only: edges of triangles, triangles of tetrahedra."""
    size = cells.shape[1]
    sides = np.concatenate([np.delete(cells, i, axis=1) for i in range(size)])
    _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    return sides[first[count == 1]]


def gap(fields: Mapping[str, np.ndarray], side: str) -> np.ndarray:
    """Distance of u from an obstacle, 0 where it penetrates it."""
    return np.clip(SIDES[side] * (fields["u"] - fields[side]), 0.0, FARTHEST)


def pressed(fields: Mapping[str, np.ndarray], side: str) -> np.ndarray:
    """Whether an obstacle presses at each node."""
    touching = fields["contact"] > 0.5  # a mean between the points where pressures are computed
    if all(other in fields for other in SIDES):
        touching &= SIDES[side] * fields["pressure"] > 0
    return touching


def _given(
    fields: Mapping[str, np.ndarray], side: str, cells: np.ndarray, edges: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes where u is given as the obstacle itself, so that no pressure tells of contact, only that beside it.

    Returns:
        First all of them, then those at corners and edges of the mesh: no neighbour is inside of it.
    """
    given = ~pressed(fields, side) & (gap(fields, side) <= 1e-10 * size)
    if not given.any():
        return given, given
    inner = np.ones(len(given), dtype=bool)
    inner[rim(cells)] = False
    corner = given.copy()
    corner[edges[0, inner[edges[1]]]] = False
    return given, corner


def _level(distance: np.ndarray, touching: np.ndarray, edges: np.ndarray) -> np.ndarray:
    a, b = edges
    root = np.where(touching, 0.0, np.sqrt(distance))
    rise = np.zeros_like(root)
    np.maximum.at(rise, a, root[b] - root[a])
    rise = np.where(rise > 0, rise, 2 * root)  # where there is none, at the end of the mesh: halfway
    across = touching[a] & ~touching[b]
    step = max(np.median(rise[b[across]]) if across.any() else 0.0, np.finfo(float).tiny)
    inside, known = _mean(a[across], (root - rise)[b[across]], len(root))
    level = np.where(touching, np.where(known, np.minimum(inside, 0.0), -2 * step), root)
    for _ in range(AVERAGED):
        near, known = _mean(a, level[b], len(root))
        level = np.where(known, (level + near) / 2, level)
    return np.where(touching, np.minimum(level, -MIN_LEVEL * step), np.maximum(level, MIN_LEVEL * step))


def _mean(nodes: np.ndarray, values: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The mean of the values that each node has, and whether it has any."""
    count = np.bincount(nodes, minlength=size)
    return np.bincount(nodes, values, size) / np.maximum(count, 1), count > 0


def _edges(cells: np.ndarray) -> np.ndarray:
    """Both directions of all edges, shape (2, n)."""
    shape = (int(cells.max(initial=-1)) + 1,) * 2
    pairs = permutations(cells.T, 2)
    return np.array(np.unravel_index(np.unique([np.ravel_multi_index(pair, shape) for pair in pairs]), shape))

"""Levels of nodal functions on simplices: the part above a level, the level itself, gradients. NumPy alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

Fields = dict[str, np.ndarray]


class Patch(NamedTuple):
    """Simplices with their nodal fields.

    Attributes:
        points: Coordinates, shape (n, 3).
        cells: Nodes of each cell, shape (cells, k + 1): points, lines, triangles or tetrahedra.
        fields: Nodal values by name, each of shape (n,).
    """

    points: np.ndarray
    cells: np.ndarray
    fields: Fields


def zero(patch: Patch, level: np.ndarray) -> Patch:
    """Where a nodal function vanishes: points in lines, lines in triangles, triangles in tetrahedra.

    Args:
        patch: Intervals, triangles or tetrahedra.
        level: Nodal values; a value of exactly 0 counts as positive.

    Returns:
        The simplices of the level, one dimension lower, with interpolated fields.
    """
    inside = level[patch.cells] < 0
    size, found = patch.cells.shape[1], list[np.ndarray]()
    for count in range(1, size):
        mine = np.flatnonzero(inside.sum(axis=1) == count)
        # the nodes inside first
        nodes = np.take_along_axis(patch.cells[mine], np.argsort(~inside[mine], axis=1, kind="stable"), axis=1)
        edges = np.stack([nodes[:, [i, j]] for i in range(count) for j in range(count, size)], axis=1)
        if edges.shape[1] == size - 1:
            found.append(edges)
        else:  # a tetrahedron cut into two pairs of nodes: a quadrilateral, two triangles
            found += [edges[:, [0, 1, 2]], edges[:, [1, 2, 3]]]
    return _at_edges(patch, level, np.concatenate(found))


def above(patch: Patch, level: np.ndarray) -> Patch:
    """The part of a triangulated surface where a nodal function is not negative, cut along its zero level."""
    inside = level[patch.cells] >= 0
    count = inside.sum(axis=1)
    whole = patch.cells[count == 3]
    corners: list[np.ndarray] = [np.stack([whole, whole], axis=2)]  # a node is an edge from itself to itself
    for kept in (1, 2):
        mine = np.flatnonzero(count == kept)
        a, b, c = np.take_along_axis(patch.cells[mine], np.argsort(~inside[mine], axis=1, kind="stable"), axis=1).T
        if kept == 1:
            corners.append(np.stack([_edge(a, a), _edge(a, b), _edge(a, c)], axis=1))
        else:
            corners.append(np.stack([_edge(a, a), _edge(b, b), _edge(a, c)], axis=1))
            corners.append(np.stack([_edge(b, b), _edge(b, c), _edge(a, c)], axis=1))
    return _at_edges(patch, level, np.concatenate(corners))


def gradients(patch: Patch, values: np.ndarray) -> np.ndarray:
    """Gradient of a nodal function on each cell, tangential on surfaces in space; shape (cells, 3)."""
    corners = patch.points[patch.cells]
    edges = corners[:, 1:] - corners[:, :1]
    rises = values[patch.cells[:, 1:]] - values[patch.cells[:, :1]]
    gram = edges @ edges.transpose(0, 2, 1)
    return np.einsum("ci,cix->cx", np.linalg.solve(gram, rises[..., None])[..., 0], edges)


def boundary(patch: Patch) -> Patch:
    """The edges that belong to one triangle only, in its direction."""
    edges = np.concatenate([patch.cells[:, [0, 1]], patch.cells[:, [1, 2]], patch.cells[:, [2, 0]]])
    names = edges.min(axis=1) * len(patch.points) + edges.max(axis=1)
    _, first, count = np.unique(names, return_index=True, return_counts=True)
    return Patch(patch.points, edges[first[count == 1]], patch.fields)


def rims(patch: Patch, plane: tuple[int, int] = (0, 1)) -> list[np.ndarray]:
    """The closed lines that bound triangles in a plane, around holes as well.

    Args:
        patch: Triangles.
        plane: Numbers of the two coordinates.

    Returns:
        Corners of each line, shape (n, 2), with the triangles to the left.
    """
    points = patch.points[:, plane]
    x, y, z = points[patch.cells].transpose(1, 0, 2)
    left = np.linalg.det(np.stack([y - x, z - x], axis=1)) > 0
    oriented = Patch(patch.points, np.where(left[:, None], patch.cells, patch.cells[:, ::-1]), {})
    following: dict[int, list[int]] = {}
    for start, end in boundary(oriented).cells.tolist():
        following.setdefault(start, []).append(end)
    lines = []
    while following:
        line = [next(iter(following))]
        while line[-1] in following:
            ends = following[line[-1]]
            line.append(ends.pop())
            if not ends:
                del following[line[-2]]
        lines.append(points[line])
    return lines


def _edge(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a, b], axis=1)


def _at_edges(patch: Patch, level: np.ndarray, corners: np.ndarray) -> Patch:
    """Simplices whose corners lie where `level` vanishes on edges; corners has shape (cells, corners, 2)."""
    a, b = np.sort(corners, axis=2).transpose(2, 0, 1)
    # an end of an edge that lies on the level is the place, whichever edge leads to it
    a, b = np.where(level[b] == 0, b, a), np.where(level[a] == 0, a, b)
    names = a * len(level) + b
    distinct = np.all(np.diff(np.sort(names, axis=1), axis=1) > 0, axis=1)
    # neighbours share their corners, so that surfaces stay connected and shading smooth
    found, cells = np.unique(names[distinct], return_inverse=True)
    a, b = np.divmod(found, max(len(level), 1))
    drop = level[a] - level[b]
    t = np.where(drop == 0, 0.0, level[a] / np.where(drop == 0, 1.0, drop))

    def between(values: np.ndarray) -> np.ndarray:
        weight = t.reshape(-1, *[1] * (values.ndim - 1))
        return (1 - weight) * values[a] + weight * values[b]

    fields = {name: between(values) for name, values in patch.fields.items()}
    return Patch(between(patch.points), cells.reshape(-1, corners.shape[1]), fields)


def patch_of(arrays: Mapping[str, np.ndarray]) -> Patch:
    """A gathered answer as a patch with all its nodal fields."""
    fields = {name: values for name, values in arrays.items() if name not in ("points", "cells", "gdim")}
    return Patch(arrays["points"], arrays["cells"], fields)

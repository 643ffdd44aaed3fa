"""Sizes, heights and normals of simplices given by the coordinates of their corners."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.mesh.cells import cross, longest_edges, signed_volumes, volumes

# of a tetrahedron, the corners of the facet opposite to each vertex, so that their normal points inward
_FACETS = ((1, 3, 2), (0, 2, 3), (0, 3, 1), (0, 1, 2))


def inward(x: np.ndarray) -> np.ndarray:
    """d |T| grad phi_i: the facet opposite to each vertex as a vector that points inward, if the corners have a
    positive determinant.

    Args:
        x: Corners of d-dimensional simplices in space of d dimensions, shape (simplices, d + 1, d).

    Returns:
        By coordinates, shape (d, simplices, d + 1).
    """
    dim = x.shape[2]
    if dim == 1:
        return np.repeat(np.array([[[-1.0, 1.0]]]), len(x), axis=1)
    found = np.empty((dim, len(x), dim + 1))
    if dim == 2:
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            # the edge from the vertex after i to the one before, turned to the left
            np.subtract(x[:, j, 1], x[:, k, 1], out=found[0, :, i])
            np.subtract(x[:, k, 0], x[:, j, 0], out=found[1, :, i])
        return found
    for i, (j, k, m) in enumerate(_FACETS):
        for axis, part in enumerate(cross(x[:, k] - x[:, j], x[:, m] - x[:, j])):
            found[axis, :, i] = part / 2
    return found


def gradients(x: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Gradients of linear functions, shape (d, simplices); infinite where a part has no size, up to round-off.

    Args:
        x: Corners, as of `inward`.
        values: At the corners, shape (simplices, d + 1).
    """
    size, found = x.shape[2] * signed_volumes(x), np.full((x.shape[2], len(x)), np.inf)
    return np.divide(np.einsum("xsk,sk->xs", inward(x), values), size, out=found, where=size != 0)


def sizes(x: np.ndarray) -> np.ndarray:
    """Length, area or volume of simplices, which may lie in a space of more dimensions; 1 for points."""
    return np.abs(signed_volumes(x)) if x.shape[1] == x.shape[2] + 1 else volumes(x)


def least_heights(x: np.ndarray, longest: np.ndarray | None = None) -> np.ndarray:
    """The least height of each simplex, 0 where a part has none; from the longest edges, if they are known."""
    corners = x.shape[1]
    if corners <= 3:
        base = longest_edges(x) if longest is None else longest
        if corners == 2:
            return base
    else:
        base = np.max([sizes(np.delete(x, k, axis=1)) for k in range(4)], axis=0, initial=0.0)
    return np.divide((corners - 1) * sizes(x), base, out=np.zeros(len(x)), where=base > 0)

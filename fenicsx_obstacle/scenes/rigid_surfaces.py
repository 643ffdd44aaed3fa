"""Gaps of elastic bodies to rigid boxes, measured heights and STL surfaces, at points along directions.

A gap is the length from a point along its direction n to the surface, negative where the point is beyond it, and
infinite where the line meets no surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from mpi4py import MPI
from scipy.linalg import null_space

from fenicsx_obstacle.data.measured.surface import MeasuredField
from fenicsx_obstacle.data.measured.triangulated import Triangulated
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import agree, largest

ALONG = 1e-12  # a component of a unit vector that is 0
ONE = 1e-6  # difference of unit vectors that are one direction
CLOSED = 1e-5  # of the area: what the area vectors of a closed surface add up to
MOST_STEPS = 200  # of the search for the point of a table along n
SETTLED = 1e-12  # relative difference of the last two of them


def box_gap(
    points: np.ndarray, normals: np.ndarray, centre: np.ndarray, sizes: Sequence[float], near: float
) -> np.ndarray:
    """Gaps to a box with sides along the axes.

    Args:
        points: Shape (n, gdim).
        normals: Directions n, shape (n, gdim).
        centre: Of the box.
        sizes: Its lengths along the axes.
        near: How far a line may pass beside the box, so that one along a side meets it.
    """
    there, half = centre - points, np.array(sizes) / 2
    across = np.abs(normals) <= ALONG
    safe = np.where(across, 1.0, normals)
    ends = (there - half) / safe, (there + half) / safe
    beside = np.abs(there) > half + near
    enters = np.where(across, np.where(beside, np.inf, -np.inf), np.minimum(*ends)).max(axis=1)
    leaves = np.where(across, np.where(beside, -np.inf, np.inf), np.maximum(*ends)).min(axis=1)
    return np.where(enters <= leaves + near, enters, np.inf)


def table_gap(
    heights: MeasuredField, comm: MPI.Comm, points: np.ndarray, normals: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """Gaps to the surface whose last coordinate is a table of the others (collective).

    Args:
        heights: The table.
        comm: Ranks of the mesh.
        points: Shape (n, gdim).
        normals: Directions n, shape (n, gdim).
        shift: How far the surface has moved, shape (gdim,).

    Raises:
        InputError: If the table has too many columns, a line along n leaves the data, or may meet the surface more than
            once.
    """
    if points.shape[1] == 2 and not heights.along_x:
        raise InputError(f"{heights.source}: in the plane a table has the columns x, z alone")
    where = points - shift
    up, size = normals[:, -1], largest(comm, np.abs(where))
    found, bad, moves = np.zeros(len(points)), np.abs(up) <= ALONG, np.ones(len(points), dtype=bool)
    for _ in range(MOST_STEPS):
        if bad.any() or not moves.any():
            break
        x = np.zeros((3, len(points)))
        x[: points.shape[1] - 1] = (where + found[:, None] * normals).T[:-1]
        before, found = found, (heights.at(x, {}) - where[:, -1]) / up
        bad = np.isnan(found)  # outside the data
        moves = np.abs(found - before) > SETTLED * (size + np.abs(found))
    with agree(comm):
        if (bad | moves).any():
            place = ", ".join(f"{x:.6g}" for x in points[np.argmax(bad if bad.any() else moves)])
            raise InputError(
                f"{heights.source}: the line along n from ({place}) does not meet the data in one point"
                f"{heights.because(np.zeros(3), {})}; give data that reach farther, or 'along' for a steeper n"
            )
    return found


def facets_gap(
    surface: MeasuredField, comm: MPI.Comm, points: np.ndarray, normals: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """The gap to the facets of an STL surface that face a body, seen along the one direction of all nodes, as a
    function of how far the surface has moved (collective).

    Corners of facets are counter-clockwise when seen from outside the obstacle.

    Raises:
        InputError: If the directions differ, or no facet faces the body.
    """
    direction = next(one[0] for one in comm.allgather(normals[:1]) if len(one))  # from the body to the obstacle
    if largest(comm, np.abs(normals - direction)) > ONE:
        raise InputError(
            f"{surface.source}: the boundary of the body is curved; give 'along', the direction of the gap"
        )
    assert surface.facets is not None
    facets, across = surface.facets, null_space(direction[None])
    outward = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    volume = np.sum((facets[:, 0] - facets[0, 0]) * outward) / 6  # heights of pyramids with one apex
    closed = np.linalg.norm(outward.sum(axis=0)) < CLOSED * np.linalg.norm(outward, axis=1).sum()
    inside_out = closed and volume < 0
    corners = facets[(outward @ direction < 0) & (not inside_out)].reshape(-1, 3)
    try:
        nearest = Triangulated(corners @ across, -corners @ direction, np.arange(len(corners)).reshape(-1, 3))
    except ValueError:
        raise InputError(
            f"{surface.source}: no facet faces the body along n = [{', '.join(f'{x:g}' for x in direction)}]; the "
            "normals of an STL surface must point out of the obstacle"
        ) from None

    def to_nearest(shift: np.ndarray) -> np.ndarray:
        found = -nearest.at((points - shift) @ across) - (points - shift) @ direction
        return np.where(np.isnan(found), np.inf, found)

    return to_nearest

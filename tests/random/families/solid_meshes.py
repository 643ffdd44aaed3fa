"""Meshes of tetrahedra: boxes, Fichera's corner, an L-shaped prism, random points; sheared and flattened ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import permutations, product
from random import Random
from typing import Any

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI
from scipy.spatial import Delaunay

from fenicsx_obstacle import releases

BOXES = (
    {"x": [-1.0, 1.0], "y": [-1.0, 1.0], "z": [-1.0, 1.0]}, {"x": [0.0, 1.0], "y": [-0.5, 0.5], "z": [0.0, 0.4]},
    {"x": [-1.0, 0.3], "y": [-0.4, 0.6], "z": [-0.7, 0.5]},
)  # fmt: skip
# octants of a cube, by the signs of the coordinates, that are not in the domain
MISSING: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "cube": lambda positive: np.zeros(len(positive), dtype=bool),
    "fichera": lambda positive: positive.all(axis=1),
    "prism": lambda positive: positive[:, :2].all(axis=1),
}
FLAT = 1e-10  # volume over that of a cell of the grid: four points on one side of the cube
FACES = ([1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2])


def octants(shape: str, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra of the cube |x|, |y|, |z| <= 1, or of a part of it.

    Args:
        shape: A key of `MISSING`.
        half: Cubes along each half side, each of six tetrahedra.
    """
    count = 2 * half + 1
    corners = np.array(list(product(range(2 * half), repeat=3)))
    corners = corners[~MISSING[shape](corners >= half)]
    unit = np.eye(3, dtype=int)
    steps = np.array([np.cumsum([[0, 0, 0], *unit[list(order)]], axis=0) for order in permutations(range(3))])
    cells = ((corners[:, None, None] + steps[None]) @ [count**2, count, 1]).reshape(-1, 4)
    used, cells = np.unique(cells, return_inverse=True)
    return np.array(list(product(range(count), repeat=3)))[used] / half - 1.0, cells.reshape(-1, 4)


def random_points(cells: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra of the cube |x|, |y|, |z| <= 1: Delaunay's, of a grid whose points are moved.

    Args:
        cells: Along each side of the grid.
        seed: Of the drawing.
    """
    grid = np.array(list(product(range(cells + 1), repeat=3))) * 2.0 / cells - 1.0
    free = np.abs(grid) < 1 - 1 / cells
    points = grid + np.random.default_rng(seed).uniform(-0.35, 0.35, grid.shape) * 2 / cells * free
    found = Delaunay(points).simplices
    edges = points[found[:, 1:]] - points[found[:, :1]]
    return points, found[np.abs(np.linalg.det(edges)) > FLAT * (2 / cells) ** 3]


def scattered(points: np.ndarray, cells: np.ndarray, by: float, seed: int) -> np.ndarray:
    """The points, with those inside moved by up to `by` along each axis."""
    facets, counts = np.unique(np.sort(np.concatenate([cells[:, face] for face in FACES])), axis=0, return_counts=True)
    inside = np.ones(len(points))
    inside[facets[counts == 1]] = 0.0
    return points + by * np.random.default_rng(seed).uniform(-1, 1, points.shape) * inside[:, None]


def tetrahedra(comm: MPI.Comm, points: np.ndarray, cells: np.ndarray) -> dmesh.Mesh:
    """A mesh of points and tetrahedra that all ranks have (collective)."""
    first = comm.rank == 0
    return releases.create_mesh(comm, cells if first else cells[:0], points if first else points[:0], "tetrahedron")


def solid(table: dict[str, Any], comm: MPI.Comm) -> Any:
    """A table [mesh] as it is, or the mesh that a table of `solids` stands for (collective)."""
    if table["shape"] == "box":
        return table
    if table["shape"] == "random points":
        points, cells = random_points(table["cells"], table["seed"])
    else:
        points, cells = octants(table["shape"], table["cells"])
        points = scattered(points, cells, table["scatter"] / table["cells"], table["seed"])
    points = points * [1.0, 1.0, table["flat"]]
    points[:, 0] += table["slope"] * points[:, 1]
    return tetrahedra(comm, points, cells)


def solids(rng: Random) -> dict[str, Any]:
    """The table [mesh] of a box, or what `solid` takes; at most 1e4 vertices."""
    shape, fine = rng.choice(["box", "box", "cube", "fichera", "prism", "random points"]), rng.random() < 0.1
    if shape == "box":
        cells = rng.choice([9, 10, 12, 14, 17, 20]) if fine else rng.randint(2, 8)
        return {"shape": shape, **rng.choice(BOXES), "cells": cells, "perturb": rng.choice([0.0, 0.1, 0.2])}
    low, high = (4, 10) if shape == "random points" else (1, 4)
    cells = rng.randint(high, 2 * high) if fine else rng.randint(low, high)
    return {"shape": shape, "cells": cells, "seed": rng.randrange(10**6), "slope": rng.choice([0.0, 0.0, 0.7, -1.5]),
            "flat": rng.choice([1.0, 1.0, 0.3, 0.1]), "scatter": rng.choice([0.0, 0.1, 0.2])}  # fmt: skip


def inscribed_ball(table: dict[str, Any]) -> tuple[list[float], float]:
    """Centre and radius of a ball in the domain of a table of `solids`."""
    if table["shape"] == "box":
        ends = [table[axis] for axis in "xyz"]
        return [(low + high) / 2 for low, high in ends], min((high - low) / 2 for low, high in ends)
    half = 0.5 if table["shape"] in ("fichera", "prism") else 1.0
    corner = half - 1.0  # of the cubes around it, by its centre
    return [corner * (1 + table["slope"]), corner, corner * table["flat"]], half * min(
        table["flat"], 1 / math.hypot(1, table["slope"])
    )

"""The quadrature of data on simplices, and cells in parts that fit into memory."""

from __future__ import annotations

from collections.abc import Iterator

import basix
import numpy as np

CELLS = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}  # by dimension
DEGREE = 6  # exact solutions have kinks in their second derivatives
AT_ONCE = 25_000  # cells: a few numbers for each fit into the cache of a core


def rule(dim: int, degree: int = DEGREE) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points, shape (n, dim + 1), and weights of sum 1 on a simplex; exact for this degree."""
    if dim == 0:
        return np.ones((1, 1)), np.ones(1)
    points, weights = basix.make_quadrature(CELLS[dim], degree)
    return np.column_stack([1 - points.sum(axis=1), points]), weights / weights.sum()


def blocks(count: int, at_once: int = AT_ONCE) -> Iterator[slice]:
    """Slices of at most so many cells."""
    for start in range(0, count, at_once):
        yield slice(start, min(start + at_once, count))

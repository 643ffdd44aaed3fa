"""Symmetric systems with few unknowns, one for each vertex patch, solved together.

A corner of a cell knows some of the unknowns of its patch. Matrices and right sides are sums over the corners.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

FLAT = (
    1e-13  # of the mean diagonal: keeps matrices of flat cells, and of vertices where parts of the mesh meet, regular
)


class PatchSystems:
    """The inverse matrices of all systems of this rank; nothing here is collective."""

    def __init__(
        self,
        numbers: np.ndarray,
        owner: np.ndarray,
        zero: np.ndarray,
        products: Iterable[tuple[int, int, np.ndarray]],
        *,
        up_to_constants: bool = False,
    ):
        """Sum and invert the matrices; unknowns of systems of the same size follow each other.

        Args:
            numbers: Of the unknowns at the corners, shape (corners, n).
            owner: The system of each unknown.
            zero: Whether an unknown is 0.
            products: Of two of the n unknowns at a corner, i <= j, the entries of the matrix there, shape (corners,).
            up_to_constants: Whether the right side says nothing about the mean of the unknowns of a system, which is
                then 0 if no unknown is.
        """
        count = len(owner)
        sizes_of = np.bincount(owner)
        size = sizes_of[owner]
        order = np.lexsort((owner, size))
        place = np.empty(count, dtype=np.int64)
        place[order] = np.arange(count)
        sizes, many = np.unique(sizes_of[sizes_of > 0], return_counts=True)
        starts = np.concatenate([[0], np.cumsum(sizes * many)]).astype(np.int64)
        blocks = np.concatenate([[0], np.cumsum(sizes**2 * many)]).astype(np.int64)  # matrices, one after the other
        group = np.searchsorted(sizes, size)
        within = place - starts[group]  # among the unknowns of systems of the same size
        row, column = blocks[group] + within * size, within % size
        values = np.zeros(blocks[-1])
        for i, j, entries in products:
            for k, m in {(i, j), (j, i)}:
                values += np.bincount(row[numbers[:, k]] + column[numbers[:, m]], entries, len(values))
        self._place, self._zero = place[numbers], zero[order]
        self._inverses = []
        for g, (n, systems) in enumerate(zip(sizes.tolist(), many.tolist(), strict=True)):
            matrix = values[blocks[g] : blocks[g + 1]].reshape(systems, n, n)
            is_zero = self._zero[starts[g] : starts[g + 1]].reshape(systems, n)
            matrix = _regular(matrix, is_zero, up_to_constants=up_to_constants)
            self._inverses.append(1 / matrix if n == 1 else np.linalg.inv(matrix))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The unknowns at the corners, shape (n, corners).

        Args:
            right: The right sides there, of the same shape.
        """
        sums = np.bincount(self._place.ravel(), right.T.ravel(), len(self._zero))
        sums[self._zero] = 0.0
        found, start = np.empty(len(sums)), 0
        for inverse in self._inverses:
            systems, n = inverse.shape[:2]
            end = start + systems * n
            found[start:end] = np.matmul(inverse, sums[start:end].reshape(systems, n, 1)).ravel()
            start = end
        return found[self._place].T


def _regular(matrix: np.ndarray, zero: np.ndarray, *, up_to_constants: bool) -> np.ndarray:
    """Matrices with what makes them regular, shape (systems, n, n).

    Args:
        matrix: As the products have them.
        zero: Unknowns that are 0, shape (systems, n).
        up_to_constants: As of `PatchSystems`.
    """
    diagonal = np.arange(matrix.shape[1])
    mean, held = matrix[:, diagonal, diagonal].mean(axis=1), zero.any(axis=1)
    if up_to_constants:
        matrix[:, diagonal, diagonal] += FLAT * mean[:, None]
        matrix[~held] += (mean[~held] / len(diagonal))[:, None, None]
    rows = np.flatnonzero(held)
    kept = ~zero[rows]
    matrix[rows] *= kept[:, :, None] & kept[:, None]
    matrix[rows[:, None], diagonal, diagonal] += zero[rows] * mean[rows, None]
    return matrix

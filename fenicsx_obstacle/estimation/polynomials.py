"""Polynomials on intervals, triangles and tetrahedra in Bernstein form, whose coefficients bound them.

A polynomial lies between its smallest and its largest Bernstein coefficient; at the vertices it equals the coefficient
there, so that the bounds of affine functions are exact. Coefficients are found from values inside the simplex: a
formula with conditions may have another value on the boundary of the cell.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import factorial, prod

import numpy as np

MAX_DEGREE = 8
INSET = 0.1  # of the way from the points of the lattice to the middle
_EPSILON = float(np.finfo(float).eps)


@cache
def inner_points(corners: int, degree: int) -> np.ndarray:
    """Barycentric coordinates of points inside that determine a polynomial, shape (points, corners)."""
    if degree == 0:
        return np.full((1, corners), 1.0 / corners)
    return (1 - INSET) * _exponents(corners, degree) / degree + INSET / corners


def coefficients(values: np.ndarray, corners: int, degree: int) -> np.ndarray:
    """Bernstein coefficients from values at `inner_points`, shape (simplices, points)."""
    return values @ _to_bernstein(corners, degree).T


def bounds(values: np.ndarray, corners: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of polynomials over their simplices, with a margin for round-off.

    Args:
        values: At `inner_points`, shape (simplices, points).
        corners: 2 for intervals, 3 for triangles, 4 for tetrahedra.
        degree: At most `MAX_DEGREE`.
    """
    found = coefficients(values, corners, degree)
    margin = round_off(values, corners, degree)
    return found.min(axis=1) - margin, found.max(axis=1) + margin


def round_off(values: np.ndarray, corners: int, degree: int) -> np.ndarray:
    """Largest error of the coefficients if values are right up to a few units of round-off."""
    amplified = np.abs(_to_bernstein(corners, degree)).sum(axis=1).max()
    return 8 * _EPSILON * amplified * np.abs(values).max(axis=1, initial=0.0)


def evaluate(coefficients: np.ndarray, points: np.ndarray, degree: int) -> np.ndarray:
    """Values at barycentric points, shape (simplices, points)."""
    return coefficients @ _basis(points, degree).T


@cache
def _exponents(corners: int, degree: int) -> np.ndarray:
    found = [steps for steps in product(range(degree, -1, -1), repeat=corners) if sum(steps) == degree]
    return np.array(found, dtype=float)


def _basis(points: np.ndarray, degree: int) -> np.ndarray:
    """Values of the Bernstein polynomials, shape (points, polynomials)."""
    exponents = _exponents(points.shape[1], degree)
    times = [factorial(degree) / prod(factorial(int(k)) for k in row) for row in exponents]
    return np.prod(points[:, None, :] ** exponents[None], axis=2) * np.array(times)


@cache
def _to_bernstein(corners: int, degree: int) -> np.ndarray:
    return np.linalg.inv(_basis(inner_points(corners, degree), degree))

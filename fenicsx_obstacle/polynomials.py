"""Polynomials on intervals, triangles and tetrahedra in Bernstein form, whose coefficients bound them; their parts.

A polynomial lies between its smallest and its largest Bernstein coefficient; at the vertices it equals the coefficient
there, so that the bounds of affine functions are exact. Coefficients are found from values inside the simplex: a
formula with conditions may have another value on the boundary of the cell.
"""

from __future__ import annotations

from functools import cache, lru_cache, reduce
from itertools import product
from math import comb, factorial, prod

import numpy as np

MAX_DEGREE = 8
SPLITS = 2
AT_ONCE = 1024  # simplices: what is made of them fits into the cache of a core
INSET = 0.1  # of the way from the points of the lattice to the middle
# |f - I f| <= REMAINDER h^n max|D^n f|/n!, n = degree + 1, for the interpolant at `inner_points`, h the longest edge,
# since f - I f = -sum_i L_i(x) D^n f(..)(a_i - x)^n/n! (Ciarlet and Raviart 1972); by corners of the simplex and degree
REMAINDER = {2: {1: 0.203, 2: 0.0825, 4: 0.179}, 3: {1: 0.361, 2: 0.149, 4: 0.298}, 4: {1: 0.456, 2: 0.291, 4: 0.374}}
# and |grad(f - I f)| <= STEEPNESS h^n max|D^n f|/n!/H, H the least height
STEEPNESS = {2: {2: 1.79, 4: 4.77}, 3: {2: 3.82, 4: 10.9}, 4: {2: 6.27, 4: 21.0}}
_EPSILON = float(np.finfo(float).eps)

# a simplex with vertices 0..dim and the middles of its edges after them: edges, children at the corners, the rest
EDGES = {
    1: [(0, 1)],
    2: [(1, 2), (0, 2), (0, 1)],
    3: [(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)],
}
_CORNERS: dict[int, list[tuple[int, ...]]] = {
    1: [(0, 2), (2, 1)],
    2: [(0, 5, 4), (5, 1, 3), (4, 3, 2)],
    3: [(0, 9, 8, 7), (9, 1, 6, 5), (8, 6, 2, 4), (7, 5, 4, 3)],
}
# children inside: the diagonal they share, and the ring of edges around it; of a tetrahedron there are three choices
RING: dict[int, dict[tuple[int, ...], list[tuple[int, ...]]]] = {
    1: {(): []},
    2: {(): [(3, 4, 5)]},
    3: {
        (4, 9): [(5, 6), (6, 8), (8, 7), (7, 5)],
        (5, 8): [(4, 6), (6, 9), (9, 7), (7, 4)],
        (6, 7): [(4, 5), (5, 9), (9, 8), (8, 4)],
    },
}
# shape (choices, children, dim + 1)
CHILDREN = {
    dim: np.array([_CORNERS[dim] + [(*d, *edge) for edge in ring] for d, ring in RING[dim].items()], dtype=np.int8)
    for dim in EDGES
}


@cache
def inner_points(corners: int, degree: int) -> np.ndarray:
    """Barycentric coordinates of points inside that determine a polynomial, shape (points, corners)."""
    if degree == 0:
        return np.full((1, corners), 1.0 / corners)
    return (1 - INSET) * exponents(corners, degree) / degree + INSET / corners


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
    return row_min(found) - margin, row_max(found) + margin


def row_min(values: np.ndarray) -> np.ndarray:
    """The least value of each row: several times faster than `values.min(axis=1)` where rows are short."""
    return reduce(np.minimum, values.T, np.inf)  # type: ignore[arg-type]


def row_max(values: np.ndarray) -> np.ndarray:
    """The largest value of each row."""
    return reduce(np.maximum, values.T, -np.inf)  # type: ignore[arg-type]


def row_size(values: np.ndarray) -> np.ndarray:
    """The largest absolute value of each row."""
    return np.maximum(row_max(values), -row_min(values))


def largest(coefficients: np.ndarray, corners: int, degree: int) -> np.ndarray:
    """An upper bound of polynomials over their simplices, sharper than the largest coefficient: on parts of the simplex
    the coefficients are nearer to the values."""
    if degree < 2:
        return row_max(coefficients)
    found, on_parts = np.empty(len(coefficients)), _on_parts(corners, degree)
    for start in range(0, len(coefficients), AT_ONCE):
        some = slice(start, start + AT_ONCE)
        np.max(on_parts @ coefficients[some].T, axis=0, out=found[some])
    return found


@cache
def _on_parts(corners: int, degree: int) -> np.ndarray:
    """Coefficients on the parts of a simplex with its edges halved `SPLITS` times from those on all of it, once each:
    neighbours share those on the side between them."""
    found = to_parts(halvings(corners, SPLITS), degree)
    found = found.reshape(-1, found.shape[2])
    return found[np.unique(found.round(9), axis=0, return_index=True)[1]]


def to_parts(parts: np.ndarray, degree: int) -> np.ndarray:
    """Bernstein coefficients on parts of a simplex from those on all of it, shape (parts, n, n).

    Args:
        parts: Barycentric coordinates of their corners, shape (parts, corners, corners).
        degree: Of the polynomials.
    """
    corners = parts.shape[1]
    inside = (inner_points(corners, degree) @ parts).reshape(-1, corners)
    count = len(exponents(corners, degree))
    values = _basis(inside, degree).reshape(len(parts), count, count)
    return _to_bernstein(corners, degree) @ values


def halved(corners: np.ndarray) -> np.ndarray:
    """Segments in two, triangles in four, tetrahedra in eight: the parts of one follow each other.

    The octahedron inside a tetrahedron is cut around its diagonal from the middle of edge (0, 2) to that of (1, 3).

    Args:
        corners: Coordinates of the corners, or linear functions there, shape (simplices, corners, ...).
    """
    dim = corners.shape[1] - 1
    middles = [(corners[:, i] + corners[:, j]) / 2 for i, j in EDGES[dim]]
    nodes = np.concatenate([corners, np.stack(middles, axis=1)], axis=1)
    return nodes[:, CHILDREN[dim][1 if dim == 3 else 0]].reshape(-1, *corners.shape[1:])


@cache
def halvings(corners: int, times: int) -> np.ndarray:
    """Barycentric coordinates of the corners of the parts of a simplex with its edges halved so many times, the parts
    of one parent consecutive, shape (parts, corners, corners)."""
    parts = np.eye(corners)[None]
    for _ in range(times):
        parts = halved(parts)
    return parts


def round_off(values: np.ndarray, corners: int, degree: int) -> np.ndarray:
    """Largest error of the coefficients if values are right up to a few units of round-off."""
    amplified = np.abs(_to_bernstein(corners, degree)).sum(axis=1).max()
    return 8 * _EPSILON * amplified * row_size(values)


def degree_of(count: int, corners: int) -> int:
    """Degree of polynomials on simplices with so many coefficients."""
    return next(degree for degree in range(count) if comb(degree + corners - 1, degree) == count)


def evaluate(coefficients: np.ndarray, points: np.ndarray, degree: int) -> np.ndarray:
    """Values at barycentric points, shape (simplices, points)."""
    return coefficients @ _basis_at(points.tobytes(), points.shape[1], degree).T


@lru_cache(64)
def _basis_at(points: bytes, corners: int, degree: int) -> np.ndarray:
    """Values of the Bernstein polynomials at few points, which are asked for again and again."""
    return _basis(np.frombuffer(points).reshape(-1, corners), degree)


@cache
def raised(corners: int, degree: int, to: int) -> np.ndarray:
    """Bernstein coefficients of a degree from those of one that is no higher, in a matrix."""
    return _to_bernstein(corners, to) @ _basis(inner_points(corners, to), degree)


def combined(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums of values of shape (simplices, n) with weights of shape (simplices or 1, points, n): (simplices, points)."""
    return values @ weights[0].T if len(weights) == 1 else np.matmul(weights, values[..., None])[..., 0]


def restricted(coefficients: np.ndarray, parts: np.ndarray, degree: int) -> np.ndarray:
    """Bernstein coefficients of polynomials on parts of their simplices.

    Args:
        coefficients: On the simplices, shape (parts, n).
        parts: Barycentric coordinates of the corners of the parts, shape (parts, corners, corners).
        degree: Of the polynomials.
    """
    found = np.empty(coefficients.shape)
    for first in range(0, len(parts), AT_ONCE):
        rows = slice(first, first + AT_ONCE)
        found[rows] = np.matmul(to_parts(parts[rows], degree), coefficients[rows, :, None])[..., 0]
    return found


def slopes(coefficients: np.ndarray, corners: int, degree: int) -> np.ndarray:
    """Bernstein coefficients of the derivatives along the barycentric coordinates, shape (simplices, corners, ...)."""
    return degree * coefficients[:, _raised(corners, degree)]


def from_chords(parts: np.ndarray, degree: int) -> np.ndarray:
    """Bernstein coefficients of polynomials less their chords on parts of a simplex, from those on all of it.

    Args:
        parts: Barycentric coordinates of the corners, shape (parts, corners, corners).
        degree: Of the polynomials, 1 at least.

    Returns:
        Shape (parts, n, n).
    """
    at_corners = _basis(parts.reshape(-1, parts.shape[2]), degree).reshape(*parts.shape[:2], -1)
    return to_parts(parts, degree) - exponents(parts.shape[2], degree) / degree @ at_corners


@cache
def _raised(corners: int, degree: int) -> np.ndarray:
    """Where the exponents of one degree less, each of them raised by one, stand, shape (corners, polynomials)."""
    place = {tuple(row): k for k, row in enumerate(exponents(corners, degree))}
    lower = exponents(corners, degree - 1)
    return np.array([[place[tuple(row + unit)] for row in lower] for unit in np.eye(corners)])


@cache
def exponents(corners: int, degree: int) -> np.ndarray:
    """Those of the Bernstein polynomials, in their order: barycentric coordinates of a lattice, times the degree."""
    found = [steps for steps in product(range(degree, -1, -1), repeat=corners) if sum(steps) == degree]
    return np.array(found, dtype=float)


def _basis(points: np.ndarray, degree: int) -> np.ndarray:
    """Values of the Bernstein polynomials, shape (points, polynomials)."""
    steps = exponents(points.shape[1], degree).astype(int)
    times = [factorial(degree) / prod(factorial(k) for k in row) for row in steps.tolist()]
    powers = np.stack([points**k for k in range(degree + 1)])
    factors = (powers[k, :, corner] for corner, k in enumerate(steps.T))
    return reduce(np.multiply, factors, np.array(times)[:, None]).T


@cache
def _to_bernstein(corners: int, degree: int) -> np.ndarray:
    return np.linalg.inv(_basis(inner_points(corners, degree), degree))

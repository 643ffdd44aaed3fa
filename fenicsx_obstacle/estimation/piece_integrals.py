"""Means of a datum in simplices, and its distance to linear functions, from polynomials on parts of the simplices.

The datum is q + r, q polynomials and |r| bounded on each part (`pieces`). Where no bound of r is known, r counts 0:
what makes of the datum a bound, has a word about these places. Integrals may have a linear weight, as in axial
symmetry, which is given at the corners of the simplices; then means are divided by that of the weight.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.simplices import integrals, reciprocals

LOWEST = -1e300  # where no lower bound is known


def mean(pieces: Pieces, factor: np.ndarray, radius: np.ndarray | None = None) -> np.ndarray:
    """The mean of q times a linear function over each simplex.

    Args:
        pieces: The datum.
        factor: The linear functions at the corners, shape (simplices, corners).
        radius: The weight of integrals there, if there is one.
    """
    found = np.zeros(len(factor))
    for part in pieces.portions():
        points, weights = rule(factor.shape[1] - 1, part.degree + 1 + (radius is not None))
        values = part.values(points) * polynomials.combined(part.points(points), factor[part.rows])
        part.add_to(found, part.share * integrals(values, part.weights(points, weights, radius)))
    return found if radius is None else found * reciprocals(radius.mean(axis=1))


def distance(
    pieces: Pieces, linear: np.ndarray, radius: np.ndarray | None = None, factor: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """How far a datum, times a factor, is from linear functions: ||.||_T/|T|^(1/2) in each simplex T.

    Args:
        pieces: The datum.
        linear: The linear functions at the corners, shape (simplices, corners).
        radius: The weight of integrals there, if there is one.
        factor: Linear functions that are factors of the datum; None: it has none.

    Returns:
        The norm of the difference for q, and a bound of that of r times the factor.
    """
    squares, rests = np.zeros(len(linear)), np.zeros(len(linear))
    for part in pieces.portions():
        degree = max(part.degree + (factor is not None), 1)
        points, weights = rule(linear.shape[1] - 1, 2 * degree + (radius is not None))
        inside, values, rest = part.points(points), part.values(points), part.known_rest
        if factor is not None:
            values = values * polynomials.combined(inside, factor[part.rows])
            rest = rest * polynomials.row_size(factor[part.rows])
        apart = values - polynomials.combined(inside, linear[part.rows])
        part.add_to(squares, part.share * integrals(apart**2, part.weights(points, weights, radius)))
        part.add_to(rests, part.share * part.mean_weight(radius) * rest**2)
    return np.sqrt(squares), np.sqrt(rests)


def highest_above(pieces: Pieces, linear: np.ndarray, sign: float, round_off: float = 0.0) -> np.ndarray:
    """Upper bounds of sign times a datum above a linear function in each simplex, 0 where that may be round-off.

    Args:
        pieces: The datum.
        linear: The linear functions at the corners, shape (simplices, corners).
        sign: 1 or -1.
        round_off: Of these functions.
    """
    found = np.full(len(linear), -np.inf)
    for group in (one.no_less(sign) for one in pieces.groups):
        degree, coefficients, margin = group.above(linear, sign)
        margin = margin + round_off
        top = polynomials.largest(coefficients, linear.shape[1], degree) + group.known_rest
        group.raise_to(found, np.where(np.abs(top) <= margin, 0.0, top + margin))
    return found


def mean_above(pieces: Pieces, linear: np.ndarray, sign: float, radius: np.ndarray | None) -> np.ndarray:
    """A lower bound of the mean of sign times a datum above a linear function in each simplex.

    Args:
        pieces: The datum.
        linear: The linear functions at the corners, shape (simplices, corners).
        sign: 1 or -1.
        radius: The weight of integrals there, if there is one.
    """
    bottom = pieces.lower if sign > 0 else -pieces.upper
    unknown = np.where(np.isfinite(bottom), bottom, LOWEST) - polynomials.row_max(linear)
    found = np.zeros(len(linear))
    for group in pieces.groups:
        degree, coefficients, _ = group.above(linear, sign)
        points, weights = rule(linear.shape[1] - 1, degree + (radius is not None))
        values = polynomials.evaluate(coefficients, points, degree)
        above = integrals(values, group.weights(points, weights, radius))
        weight, known = group.mean_weight(radius), np.isfinite(group.rest)
        least = np.where(known, above - group.known_rest * weight, unknown[group.rows] * weight)
        group.add_to(found, group.share * least)
    return found if radius is None else found * reciprocals(radius.mean(axis=1))

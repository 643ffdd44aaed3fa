"""The lattice of a triangle, the small triangles that it is made of, and polynomials on these."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from fenicsx_obstacle.estimation.quadrature import blocks
from fenicsx_obstacle.estimation.rt1 import MASS, nodes_of, quadratics, reference_fields
from fenicsx_obstacle.polynomials import evaluate, exponents, from_chords, halvings

DENSE = 8  # parts of an edge, a power of 2
FEW = 128  # cells per block: its arrays fit into the cache of a core
CLOSE = 4  # degree of Bernstein bounds of quadratic functions; with degree 2 they are up to twice as large
POINTS = exponents(3, DENSE)[::-1] / DENSE  # that divide the edges and the inside evenly

TIMES = DENSE.bit_length() - 1  # halvings of the edges that give the small triangles
# corners of the small triangles, as indices in the lattice
SMALL = np.abs(halvings(3, TIMES)[:, :, None] - POINTS).sum(axis=3).argmin(axis=2)


def _slopes() -> np.ndarray:
    """Derivatives along the reference axes in each small triangle from values on the lattice, (small, 2, points)."""
    found = np.zeros((len(SMALL), 2, len(POINTS)))
    for number, corner in enumerate(SMALL):
        x = POINTS[corner, 1:]
        J = np.array([x[1] - x[0], x[2] - x[0]])
        to = np.array([[-1.0, 1, 0], [-1, 0, 1]])
        found[number][:, corner] = np.linalg.solve(J, to)
    return found


def _means() -> np.ndarray:
    """Means of the functions of RT1 over the small triangles, shape (small, 2, 8)."""
    corner = POINTS[SMALL]
    middles = (corner + corner[:, [1, 2, 0]]) / 2  # the rule there is exact for degree 2
    fields = reference_fields(middles.reshape(-1, 3)).reshape(8, len(SMALL), 3, 2)
    return np.moveaxis(fields.mean(axis=2), 0, 2)


def by_part(matrices: np.ndarray, part: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Rows of values, shape (n, k) or (n, k, axes), each times the matrix of its part, shape (parts, m, k)."""
    found = np.empty((len(values), matrices.shape[1], *values.shape[2:]))
    for number, matrix in enumerate(matrices):
        rows = np.flatnonzero(part == number)
        found[rows] = np.moveaxis(np.tensordot(values[rows], matrix, (1, 1)), -1, 1)
    return found


def _products() -> np.ndarray:
    """Integrals of products of two functions that are linear in each small triangle, from their values on the lattice,
    the small triangles having the size 1."""
    found = np.zeros((len(POINTS), len(POINTS)))
    for corner in SMALL:
        found[np.ix_(corner, corner)] += MASS
    return found


def bernstein(u: np.ndarray) -> np.ndarray:
    """Bernstein coefficients of functions of P2 from their values at the nodes of cells."""
    return np.hstack([u[:, :3], 2 * u[:, 3:] - (u[:, :3].sum(axis=1, keepdims=True) - u[:, :3]) / 2])


def _number(x: float, y: float) -> int:
    """Place in the lattice of the point with these reference coordinates."""
    return int(np.argmin(np.abs(POINTS[:, 1:] - (x, y)).sum(axis=1)))


@dataclass(frozen=True, eq=False)
class Halves:
    """The parts of a triangle with edges halved some times, which are made of small triangles of the lattice.

    Attributes:
        corners: Their barycentric coordinates, shape (parts, 3, 3).
        small: Corners of the small triangles in a part, in its own coordinates, shape (small, 3, 3); those of one part
            follow each other in the lattice.
        to_nodes: Values of P2 at the nodes of parts from those of the triangle, shape (parts, 6, 6).
    """

    corners: np.ndarray
    small: np.ndarray
    to_nodes: np.ndarray

    @classmethod
    def of(cls, times: int) -> Halves:
        """Parts of edges halved so many times."""
        corners = halvings(3, times)
        nodes = np.array([nodes_of(part) for part in corners])
        to_nodes = quadratics(nodes.reshape(-1, 3)).T.reshape(-1, 6, 6)
        return cls(corners, halvings(3, TIMES - times), to_nodes)


@cache
def _to_chords(times: int, degree: int) -> np.ndarray:
    """Bernstein coefficients of polynomials on a part minus their chords (linear interpolants) on its small triangles.

    Args:
        times: How often the edges were halved for the part.
        degree: Of the polynomials.

    Returns:
        Shape (n, small, n): coefficient on the small triangle, small triangle, coefficient of the polynomial.
    """
    return np.ascontiguousarray(from_chords(HALVES[times].small, degree).transpose(1, 0, 2))


def above_chords(times: int, degree: int, polynomials: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The largest and the least coefficients of polynomials minus their chords, and the means of these differences.

    Args:
        times: As for `_to_chords`.
        degree: Of the polynomials.
        polynomials: Their coefficients on parts, shape (parts, n).

    Returns:
        Each of shape (parts, small).
    """
    to_chords = _to_chords(times, degree)
    count, small, _ = to_chords.shape
    most, least = (np.empty((len(polynomials), small)) for _ in range(2))
    for block in blocks(len(polynomials), FEW):
        above = (to_chords.reshape(count * small, count) @ polynomials[block].T).reshape(count, small, -1)
        most[block], least[block] = above.max(axis=0).T, above.min(axis=0).T
    return most, least, polynomials @ to_chords.mean(axis=0).T


SLOPES, MEANS = _slopes(), _means()
HALVES = [Halves.of(times) for times in range(TIMES)]
PRODUCTS = _products()
MIDDLES = POINTS[SMALL].mean(axis=1)  # of the small triangles
COARSE = [_number(*x[1:]) for x in exponents(3, CLOSE) / CLOSE]  # points of the lattice for interpolants of this degree
# the Bernstein coefficients of these interpolants from values there
FROM_COARSE = np.linalg.inv(evaluate(np.eye(len(COARSE)), POINTS[COARSE], CLOSE))
NODES = [_number(*x) for x in ((0, 0), (1, 0), (0, 1), (0.5, 0.5), (0, 0.5), (0.5, 0))]  # those of P2 in the lattice
# the functions of P2 at the nodes of the small triangles, shape (6, small, 6)
OF_SMALL = quadratics((nodes_of(np.eye(3)) @ POINTS[SMALL]).reshape(-1, 3)).reshape(6, len(SMALL), 6)

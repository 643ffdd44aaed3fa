"""A matrix-valued tension A in the cells: enclosures of it for the error bound.

Cells are divided into parts on which each entry is q + r, q a polynomial and |r| bounded (`pieces`). On a part let M
be the mean of the polynomials, M = L L^T, and C_k their Bernstein coefficients, which are matrices. As the least
eigenvalue is concave and the largest one convex,

    alpha M <= A <= beta M,   alpha = min_k lambda_min(L^-1 C_k L^-T) - delta,   beta = max_k lambda_max(..) + delta,

where delta bounds the norm of L^-1 R L^-T, which is largest at a vertex of the box of all R. Bounds are thus relative
to M: neither the ratio of the eigenvalues nor the direction of their axes matters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement, product

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Field, Rows
from fenicsx_obstacle.estimation.cell_data import Fields, Tension
from fenicsx_obstacle.estimation.certification import CellDatum
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of
from fenicsx_obstacle.estimation.oscillation import poincare
from fenicsx_obstacle.estimation.parts import Arrays, Parts
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.estimation.simplices import Simplices

DEPTH = {1: 8, 2: 4, 3: 2}  # how often cells are divided, by their dimension
NEAR = 0.1  # delta, and 1 - alpha, above which they are
ROUND_OFF = 64 * float(np.finfo(float).eps)  # times the ratio of the eigenvalues of M, in alpha, beta and delta
AT_ONCE = 4000  # parts


@dataclass(frozen=True, eq=False)
class _Part(Arrays):
    """Parts of cells.

    Attributes:
        rows: The cell of each.
        corners: Barycentric coordinates of its corners there, shape (parts, d + 1, d + 1).
        share: Of its measure.
        degree: Of the polynomials.
        coefficients: Their Bernstein coefficients, shape (parts, n, d, d).
        middle: M, shape (parts, d, d).
        root: L.
        rest: Bounds of the entries of R, shape (parts, d, d).
        delta: See above, shape (parts,).
        alpha: Positive.
        beta: Largest.
        unknown: Where no bounds are known: M stands for A.
    """

    rows: np.ndarray
    corners: np.ndarray
    share: np.ndarray
    degree: int
    coefficients: np.ndarray
    middle: np.ndarray
    root: np.ndarray
    rest: np.ndarray
    delta: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    unknown: np.ndarray


class MatrixTension(Tension):
    """The matrix A in the cells; `least` and `most` are bounds of its eigenvalues.

    Attributes:
        poincare: C with ||v||_T <= C ||A^(1/2) grad v||_T for functions of mean zero; infinite where cells are divided.
    """

    def __init__(self, simplices: Simplices, rows: Rows, of_solver: np.ndarray):
        """Enclose it (collective).

        Args:
            simplices: The cells.
            rows: Of the matrix.
            of_solver: A in each cell as the solver has it, shape (cells, d, d).
        """
        self._area, self._dim, self._simplices = simplices.area, simplices.dim, simplices
        self._rows, self._of_solver = rows, of_solver
        self._symmetric = all(_same(rows[i][j], rows[j][i]) for i in range(len(rows)) for j in range(i))
        self._sampled, count = False, len(simplices.area)
        for entry in (one for row in rows for one in row):
            simplices.data.names(simplices.data.here(entry))  # collective, and a rank may have no cells
        self._matrices = list(self._enclosed())
        self.varies, self._unknown = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
        self.least, self.most, times = np.full(count, np.inf), np.zeros(count), np.zeros(count, dtype=int)
        shape = (count, self._dim, self._dim)
        self._mean, self._spread, self._low, self._high = (np.zeros(shape) for _ in range(4))
        self.poincare = np.full(count, np.inf)
        for part in self._matrices:
            eigenvalues = np.linalg.eigvalsh(part.middle)
            np.minimum.at(self.least, part.rows, part.alpha * eigenvalues[:, 0])
            np.maximum.at(self.most, part.rows, part.beta * eigenvalues[:, -1])
            np.add.at(times, part.rows, 1)
            self._unknown[part.rows[part.unknown]] = True
            for sums, one in ((self._mean, part.coefficients.mean(axis=1)), (self._spread, part.rest),
                              (self._low, part.alpha[:, None, None] * part.middle),
                              (self._high, part.beta[:, None, None] * part.middle)):  # fmt: skip
                np.add.at(sums, part.rows, part.share[:, None, None] * one)
        for part in self._matrices:
            some = part[times[part.rows] == 1]
            x = simplices.x[some.rows] @ np.linalg.inv(some.root).transpose(0, 2, 1)
            area = simplices.area[some.rows] / np.abs(np.linalg.det(some.root))
            self.poincare[some.rows] = poincare(x, area) / np.sqrt(some.alpha)

    def known(self) -> CellDatum:
        """See `Tension.known`."""
        least = np.where(self._unknown, 0.0, self.least) if self._symmetric else np.zeros(len(self.least))
        pieces = Pieces([], least, self.most, self._sampled)
        what = "may be infinite, undefined or not positive definite" if self._symmetric else (
            "is not known to be symmetric, as two entries are written differently,")  # fmt: skip
        return CellDatum("tension", pieces, f"tension {what}", least=0.0)

    def energy_above(self, gradient: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """See `Tension.energy_above`."""
        size = np.abs(gradient)
        mean = _form(self._mean[cells], gradient) + _form(self._spread[cells], size)
        return self._area[cells] * np.minimum(mean, _form(self._high[cells], gradient))

    def energy_below(self, gradient: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """See `Tension.energy_below`."""
        size = np.abs(gradient)
        mean = _form(self._mean[cells], gradient) - _form(self._spread[cells], size)
        return self._area[cells] * np.maximum(mean, _form(self._low[cells], gradient))

    def integrate_distances(self, squares: np.ndarray, fields: Fields, degree: int) -> None:
        """Set squares to a bound of ||A^(1/2) g - A^(-1/2) s||_T^2 in all cells, (E20) (local).

        On a part it is at most alpha^(-1) (||L^-1 (q g - s)|| + delta ||L^T g||)^2, and also at most the integral of
        beta g . M g - 2 g . s + s . M^-1 s/alpha. The arguments are those of `Tension.integrate_distances`.
        """
        squares[:] = 0.0
        for whole in self._matrices:
            points, weights = rule(self._dim, 2 * max(whole.degree + degree - 1, degree))
            for block in blocks(len(whole.rows), AT_ONCE):
                part = whole[block]
                g, s = fields(part.rows, points @ part.corners)
                inverse = np.linalg.inv(part.root)
                basis = polynomials.evaluate(np.eye(part.coefficients.shape[1]), points, part.degree)
                q = np.einsum("kp,nkij->npij", basis, part.coefficients)
                near = np.einsum("npij,npj->npi", q, g) - s
                near, of_g, of_s = (
                    np.einsum("nij,npj->npi", matrix, vector)
                    for matrix, vector in ((inverse, near), (part.root.transpose(0, 2, 1), g), (inverse, s))
                )
                norms = [np.einsum("npi,npi,p->n", one, one, weights) for one in (near, of_g, of_s)]
                smooth = (np.sqrt(norms[0]) + part.delta * np.sqrt(norms[1])) ** 2 / part.alpha
                convex = part.beta * norms[1] - 2 * np.einsum("npi,npi,p->n", g, s, weights) + norms[2] / part.alpha
                found = np.minimum(smooth, np.maximum(convex, 0.0))
                np.add.at(squares, part.rows, part.share * self._area[part.rows] * found)

    def _enclosed(self) -> Iterator[_Part]:
        """The parts of all cells."""
        dim, parts = self._dim, Parts.whole(self._simplices.x, np.arange(len(self._area)))
        for depth in range(DEPTH[dim] + 1):
            rough = []
            for block in blocks(len(parts.rows), AT_ONCE):
                part = self._near(parts[block])
                open_ = part.unknown | (part.delta > NEAR) | (part.alpha < 1 - NEAR)
                last = depth == DEPTH[dim] or all(entry.uniform for row in self._rows for entry in row)
                yield part if last else part[~open_]
                rough.append(np.flatnonzero(open_ & (not last)) + block.start)
            parts = parts[np.concatenate(rough or [np.empty(0, dtype=int)])].halved()

    def _near(self, parts: Parts) -> _Part:
        """Polynomials and bounds on parts of cells."""
        dim, cells, data = self._dim, parts.cells, self._simplices.data
        count = len(cells)
        entries: dict[tuple[int, int], tuple[int, np.ndarray, np.ndarray]] = {}
        for i, j in combinations_with_replacement(range(dim), 2):
            found = pieces_of(data, self._rows[i][j], parts.x, cells, Division(0))
            self._sampled |= found.sampled
            entries[i, j] = _single(found, count, dim + 1)
        degree = max((one[0] for one in entries.values()), default=0)
        size = polynomials.raised(dim + 1, 0, degree).shape[0]
        coefficients, rest = np.zeros((count, size, dim, dim)), np.zeros((count, dim, dim))
        for (i, j), (own, values, bound) in entries.items():
            raised = values @ polynomials.raised(dim + 1, own, degree).T
            coefficients[:, :, i, j] = coefficients[:, :, j, i] = raised
            # what raising the degree rounds
            rest[:, i, j] = rest[:, j, i] = bound + polynomials.round_off(raised, dim + 1, degree) * (degree > 0)
        middle = coefficients.mean(axis=1)
        unknown = ~(np.isfinite(middle).all(axis=(1, 2)) & np.isfinite(rest).all(axis=(1, 2)))
        middle[unknown] = self._of_solver[cells[unknown]]
        unknown |= np.linalg.eigvalsh(middle)[:, 0] <= 0
        middle[unknown] = self._of_solver[cells[unknown]]
        eigenvalues = np.linalg.eigvalsh(middle)
        margin = ROUND_OFF * eigenvalues[:, -1] / eigenvalues[:, 0]
        coefficients[unknown], rest[unknown] = middle[unknown][:, None], 0.0
        root = np.linalg.cholesky(middle)
        inverse = np.linalg.inv(root)
        delta = np.zeros(count)
        for signs in _signs(dim):
            delta = np.maximum(delta, np.linalg.norm(_scaled(inverse, signs * rest), ord=2, axis=(1, 2)))
        delta += margin
        scaled = np.linalg.eigvalsh(_scaled(inverse[:, None], coefficients))
        alpha, beta = scaled[..., 0].min(axis=1) - delta, scaled[..., -1].max(axis=1) + delta
        unknown |= alpha <= margin
        bad = np.flatnonzero(unknown)
        coefficients[bad], rest[bad], delta[bad], alpha[bad], beta[bad] = middle[bad][:, None], 0.0, 0.0, 1.0, 1.0
        return _Part(
            cells, parts.places, parts.share, degree, coefficients, middle, root, rest, delta, alpha, beta, unknown
        )


def _same(one: Field, other: Field) -> bool:
    """Whether two entries are one datum for sure."""
    function = getattr(one, "function", None)
    if one is other or (function is not None and function is getattr(other, "function", None)):
        return True
    return (one.everywhere and other.everywhere and type(one) is type(other)
                            and one.text == other.text)  # fmt: skip


def _single(pieces: Pieces, count: int, corners: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Degree, Bernstein coefficients and bounds of the rest, with one polynomial on each simplex; where simplices are
    divided the rest is infinite."""
    degree = max((group.degree for group in pieces.groups), default=0)
    size = polynomials.raised(corners, 0, degree).shape[0]
    values, rest = np.zeros((count, size)), np.full(count, np.inf)
    for group in pieces.groups:
        if group.corners is None:
            values[group.rows] = group.coefficients @ polynomials.raised(corners, group.degree, degree).T
            rest[group.rows] = group.rest
    return degree, values, rest


def _form(matrices: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """g . A g, gradients g of shape (d, cells)."""
    return np.einsum("xc,cxy,yc->c", gradient, matrices, gradient)


def _scaled(inverse: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """L^-1 A L^-T."""
    return inverse @ matrices @ np.swapaxes(inverse, -1, -2)


def _signs(dim: int) -> Iterator[np.ndarray]:
    """Symmetric matrices of signs, one of each and its negative."""
    upper = list(combinations_with_replacement(range(dim), 2))
    for rest in product((1.0, -1.0), repeat=len(upper) - 1):
        found = np.ones((dim, dim))
        for (i, j), sign in zip(upper, (1.0, *rest), strict=True):
            found[i, j] = found[j, i] = sign
        yield found

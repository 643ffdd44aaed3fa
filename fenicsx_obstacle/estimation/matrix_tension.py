"""A matrix-valued tension A in the cells: numbers as they are, other data at points of a quadrature.

Let A = L L^T. The bound needs ||A^(1/2) g - A^(-1/2) s|| = ||L^-1 (A g - s)||. Where A varies it is known at samples
only, and the bound is certified for these.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.effects.field import Rows
from fenicsx_obstacle.estimation.cell_data import Fields, Tension
from fenicsx_obstacle.estimation.certification import CellDatum
from fenicsx_obstacle.estimation.oscillation import poincare
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.estimation.simplices import Simplices

ROUND_OFF = 64 * float(np.finfo(float).eps)  # times the ratio of the eigenvalues of A: relative to A
UNDECIDED = 0.5  # of A: with more round-off nothing is known of it
AT_ONCE = 4000  # cells


class MatrixTension(Tension):
    """The matrix A in the cells; `least` and `most` are bounds of its eigenvalues."""

    def __init__(self, simplices: Simplices, rows: Rows, of_solver: np.ndarray):
        """Sample it (collective).

        Args:
            simplices: The cells.
            rows: Of the matrix.
            of_solver: A in each cell as the solver has it, shape (cells, d, d).
        """
        self._area, self._dim = simplices.area, simplices.dim
        as_given, every = simplices.data.matrices(rows), [entry for row in rows for entry in row]
        symmetric = bool(np.all(as_given == as_given.transpose(0, 2, 1)))
        self._sampled = not (symmetric and all(entry.uniform for entry in every))
        count, dim = len(simplices.area), simplices.dim
        if self._sampled:
            self._points, self._weights = rule(dim)
            A = np.stack([simplices.values(entry, self._points) for entry in every], axis=2)
            A = A.reshape(count, len(self._points), dim, dim)
            A = (A + A.transpose(0, 1, 3, 2)) / 2
        else:
            self._points, self._weights = rule(dim, 2)
            A = np.repeat(of_solver[:, None], len(self._points), axis=1)
        self._unknown = ~np.isfinite(A).all(axis=(1, 2, 3))
        A[self._unknown] = of_solver[self._unknown, None]
        eigenvalues = np.linalg.eigvalsh(A)
        self._unknown |= (ROUND_OFF * eigenvalues[..., -1] >= UNDECIDED * eigenvalues[..., 0]).any(axis=1)
        A[self._unknown] = of_solver[self._unknown, None]
        eigenvalues[self._unknown] = np.linalg.eigvalsh(A[self._unknown])
        ratio = (eigenvalues[..., -1] / eigenvalues[..., 0]).max(axis=1, initial=1.0)
        self._matrices, self._margin = A, np.minimum(ROUND_OFF * ratio, UNDECIDED)
        self.least = (1 - self._margin) * eigenvalues[..., 0].min(axis=1, initial=np.inf)
        self.most = (1 + self._margin) * eigenvalues[..., -1].max(axis=1, initial=0.0)
        self.varies = np.ones(count, dtype=bool)
        self._mean = np.einsum("cpxy,p->cxy", A, self._weights)
        root = np.linalg.cholesky(self._mean)
        inverse = np.linalg.inv(root)
        scaled = inverse[:, None] @ A @ inverse.transpose(0, 2, 1)[:, None]
        alpha = np.linalg.eigvalsh(scaled)[..., 0].min(axis=1, initial=1.0) - self._margin
        area = simplices.area / np.abs(np.linalg.det(root))
        # C with ||v||_T <= C ||A^(1/2) grad v||_T for functions of mean zero
        constant = poincare(simplices.x @ inverse.transpose(0, 2, 1), area)
        self.poincare = np.divide(constant, np.sqrt(np.abs(alpha)), out=np.full(count, np.inf), where=alpha > 0)

    def known(self) -> CellDatum:
        """See `Tension.known`."""
        pieces = Pieces([], np.where(self._unknown, 0.0, self.least), self.most, self._sampled)
        wrong = "tension may be infinite, undefined or not positive definite"
        return CellDatum("tension", pieces, wrong, least=0.0)

    def energy_above(self, gradient: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """See `Tension.energy_above`."""
        return self._area[cells] * np.einsum("xc,cxy,yc->c", gradient, self._mean[cells], gradient)

    energy_below = energy_above

    def integrate_distances(self, squares: np.ndarray, fields: Fields, degree: int) -> None:
        """Set squares to ||A^(1/2) g - A^(-1/2) s||_T^2 in all cells, (E20) (local).

        The arguments are those of `Tension.integrate_distances`.
        """
        every = np.arange(len(squares))
        for block in blocks(len(squares), AT_ONCE):
            g, s = fields(every[block], self._points[None])
            A = self._matrices[block]
            root = np.linalg.cholesky(A)
            away = np.linalg.inv(root) @ ((A @ g[..., None]) - s[..., None])
            of_g = root.transpose(0, 1, 3, 2) @ g[..., None]
            near, size = (np.sqrt(np.einsum("cpxz,cpxz,p->c", one, one, self._weights)) for one in (away, of_g))
            margin = self._margin[block]
            squares[block] = self._area[block] * (near + margin * size) ** 2 / (1 - margin)

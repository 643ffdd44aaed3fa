"""Singular values of a bilinear form between two normed spaces, by LAPACK on rank 0.

A form b with matrix B, a norm with matrix H on its columns and one with matrix N on its rows:

    inf over q of sup over v of b(q, v) / (||v||_H ||q||_N) = sqrt(lambda),    B H^-1 B^T q = lambda N q.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy import linalg
from scipy.sparse.linalg import splu

from fenicsx_obstacle.check.reference import gathered_matrix
from fenicsx_obstacle.parallel import on_root

Dual = tuple[PETSc.Mat, PETSc.Mat]  # c and K of the dual norm N = c K^-1 c^T


def spectrum(B: PETSc.Mat, H: PETSc.Mat, norm: PETSc.Mat | Dual) -> np.ndarray:
    """All singular values of B, ascending, one for each row, those of the kernel to round-off (collective).

    Args:
        B: Matrix of the form.
        H: Norm on the columns.
        norm: Norm on the rows: N itself, or c and K of a dual norm.
    """
    matrices: list[Any] = [gathered_matrix(A) for A in (B, H, *(norm if isinstance(norm, tuple) else (norm,)))]
    b, h, *n = matrices
    return on_root(B.comm.tompi4py(), lambda: _values(b, h, _dual(*n) if len(n) == 2 else n[0].toarray()))


def ratios(D: PETSc.Mat, M: PETSc.Mat) -> tuple[float, float]:
    """The smallest and the largest of (D q, q)/(M q, q), both matrices positive definite (collective)."""
    d, m = gathered_matrix(D), gathered_matrix(M)
    return on_root(D.comm.tompi4py(), lambda: _ends(d, m))


def _values(B: Any, H: Any, N: np.ndarray) -> np.ndarray:
    right = linalg.solve_triangular(linalg.cholesky(H.toarray(), lower=True), B.toarray().T, lower=True)
    both = linalg.solve_triangular(linalg.cholesky(N, lower=True), right.T, lower=True)
    values = linalg.svdvals(both)[::-1]
    # rows beyond the number of columns are in the kernel
    return np.concatenate([np.zeros(B.shape[0] - len(values)), values])


def _dual(c: Any, K: Any) -> np.ndarray:
    """c K^-1 c^T."""
    return c @ splu(K.tocsc()).solve(c.T.toarray())


def _ends(D: Any, M: Any) -> tuple[float, float]:
    values = linalg.eigvalsh(D.toarray(), M.toarray())
    return float(values[0]), float(values[-1])

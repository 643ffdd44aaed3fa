"""Singular values of a bilinear form between two normed spaces, by LAPACK on rank 0.

A form b with matrix B, a norm with matrix H on its columns and one with matrix N on its rows:

    inf over q of sup over v of b(q, v) / (||v||_H ||q||_N) = sqrt(lambda),    B H^-1 B^T q = lambda N q.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.parallel import on_root

Dual = tuple[PETSc.Mat, PETSc.Mat]  # c and K of the dual norm N = c K^-1 c^T


def smallest(B: PETSc.Mat, H: PETSc.Mat, norm: PETSc.Mat | Dual) -> float:
    """The smallest singular value of B, one for each row (collective).

    Args:
        B: Matrix of the form.
        H: Norm on the columns.
        norm: Norm on the rows: N itself, or c and K of a dual norm.
    """
    b, h, *n = (_gathered(A) for A in (B, H, *(norm if isinstance(norm, tuple) else (norm,))))
    return on_root(B.comm.tompi4py(), lambda: _least(_dual(b, h), _dual(*n) if len(n) == 2 else n[0].toarray()))


def spectrum(B: PETSc.Mat, H: PETSc.Mat, N: PETSc.Mat) -> np.ndarray:
    """All singular values of B, ascending, one for each row, those of the kernel to round-off (collective)."""
    b, h, n = (_gathered(A) for A in (B, H, N))
    return on_root(B.comm.tompi4py(), lambda: _values(b, h, n.toarray()))


def ratios(D: PETSc.Mat, M: PETSc.Mat) -> tuple[float, float]:
    """The smallest and the largest of (D q, q)/(M q, q), both matrices positive definite (collective)."""
    d, m = _gathered(D), _gathered(M)
    return on_root(D.comm.tompi4py(), lambda: _ends(d, m))


def _gathered(A: PETSc.Mat) -> Any:
    """A distributed matrix as a SciPy one on rank 0, None elsewhere."""
    from scipy import sparse

    indptr, indices, data = A.getValuesCSR()
    parts = A.comm.tompi4py().gather((data, indices, indptr))
    if parts is None:
        return None
    rows = [sparse.csr_matrix(part, shape=(len(part[2]) - 1, A.size[1])) for part in parts]
    return sparse.vstack(rows, format="csr")


def _least(A: np.ndarray, N: np.ndarray) -> float:
    from scipy import linalg

    return math.sqrt(linalg.eigvalsh(A, N, subset_by_index=[0, 0])[0])


def _values(B: Any, H: Any, N: np.ndarray) -> np.ndarray:
    from scipy import linalg

    right = linalg.solve_triangular(linalg.cholesky(H.toarray(), lower=True), B.toarray().T, lower=True)
    both = linalg.solve_triangular(linalg.cholesky(N, lower=True), right.T, lower=True)
    values = linalg.svdvals(both)[::-1]
    # rows beyond the number of columns are in the kernel
    return np.concatenate([np.zeros(B.shape[0] - len(values)), values])


def _dual(c: Any, K: Any) -> np.ndarray:
    """c K^-1 c^T."""
    from scipy.sparse import linalg

    return c @ linalg.splu(K.tocsc()).solve(c.T.toarray())


def _ends(D: Any, M: Any) -> tuple[float, float]:
    from scipy import linalg

    values = linalg.eigvalsh(D.toarray(), M.toarray())
    return float(values[0]), float(values[-1])

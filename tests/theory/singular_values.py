"""Singular values of a bilinear form between two normed spaces, by LAPACK on rank 0 or by SLEPc on all ranks.

A form b with matrix B, a norm with matrix H on its columns and one with matrix N on its rows:

    inf over q of sup over v of b(q, v) / (||v||_H ||q||_N) = sqrt(lambda),    B H^-1 B^T q = lambda N q.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.errors import ObstacleError
from fenicsx_obstacle.parallel import on_root

SMALL = 500  # rows at most for LAPACK
TOLERANCE = 1e-9  # of SLEPc
VECTORS = 60  # that it keeps: on regular meshes the smallest values lie close together
Dual = tuple[PETSc.Mat, PETSc.Mat]  # c and K of the dual norm N = c K^-1 c^T


def smallest(B: PETSc.Mat, H: PETSc.Mat, norm: PETSc.Mat | Dual, dense: bool | None = None) -> float:
    """The smallest singular value of B, one for each row (collective).

    Args:
        B: Matrix of the form; SLEPc wants its rows independent.
        H: Norm on the columns.
        norm: Norm on the rows: N itself, or c and K of a dual norm.
        dense: LAPACK or SLEPc; None leaves it to the size.
    """
    if not _is_dense(B, dense):
        return math.sqrt(_nearest_zero(B, H, *(norm if isinstance(norm, tuple) else (norm, None))))
    b, h, *n = (_gathered(A) for A in (B, H, *(norm if isinstance(norm, tuple) else (norm,))))
    return on_root(B.comm.tompi4py(), lambda: float(_values(b, h, _dual(*n) if len(n) == 2 else n[0].toarray())[0]))


def spectrum(B: PETSc.Mat, H: PETSc.Mat, N: PETSc.Mat) -> np.ndarray:
    """All singular values of B, ascending, one for each row, by LAPACK (collective)."""
    b, h, n = (_gathered(A) for A in (B, H, N))
    return on_root(B.comm.tompi4py(), lambda: _values(b, h, n.toarray()))


def ratios(D: PETSc.Mat, M: PETSc.Mat, dense: bool | None = None) -> tuple[float, float]:
    """The smallest and the largest of (D q, q)/(M q, q), both matrices positive definite (collective)."""
    if not _is_dense(M, dense):
        return 1 / _eigenvalue(M, D, near_zero=False), _eigenvalue(D, M, near_zero=False)
    d, m = _gathered(D), _gathered(M)
    return on_root(D.comm.tompi4py(), lambda: _ends(d, m))


def _is_dense(rows: PETSc.Mat, dense: bool | None) -> bool:
    return rows.size[0] <= SMALL if dense is None else dense


def _nearest_zero(B: PETSc.Mat, H: PETSc.Mat, N: PETSc.Mat, K: PETSc.Mat | None) -> float:
    """The smallest lambda, with v = H^-1 B^T q (and w = K^-1 c^T q) as unknowns beside q: all sparse."""
    Bt = B.transpose(PETSc.Mat())
    if K is None:
        left = [[_minus(H), Bt], [B, _empty(N)]]
        right = [[_empty(H), None], [None, N]]
    else:
        corner = B.matMult(Bt)
        left = [[_minus(H), None, Bt], [None, _minus(K), N.transpose(PETSc.Mat())], [B, None, _empty(corner)]]
        right = [[_empty(H), None, None], [None, _empty(K), None], [None, N, _empty(corner)]]
    A, M = (PETSc.Mat().createNest(blocks, comm=B.comm).convert("aij") for blocks in (left, right))
    return _eigenvalue(A, M, near_zero=True)


def _eigenvalue(A: PETSc.Mat, N: PETSc.Mat, *, near_zero: bool) -> float:
    """The eigenvalue of A x = lambda N x nearest zero, N singular, or the largest one, N positive definite.

    Raises:
        ObstacleError: If SLEPc finds none.
    """
    from slepc4py import SLEPc

    solver = SLEPc.EPS().create(A.comm)
    solver.setOperators(A, N)
    solver.setProblemType(SLEPc.EPS.ProblemType.GNHEP if near_zero else SLEPc.EPS.ProblemType.GHEP)
    solver.setTolerances(TOLERANCE, 1000)
    solver.setDimensions(1, min(VECTORS, A.size[0]))
    transformation = solver.getST()
    if near_zero:
        transformation.setType("sinvert")
        solver.setTarget(0.0)
        solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    else:
        solver.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
    inner = transformation.getKSP()
    inner.setType("preonly")
    inner.getPC().setType("lu")
    inner.getPC().setFactorSolverType("mumps")
    solver.solve()
    found = solver.getConverged() > 0
    value = float(solver.getEigenvalue(0).real) if found else math.nan
    solver.destroy()
    if not found:
        raise ObstacleError("SLEPc found no eigenvalue")
    return value


def _minus(A: PETSc.Mat) -> PETSc.Mat:
    B = A.copy()
    B.scale(-1.0)
    return B


def _empty(A: PETSc.Mat) -> PETSc.Mat:
    """Zeros in the places of A: a block without a matrix would have no size."""
    B = A.duplicate()
    B.zeroEntries()
    return B


def _gathered(A: PETSc.Mat) -> Any:
    """A distributed matrix as a SciPy one on rank 0, None elsewhere."""
    from scipy import sparse

    indptr, indices, data = A.getValuesCSR()
    parts = A.comm.tompi4py().gather((data, indices, indptr))
    if parts is None:
        return None
    rows = [sparse.csr_matrix(part, shape=(len(part[2]) - 1, A.size[1])) for part in parts]
    return sparse.vstack(rows, format="csr")


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

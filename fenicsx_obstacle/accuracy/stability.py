"""How stable a pair (V_h, I, Q_h) is: the constants of (3.18), (4.7) and of the dual norm, and the kernel of I.

Each is the smallest singular value of a form between V_h with ||.||_1 and Q_h with a norm of its own,

    inf over q of sup over v of b(q, v) / (||v||_1 ||q||),    b H^-1 b^T q = lambda N q,    constant = sqrt(lambda),

H the matrix of the full H1 product on V_h (v = 0 on the boundary), N that of the norm of q. Small problems are
gathered and solved by LAPACK on rank 0; large ones stay distributed, by SLEPc.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.parallel import on_root

SMALL = 600  # pressures at most for LAPACK
RICHER = 2  # degrees above V_h of the space that stands for H^1_0
ZERO = 1e-10  # singular values below, relative to the largest, belong to the kernel
TOLERANCE = 1e-11  # of SLEPc


class Stability:
    """The constants of one pair on one mesh; all methods are collective, all figures the same on every rank.

    Lengths are those of the mesh, so that alpha has the unit 1/length of ||.||_0 over ||.||_1 at small h.

    Attributes:
        V: V_h without boundary values.
        Q: Q_h.
        inside: Q_h's nodes that are not on the boundary, where alone I sees V_h.
    """

    def __init__(self, mesh: dmesh.Mesh, pair: Pair):
        """Assemble what (3.18) needs.

        Raises:
            InputError: If the pair is not for such cells.
        """
        self.mesh, self.pair, self.comm = mesh, pair, mesh.comm
        self.rule = pair.rule(releases.cell_name(mesh))
        self.V = releases.functionspace(mesh, "Lagrange", pair.degree)
        self.Q = releases.functionspace(mesh, *pair.pressure)
        self._free, self.inside = _interior(self.V), _interior(self.Q)
        self._H = _gram(self.V, self._free)

    @cached_property
    def _I(self) -> PETSc.Mat:
        """I(q, v), rows of all of Q_h."""
        if self.pair.voronoi:
            return _part(self._diagonal(voronoi_areas(self.V)), None, self._free)
        q, v = ufl.TestFunction(self.Q), ufl.TrialFunction(self.V)
        return _part(_matrix(q * v * self.rule.on(ufl.dx)), None, self._free)

    @cached_property
    def _M(self) -> PETSc.Mat:
        """(q, r) on all of Q_h."""
        return _matrix(ufl.TestFunction(self.Q) * ufl.TrialFunction(self.Q) * ufl.dx)

    @cached_property
    def _lumped(self) -> PETSc.Mat:
        """I(q, r) on all of Q_h."""
        if self.pair.voronoi:
            return self._diagonal(voronoi_areas(self.V))
        return _matrix(ufl.TestFunction(self.Q) * ufl.TrialFunction(self.Q) * self.rule.on(ufl.dx))

    def alpha(self, *, dense: bool | None = None) -> float:
        """alpha_h of (3.18) for pressures that vanish on the boundary: sup_v I(q, v)/||v||_1 >= alpha_h ||q||_0.

        Args:
            dense: LAPACK or SLEPc; None leaves it to the size.
        """
        return self._smallest(_part(self._I, self.inside), self._norm(), dense)

    def alpha_hat(self, *, dense: bool | None = None) -> float:
        """The same with (q, v) in place of I(q, v), as (4.7) has it."""
        return self._smallest(_part(self._duality(self.V, self._free), self.inside), self._norm(), dense)

    def beta(self, *, rich: bool = False, dense: bool | None = None) -> float:
        """The same as alpha with the dual norm of q, ||q||_1* = sup_w (q, w)/||w||_1, in place of ||q||_0.

        Args:
            rich: w from a space `RICHER` degrees above V_h, for H^1_0 itself; otherwise from V_h.
            dense: LAPACK or SLEPc; None leaves it to the size.
        """
        W, free, gram = self.V, self._free, self._H
        if rich:
            W = releases.functionspace(self.mesh, "Lagrange", self.pair.degree + RICHER)
            free = _interior(W)
            gram = _gram(W, free)
        duality = _part(self._duality(W, free), self.inside)
        return self._smallest(_part(self._I, self.inside), (duality, gram), dense)

    def equivalence(self, *, dense: bool | None = None) -> tuple[float, float]:
        """Range of I(q, q)/||q||_0^2 over Q_h, (3.21) and (3.28)."""
        D, M = self._lumped, self._M
        if self._is_dense(M, dense):
            return tuple(on_root(self.comm, _ends, _gathered(D), _gathered(M)))
        return 1 / self._largest(M, D), self._largest(D, M)

    def spectrum(self) -> np.ndarray:
        """Singular values of I between V_h and all of Q_h, ascending, one for each pressure (LAPACK).

        The first is alpha_h of (3.18) as it is printed, without a condition on the boundary.
        """
        B, H, M = _gathered(self._I), _gathered(self._H), _gathered(self._M)
        return on_root(self.comm, lambda: _singular_values(B, H, M.toarray()))

    def kernel(self) -> tuple[int, float]:
        """Dimension of {q in Q_h: I(q, v) = 0 for all v}, and the smallest singular value that is not zero."""
        values = self.spectrum()
        zero = values <= ZERO * values[-1]
        return int(zero.sum()), float(values[~zero][0])

    def _norm(self) -> PETSc.Mat:
        return _part(self._M, self.inside, self.inside)

    def _duality(self, W: fem.FunctionSpace, free: PETSc.IS) -> PETSc.Mat:
        return _part(_matrix(ufl.TestFunction(self.Q) * ufl.TrialFunction(W) * ufl.dx), None, free)

    def _diagonal(self, values: np.ndarray) -> PETSc.Mat:
        D = self._M.duplicate()
        x = D.createVecLeft()
        x.array[:] = values
        D.setDiagonal(x)
        return D

    def _is_dense(self, rows: PETSc.Mat, dense: bool | None) -> bool:
        return rows.size[0] <= SMALL if dense is None else dense

    def _smallest(self, B: PETSc.Mat, norm: Any, dense: bool | None) -> float:
        """The smallest singular value of B; `norm` is N, or (b, H) for N = b H^-1 b^T."""
        if not self._is_dense(B, dense):
            return math.sqrt(self._nearest_zero(B, norm))
        matrices = [_gathered(M) for M in (B, self._H, *(norm if isinstance(norm, tuple) else (norm,)))]

        def smallest() -> float:
            N = matrices[2].toarray() if len(matrices) == 3 else _dual_norm(*matrices[2:])
            return float(_singular_values(*matrices[:2], N)[0])

        return on_root(self.comm, smallest)

    def _nearest_zero(self, B: PETSc.Mat, norm: Any) -> float:
        """lambda with v = H^-1 B^T q, and w = H^-1 b^T q where the norm is dual, as unknowns beside q: all sparse."""
        H, Bt = self._H, B.transpose(PETSc.Mat())
        if isinstance(norm, tuple):
            b, K = norm
            corner = _part(self._M, self.inside, self.inside)
            left = [
                [_times(H, -1), None, Bt],
                [None, _times(K, -1), b.transpose(PETSc.Mat())],
                [B, None, corner.duplicate()],
            ]  # noqa: E501
            right = [[H.duplicate(), None, None], [None, K.duplicate(), None], [None, b, corner.duplicate()]]
        else:
            left = [[_times(H, -1), Bt], [B, norm.duplicate()]]
            right = [[H.duplicate(), None], [None, norm]]
        A, N = (PETSc.Mat().createNest(blocks, comm=self.comm).convert("aij") for blocks in (left, right))
        return _eigenvalue(A, N, near_zero=True)

    def _largest(self, A: PETSc.Mat, N: PETSc.Mat) -> float:
        return _eigenvalue(A, N, near_zero=False)


def voronoi_areas(V: fem.FunctionSpace) -> np.ndarray:
    """D_i = -(1/4) sum_j A_ij |x_i - x_j|^2 at owned dofs of P1, A of the Laplacian: areas of Voronoi cells."""
    A = _matrix(ufl.inner(ufl.grad(ufl.TestFunction(V)), ufl.grad(ufl.TrialFunction(V))) * ufl.dx)
    own = V.dofmap.index_map.size_local
    x, y = A.createVecs()
    areas = np.zeros(own)
    points = V.tabulate_dof_coordinates()[:own]
    # rows of A sum to zero: the sum is A|x|^2 - 2 x.(Ax)
    for values, factor in [((points**2).sum(axis=1), 1.0), *((axis, -2 * axis) for axis in points.T)]:
        x.array[:] = values
        A.mult(x, y)
        areas -= factor * y.array / 4
    return areas


def _matrix(form: ufl.Form) -> PETSc.Mat:
    compiled = releases.form(form)
    A = releases.create_matrix(compiled)
    fem.petsc.assemble_matrix(A, compiled)
    A.assemble()
    return A


def _gram(V: fem.FunctionSpace, free: PETSc.IS) -> PETSc.Mat:
    """The full H1 product on V with zero boundary values."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    return _part(_matrix((ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx), free, free)


def _interior(V: fem.FunctionSpace) -> PETSc.IS:
    """Global numbers of owned dofs that are not on the boundary."""
    mesh, index_map = V.mesh, V.dofmap.index_map
    facets = dmesh.exterior_facet_indices(mesh.topology)
    inside = np.ones(index_map.size_local + index_map.num_ghosts, dtype=bool)
    inside[fem.locate_dofs_topological(V, mesh.topology.dim - 1, facets)] = False
    own = index_map.local_range[0] + np.flatnonzero(inside[: index_map.size_local])
    return PETSc.IS().createGeneral(own.astype(PETSc.IntType), comm=mesh.comm)


def _part(A: PETSc.Mat, rows: PETSc.IS | None = None, columns: PETSc.IS | None = None) -> PETSc.Mat:
    """Rows and columns of a matrix, all of them by default."""

    def every(ends: tuple[int, int]) -> PETSc.IS:
        return PETSc.IS().createStride(ends[1] - ends[0], ends[0], 1, comm=A.comm)

    rows = every(A.getOwnershipRange()) if rows is None else rows
    return A.createSubMatrix(rows, every(A.getOwnershipRangeColumn()) if columns is None else columns)


def _times(A: PETSc.Mat, factor: float) -> PETSc.Mat:
    scaled = A.copy()
    scaled.scale(factor)
    return scaled


def _eigenvalue(A: PETSc.Mat, N: PETSc.Mat, *, near_zero: bool) -> float:
    """The eigenvalue of A x = lambda N x nearest zero, or the largest one; of a pencil whose eigenvalues are real."""
    from slepc4py import SLEPc

    solver = SLEPc.EPS().create(A.comm)
    solver.setOperators(A, N)
    solver.setProblemType(SLEPc.EPS.ProblemType.GNHEP if near_zero else SLEPc.EPS.ProblemType.GHEP)
    solver.setTolerances(TOLERANCE, 1000)
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
    if solver.getConverged() < 1:
        raise RuntimeError("SLEPc found no eigenvalue")
    value = float(solver.getEigenvalue(0).real)
    solver.destroy()
    return value


def _gathered(A: PETSc.Mat) -> Any:
    """A distributed matrix as a SciPy one on rank 0, None elsewhere."""
    from scipy import sparse

    indptr, indices, data = A.getValuesCSR()
    parts = A.comm.tompi4py().gather((data, indices, indptr))
    columns = A.size[1]
    return None if parts is None else sparse.vstack(
        [sparse.csr_matrix(part, shape=(len(part[2]) - 1, columns)) for part in parts], format="csr")  # fmt: skip


def _singular_values(B: Any, H: Any, N: np.ndarray) -> np.ndarray:
    """Of B between ||.||_H and ||.||_N, ascending, with a zero for each row more than columns."""
    from scipy import linalg

    right = linalg.solve_triangular(linalg.cholesky(H.toarray(), lower=True), B.toarray().T, lower=True)
    both = linalg.solve_triangular(linalg.cholesky(N, lower=True), right.T, lower=True)
    values = linalg.svdvals(both)[::-1]
    return np.concatenate([np.zeros(max(B.shape[0] - len(values), 0)), values])


def _dual_norm(b: Any, H: Any) -> np.ndarray:
    """b H^-1 b^T."""
    from scipy.sparse import linalg

    return b @ linalg.splu(H.tocsc()).solve(b.T.toarray())


def _ends(D: Any, M: Any) -> tuple[float, float]:
    from scipy import linalg

    values = linalg.eigvalsh(D.toarray(), M.toarray())
    return float(values[0]), float(values[-1])

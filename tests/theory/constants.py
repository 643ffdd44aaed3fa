"""Stability of a pair (V_h, I, Q_h): the constants of (3.18), (4.7) and of the dual norm, and the kernel of I.

A form b with matrix B, a norm with matrix H on its columns and one with matrix N on its rows:

    inf over q of sup over v of b(q, v) / (||v||_H ||q||_N) = sqrt(lambda),    B H^-1 B^T q = lambda N q.

Each rank has all matrices, and finds the same values by LAPACK.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from fenicsx_obstacle import releases
from fenicsx_obstacle.check.reference import gathered_matrix
from fenicsx_obstacle.discrete.assembly import weights_of_cells
from fenicsx_obstacle.forms.pairs import Pair

RICHER = 2  # degrees above V_h of the space that stands for H^1_0
ZERO = 1e-10  # singular values below, relative to the largest, belong to the kernel


class Stability:
    """The constants of one pair on one mesh; all methods are collective, all figures the same on every rank.

    ||v||_1 is the full H1 norm, v = 0 on the boundary.

    Attributes:
        V: V_h, boundary values included.
        Q: Q_h.
    """

    def __init__(self, mesh: dmesh.Mesh, pair: Pair):
        """Take the pair's spaces on a mesh.

        Raises:
            InputError: If the pair is not for such cells.
        """
        self.mesh, self.pair = mesh, pair
        self.rule = pair.rule(releases.cell_name(mesh))
        self.V = releases.functionspace(mesh, "Lagrange", pair.degree)
        self.Q = releases.functionspace(mesh, *pair.pressure)
        self._free, self._inside = _interior(self.V), _interior(self.Q)
        self._q = ufl.TestFunction(self.Q)

    def alpha(self) -> float:
        """alpha_h of (3.18), sup_v I(q, v)/||v||_1 >= alpha_h ||q||_0, for q that vanish at nodes on the boundary.

        Unit: length, or dimensionless on a domain of size 1.
        """
        return float(singular_values(self._I[self._inside], self._H, self._norm)[0])

    def alpha_hat(self) -> float:
        """The same with (q, v) in place of I(q, v), as (4.7) has it."""
        return float(singular_values(self._duality[self._inside], self._H, self._norm)[0])

    def beta(self, *, rich: bool = False) -> float:
        """The constant of the dual norm, sup_v I(q, v)/||v||_1 >= beta_h ||q||_1*, for the same q; dimensionless.

        Args:
            rich: ||q||_1* = sup (q, w)/||w||_1 with w from a space `RICHER` degrees above V_h, for H^1_0 itself;
                otherwise from V_h.
        """
        c, K = self._duality[self._inside], self._H
        if rich:
            W = releases.functionspace(self.mesh, "Lagrange", self.pair.degree + RICHER)
            free = _interior(W)
            c = _matrix(self._q * ufl.TrialFunction(W) * ufl.dx)[self._inside][:, free]
            K = _gram(W, free)
        dual = c @ splu(K.tocsc()).solve(c.T.toarray())
        return float(singular_values(self._I[self._inside], self._H, dual)[0])

    def equivalence(self) -> tuple[float, float]:
        """Range of I(q, q)/||q||_0^2 over all of Q_h, (3.21) and (3.28)."""
        values = linalg.eigvalsh(self._lumped.toarray(), self._M.toarray())
        return float(values[0]), float(values[-1])

    def spectrum(self) -> np.ndarray:
        """Singular values of I between V_h and all of Q_h, ascending, one for each pressure.

        The first is alpha_h of (3.18) to the letter, for all of Q_h.
        """
        return singular_values(self._I, self._H, self._M.toarray())

    def kernel(self) -> tuple[int, float]:
        """Dimension of {q in Q_h: I(q, v) = 0 for all v}, and the smallest singular value that is not zero."""
        values = self.spectrum()
        zero = values <= ZERO * values[-1]
        return int(zero.sum()), float(values[~zero][0])

    def consistency(self) -> float:
        """How far I is from exact on V_h: largest |I(1, v) - (1, v)| of basis functions over the largest (1, v)."""
        lumped, true = (np.asarray(one.sum(axis=0)) for one in (self._I, self._duality))
        return float(np.abs(lumped - true).max() / np.abs(true).max())

    @cached_property
    def _H(self) -> Any:
        return _gram(self.V, self._free)

    @cached_property
    def _I(self) -> Any:
        """I(q, v), rows of all of Q_h."""
        if self.pair.own_weights:
            return self._lumped[:, self._free]
        return _matrix(self._q * ufl.TrialFunction(self.V) * self.rule.on(ufl.dx))[:, self._free]

    @cached_property
    def _duality(self) -> Any:
        """(q, v), rows of all of Q_h."""
        return _matrix(self._q * ufl.TrialFunction(self.V) * ufl.dx)[:, self._free]

    @cached_property
    def _M(self) -> Any:
        """(q, r) on all of Q_h."""
        return _matrix(self._q * ufl.TrialFunction(self.Q) * ufl.dx)

    @cached_property
    def _norm(self) -> np.ndarray:
        return np.asarray(self._M[self._inside][:, self._inside].toarray())

    @cached_property
    def _lumped(self) -> Any:
        """I(q, r) on all of Q_h."""
        if self.pair.own_weights:
            own = weights_of_cells(self.pair, self.V)
            return sparse.diags(np.concatenate(self.mesh.comm.allgather(own))).tocsr()
        return _matrix(self._q * ufl.TrialFunction(self.Q) * self.rule.on(ufl.dx))


def singular_values(B: Any, H: Any, N: np.ndarray) -> np.ndarray:
    """All singular values of B, ascending, one for each row, those of the kernel to round-off.

    Args:
        B: Sparse matrix of the form.
        H: Sparse matrix of the norm on the columns.
        N: Of the norm on the rows.
    """
    right = linalg.solve_triangular(linalg.cholesky(H.toarray(), lower=True), B.toarray().T, lower=True)
    both = linalg.solve_triangular(linalg.cholesky(N, lower=True), right.T, lower=True)
    values = linalg.svdvals(both)[::-1]
    # rows beyond the number of columns are in the kernel
    return np.concatenate([np.zeros(B.shape[0] - len(values)), values])


def _matrix(form: ufl.Form) -> Any:
    """The sparse matrix of a form, on every rank (collective)."""
    compiled = releases.form(form)
    A = fem.petsc.create_matrix(compiled)
    fem.petsc.assemble_matrix(A, compiled)
    A.assemble()
    return A.comm.tompi4py().bcast(gathered_matrix(A))


def _gram(V: fem.FunctionSpace, free: np.ndarray) -> Any:
    """The full H1 product of functions that are zero on the boundary."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    return _matrix((ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx)[free][:, free]


def _interior(V: fem.FunctionSpace) -> np.ndarray:
    """Whether dofs are not on the boundary: those of all ranks, in their order (collective)."""
    mesh, index_map = V.mesh, V.dofmap.index_map
    facets = dmesh.exterior_facet_indices(mesh.topology)
    inside = np.ones(index_map.size_local + index_map.num_ghosts, dtype=bool)
    inside[fem.locate_dofs_topological(V, mesh.topology.dim - 1, facets)] = False
    return np.concatenate(mesh.comm.allgather(inside[: index_map.size_local]))

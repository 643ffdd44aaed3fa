"""Stability of a pair (V_h, I, Q_h): the constants of (3.18), (4.7) and of the dual norm, and the kernel of I."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.assembly import weights_of_cells
from fenicsx_obstacle.forms.pairs import Pair
from tests.theory.singular_values import ratios, spectrum

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
        return float(spectrum(self._seen(self._I), self._H, self._norm)[0])

    def alpha_hat(self) -> float:
        """The same with (q, v) in place of I(q, v), as (4.7) has it."""
        return float(spectrum(self._seen(self._duality), self._H, self._norm)[0])

    def beta(self, *, rich: bool = False) -> float:
        """The constant of the dual norm, sup_v I(q, v)/||v||_1 >= beta_h ||q||_1*, for the same q; dimensionless.

        Args:
            rich: ||q||_1* = sup (q, w)/||w||_1 with w from a space `RICHER` degrees above V_h, for H^1_0 itself;
                otherwise from V_h.
        """
        dual = (self._seen(self._duality), self._H)
        if rich:
            W = releases.functionspace(self.mesh, "Lagrange", self.pair.degree + RICHER)
            free = _interior(W)
            dual = (self._seen(_part(_matrix(self._q * ufl.TrialFunction(W) * ufl.dx), None, free)), _gram(W, free))
        return float(spectrum(self._seen(self._I), self._H, dual)[0])

    def equivalence(self) -> tuple[float, float]:
        """Range of I(q, q)/||q||_0^2 over all of Q_h, (3.21) and (3.28)."""
        return ratios(self._lumped, self._M)

    def spectrum(self) -> np.ndarray:
        """Singular values of I between V_h and all of Q_h, ascending, one for each pressure.

        The first is alpha_h of (3.18) to the letter, for all of Q_h.
        """
        return spectrum(self._I, self._H, self._M)

    def kernel(self) -> tuple[int, float]:
        """Dimension of {q in Q_h: I(q, v) = 0 for all v}, and the smallest singular value that is not zero."""
        values = self.spectrum()
        zero = values <= ZERO * values[-1]
        return int(zero.sum()), float(values[~zero][0])

    def consistency(self) -> float:
        """How far I is from exact on V_h: largest |I(1, v) - (1, v)| of basis functions over the largest (1, v)."""
        one, lumped, true = self._I.createVecLeft(), self._I.createVecRight(), self._duality.createVecRight()
        one.set(1.0)
        self._I.multTranspose(one, lumped)
        self._duality.multTranspose(one, true)
        scale = true.norm(PETSc.NormType.INFINITY)
        lumped.axpy(-1.0, true)
        return float(lumped.norm(PETSc.NormType.INFINITY) / scale)

    @cached_property
    def _H(self) -> PETSc.Mat:
        return _gram(self.V, self._free)

    @cached_property
    def _I(self) -> PETSc.Mat:
        """I(q, v), rows of all of Q_h."""
        if self.pair.own_weights:
            return _part(self._lumped, None, self._free)
        return _part(_matrix(self._q * ufl.TrialFunction(self.V) * self.rule.on(ufl.dx)), None, self._free)

    @cached_property
    def _duality(self) -> PETSc.Mat:
        """(q, v), rows of all of Q_h."""
        return _part(_matrix(self._q * ufl.TrialFunction(self.V) * ufl.dx), None, self._free)

    @cached_property
    def _M(self) -> PETSc.Mat:
        """(q, r) on all of Q_h."""
        return _matrix(self._q * ufl.TrialFunction(self.Q) * ufl.dx)

    @cached_property
    def _norm(self) -> PETSc.Mat:
        return _part(self._M, self._inside, self._inside)

    @cached_property
    def _lumped(self) -> PETSc.Mat:
        """I(q, r) on all of Q_h."""
        D = _matrix(self._q * ufl.TrialFunction(self.Q) * self.rule.on(ufl.dx))
        if self.pair.own_weights:
            weights = D.getDiagonal()
            weights.array[:] = weights_of_cells(self.pair, self.V)
            D.setDiagonal(weights)
        return D

    def _seen(self, A: PETSc.Mat) -> PETSc.Mat:
        """Rows of the nodes inside: those on the boundary V_h does not see."""
        return _part(A, self._inside)


def _matrix(form: ufl.Form) -> PETSc.Mat:
    compiled = releases.form(form)
    A = fem.petsc.create_matrix(compiled)
    fem.petsc.assemble_matrix(A, compiled)
    A.assemble()
    return A


def _gram(V: fem.FunctionSpace, free: PETSc.IS) -> PETSc.Mat:
    """The full H1 product of functions that are zero on the boundary."""
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


def _part(A: PETSc.Mat, rows: PETSc.IS | None, columns: PETSc.IS | None = None) -> PETSc.Mat:
    """Rows and columns of a matrix, None for all."""

    def chosen(these: PETSc.IS | None, ends: tuple[int, int]) -> PETSc.IS:
        return PETSc.IS().createStride(ends[1] - ends[0], ends[0], 1, comm=A.comm) if these is None else these

    return A.createSubMatrix(chosen(rows, A.getOwnershipRange()), chosen(columns, A.getOwnershipRangeColumn()))

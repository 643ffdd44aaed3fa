"""The dual weighted residual: what each node of a finer mesh contributes to the error of an output quantity.

Let u_h be the solution on a mesh and u the one on a finer mesh, which stands for the exact one, A its stiffness, and
F = A u - f the nodal forces, which are not 0 at nodes in contact and where u is given. Let C be the nodes where u is
given or at which both u and u_h are in contact. For a quantity Q of u and of these forces let q = dQ/du and w = dQ/dF,
w for all nodes in contact on either mesh. With z = 0 in C and

    A^T z = q + A^T w   at all other nodes,   y = z - w,   m = q - A^T y   (which is 0 outside of C),

a quantity that is linear, on nested meshes, has the error

    Q(u) - Q(u_h) = (y - y_h) . (f - A u_h) + z . F + m . (u - u_h)

for any y_h of the coarser space that is -w at its nodes in contact (Galerkin's orthogonality). The terms of this sum
by nodes say where the mesh is to be refined: those of z . F belong to nodes where only u is in contact. Moreover m is
the derivative of Q with respect to obstacle and boundary values, so that m . (obstacle - u) in contact is the part of
the penalty.

Sources: Becker and Rannacher (2001); Blum and Suttmeier (2000) for obstacle problems.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.linear_solvers import DIRECT, GENERAL, INEXACT, LARGEST, attempt, defaults
from fenicsx_obstacle.algebra.products import product
from fenicsx_obstacle.algebra.truncated_multigrid import Multigrid
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import NotConverged

TOLERANCE = 1e-6  # of the adjoint, which is a weight only
MULTIGRID = {**INEXACT, "ksp_type": "fgmres"}  # the cycle is not symmetric to the last digits


@dataclass(frozen=True, eq=False)
class Adjoint:
    """The adjoint solution of a quantity; arrays of owned dofs.

    Attributes:
        z: See above.
        w: See above.
        m: See above.
    """

    z: np.ndarray
    w: np.ndarray
    m: np.ndarray


def adjoint_of(
    problem: Problem, multigrid: Multigrid | None, active: np.ndarray, q: np.ndarray, w: np.ndarray
) -> Adjoint:
    """The adjoint solution at the problem's state, linearised with its contact set (collective).

    Args:
        problem: Holds the solution.
        multigrid: A preconditioner for it; None where there is none, as without symmetry.
        active: Whether a node is in contact on both meshes.
        q: dQ/du.
        w: dQ/dF.

    Raises:
        NotConverged: If the linear solver fails.
    """
    held = active | problem.fixed
    once = problem.affine and problem.level.pair.nodal
    A = problem.matrices.stiffness if once else _stiffness(problem)
    x, b = A.createVecs()
    b.array[:] = np.where(held, 0.0, q + product(A, w, transposed=True))
    _solve(problem, multigrid, active, b, x)
    z = np.where(held, 0.0, x.array_r)
    m = np.where(held, q - product(A, z - w, transposed=True), 0.0)
    for owner in (x, b, *(() if once else (A,))):
        owner.destroy()
    return Adjoint(z, w, m)


def _stiffness(problem: Problem) -> PETSc.Mat:
    """The derivative of a(u, .) - f at the state, which the caller frees (collective)."""
    state = problem.vector()
    A = problem.jacobian(state, penalised=False).duplicate(copy=True)
    state.destroy()
    return A


def _solve(problem: Problem, multigrid: Multigrid | None, active: np.ndarray, b: PETSc.Vec, x: PETSc.Vec) -> None:
    """Solve A^T x = b with x = 0 in contact and where u is given (collective)."""
    closed = np.where(active & ~problem.fixed, np.inf, 0.0)
    if problem.affine and problem.level.pair.nodal:
        problem.hold(closed)
    else:
        state = problem.vector()
        problem.jacobian(state, penalised=False)
        state.destroy()
        first, _ = problem.A.getOwnershipRange()
        rows = (first + np.flatnonzero(closed)).astype(PETSc.IntType)
        problem.A.zeroRowsColumns(rows, 1.0)
    ways: list[Mapping[str, Any]] = [DIRECT, GENERAL] if problem.level.dofs <= LARGEST else [GENERAL]
    if multigrid is not None:
        multigrid.truncate(closed)
        ways = [MULTIGRID]
    for options in ways:
        ksp = PETSc.KSP().create(problem.level.comm)
        ksp.setOperators(problem.A)
        ksp.setOptionsPrefix("adjoint_")
        with defaults("adjoint_", {**options, "ksp_rtol": TOLERANCE, "ksp_atol": 0.0}):
            if multigrid is not None:
                multigrid.install(ksp.getPC())
            ksp.setFromOptions()
        solve = ksp.solve if problem.symmetric else ksp.solveTranspose
        solved = attempt(partial(solve, b, x), ksp, b, x) and ksp.getConvergedReason() > 0
        ksp.destroy()
        if solved:
            return
    reason = "the linear solver of the adjoint problem"
    raise NotConverged("error estimate", reason, 0, eps=None, h=problem.level.h)


def contributions(
    finest: Problem, below: Sequence[Problem], coarse: np.ndarray, touching: np.ndarray, adjoint: Adjoint
) -> np.ndarray:
    """The terms of the error by owned nodes of the finest mesh (collective).

    Args:
        finest: Holds the solution u on the finest mesh.
        below: The problems of the meshes between, the finer first, whose last one was refined from that of u_h.
        coarse: Owned values of u_h.
        touching: Whether it is in contact.
        adjoint: On the finest mesh.
    """
    chain = [finest, *below]
    y, w = adjoint.z - adjoint.w, adjoint.w
    y_h, w_h = y, w
    for problem in chain:
        y_h, w_h = (problem.transfer.inject(values) for values in (y_h, w_h))
    u, y_h = interpolated(chain, coarse), interpolated(chain, np.where(touching, -w_h, y_h))
    fine = _owned(finest)
    forces = np.where(finest.fixed, 0.0, -unbalanced(finest, fine))
    return (y - y_h) * unbalanced(finest, u) + adjoint.z * forces + adjoint.m * (fine - u)


def energy_contributions(finest: Problem, below: Sequence[Problem], coarse: np.ndarray) -> np.ndarray:
    """The same for the energy, (u - u_h)(F - (f - A u_h))/2, exact where it is quadratic (collective)."""
    u, forces = interpolated([finest, *below], coarse), -unbalanced(finest, _owned(finest))
    return (_owned(finest) - u) * (forces - unbalanced(finest, u)) / 2


def interpolated(chain: Sequence[Problem], coarse: np.ndarray) -> np.ndarray:
    """Owned values on the first of some meshes, from those on the mesh that the last was refined from (collective)."""
    for problem in reversed(chain):
        coarse = problem.transfer.interpolate(coarse)
    return coarse


def _owned(problem: Problem) -> np.ndarray:
    return problem.solution().x.array[: problem.level.owned]


def unbalanced(problem: Problem, u: np.ndarray) -> np.ndarray:
    """f - a(u, .) at owned dofs of owned values u; the state stays (collective)."""
    return -problem.elastic_at(u - problem.state.r)

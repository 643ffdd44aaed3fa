"""A second solution of small problems: primal-dual active sets with the sparse direct solver of SciPy, on rank 0.

The problem is the linear one with the derivative of the residual at the checked state, A = F'(u), and the load
A u - F(u). Of a linear F that is the problem itself; of any other F a solution solves it too. Nothing of the solvers is
used but the matrix, the residual, the weights and the obstacles.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from petsc4py import PETSc
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.parallel import gathered

LARGEST = 20_000  # unknowns
STEPS = 100


class FreeRows(NamedTuple):
    """The linear problem at free dofs, in the order of their global numbers, on one rank. The unknown is w = u - r.

    Attributes:
        A: The derivative of the residual.
        load: A w - F(u).
        weights: D, 0 where nothing can touch.
        lower: Lower obstacle minus r, -inf where there is none.
        upper: Upper obstacle minus r, inf where there is none.
        w: The checked state.
        unbalanced: Its unbalanced forces.
        noise: Their round-off, >= 0.
        eps: Penalty parameter; None for the inequality.
        of_body: Whether nodes have several rows.
    """

    A: sparse.csr_matrix
    load: np.ndarray
    weights: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    w: np.ndarray
    unbalanced: np.ndarray
    noise: np.ndarray
    eps: float | None
    of_body: bool


class Distance(NamedTuple):
    """How far a state is from the solution of active sets.

    Attributes:
        apart: In the energy norm, which is that of the symmetric part S of A.
        reach: What the unbalanced forces r and their round-off explain: the root of r' S^-1 r.
        largest: Largest difference at a node.
        moved: What the round-off of the forces moves a node by, at most.
        stiffness: Root of the sum of A_ii: what a change by 1 at each node may be in the energy norm.
    """

    apart: float
    reach: float
    largest: float
    moved: float
    stiffness: float


def is_small(system: System) -> bool:
    """Whether a problem is solved again: contact is at nodes, and more than contact holds u."""
    return system.nodal and not system.floating and system.dofs <= LARGEST


def free_rows(
    system: System, eps: float | None, elastic: np.ndarray, unbalanced: np.ndarray, noise: np.ndarray
) -> FreeRows | None:
    """The linear problem of a state on rank 0; None on other ranks (collective).

    Args:
        system: Holds the state.
        eps: Penalty parameter; None for the inequality.
        elastic: F(u) at owned dofs.
        unbalanced: The unbalanced forces.
        noise: Their round-off, >= 0.
    """
    x = system.vector()
    A = gathered_matrix(system.jacobian(x, penalised=False))
    x.destroy()
    sides = [np.broadcast_to(none if gap is None else gap, system.owned)
             for gap, none in ((system.below, -np.inf), (system.above, np.inf))]  # fmt: skip
    lower, upper = (np.where(system.touchable, side, none) for side, none in zip(sides, (-np.inf, np.inf), strict=True))
    weights = np.where(system.touchable, system.weights, 0.0)
    owned = weights, lower, upper, system.w, unbalanced, noise, elastic, system.fixed
    of_all: list[Any] = [gathered(system.comm, values) for values in owned]
    if A is None:
        return None
    free = ~of_all.pop()
    D, low, high, w, left, rounded, forces = (values[free] for values in of_all)
    A = A[free][:, free]
    return FreeRows(A, A @ w - forces, D, low, high, w, left, rounded, eps, bool(system.preconditioner))


def distance(p: FreeRows, factors: SuperLU) -> Distance | None:
    """The distance of a state from the solution of active sets; None where these do not settle.

    With e the difference of two solutions whose forces are unbalanced by r, and p decreasing in u, e' S e <= e' r.

    Args:
        p: The problem and the state.
        factors: Those of the symmetric part S of A.
    """
    w = active_sets(p.A.tocsc(), p.load, p.weights, p.lower, p.upper, p.w, p.eps)
    if w is None:
        return None
    e = p.w - w
    reach = sum(energy_norm_of(left, factors) for left in (p.unbalanced, 2 * p.noise))
    moved, stiffness = np.abs(factors.solve(2 * p.noise)).max(), np.sqrt(p.A.diagonal().sum())
    return Distance(energy_norm(e, p.A), reach, float(np.abs(e).max()), float(moved), float(stiffness))


def energy_norm(e: np.ndarray, A: sparse.csr_matrix) -> float:
    """The root of e' A e, which is e' S e."""
    return float(np.sqrt(max(e @ (A @ e), 0.0)))


def energy_norm_of(forces: np.ndarray, factors: SuperLU) -> float:
    """The energy norm of S^-1 times forces."""
    return float(np.sqrt(np.abs(forces @ factors.solve(forces))))


def positive_factors(A: sparse.csr_matrix) -> SuperLU | None:
    """Factors of the symmetric part of A with pivots on the diagonal; None unless it is positive definite."""
    S = ((A + A.T) / 2).tocsc()
    if not (S.shape[0] and np.isfinite(S.data).all()):
        return None
    try:
        factors = splu(S, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # singular
        return None
    in_order = np.array_equal(factors.perm_r, factors.perm_c)
    return factors if in_order and (factors.U.diagonal() > 0).all() else None


def active_sets(
    A: sparse.csc_matrix, forces: np.ndarray, D: np.ndarray, low: np.ndarray, high: np.ndarray, start: np.ndarray,
    eps: float | None,
) -> np.ndarray | None:  # fmt: skip
    """u of a linear problem: sets of nodes at or beyond an obstacle, from those of a start, until they repeat.

    Args:
        A: Stiffness.
        forces: Load.
        D: Weights of I, 0 at nodes without an obstacle.
        low: Lower obstacle, -inf where there is none.
        high: Upper obstacle, inf where there is none.
        start: u.
        eps: Penalty parameter; None for the inequality.

    Returns:
        None if the sets do not repeat.
    """
    beside, w = D > 0, start
    at_low, at_high = beside & (w <= low), beside & (w >= high) & ~(w <= low)
    for _ in range(STEPS):
        active = at_low | at_high
        g = np.where(at_low, low, np.where(at_high, high, 0.0))
        if eps is None:
            inner, w = np.flatnonzero(~active), g
            if len(inner):
                w[inner] = splu(A[inner][:, inner].tocsc()).solve(forces[inner] - (A @ g)[inner])
            push = np.where(active, A @ w - forces, 0.0)
            new_low, new_high = np.where(at_low, push > 0, w < low), np.where(at_high, push < 0, w > high)
        else:
            spring = np.where(active, D / eps, 0.0)
            w = splu((A + sparse.diags(spring)).tocsc()).solve(forces + spring * g)
            new_low, new_high = w < low, w > high
        old, at_low, at_high = (at_low, at_high), beside & new_low, beside & new_high
        if np.array_equal(at_low, old[0]) and np.array_equal(at_high, old[1]):
            return w
    return None


def gathered_matrix(A: PETSc.Mat) -> sparse.csr_matrix | None:
    """A distributed matrix, on rank 0 (collective)."""
    parts, size = A.comm.tompi4py().gather(A.getValuesCSR()), A.getSize()[1]
    if parts is None:
        return None
    return sparse.vstack([sparse.csr_matrix((v, c, s), shape=(len(s) - 1, size)) for s, c, v in parts]).tocsr()

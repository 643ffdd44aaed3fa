"""An own solution of small problems: primal-dual active sets with the sparse direct solver of SciPy, on rank 0.

Nothing of the solvers is used but the matrix, the load, the weights and the obstacles.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from petsc4py import PETSc
from scipy import sparse
from scipy.sparse.linalg import splu

from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.parallel import gathered, on_root

LARGEST = 20_000  # unknowns
STEPS = 100


class Distance(NamedTuple):
    """How far a state is from the solution of active sets.

    Attributes:
        apart: In the energy norm.
        reach: What the unbalanced forces r and their round-off explain: the root of r' A^-1 r.
        stiffness: Root of the sum of A_ii over free dofs: what a change by 1 at each node may be in the energy norm.
    """

    apart: float
    reach: float
    stiffness: float


def distance(system: System, eps: float | None, unbalanced: np.ndarray, noise: np.ndarray) -> Distance | None:
    """The distance of the state of a small linear symmetric problem with contact at dofs from its solution; None of
    other problems, of one that contact alone holds, and where active sets do not settle (collective).

    Args:
        system: Holds the state.
        eps: Penalty parameter; None for the inequality.
        unbalanced: The unbalanced forces at owned dofs.
        noise: Their round-off, >= 0.
    """
    linear = system.affine and system.symmetric and system.has_energy
    if not linear or not system.nodal or system.floating or system.dofs > LARGEST:
        return None
    u_values = system.u
    u_values[system.fixed] = system.given[system.fixed]
    lower, upper = (np.broadcast_to(side, len(u_values)) for side in system.obstacles())
    weights = np.where(system.touchable, system.weights, 0.0)
    load = -system.matrices.minus_load.array_r
    owned = u_values, lower, upper, load, weights, unbalanced, noise, system.fixed
    A = gathered_matrix(system.matrices.stiffness)
    parts: list[Any] = [gathered(system.comm, values) for values in owned]
    return on_root(system.comm, lambda: _distance(eps, A, *parts))


def _distance(
    eps: float | None, A: sparse.csr_matrix, u: np.ndarray, lower: np.ndarray, upper: np.ndarray, load: np.ndarray,
    weights: np.ndarray, unbalanced: np.ndarray, noise: np.ndarray, fixed: np.ndarray,
) -> Distance | None:  # fmt: skip
    """On rank 0, of all dofs, in the order of their global numbers."""
    free, held = np.flatnonzero(~fixed), np.flatnonzero(fixed)
    forces, A = load[free] - A[free][:, held] @ u[held], A[free][:, free].tocsc()
    w = active_sets(A, forces, weights[free], lower[free], upper[free], u[free], eps)
    if w is None:
        return None
    e, solve = u[free] - w, splu(A).solve if len(free) else (lambda forces: forces)
    reach = sum(np.sqrt(np.abs(left @ solve(left))) for left in (unbalanced[free], 2 * noise[free]))
    return Distance(float(np.sqrt(max(e @ (A @ e), 0.0))), float(reach), float(np.sqrt(A.diagonal().sum())))


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

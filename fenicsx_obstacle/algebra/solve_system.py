"""Obstacle problems given as matrices, from any finite element or finite difference code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra.affine import Affine
from fenicsx_obstacle.algebra.coarse import SMALLEST, algebraic_levels
from fenicsx_obstacle.algebra.coarsening import FIXED, FREE, Nodes, first_keys
from fenicsx_obstacle.algebra.kernels import kernels
from fenicsx_obstacle.algebra.m_matrix import is_symmetric
from fenicsx_obstacle.algebra.methods import method_of
from fenicsx_obstacle.algebra.nested import Levels, solve_nested
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.products import product
from fenicsx_obstacle.algebra.separate_parts import SeparateParts
from fenicsx_obstacle.algebra.state import State
from fenicsx_obstacle.algebra.stopping import Step
from fenicsx_obstacle.algebra.system import System, with_infinities
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import agree, total
from fenicsx_obstacle.text import counted

ROUND_OFF = 1e-12  # of the entries of A: row sums that are none
NAME = "solve_system:"


class MatrixSystem(System):
    """A u = f with bounds of u, without a mesh."""

    all_points = True

    def __init__(
        self,
        A: PETSc.Mat,
        f: np.ndarray,
        *,
        lower: np.ndarray | None,
        upper: np.ndarray | None,
        weights: np.ndarray,
        fixed: np.ndarray,
        given: np.ndarray,
    ):
        """Take matrices (collective); arrays hold owned rows, and all of them are checked.

        Args:
            A: Stiffness, without boundary conditions.
            f: Load.
            lower: Lower bound of u, -inf where there is none; None if there is none at all.
            upper: Upper bound.
            weights: D.
            fixed: Whether u is given.
            given: Its values there.
        """
        self.comm, self.lower, self.upper, self.fixed, self.given = A.comm.tompi4py(), lower, upper, fixed, given
        self.symmetric = self.has_energy = is_symmetric(A)
        w_vector, r_vector, minus_load = A.createVecRight(), A.createVecRight(), A.createVecLeft()
        # reactions are sums of A_ij (u_j - u_i): what A and f have in rows of boundary conditions is no scale of force
        minus_load.array[:] = np.where(fixed, -product(A, 1.0) * given, -f)
        state = State(w_vector, r_vector, lower=lower is not None, upper=upper is not None)
        self._set_law(Affine(self.comm, state, A, minus_load, weights, np.flatnonzero(fixed)))
        self.load = total(self.comm, np.abs(f[~fixed]))
        self.jacobian(w_vector, penalised=False)
        self._begin_in_contact()
        self.set_reference(self.cold_start())

    def _begin_in_contact(self) -> None:
        """Find the parts of the free rows on which A maps constants to 0: contact alone holds u there, and begins
        everywhere (collective).

        Raises:
            InputError: If the load does not press such a part against an obstacle.
        """
        parts, A, force = SeparateParts(self, np.zeros(self.owned)), self.matrices, -self.matrices.minus_load.array_r
        sums, held = (parts.sums(np.abs(product(A.stiffness, ones))) for ones in (1.0, self.fixed.astype(float)))
        loose = (held == 0) & (sums <= ROUND_OFF * parts.sums(np.abs(A.diagonal)))
        net = parts.sums(force)
        sign = np.where(net > 0, 1.0, -1.0)
        self.parts = len(loose) + 1, parts.of_dofs()
        way = np.append(sign, 0.0)[self.parts[1]]
        upper, lower = (np.full(self.owned, np.inf) if side is None else sign * side
                        for side, sign in ((self.upper, 1.0), (self.lower, -1.0)))  # fmt: skip
        bound = np.where(way > 0, upper, lower)  # in the direction of the load
        highest = parts.largest(np.where(np.isfinite(bound), bound, -np.inf))
        if (wrong := loose & ((net == 0) | np.isneginf(highest))).any():
            where = "" if loose.all() else " on a part without a given value"
            raise InputError(
                f"{NAME} A maps constants to 0{where}, and the load there, {net[wrong][0]:.3g} in all, presses against "
                "no bound: give u somewhere by `fixed` and `given`"
            )
        if loose.any():
            extended = np.where(np.isfinite(bound), bound, np.append(highest, 0.0)[self.parts[1]])
            start = way * np.nextafter(extended, np.inf)
            self.start = np.where(np.append(loose, False)[self.parts[1]], start, np.nan)
            self.floating, self.borne = True, np.append(loose, False)


@dataclass(frozen=True, eq=False)
class SystemSolution:
    """The solution of `solve_system`; arrays hold owned rows.

    Attributes:
        u: The solution.
        pressure: p, the contact force by weight; >= 0 at the lower bound, <= 0 at the upper one. Of the dimension of
            f/weights.
        contact: -1 at rows that press against the lower bound, 1 at the upper one, 0 elsewhere.
        eps: The penalty parameter, in units of u/p; None with the method vi, and without bounds.
        iterations: Newton steps on the finest level.
        krylov: Linear iterations there.
        levels: Number of unknowns of each level, the coarsest first.
        history: One `Step` for each residual on the finest level.
    """

    u: np.ndarray
    pressure: np.ndarray
    contact: np.ndarray
    eps: float | None
    iterations: int
    krylov: int
    levels: tuple[int, ...]
    history: tuple[Step, ...]


def solve_system(
    A: Any,
    f: Any,
    *,
    lower: Any = None,
    upper: Any = None,
    weights: Any = None,
    fixed: Any = None,
    given: Any = 0.0,
    points: Any = None,
    method: str = "penalty",
    eps: float | str = "auto",
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> SystemSolution:
    """Solve (A u - f) . (v - u) >= 0 for all v with lower <= v <= upper, lower <= u <= upper (collective).

    With the method "penalty" this is A u - f + D chi (u - g)/eps = 0, (3.4), where D are the weights, chi is 1 at rows
    beyond a bound g, and p = -(u - g)/eps there is the pressure. With "vi" it is the inequality itself. Newton's method
    begins from the solution of coarser levels, if there are `points`; then its steps do not depend on the number of
    unknowns.

    Args:
        A: Stiffness matrix, without boundary conditions: a PETSc matrix, or on one rank whatever
            `scipy.sparse.csr_matrix` takes.
        f: Load: a PETSc vector or an array of owned rows, in the unit of A u. At fixed rows it is not used.
        lower: Lower bound of u, a number or an array of owned rows; -inf, or -1e20 and beyond, where there is none.
        upper: Upper bound.
        weights: D > 0, the volume that belongs to a row, for example int phi_i; by default 1.
        fixed: Rows, as flags of owned rows or their numbers, where u is `given`.
        given: Values of u there, a number or an array of owned rows.
        points: Coordinates of rows, shape (rows, 1 to 3), for coarse levels. They have to be those of the nodes of
            linear elements, or of finite differences. By default there are no coarse levels.
        method: "penalty", "successive" or "vi".
        eps: Penalty parameter in units of u/p, or "auto": a hundredth of the median of D_i/A_ii, lowered if u
            penetrates by more than 1 % of its range, or where it does not fit the stiffness at the solution.
        comm: Communicator of a matrix that is not PETSc's.

    Returns:
        The solution.

    Raises:
        InputError: If an argument is invalid.
        NotConverged: With PETSc's reason.
    """
    system = _system(A, f, comm, lower=lower, upper=upper, weights=weights, fixed=fixed, given=given)
    options = SolverOptions(method, "auto" if method == "vi" else eps, source=NAME)
    touchable = total(system.comm, np.count_nonzero(system.touchable)) > 0
    way = method_of(system, options, known=None if touchable else 1.0)  # if u is given everywhere, any eps
    coarser: list[System] = []
    if points is not None:
        with agree(system.comm):
            x = _points(points, system.owned)
        if method != "successive" and system.symmetric:
            coarser = _coarser(system, x)
    levels = Levels.of([*coarser, system], multigrid=True)
    outcome = solve_nested(levels, way)[-1]
    pressure = way.pressure(system)
    return SystemSolution(
        system.u, pressure, -np.sign(pressure).astype(np.int8), outcome.eps, outcome.iterations, outcome.krylov,
        tuple(level.dofs for level in levels.systems), outcome.history,
    )  # fmt: skip


def _system(A: Any, f: Any, comm: MPI.Comm, **data: Any) -> MatrixSystem:
    """Check the arguments (collective).

    Raises:
        InputError: Naming the argument.
    """
    A = matrix_of(A, comm)
    comm = A.comm.tompi4py()
    (own, rows), (_, columns) = A.getSizes()
    if rows != columns:
        raise InputError(f"{NAME} A: expected a square matrix, it has {rows} rows and {columns} columns")
    fixed = np.zeros(own, dtype=bool)
    with agree(comm):
        f = _array(f.array_r if isinstance(f, PETSc.Vec) else f, own, "f")
        low = with_infinities(_array(-np.inf if data["lower"] is None else data["lower"], own, "lower", finite=False))
        high = with_infinities(_array(np.inf if data["upper"] is None else data["upper"], own, "upper", finite=False))
        weights = _array(1.0 if data["weights"] is None else data["weights"], own, "weights")
        given = _array(data["given"], own, "given")
        if data["fixed"] is not None:
            fixed[_rows(data["fixed"], own)] = True
        given[~fixed] = 0.0
    diagonal = A.getDiagonal()
    wrong = {
        "A: no diagonal entry (take an explicit 0 where u is given)": ~_diagonal_entries(A),
        "weights: must be positive": weights <= 0,
        "lower is inf": np.isposinf(low),
        "upper is -inf": np.isneginf(high),
        "lower is above upper": low > high,
        "given values are not between the bounds": fixed & ((given < low) | (given > high)),
        "A: must be positive definite, but the diagonal is not positive": ~(diagonal.array_r > 0) & ~fixed,
    }
    diagonal.destroy()
    for words, where in wrong.items():
        if (count := total(comm, np.count_nonzero(where))) > 0:
            raise InputError(f"{NAME} {words} at {counted(int(count), 'row')}")
    bounds = {side: bound if total(comm, np.isfinite(bound)) > 0 else None
              for side, bound in (("lower", low), ("upper", high))}  # fmt: skip
    return MatrixSystem(A, f, weights=weights, fixed=fixed, given=given, **bounds)


def _diagonal_entries(A: PETSc.Mat) -> np.ndarray:
    """Whether owned rows have an entry on the diagonal: Newton's matrices change it."""
    starts, columns = A.getDiagonalBlock().getRowIJ()
    rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    found = np.zeros(len(starts) - 1, dtype=bool)
    found[rows[rows == columns]] = True
    return found


def matrix_of(A: Any, comm: MPI.Comm) -> PETSc.Mat:
    """A matrix of PETSc's from one of its own, or on one rank from whatever `scipy.sparse.csr_matrix` takes."""
    if isinstance(A, PETSc.Mat):
        if not A.isAssembled():
            raise InputError(f"{NAME} A: the matrix is not assembled: call A.assemble()")
        return A if "aij" in A.getType() and "baij" not in A.getType() else A.convert("aij", PETSc.Mat())
    from scipy.sparse import csr_matrix

    if comm.size > 1:
        raise InputError(f"{NAME} A: on several ranks expected a PETSc matrix, whose rows are distributed")
    rows = csr_matrix(A, copy=True)  # the arrays may be those of another matrix too
    rows.sum_duplicates()
    if rows.dtype.kind == "c":
        raise InputError(f"{NAME} A: expected real numbers, not complex ones")
    csr = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data.astype(float)
    return PETSc.Mat().createAIJ(rows.shape, csr=csr, comm=comm)


def _array(values: Any, own: int, name: str, *, finite: bool = True) -> np.ndarray:
    if np.iscomplexobj(values):
        raise InputError(f"{NAME} {name}: expected real numbers, not complex ones")
    try:
        numbers = np.ma.filled(np.asanyarray(values, dtype=float), np.nan)  # a masked value is none
        found = np.array(np.broadcast_to(numbers, own))
    except (TypeError, ValueError):
        raise InputError(f"{NAME} {name}: expected a number, or an array of {own} numbers") from None
    if np.isnan(found).any() or (finite and not np.isfinite(found).all()):
        raise InputError(f"{NAME} {name}: holds values that are not {'finite' if finite else 'numbers'}")
    return found


def _rows(rows: Any, own: int) -> np.ndarray:
    found = np.asarray(rows)
    flags = found.dtype == bool and found.shape == (own,)
    numbers = found.dtype.kind in "iu" and found.ndim == 1 and np.all((found >= 0) & (found < own))
    if numbers and len(found) == own > 2 and np.all(found < 2):
        raise InputError(f"{NAME} fixed: zeros and ones for all {own} rows: flags must be of the type bool")
    if not (flags or numbers or found.size == 0):
        raise InputError(f"{NAME} fixed: expected {own} flags, or numbers of owned rows from 0 to {own - 1}")
    return found if found.size else np.empty(0, dtype=int)


def _points(points: Any, own: int) -> np.ndarray:
    x = np.asarray(points, dtype=float)
    if x.ndim != 2 or x.shape[0] != own or not 1 <= x.shape[1] <= 3 or not np.isfinite(x).all():
        raise InputError(f"{NAME} points: expected finite coordinates of the shape ({own}, 1 to 3), got {x.shape}")
    return x


def _coarser(system: MatrixSystem, x: np.ndarray) -> list[System]:
    """Algebraic levels; none for few unknowns, or without a compiler (collective)."""
    if system.dofs < SMALLEST or (loops := kernels(system.comm)) is None:
        return []
    padded = np.zeros((system.owned, 3))
    padded[:, : x.shape[1]] = x
    kind = np.where(system.fixed, FIXED, FREE).astype(np.int8)
    nodes = Nodes(padded, kind, first_keys(system.matrices.stiffness, padded), None, x.shape[1])
    return algebraic_levels(system, nodes, loops)

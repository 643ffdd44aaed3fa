"""The discrete obstacle problem: matrices and arrays, no mesh and no form.

    Find u with lower <= u <= upper at the points of I, and (A u - f) . (v - u) >= 0 for all such v.        (3.19)

The penalty method solves A u - f + D chi (u - g)/eps = 0 instead, (3.4); D are the weights of the rule I, chi is 1 at
the points beyond an obstacle g. A nonlinear problem has a residual in place of A u - f, and its derivative.

The unknown is w = u - r, where the reference r is the obstacle that a node may touch ('gap form'). In contact
w = -eps p is small and has full relative accuracy. As a difference u - r of values of order 1 the penalty w/eps would
be round-off for eps < 1e-12.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra.affine import Affine
from fenicsx_obstacle.algebra.m_matrix import is_m_matrix
from fenicsx_obstacle.algebra.products import product
from fenicsx_obstacle.algebra.state import Law
from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.parallel import largest, smallest, total

LIMIT = 1e-2  # of the forces that the data exert: round-off beyond it makes a solution meaningless
PRESCRIBE = "prescribe u on a part of the boundary ([[boundary]] value, or bcs)"  # part of messages


NO_BOUND = 1e20  # an obstacle of this absolute value or beyond is none; PETSc.INFINITY is this, or 4.5e307


def with_infinities(g: np.ndarray) -> np.ndarray:
    """Values of an obstacle as they were given, with inf and -inf where they mean that there is none."""
    return np.where(np.abs(g) >= NO_BOUND, np.copysign(np.inf, g), g)


Check = Callable[["System", np.ndarray], "str | None"]  # see `System.checks`


class System:
    """A discrete obstacle problem, and its state.

    All arrays hold owned dofs or owned points of I. All methods are collective. Objects live as long as the system and
    are changed in place.

    Attributes:
        comm: Communicator.
        law: Residual, derivative and energy.
        lower: The lower obstacle at dofs, -inf where there is none; None if there is none at all.
        upper: The upper one.
        fixed: Whether u is given at a dof.
        given: The given values, at fixed dofs.
        weights: D, the area that belongs to a point of I.
        touchable: Whether u can touch an obstacle at a point of I.
        to_points: Maps values at dofs to the points of I; None if these are dofs.
        all_points: Whether every dof counts as a point of I, whatever its weight.
        weights_are_sparse: Whether contact is on a part of the boundary or a curve, beside which D is 0.
        thickness: What a weight is per unit of length if contact is on a boundary, else 1.
        A: The derivative of the residual; the same matrix for life.
        elastic: a(u, .) - f at the last state, rows of fixed dofs included (their support reaction).
        reaction: (1/eps) I((u - g)^+, .) at the last state.
        load: Sum of |f_i| over free dofs.
        affine: Whether the residual is linear in u plus a constant.
        symmetric: Whether the derivative is.
        has_energy: Whether the residual is the derivative of a convex energy.
        at_rest: Whether it is no step in time. A step is held by the state before it.
        share: Of the force that balances a step in time, the part that is the contact force: 1, or 1/2 with inertia.
        floating: Whether only contact holds some part of the mesh.
        parts: Number of connected parts, and that of each dof. Only needed with `borne`, `unheld` or `held`.
        borne: For each part whether contact alone bears its load; None if there are none.
        unheld: For each part whether u is given nowhere, so that contact forces alone may determine it.
        held: For each part where supports alone hold u, and F is affine, their stiffness: the force per unit of a
            constant that is added to u; elsewhere infinite. None if there are none.
        loose: Of bodies, the rigid motions that only contact resists; None if there are none.
        checks: Of a state in balance: the reason why it is no solution, or None; for effects that need more.
        hint: What a solver that fails adds to its reason.
        source: What messages call the problem.
        direct: Whether linear systems are solved directly, as those of saddle points, where A_ii may be 0.
        fields: Number of fields with units of their own, and that of each dof; None where u is one field.
        h: Mesh size, for messages; 0 without a mesh.
        prefix: Of its PETSc options; where it is empty, that of the solver.
        solver: The SNES of the last attempt, where it is kept.
        transfer: Interpolation from the next coarser system.
        on_mesh: Whether the dofs are those of a mesh that the caller knows.
    """

    preconditioner: Mapping[str, str] = {}  # options in place of those for scalar problems
    keeps_solver = False  # for the caller to look at; it holds memory
    solver: PETSc.SNES | None = None
    to_points: PETSc.Mat | None = None
    all_points = False
    weights_are_sparse = False
    affine = True
    symmetric = True
    has_energy = True
    at_rest = True
    share = 1.0
    floating = False
    parts: tuple[int, np.ndarray] | None = None
    borne: np.ndarray | None = None
    unheld: np.ndarray | None = None
    held: np.ndarray | None = None
    loose: np.ndarray | None = None
    checks: Sequence[Check] = ()
    hint = ""
    source = "solve_system:"
    direct = False
    fields: tuple[int, np.ndarray] | None = None
    h = 0.0
    prefix = ""
    on_mesh = False
    eps_share = 0.01  # of the median of D_i/A_ii: eps = "auto" where no effect says how stiff it is
    transfer: Transfer
    comm: MPI.Comm
    law: Law
    lower: np.ndarray | None
    upper: np.ndarray | None
    fixed: np.ndarray
    given: np.ndarray
    weights: np.ndarray
    load: float
    start: np.ndarray | None = None  # u in contact on parts that only contact supports, elsewhere not-a-number

    def _set_law(self, law: Law) -> None:
        """Make what stays, for a system whose data are set."""
        self.law, self.state = law, law.state
        self.thickness = law.thickness
        self.A = law.create_matrix()
        self.elastic, self.reaction = law.vector(), law.vector()
        self.weights = law.weights()
        self.touchable = (self.weights > 0) & ~self.fixed if self.nodal else np.ones(len(self.weights), dtype=bool)

    @property
    def owned(self) -> int:
        """Number of owned dofs."""
        return len(self.fixed)

    @cached_property
    def dofs(self) -> int:
        """Number of dofs on all ranks."""
        return int(total(self.comm, self.owned))

    @property
    def nodal(self) -> bool:
        """Whether the points of I are dofs."""
        return self.to_points is None

    @property
    def constrained(self) -> bool:
        """Whether there is an obstacle."""
        return self.lower is not None or self.upper is not None

    @property
    def w(self) -> np.ndarray:
        """The unknown."""
        return self.state.w

    @property
    def below(self) -> np.ndarray | None:
        """Distance of the lower obstacle from r."""
        return self.state.below

    @property
    def above(self) -> np.ndarray | None:
        """Distance of the upper obstacle from r."""
        return self.state.above

    @property
    def eps(self) -> float:
        """The penalty parameter of the residual, in units of u/p."""
        return self.state.eps

    @eps.setter
    def eps(self, value: float) -> None:
        self.state.eps = value

    @property
    def u(self) -> np.ndarray:
        """u = w + r, a new array."""
        return self.state.w + self.state.r

    def options_of(self, solver: str) -> str:
        """The prefix of the PETSc options of a solver."""
        return self.prefix or f"{solver}_"

    def heights(self) -> list[np.ndarray]:
        """Values of u in the data beside given values and obstacles, such as the levels of supports."""
        return []

    def pushes(self) -> tuple[float, float] | None:
        """The least and the largest load, if a load of one sign moves u to that side only; else None."""
        return None

    def tension(self) -> float | None:
        """The largest tension, if it is among the data: eps is chosen in proportion to it."""
        return None

    @property
    def compliance_power(self) -> float:
        """The power of D_i that D_i/A_ii is proportional to, as cells change their size: 2/d in d dimensions."""
        return 0.0

    def cold_start(self) -> np.ndarray:
        """Initial values of u: the given ones, and elsewhere their mean, moved between the obstacles.

        The mean changes with a shift of all data, so that results do not depend on the zero of u.
        """
        given = self.given[self.fixed]
        mean = total(self.comm, given) / max(total(self.comm, len(given)), 1.0)
        u_values = np.clip(np.full(self.owned, mean), *self.obstacles())
        u_values[self.fixed] = given
        if self.start is not None:  # nothing else holds it: begin with contact everywhere, where the load presses
            u_values = np.where(np.isnan(self.start), u_values, self.start)
        return u_values

    def flat(self) -> np.ndarray:
        """Heights of data above the lowest one: a u that equals given values and obstacles, and is constant
        elsewhere."""
        u_values = self.cold_start()
        u_values -= smallest(self.comm, u_values)
        return u_values

    def obstacles(self) -> tuple[np.ndarray | float, np.ndarray | float]:
        """The obstacles at dofs; -inf and inf where there is none."""
        return (-np.inf if self.lower is None else self.lower), (np.inf if self.upper is None else self.upper)

    def between(self, u_values: np.ndarray) -> np.ndarray:
        """The nearest values of u between the obstacles."""
        return np.clip(u_values, *self.obstacles())

    def set_reference(self, u_values: np.ndarray) -> None:
        """Set the reference r to the obstacle that a node touches or may touch, and store w = u - r.

        That is the obstacle nearest to u, where it is no farther off than the range of u. Elsewhere r is u itself, and
        where u is given r is its value: a far obstacle takes no digit from u.
        """
        lower, upper = self.obstacles()
        below, above = u_values - lower, upper - u_values
        nearest = np.where(np.abs(below) <= np.abs(above), lower, upper)
        spread = self.spread(u_values)
        r = self.state.r
        r[:] = np.where(np.minimum(below, above) <= spread, nearest, u_values if self.constrained else 0.0)
        r[self.fixed] = self.given[self.fixed]
        self.w[:] = u_values - r
        self.w[self.fixed] = 0.0
        self._measure_gaps()

    def move(self, u_values: np.ndarray) -> bool:
        """Take data that have changed with time and set u; returns whether the stiffness has changed."""
        self.set_reference(u_values)
        return False

    def renew(self, *, stiffness: bool) -> None:
        """Take data that the caller has changed; the state is that of a cold start afterwards.

        Args:
            stiffness: Whether a(., .) is among it.
        """
        self.set_reference(self.cold_start())

    def in_components(self, u_values: np.ndarray) -> np.ndarray:
        """Values of u in the components of w."""
        return u_values

    def set_unknown(self, values: np.ndarray) -> None:
        """Set u in the components of w, and the reference as `set_reference` does."""
        System.set_reference(self, values)

    def update_reference(self, *, roundoff_limited: bool = False) -> bool:
        """Set the reference r to the obstacle that each node touches; returns whether any node has changed.

        Args:
            roundoff_limited: Count w of the other nodes from their present values: w has become so large, because an
                obstacle is far off, that its last digit is felt.
        """
        if not self.constrained or not self.nodal:
            return False
        w, r = self.w, self.state.r
        points = np.ones(len(w), dtype=bool) if self.all_points else self.weights > 0
        lower, upper = self.obstacles()
        new_w, new_r, free = w.copy(), r.copy(), np.ones(len(w), dtype=bool)
        for gap, obstacle, sign in ((self.below, lower, -1), (self.above, upper, 1)):
            if gap is None:
                continue
            touching = points & (sign * (w - gap) >= 0)
            wrong = touching & (gap != 0)
            # differences of gaps, not of u: the excess keeps its digits
            new_w = np.where(wrong, w - gap, new_w)
            new_r = np.where(wrong, obstacle, new_r)
            free &= ~touching
        if roundoff_limited:
            new_r, new_w = np.where(free, r + w, new_r), np.where(free, 0.0, new_w)
        changed = total(self.comm, np.count_nonzero(new_r != r)) > 0
        if changed:
            w[:], r[:] = new_w, new_r
            self._measure_gaps()
        return changed

    def _measure_gaps(self) -> None:
        """Distances of the obstacles from r."""
        if self.below is not None:
            self.below[:] = self.obstacles()[0] - self.state.r
        if self.above is not None:
            self.above[:] = self.obstacles()[1] - self.state.r
        self.state.share_all()
        self.law.set_reference()

    def spread(self, u_values: np.ndarray) -> np.ndarray | float:
        """The range of values of u, of several fields at each dof that of its field."""
        return largest(self.comm, u_values) - smallest(self.comm, u_values)

    def bounded_fields(self) -> list[np.ndarray | slice]:
        """The dofs of each field that has bounds."""
        return [slice(None)]

    def range_of_u(self) -> float:
        """The range of u in the present state, 0 without nodes; of several fields with bounds the smallest."""
        parts = [self.u[dofs] for dofs in self.bounded_fields()]
        return max(min(largest(self.comm, part) - smallest(self.comm, part) for part in parts), 0.0)

    def vector(self) -> PETSc.Vec:
        """A vector for the solver, holding w."""
        x = self.law.vector()
        x.array[:] = self.w
        return x

    def set_state(self, x: PETSc.Vec) -> None:
        """Set w to x."""
        self.w[:] = x.array_r
        self.state.share()

    def residual(self, x: PETSc.Vec, out: PETSc.Vec, *, penalised: bool = True) -> None:
        """out = a(u, .) + (1/eps) I((u - g)^+, .) - f at w = x, (3.4); 0 at fixed dofs, where x has its value."""
        self.set_state(x)
        self.law.elastic(self.elastic)
        values = out.array
        values[:] = self.elastic.array_r
        if self.constrained and penalised:
            self.law.reaction(self.reaction)
            values += self.reaction.array_r
        values[self.fixed] = 0.0

    def jacobian(self, x: PETSc.Vec, *, penalised: bool = True) -> PETSc.Mat:
        """Derivative of `residual` at w = x, with rows and columns of fixed dofs those of the identity."""
        self.set_state(x)
        self.law.jacobian(self.A, penalised=self.constrained and penalised)
        return self.A

    def energy(self, x: PETSc.Vec, *, penalised: bool = True, moving: bool = True) -> float:
        """a(u, u)/2 - f(u) + I((u - g)^+ ^2, 1)/(2 eps) at w = x; the terms of a step in time only if `moving`."""
        self.set_state(x)
        return self.law.energy(penalised=self.constrained and penalised, moving=moving)

    def hold(self, penalty_diagonal: np.ndarray) -> None:
        """Add a diagonal to the stiffness in A; infinite entries fix a dof."""
        self.matrices.add_penalty_diagonal(self.A, penalty_diagonal)

    @property
    def matrices(self) -> Affine:
        """The assembled matrices of an affine system whose points of I are dofs."""
        assert isinstance(self.law, Affine)
        return self.law

    @cached_property
    def m_matrix(self) -> bool:
        """Whether the stiffness between free dofs is an M-matrix."""
        if not (self.affine and self.nodal and self.has_energy):
            return False
        return is_m_matrix(self.A, self.matrices.diagonal, self.comm)

    def gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances u - lower and upper - u at the points of I; inf where there is no obstacle."""
        none = np.broadcast_to(np.inf, len(self.weights))
        lower = none if self.below is None else self.at_points(self.w - self.below)
        upper = none if self.above is None else self.at_points(self.above - self.w)
        return lower, upper

    def pressed_gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """The gaps in the penalty term: those of the augmented obstacles, if there is a multiplier."""
        lower, upper = self.gaps()
        if self.state.multiplier is not None:
            shift = self.eps * self.state.multiplier
            lower, upper = lower - shift, upper + shift
        return lower, upper

    def at_points(self, values: np.ndarray) -> np.ndarray:
        """Values at dofs at the points of I; inf at dofs that are none."""
        if self.to_points is None:
            return values if self.all_points else np.where(self.weights > 0, values, np.inf)
        return product(self.to_points, values)

    def from_points(self, values: np.ndarray) -> np.ndarray:
        """The transpose of `at_points`: forces at points of I as forces at dofs."""
        return values if self.to_points is None else product(self.to_points, values, transposed=True)

    def active_dofs(self, active: np.ndarray) -> np.ndarray:
        """Dofs on which contact at these points of I acts."""
        return active if self.to_points is None else self.from_points(active) > 0

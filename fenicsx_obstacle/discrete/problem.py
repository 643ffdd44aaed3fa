"""The discrete problem on one level: the penalised residual (3.4), its Jacobian and energy for PETSc.

The unknown is w = u - r, where the reference r is the obstacle that a node may touch ('gap form'). In contact w =
-eps p is small and has full relative accuracy. As a difference u - r of values of order 1 the penalty w/eps would be
round-off for eps < 1e-12.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.admissible import check_admissible
from fenicsx_obstacle.discrete.assembly import Forms, Nodal
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.duality import in_q, point_cells
from fenicsx_obstacle.discrete.limit_load import check_limit_load
from fenicsx_obstacle.discrete.m_matrix import is_m_matrix
from fenicsx_obstacle.discrete.solvability import Support, check_support, forces_at_work
from fenicsx_obstacle.discrete.transfer import Transfer, to_parents
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.residence import Drift


class Problem:
    """A model on one mesh, ready for a solver; forms compile once, whatever eps.

    All arrays hold the owned dofs. All methods are collective.

    Attributes:
        data: The data of the model on this mesh.
        model: What is to be solved.
        level: The mesh and V.
        w: The unknown, as a Function.
        reference: r, the reference of w = u - r.
        affine: Whether the elastic residual is linear in u plus a constant.
        fixed: Whether u is given at a dof.
        weights: D_i = I(phi_i, 1), the area that belongs to a point of I. These points are the owned dofs, or where
            the pair is not nodal the owned dofs of Q_h.
        touchable: Whether u can touch an obstacle at a point of I.
        thickness: What a weight is per unit of length where contact is on the boundary, else 1: p times it is a force
            per length there.
        floating: Whether only contact holds some part of the mesh.
        borne: For each connected part of the mesh whether contact alone bears its load; None where there are none.
        balanced: For each of these parts whether only contact forces determine a constant that may be added to u.
        loose: Of bodies, the rigid motions that only contact resists, at owned dofs; None where there are none.
        A: The Jacobian; the same matrix for life.
        elastic: a(u, .) - f at the last state, rows of fixed dofs included (their support reaction).
        reaction: (1/eps) I((u - g)^+, .) at the last state.
        prefix: Of its PETSc options; where it is empty, that of the solver.
        solver: The SNES of the last attempt, where it is kept.
    """

    preconditioner: Mapping[str, str] = {}  # options in place of those for scalar problems
    keeps_solver = False  # for the caller to look at; it holds memory
    solver: PETSc.SNES | None = None
    loose: np.ndarray | None = None
    eps_share = 0.01  # of the median of D_i/A_ii: eps = "auto" where no effect says how stiff it is

    def __init__(self, data: Data, prefix: str = ""):
        """Assemble what stays."""
        self.prefix = prefix
        self.data, self.model, self.level = data, data.model, data.level
        model, level = self.model, self.level
        check_admissible(data)
        self.affine = all(effect.affine for effect in model.effects)
        nodal = level.pair.nodal
        self.forms = forms = self._make_forms()
        self.w, self.reference, self.eps = forms.w, forms.reference, forms.eps
        self.below, self.above = forms.below, forms.above
        self.constrained = self.below is not None or self.above is not None
        self.fixed = np.zeros(level.owned, dtype=bool)
        self.fixed[forms.fixed] = True
        self.thickness = forms.thickness
        self.A = forms.create_matrix()
        self.elastic, self.reaction = forms.vector(), forms.vector()
        self.weights = forms.weights()
        self.touchable = (self.weights > 0) & ~self.fixed if nodal else np.ones(len(self.weights), dtype=bool)
        self.load = self._load_sum()
        check_limit_load(self)
        self._start, self.floating, self.borne, self.balanced = self._check_support()
        self.set_reference(self.cold_start())

    def _make_forms(self) -> Forms:
        """The object that assembles the residual.

        Raises:
            InputError: If the element is not for these data.
        """
        model, pair = self.model, self.level.pair
        if self.data.thin and not pair.at_vertices:
            raise InputError(f"{model.source}: obstacles on the boundary are for elements P1 and Q1")
        if pair.own_weights:
            others = [effect.key for effect in model.effects if not effect.in_model_problem]
            others += ["[time]"] * (model.time is not None)
            if others:
                message = f"element {pair.name} is for tension and load, not for {others[0]}"
                raise InputError(f"{model.source}: {message}")
        return (Nodal if self.affine and pair.nodal else Forms)(model.effects, self.data)

    def _check_support(self) -> Support:
        """The result of `check_support`."""
        return check_support(self)

    def options_of(self, solver: str) -> str:
        """The prefix of the PETSc options of a solver."""
        return self.prefix or f"{solver}_"

    def cold_start(self) -> np.ndarray:
        """Initial values of u, ghosts included: the boundary values, and inside their mean, moved between the
        obstacles.

        The mean changes with a shift of all data, so that results do not depend on the zero of u.
        """
        dofs, values = self.data.fixed
        comm, own = self.level.comm, dofs[dofs < self.level.owned]
        mean = total(comm, values.x.array[own]) / max(total(comm, len(own)), 1.0)
        u_values = np.full(len(values.x.array), mean)
        lower, upper = self.obstacles()
        np.clip(u_values, lower, upper, out=u_values)
        u_values[dofs] = values.x.array[dofs]
        if self._start is not None:  # nothing else holds it: begin with contact everywhere, where the load presses
            u_values = np.where(np.isnan(self._start), u_values, self._start)
        return u_values

    def flat(self) -> np.ndarray:
        """Heights of data above the lowest one: a u that equals boundary values and obstacles, and is constant
        elsewhere; local dofs (collective)."""
        u_values = self.cold_start()
        u_values -= smallest(self.level.comm, u_values)
        return u_values

    def move(self, u_values: np.ndarray) -> bool:
        """Update the data for the present time and set u; returns whether the stiffness has changed.

        Raises:
            InputError: If no u can satisfy the data.
        """
        changed = self._take_data(stiffness=self.data.move())
        self.set_reference(u_values)
        self.load = forces_at_work(self, self.load)
        return changed

    def renew(self, *, stiffness: bool) -> None:
        """Update data that the caller has changed; the state is that of a cold start afterwards.

        Args:
            stiffness: Whether a(., .) is among it.

        Raises:
            InputError: If no u can satisfy the data.
        """
        self.data.renew()
        self._take_data(stiffness=stiffness)
        self.set_reference(self.cold_start())

    def _take_data(self, *, stiffness: bool) -> bool:
        """Assemble again what depends on changed data; returns whether the stiffness has changed."""
        changed = self.forms.renew(self.A, stiffness=stiffness)
        if self.data.moving:
            check_admissible(self.data)
        if changed:
            self.__dict__.pop("m_matrix", None)
        if changed or not (self.affine and self.level.pair.nodal):  # otherwise the forms do not tell
            self.__dict__.pop("drift", None)
        self.load = self._load_sum()
        check_limit_load(self)
        self._start, self.floating, self.borne, self.balanced = self._check_support()
        return changed

    def obstacles(self) -> tuple[np.ndarray | float, np.ndarray | float]:
        """Nodal values of the obstacles, ghosts included; -inf and inf where there is none."""
        lower, upper = self.data.lower, self.data.upper
        return (-np.inf if lower is None else lower.x.array), (np.inf if upper is None else upper.x.array)

    def between(self, u_values: np.ndarray) -> np.ndarray:
        """The nearest values of u between the obstacles, ghosts included."""
        return np.clip(u_values, *self.obstacles())

    def in_components(self, u_values: np.ndarray) -> np.ndarray:
        """Values of u, ghosts included, in the components of w."""
        return u_values

    def in_q(self, values: np.ndarray) -> fem.Function:
        """Values at owned points of I as a Function of Q_h (collective)."""
        return in_q(self.level, values)

    def pressures(self, p: np.ndarray) -> fem.Function:
        """The same of pressures, whose Q_h may have more nodes (collective)."""
        return self.in_q(p)

    def set_reference(self, u_values: np.ndarray) -> None:
        """Set the reference r to the obstacle that a node touches or may touch, and store w = u - r.

        That is the obstacle nearest to u, where it is no farther off than the range of u. Elsewhere r is u itself, and
        where u is given r is its value: a far obstacle takes no digit from u.

        Args:
            u_values: Values of u, ghosts included.
        """
        lower, upper = self.obstacles()
        below, above = u_values - lower, upper - u_values
        nearest = np.where(np.abs(below) <= np.abs(above), lower, upper)
        comm = self.level.comm
        spread = largest(comm, u_values) - smallest(comm, u_values)
        r = np.where(np.minimum(below, above) <= spread, nearest, u_values if self.constrained else 0.0)
        dofs, values = self.data.fixed
        r[dofs] = values.x.array[dofs]
        # the owner of a dof decides for all: by round-off in its point, ranks may see different obstacles nearer
        self.reference.x.array[:] = r
        self.reference.x.scatter_forward()
        self.w.x.array[:] = u_values - self.reference.x.array
        self.w.x.array[dofs] = values.x.array[dofs] - self.reference.x.array[dofs]
        self._measure_gaps()

    def set_unknown(self, values: np.ndarray) -> None:
        """Set u from owned values in the components of w, and the reference as `set_reference` does (collective)."""
        self.w.x.array[: self.level.owned] = values
        self.w.x.scatter_forward()
        Problem.set_reference(self, self.w.x.array.copy())

    def update_reference(self, *, roundoff_limited: bool = False) -> bool:
        """Set the reference r to the obstacle that each node touches; returns whether any node has changed.

        Args:
            roundoff_limited: Count w of the other nodes from their present values: w has become so large, because an
                obstacle is far off, that its last digit is felt.
        """
        if not self.constrained or not self.level.pair.nodal:
            return False
        w, r = self.w.x.array, self.reference.x.array
        points = self._at_all_dofs(self.weights > 0)
        lower, upper = self.obstacles()
        new_w, new_r, free = w.copy(), r.copy(), np.ones(len(w), dtype=bool)
        for gap, obstacle, sign in ((self.below, lower, -1), (self.above, upper, 1)):
            if gap is None:
                continue
            touching = points & (sign * (w - gap.x.array) >= 0)
            wrong = touching & (gap.x.array != 0)
            # differences of gaps, not of u: the excess keeps its digits
            new_w = np.where(wrong, w - gap.x.array, new_w)
            new_r = np.where(wrong, obstacle, new_r)
            free &= ~touching
        if roundoff_limited:
            new_r, new_w = np.where(free, r + w, new_r), np.where(free, 0.0, new_w)
        changed = total(self.level.comm, np.count_nonzero(new_r != r)) > 0
        if changed:
            w[:], r[:] = new_w, new_r
            self._measure_gaps()
        return changed

    def _measure_gaps(self) -> None:
        """Distances of the obstacles from r."""
        lower, upper = self.obstacles()
        if self.below is not None:
            self.below.x.array[:] = lower - self.reference.x.array
        if self.above is not None:
            self.above.x.array[:] = upper - self.reference.x.array
        self.forms.set_reference()

    def solution(self) -> fem.Function:
        """u = w + r."""
        u = fem.Function(self.level.V, name="u")
        u.x.array[:] = self.w.x.array + self.reference.x.array
        return u

    def range_of_u(self) -> float:
        """The range of u in the present state, 0 without nodes."""
        u_values, comm = self.w.x.array + self.reference.x.array, self.level.comm
        return max(largest(comm, u_values) - smallest(comm, u_values), 0.0)

    def state(self) -> PETSc.Vec:
        """A vector for the solver, holding w."""
        x = self.forms.vector()
        x.array[:] = self.w.x.array[: self.level.owned]
        return x

    def set_state(self, x: PETSc.Vec) -> None:
        """Set w to x, ghosts included."""
        own = self.level.owned
        self.w.x.array[:own] = x.array_r
        self.w.x.scatter_forward()

    def residual(self, x: PETSc.Vec, out: PETSc.Vec, *, penalised: bool = True) -> None:
        """out = a(u, .) + (1/eps) I((u - g)^+, .) - f at w = x, (3.4); 0 at fixed dofs, where x has its value."""
        self.set_state(x)
        self.forms.elastic(self.elastic)
        values = out.array
        values[:] = self.elastic.array_r
        if self.constrained and penalised:
            self.forms.reaction(self.reaction)
            values += self.reaction.array_r
        values[self.fixed] = 0.0

    def jacobian(self, x: PETSc.Vec, *, penalised: bool = True) -> PETSc.Mat:
        """Derivative of `residual` at w = x, with rows and columns of fixed dofs those of the identity."""
        self.set_state(x)
        self.forms.jacobian(self.A, penalised=self.constrained and penalised)
        return self.A

    def hold(self, penalty_diagonal: np.ndarray) -> None:
        """Add a diagonal to the stiffness in A; infinite entries fix a dof (collective)."""
        self.nodal.add_penalty_diagonal(self.A, penalty_diagonal)

    @cached_property
    def transfer(self) -> Transfer:
        """Interpolation from the next coarser problem; by default from the mesh that this one was refined from (first
        use is collective)."""
        return to_parents(self.level.on_meshes if self.level.grids else self.level)

    @property
    def nodal(self) -> Nodal:
        """The assembled matrices (affine effects only)."""
        assert isinstance(self.forms, Nodal)
        return self.forms

    @property
    def loose_without_contact(self) -> bool:
        """Whether the first active set of SNES VI has to be that of a penalty solve."""
        return False

    @property
    def symmetric(self) -> bool:
        """Whether the Jacobian is."""
        return all(effect.symmetric for effect in self.model.effects)

    @property
    def has_energy(self) -> bool:
        """Whether the residual is the derivative of a convex energy."""
        w, data, effects = self.forms.w, self.data, self.model.effects
        derived = (e.energy(w, data) is not None or e.terms(w, self.forms.v, data) is None for e in effects)
        return all(effect.convex for effect in effects) and all(derived)

    @cached_property
    def drift(self) -> Drift | None:
        """The drift of the model, if it has one; renewed with the stiffness (first use is collective)."""
        velocity = next((found for effect in self.model.effects if (found := effect.velocity) is not None), None)
        if velocity is None:
            return None
        from fenicsx_obstacle.discrete.peclet import peclet  # only where a model has drift
        from fenicsx_obstacle.discrete.residence import Drift

        return Drift(velocity, peclet(self.data, velocity))

    @cached_property
    def m_matrix(self) -> bool:
        """Whether the stiffness between free dofs is an M-matrix (first use is collective)."""
        forms = self.forms
        return isinstance(forms, Nodal) and self.has_energy and is_m_matrix(self.A, forms.diagonal, self.level.comm)

    @property
    def active_sets_shrink(self) -> bool:
        """Whether active sets of (3.4)* must shrink after its first step: one obstacle, on an M-matrix."""
        return (self.below is None) != (self.above is None) and self.m_matrix

    def energy(self, x: PETSc.Vec, *, penalised: bool = True, moving: bool = True) -> float:
        """a(u, u)/2 - f(u) + I((u - g)^+ ^2, 1)/(2 eps) at w = x; the terms of a step in time only if `moving`."""
        self.set_state(x)
        return self.forms.energy(penalised=self.constrained and penalised, moving=moving)

    def gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances u - lower and upper - u at the points of I; inf where there is no obstacle."""
        w, none = self.w.x.array, np.broadcast_to(np.inf, len(self.weights))
        lower = none if self.below is None else self.at_points(w - self.below.x.array)
        upper = none if self.above is None else self.at_points(self.above.x.array - w)
        return lower, upper

    def pressed_gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """The gaps in the penalty term: those of the augmented obstacles, if there is a multiplier."""
        lower, upper = self.gaps()
        if self.forms.multiplier is not None:
            shift = float(self.eps.value) * self.forms.multiplier.x.array[: len(self.weights)]
            lower, upper = lower - shift, upper + shift
        return lower, upper

    def active_dofs(self, active: np.ndarray) -> np.ndarray:
        """Owned dofs on which contact at these points of I acts (collective)."""
        if self.level.pair.nodal:
            return active
        bears = fem.Function(self.level.V)
        bears.x.array[releases.cell_dofs(self.level.V)[: len(active)][active[point_cells(self.level)]]] = 1.0
        releases.add_ghosts(bears)
        return bears.x.array[: self.level.owned] > 0

    def at_points(self, values: np.ndarray) -> np.ndarray:
        """A function of V_h, ghosts included, at the points of I; inf at dofs that are none."""
        if self.level.pair.at_vertices:  # all dofs are points
            return values[: self.level.owned]
        if self.level.pair.nodal:
            return np.where(self.weights > 0, values[: self.level.owned], np.inf)
        means = np.empty(len(self.weights))
        means[point_cells(self.level)] = values[releases.cell_dofs(self.level.V)[: len(means)]].mean(axis=1)
        return means

    def _at_all_dofs(self, owned: np.ndarray) -> np.ndarray:
        """Flags of owned dofs at all local ones (collective)."""
        if self.level.pair.degree == 1:
            return np.ones(len(self.w.x.array), dtype=bool)
        flags = fem.Function(self.level.V)
        flags.x.array[: len(owned)] = owned
        flags.x.scatter_forward()
        return flags.x.array > 0.5

    def _load_sum(self) -> float:
        """Sum of |f_i| over free dofs, f being minus the residual of u = 0, which is the state afterwards."""
        self.w.x.array[:] = self.reference.x.array[:] = 0.0
        self.forms.set_reference()
        self.forms.elastic(self.elastic)
        return total(self.level.comm, np.abs(self.elastic.array_r[~self.fixed]))

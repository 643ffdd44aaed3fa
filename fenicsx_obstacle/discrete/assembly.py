"""Evaluation of (3.4) on one level, by UFL forms or by matrices that are assembled once.

With the nodal rule the penalty (3.6) is a diagonal, so whenever all effects are affine the residual is
A w + (A r - f) + D chi (w - gap) / eps, and a Newton step changes nothing but the diagonal of its matrix. That makes
an evaluation some twenty times cheaper than running over the cells again.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.algorithms import expand_derivatives

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.affine import MOSTLY, Affine
from fenicsx_obstacle.algebra.state import State
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.effects.effect import Effect, residual
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.forms.penalty import penalty, penalty_energy
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import corners, own_cells
from fenicsx_obstacle.mesh.points import spread
from fenicsx_obstacle.parallel import largest, smallest, total

NO_WEIGHT = 1e-12  # of the largest in its cells: a node that is no point of I
FAR = 1e300  # an infinite distance, in a form
ROUND_OFF = 1e-12  # of the sum of the forces


class FunctionState(State):
    """A state whose w, r and multiplier are the owned values of Functions, for forms (all methods collective)."""

    def __init__(
        self,
        w: fem.Function,
        r: fem.Function,
        multiplier: fem.Function | None,
        eps: fem.Constant,
        *,
        lower: bool,
        upper: bool,
    ):
        """Refer to Functions and a Constant, as in `Forms`; whether there is a lower and an upper obstacle."""
        super().__init__(releases.vec(w), releases.vec(r), lower=lower, upper=upper)
        self._w, self._constant = w, eps
        self._shared = [function for function in (w, r, multiplier) if function is not None]
        self.multiplier = None if multiplier is None else _owned(multiplier)

    @property
    def eps(self) -> float:
        return float(self._constant.value)

    @eps.setter
    def eps(self, value: float) -> None:
        self._constant.value = value

    def share(self) -> None:
        self._w.x.scatter_forward()

    def share_all(self) -> None:
        for function in self._shared:
            function.x.scatter_forward()


def _owned(function: fem.Function) -> np.ndarray:
    """The values at owned dofs, in place."""
    dofmap = function.function_space.dofmap
    return function.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs]


def beyond_round_off(V: fem.FunctionSpace, values: np.ndarray) -> np.ndarray:
    """Which values at local nodes are positive, and more than round-off of those at other nodes of their cells
    (collective).

    Of a mesh that is graded to a point the largest values are those of far larger cells.
    """
    sizes, comm = np.abs(values), V.mesh.comm
    small = (values != 0) & (sizes < NO_WEIGHT * largest(comm, sizes))
    if total(comm, np.count_nonzero(small)) == 0:
        return values > 0
    around = AroundNodes(V, releases.cell_dofs(V)[: own_cells(V.mesh)])
    of_cells = sizes[around.nodes].max(axis=1, keepdims=True, initial=0.0)
    return values > NO_WEIGHT * around.largest(np.broadcast_to(of_cells, around.nodes.shape))


def assembled(form: ufl.Form, V: fem.FunctionSpace) -> fem.Function:
    """A linear form at local dofs, ghosts included (collective)."""
    found = fem.Function(V)
    vector = releases.vec(found)
    fem.petsc.assemble_vector(vector, releases.form(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    vector.destroy()
    found.x.scatter_forward()
    return found


class Forms:
    """The residual, its derivative and the energy in UFL, assembled at every evaluation (all methods collective).

    Attributes:
        w: The unknown.
        reference: r; u = w + r.
        eps: Penalty parameter.
        measure: Where contact can be: the domain, or parts of its boundary.
        thickness: What makes weights on the boundary areas: its length times it is one; 1 in the domain.
        forces: Forces at owned nodes that are in no form, or None.
        impulse: Such forces of the beginning of a step in time, or None.
        multiplier: p_k of the augmented obstacle g + eps p_k, where the points of I are no nodes; else None.
        state: The owned values of w, r and p_k, and the gaps.
    """

    def __init__(self, effects: Sequence[Effect], data: Data):
        self.effects, self.data = effects, data
        V = data.level.V
        self.w, self.reference = fem.Function(V, name="w"), fem.Function(V, name="r")
        self.eps = fem.Constant(data.level.mesh, PETSc.ScalarType(1.0))
        pair = data.level.pair
        self.v = ufl.TestFunction(V)
        self.thickness = 1.0
        self._set_contact_measure()
        self.multiplier = None if pair.nodal else fem.Function(data.level.Q)
        sides = {"lower": data.lower is not None, "upper": data.upper is not None}
        self.state: State = FunctionState(self.w, self.reference, self.multiplier, self.eps, **sides)
        given = [effect for effect in effects if effect.role == "point forces"]
        table = f"{data.model.source}: [effects]"
        vectors = [spread(data.level, cast(Any, effect.value), f"{table} {effect.key}") for effect in given]
        self.forces: np.ndarray | None = np.sum(vectors, axis=0) if vectors else None
        self.impulse: np.ndarray | None = None
        self._u, varied = self._unknown()
        self._a_minus_f = self._terms(self._u)
        slopes = [effect.derivative(self._u, self.v, data) for effect in effects]
        self._slope = sum(form for form in slopes if form is not None) or ufl.derivative(self._a_minus_f, varied)
        self._stiffness = releases.form(self._slope)
        dofs, values = data.fixed
        self.fixed = dofs[dofs < data.level.owned]
        self._bc = fem.dirichletbc(values, dofs)
        self._made: dict[str, Any] = {}

    def _set_contact_measure(self) -> None:
        """Set the measure of the contact integral I, and its rule."""
        data = self.data
        self.measure: Any = data.dx
        self.rule = data.level.pair.rule(releases.cell_name(data.level.mesh))
        if data.thin:
            self.measure, self.rule, self.thickness = data.parts.all("contact"), data.parts.rule, data.extent

    def _unknown(self) -> tuple[Any, fem.Function]:
        """u in UFL, and the Function by which forms are differentiated."""
        return self.w + self.reference, self.w

    def vector(self) -> PETSc.Vec:
        """A new vector, ghosted."""
        return self._blank.duplicate()

    @cached_property
    def _blank(self) -> PETSc.Vec:
        """What new vectors are made like: they share its table of ghosts."""
        return releases.create_vector(self.w.function_space)

    def _terms(self, u: Any) -> ufl.Form:
        """a(u, v) - f(v)."""
        return residual(self.effects, u, self.v, self.data)

    def weights(self) -> np.ndarray:
        """D_i = I(phi_i, 1) at owned points of I: dofs of V_h, 0 at those that are none, or else of Q_h."""
        return self._point_weights()

    def _point_weights(self) -> np.ndarray:
        level = self.data.level
        v = self.v if level.pair.nodal else ufl.TestFunction(level.Q)
        weights = assembled(v * self.rule.on(self.measure), v.ufl_function_space())
        weights.x.array[~beyond_round_off(v.ufl_function_space(), weights.x.array)] = 0.0
        return _owned(weights) * self.thickness

    def unit_load(self) -> np.ndarray:
        """int phi_i at owned dofs."""
        return _owned(assembled(self.v * self.data.dx, self.data.level.V)).copy()

    def set_reference(self) -> None:
        """Called when r has changed."""
        for side, finite in self._finite.items():
            _owned(finite)[:] = np.clip(getattr(self.state, side), -FAR, FAR)
            finite.x.scatter_forward()

    @cached_property
    def _finite(self) -> dict[str, fem.Function]:
        """The distances of the obstacles from r in the forms, where 0 times infinity must not occur."""
        sides = [side for side in ("below", "above") if getattr(self.state, side) is not None]
        return {side: fem.Function(self.data.level.V) for side in sides}

    def elastic(self, out: PETSc.Vec) -> None:
        """out = a(w + r, .) - f."""
        self._assemble(out, self._form("elastic"))
        for forces in self._given():
            out.array[:] -= forces

    def row_sums(self) -> np.ndarray:
        """The derivative of a(u, .) times u = 1 at owned dofs, without what belongs to a step in time."""
        one = fem.Function(self.w.function_space)
        one.x.array[:] = 1.0
        return _owned(assembled(ufl.derivative(self._at_rest, self.w, one), one.function_space)).copy()

    def _given(self, *, moving: bool = True) -> list[np.ndarray]:
        """The forces that are in no form."""
        return [forces for forces in (self.forces, self.impulse if moving else None) if forces is not None]

    def forces_at(self, u_values: np.ndarray | float) -> np.ndarray:
        """a(u, .) - f at owned dofs for this u; the state stays as it is."""
        state, out = self.state, self.vector()
        kept = state.w.copy(), state.r.copy()
        state.r[:], state.w[:] = 0.0, u_values
        state.share_all()
        self.set_reference()
        self.elastic(out)
        state.w[:], state.r[:] = kept
        state.share_all()
        self.set_reference()
        found = out.array.copy()
        out.destroy()
        return found

    def at_rest(self, out: PETSc.Vec) -> None:
        """out = a(w + r, .) - f, without what belongs to a step in time."""
        self._assemble(out, self._form("at rest"))
        for forces in self._given(moving=False):
            out.array[:] -= forces

    def renew(self, A: PETSc.Mat, *, stiffness: bool) -> bool:
        """Assemble again the parts that depend on time; returns whether the stiffness has changed."""
        return stiffness

    def reaction(self, out: PETSc.Vec) -> None:
        """out = (1/eps) I((u - g)^+, .)."""
        self._assemble(out, self._form("contact"))

    def create_matrix(self) -> PETSc.Mat:
        """The matrix that `jacobian` fills."""
        one = fem.Constant(self.data.level.mesh, PETSc.ScalarType(1.0)) * self.rule.on(self.measure)
        if not any(integral.integral_type() == "interior_facet" for integral in one.integrals()):
            return fem.petsc.create_matrix(self._stiffness)
        # the penalty couples cells on both sides of a facet: entries that the first assembly does not fill are lost
        across = ufl.avg(ufl.TrialFunction(self.w.function_space)) * ufl.avg(self.v) * ufl.dS
        coupled = releases.form(self._slope + across)
        A = fem.petsc.create_matrix(coupled)
        fem.petsc.assemble_matrix(A, coupled)
        A.assemble()
        self.jacobian(A, penalised=False)
        return A

    def jacobian(self, A: PETSc.Mat, *, penalised: bool) -> None:
        """Fill A with the derivative of the residual; rows and columns of fixed dofs are those of the identity."""
        A.zeroEntries()
        # each by itself: measures of the caller and of the contact may have tags of their own, which no form may mix
        for form in (self._stiffness, self._form("contact slope")) if penalised else (self._stiffness,):
            fem.petsc.assemble_matrix(A, form, [self._bc])
            A.assemble()

    def energy(self, *, penalised: bool, moving: bool = True) -> float:
        """a(u, u)/2 - f(u), and the energy of the penalty; what belongs to a step in time only if `moving`."""
        comm = self.data.level.comm
        parts = (fem.assemble_scalar(form) for order, form in self._energies if moving or order == 0)
        value = total(comm, sum(parts))
        for forces in self._given(moving=moving):
            value -= total(comm, forces * (self.state.w + self.state.r))
        return value + (total(comm, fem.assemble_scalar(self._form("contact energy"))) if penalised else 0.0)

    @cached_property
    def _energies(self) -> list[tuple[int, Any]]:
        """Energies of the effects with their orders in time, each by itself: in one form FFCx 0.5 takes u at the only
        point of one rule for u at all points of another."""
        return [(order, releases.form(part)) for order, part in self._energies_of(self._u)]

    def _energies_of(self, u: Any) -> list[tuple[int, ufl.Form]]:
        """The same in UFL."""
        parts = ((effect.order, effect.energy(u, self.data)) for effect in self.effects)
        return [(order, part) for order, part in parts if part is not None]

    @property
    def _at_rest(self) -> ufl.Form:
        """a(u, v) - f(v) without what belongs to a step in time."""
        still = [effect for effect in self.effects if effect.order == 0]
        return residual(still, self._u, self.v, self.data)

    def _form(self, name: str) -> Any:
        """Compiled on first use (collective): the fast path needs none of these."""
        if name not in self._made:
            gaps: dict[str, Any] = {"lower": self._finite.get("below"), "upper": self._finite.get("above")}
            Forms.set_reference(self)
            if self.multiplier is not None:
                gaps = {side: None if gap is None else gap + self.eps * self.multiplier for side, gap in gaps.items()}
            gaps["eps"] = self.eps if self.thickness == 1.0 else self.eps / self.thickness
            if name == "at rest":
                form = self._at_rest
            elif name == "elastic":
                form = self._a_minus_f
            elif name == "contact energy":
                form = penalty_energy(self.w, dI=self.rule.on(self.measure), **gaps)
            else:
                form = penalty(self.w, self.v, rule=self.rule, measure=self.measure, **gaps)
            if name == "contact slope":
                form = ufl.derivative(form, self.w)
            self._made[name] = releases.form(form)
        return self._made[name]

    def _assemble(self, b: PETSc.Vec, form: object) -> None:
        with b.localForm() as local:
            local.set(0.0)
        fem.petsc.assemble_vector(b, form)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)


class Nodal(Affine, Forms):
    """The same for affine effects, from A, f and D that are assembled once (all methods collective)."""

    def __init__(self, effects: Sequence[Effect], data: Data):
        Forms.__init__(self, effects, data)
        loads = self._terms(self._zero())
        loaded = any(integral.integrand() != 0 for integral in loads.integrals())
        self._loads = releases.form(loads) if loaded else None
        stiffness, minus_load = self._assembled(), Forms.vector(self)
        Affine.__init__(self, data.level.comm, self.state, stiffness, minus_load, np.empty(0), self.fixed)
        self._load()
        self.D = self._point_weights()
        if data.level.pair.own_weights:
            self._lump(weights_of_cells(data.level.pair, data.level.V))

    def vector(self) -> PETSc.Vec:
        return Forms.vector(self)

    def _assembled(self) -> PETSc.Mat:
        """The stiffness."""
        return self._filled(fem.petsc.create_matrix(self._stiffness))

    def _assemble_again(self) -> None:
        """Fill the stiffness with its present values."""
        self._filled(self.stiffness)

    def _filled(self, A: PETSc.Mat) -> PETSc.Mat:
        """The matrix, with the present values of the stiffness in Cartesian components."""
        A.zeroEntries()
        fem.petsc.assemble_matrix(A, self._stiffness)
        A.assemble()
        return A

    def _zero(self) -> fem.Constant:
        """u = 0."""
        return fem.Constant(self.data.level.mesh, np.zeros(self.w.ufl_shape, dtype=PETSc.ScalarType))

    def _load(self) -> None:
        if self._loads is None:
            self.minus_load.set(0.0)
        else:
            self._assemble(self.minus_load, self._loads)
        for forces in self._given():
            self.minus_load.array[:] -= forces

    def renew(self, A: PETSc.Mat, *, stiffness: bool) -> bool:
        self._load()
        changed = stiffness or self._stiffness_moves
        if changed:
            self._assemble_again()
            self.take_stiffness(A)
        return changed

    @cached_property
    def _stiffness_moves(self) -> bool:
        """Whether the stiffness depends on time."""
        form = expand_derivatives(self._slope)
        return bool({*form.coefficients(), *form.constants()} & set(self.data.moving))

    def _lump(self, D: np.ndarray) -> None:
        """Take these weights for I, and F_i = f(x_i) D_i, or -(A g + f)/D would not tend to the pressure."""
        zero = self._zero()
        for effect in self.effects:
            if effect.role != "load":
                continue
            f, part = _owned(self.data.nodal(effect.value)).copy(), self.vector()
            self._assemble(part, releases.form(effect.terms(zero, self.v, self.data)))
            self.add_forces(f * D + part.array_r)
            part.destroy()
        self.D = D

    def add_forces(self, forces: np.ndarray) -> None:
        """Add forces at owned nodes to the load (collective)."""
        self.forces = forces if self.forces is None else self.forces + forces
        self.minus_load.array[:] -= forces
        self.set_reference()

    def leans(self, side: int, share: float = MOSTLY) -> bool:
        """As before; where forces were added at vertices, any beyond round-off counts."""
        added = self.forces is not None and self.data.level.pair.at_vertices
        return super().leans(side, ROUND_OFF if added else share)

    def energy(self, *, penalised: bool, moving: bool = True) -> float:
        if all(effect.order == 0 for effect in self.effects):
            value = total(self.comm, sum(map(fem.assemble_scalar, self._energies_at_zero))) + self.work()
        else:
            value = Forms.energy(self, penalised=False, moving=moving)
        return value + (self.penalty_energy() if penalised else 0.0)

    @cached_property
    def _energies_at_zero(self) -> list[Any]:
        """Energies of the effects at u = 0 where they are not 0 as written, as those of supports at rest elsewhere."""
        zero = self._zero()
        nothing = {zero: ufl.constantvalue.Zero(zero.ufl_shape)}
        parts = [ufl.replace(expand_derivatives(part), nothing) for _, part in self._energies_of(zero)]
        return [releases.form(part) for part in parts if any(one.integrand() != 0 for one in part.integrals())]


def weights_of_cells(pair: Pair, V: fem.FunctionSpace) -> np.ndarray:
    """D_i at owned dofs of V_h of pairs that define them cell by cell, such as Voronoi areas (collective).

    Args:
        pair: With `own_weights`.
        V: Its P1 space.

    Raises:
        InputError: If one is not positive, against (3.6).
    """
    mesh = V.mesh
    parts = pair.cell_weights(corners(mesh, slice(own_cells(mesh))))
    weights = AroundNodes(V, releases.cell_dofs(V)[: len(parts)]).sums(parts)[: V.dofmap.index_map.size_local]
    if smallest(mesh.comm, weights) <= 0:
        raise InputError(f"element {pair.name}: {pair.not_positive} (3.6)")
    return weights

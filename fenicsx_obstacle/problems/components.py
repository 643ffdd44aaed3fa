"""Bounds of single components of u, the sub-spaces of a mixed or a blocked space.

The matrix may be that of a saddle point, with A_ii = 0: linear systems are solved directly, and the sums of |A_ij| of a
row take the place of A_ii. Components have units of their own, so that forces are balanced in each of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any, NoReturn, cast

import numpy as np
import ufl
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.data_scales import EPSILON
from fenicsx_obstacle.algebra.fields import ROUNDED
from fenicsx_obstacle.algebra.methods import method_of
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.plausibility import NEAR, displacements
from fenicsx_obstacle.algebra.products import product
from fenicsx_obstacle.algebra.stopping import Step, StepMonitor
from fenicsx_obstacle.algebra.system import LIMIT, System
from fenicsx_obstacle.data.admissible import check_admissible
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.discrete.assembly import assembled
from fenicsx_obstacle.discrete.form_law import FormLaw, NonlinearFormLaw
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.scalar import Force
from fenicsx_obstacle.mesh.levels import of_space
from fenicsx_obstacle.mesh.reference_cell import lagrange_degree
from fenicsx_obstacle.mesh.shared_dofs import share
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.problems.form_checks import warn_of_indefinite
from fenicsx_obstacle.problems.input_checks import check_not_moved, obstacle, vertex_digests
from fenicsx_obstacle.problems.residual_form import ResidualForm
from fenicsx_obstacle.text import counted, shown

Bounds = dict[int, dict[str, Field]]  # of each component, by lower and upper


def bounds_of(u: fem.Function, name: str, **given: Any) -> Bounds:
    """The bounds of components.

    Raises:
        InputError: If one is no dict, or names a component that u does not have.
    """
    found: Bounds = {}
    count = u.function_space.num_sub_spaces
    for side, bounds in given.items():
        if bounds is not None and not isinstance(bounds, Mapping):
            raise InputError(f"{name}: {side} = {shown(bounds)}: expected a dict, as the other bound is")
        for number, g in (bounds or {}).items():
            place = f"{name}: {side}[{shown(number)}]"
            if isinstance(number, bool) or not isinstance(number, Integral):
                raise InputError(f"{place}: expected the number of a sub-space, as in u.sub(0)")
            if count == 0:
                raise InputError(f"{place}: u is scalar: give {side}= without a dict")
            if int(number) not in range(count):
                raise InputError(f"{place}: u has the components 0 to {count - 1}")
            found.setdefault(int(number), {})[side] = obstacle(g, u, place)
    if not found:
        raise InputError(f"{name}: the dict of bounds is empty: give one, such as lower={{1: 0.0}}")
    return dict(sorted(found.items()))


class Component:
    """A component of u with bounds.

    Attributes:
        level: Its mesh and space.
        weights: D, as a Function in the space of u.
        model: Its bounds.
    """

    def __init__(self, number: int, residual: ResidualForm, bounds: dict[str, Field], name: str):
        """Make its space (collective).

        Raises:
            InputError: If it has no positive nodal weights.
        """
        self._u, part = residual.u, residual.u.function_space.sub(number)
        V = releases.space_of(part.mesh, part.ufl_element())
        source = f"{name}: component {number}"
        degree_1 = f"{source} is of {V.ufl_element()}: bounds are for scalar continuous Lagrange elements with positive"
        degree_1 += " weights of all nodes (3.6): take degree 1 for this component"
        if V.dofmap.index_map_bs > 1 or lagrange_degree(V) is None:
            raise InputError(degree_1)
        self.level = of_space(V, source)
        self.model = Model((residual,), bounds.get("lower"), bounds.get("upper"), source=source)
        self._mine, self._of_u = (releases.cell_dofs(space).ravel() for space in (V, part))
        rule = self.level.pair.rule(releases.cell_name(V.mesh)).on(ufl.Measure("dx", domain=V.mesh))
        weights = assembled(ufl.TestFunction(V) * rule, V)
        if not self.level.pair.at_vertices or smallest(V.mesh.comm, weights.x.array) <= 0:
            raise InputError(degree_1)
        self.weights = fem.Function(self._u.function_space)
        self.put(weights, self.weights)

    def put(self, values: fem.Function, f: fem.Function) -> None:
        """Give a Function in the space of u values of this component (collective)."""
        f.x.array[self._of_u] = values.x.array[self._mine]
        share(f)

    def function(self, f: fem.Function, name: str) -> fem.Function:
        """This component of a Function in the space of u (collective)."""
        found = fem.Function(self.level.V, name=name)
        found.x.array[self._mine] = f.x.array[self._of_u]
        share(found)
        return found

    def data(self, fixed: fem.Function, values: fem.Function) -> Data:
        """Its bounds now, where u has these values at fixed dofs (collective).

        Raises:
            InputError: If no u satisfies them.
        """
        flags, given = self.function(fixed, "fixed"), self.function(values, "given")
        held = fem.dirichletbc(given, np.flatnonzero(flags.x.array > 0).astype(np.int32))
        data = Data(self.model, self.level, bcs=[held])
        check_admissible(data)
        return data

    def force(self, forces: np.ndarray) -> Force:
        """Its contact forces, from those at its owned dofs, > 0 at the lower bound (collective)."""
        sides = ((self.model.lower, forces), (self.model.upper, -forces))
        sums = [total(self.level.comm, np.maximum(one, 0.0)) for _, one in sides]
        return Force(*(None if g is None else found for (g, _), found in zip(sides, sums, strict=True)))


@dataclass(frozen=True, eq=False)
class ComponentSolution:
    """A converged solution with bounds of components; the keys of dicts are their numbers.

    Attributes:
        u: Solution, a copy.
        pressure: Contact pressure, P1 or Q1: >= 0 at the lower bound, <= 0 at the upper one.
        contact: 1 at nodes in contact, 0 at the others.
        force: Sums of pressure times weight, >= 0, such as `force[1].lower`.
        area: Sum of the weights of the nodes in contact.
        penetration: Largest distance beyond a bound.
        method: vi, penalty or successive.
        eps: Penalty parameter; None for vi.
        iterations: Newton steps.
        history: The steps; their forces are sums over components, whose units may differ.
        title: What was solved.
    """

    u: fem.Function
    pressure: dict[int, fem.Function]
    contact: dict[int, fem.Function]
    force: dict[int, Force]
    area: dict[int, float]
    penetration: dict[int, float]
    method: str
    eps: float | None
    iterations: int
    history: tuple[Step, ...] = field(repr=False)
    title: str

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(line.strip() for line in self.summary().splitlines())})"

    def summary(self) -> str:
        """The main values in a few lines of text."""
        V, eps = self.u.function_space, "" if self.eps is None else f", eps = {self.eps:.3g}"
        size = counted(V.dofmap.index_map.size_global * V.dofmap.index_map_bs, "unknown")
        lines = [self.title, f"  {self.method}{eps}; {size}; {counted(self.iterations, 'Newton step')}"]
        for k, force in self.force.items():
            sides = [f"force on {key} bound {value:.6g}; " for key, value in vars(force).items() if value is not None]
            area, beyond = f"contact area {self.area[k]:.6g}", f"penetration {self.penetration[k]:.3g}"
            lines.append(f"  component {k}: {area}; {''.join(sides)}{beyond}")
        return "\n".join(lines)

    def _none(self, *_: Any, **__: Any) -> NoReturn:
        raise InputError(
            "save, plot, at, along and verify are not for bounds of components: u, pressure[0] and contact[0] are "
            "DOLFINx Functions, for VTKFile and XDMFFile; u.sub(0).collapse() is a component of u"
        )

    save = plot = at = along = on = verify = _none


class ComponentSystem(System):
    """A form with bounds of components of its unknown. All methods are collective."""

    direct = True
    keeps_solver = True
    hint = "; if nothing holds a component, the matrix is singular: where only contact does, start at its bound"

    def __init__(self, residual: ResidualForm, bounds: Bounds, bcs: list[Any], name: str, prefix: str):
        """Compile and assemble."""
        u, self._bcs, self._name, self.source, self.prefix = residual.u, bcs, name, f"{name}:", prefix
        V, self.comm, self._u, self._residual = u.function_space, u.function_space.mesh.comm, u, residual
        self.affine = residual.affine
        self.has_energy, self.checks = residual.functional is not None, (cast(Any, ComponentSystem.undetermined),)
        self._bounded = {k: Component(k, residual, sides, name) for k, sides in bounds.items()}
        level = next(iter(self._bounded.values())).level
        self.h, self._level, self._vertices = level.h, level, vertex_digests(level)
        own, number = V.dofmap.index_map.size_local * V.dofmap.index_map_bs, fem.Function(V)
        for k in range(V.num_sub_spaces):
            number.x.array[releases.cell_dofs(V.sub(k)).ravel()] = k
        share(number)
        self.fields = V.num_sub_spaces, number.x.array[:own].astype(np.int64)
        self._dofs = [self.fields[1] == k for k in range(V.num_sub_spaces)]
        weights: np.ndarray = np.sum([part.weights.x.array[:own] for part in self._bounded.values()], axis=0)
        self._fixed = fem.Function(V)
        for bc in bcs:
            self._fixed.x.array[np.asarray(bc.dof_indices()[0])] = 1.0
        share(self._fixed)
        self.fixed, self.given = self._fixed.x.array[:own] > 0, np.zeros(own)
        sides = [any(side in one for one in bounds.values()) for side in ("lower", "upper")]
        self.lower, self.upper = (np.full(own, g) if is_side else None
                                  for g, is_side in zip((-np.inf, np.inf), sides, strict=True))  # fmt: skip
        slope = residual.slope if residual.J is None else residual.J
        forms, state = {"F": residual.F, "J": slope, "energy": residual.functional}, fem.Function(V)
        made = {key: releases.form(ufl.replace(one, {u: state})) for key, one in forms.items() if one is not None}
        law = (FormLaw if self.affine else NonlinearFormLaw)(made, state, weights, np.flatnonzero(self.fixed), sides)
        law.assemble()
        self._set_law(law)

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        return self._residual.symmetric

    def begin(self) -> None:
        """Take the data as they are now, and u as the start.

        Raises:
            InputError: If no u satisfies the data.
        """
        check_not_moved(self._level, self._vertices, self._name)
        law, values = self.law, fem.Function(self._u.function_space)
        assert isinstance(law, FormLaw)
        releases.set_values(values.x.array, self._bcs)
        for words, one in (("a value of bcs", values), ("u, the start,", self._u)):
            share(one)
            if total(self.comm, ~np.isfinite(one.x.array)) > 0:
                raise InputError(f"{self.source} {words} is not a finite number somewhere")
        self.given[:] = values.x.array[: self.owned]
        for k, part in self._bounded.items():
            data, on_all = part.data(self._fixed, values), fem.Function(self._u.function_space)
            for bounds, now in ((self.lower, data.lower), (self.upper, data.upper)):
                if bounds is not None and now is not None:
                    part.put(now, on_all)
                    bounds[self._dofs[k]] = on_all.x.array[: self.owned][self._dofs[k]]
        self.set_reference(np.where(self.fixed, self.given, self.between(self._u.x.array[: self.owned])))
        law.assemble()
        law.take_stiffness(self.A)
        if self.affine:
            self._residual.look_again(law.stiffness)
        forces = law.forces_at(self.u)
        if total(self.comm, ~np.isfinite(forces + law.scales)) > 0:
            raise InputError(f"{self.source} F or its derivative is not finite at the start: is a coefficient in it?")
        for gap, sign in ((self.below, 1.0), (self.above, -1.0)):
            if gap is not None:  # contact from the first step on where F presses: nothing else may hold u
                pressed = self.touchable & (self.w == gap) & (sign * forces > 0)
                self.w[pressed] = np.nextafter(gap[pressed], -sign * np.inf)
        self.load = total(self.comm, np.abs(law.forces_within()[0] - forces)[~self.fixed])

    def check_signs(self) -> None:
        """Reject a component k whose bounds would mean the opposite, as that of a saddle point with equal signs off the
        diagonal: with u of the other components in balance, x . A x < 0 for a random change x of this one. The
        inequality is F(u; v - u) >= 0. Only if F is linear, or A_kk is 0.

        Raises:
            InputError: With the remedy.
        """
        A, comm = self.matrices.stiffness, self.comm
        for k in self._bounded:
            change = np.random.default_rng(comm.rank).normal(size=self.owned) * (self._dofs[k] & ~self.fixed)
            forces = product(A, change)
            own, others = total(comm, change * forces), displacements(self, self._dofs[k].astype(int), -forces)
            assert others is not None
            if total(comm, ~np.isfinite(others)) == 0:
                forces = product(A, change + others)
            if total(comm, change * forces) < 0 and (self.affine or own == 0):
                raise InputError(
                    f"{self.source} component {k}: the terms with its test function have the wrong sign for a bound: "
                    "a(v, v) must be positive, and a saddle point be - p*div(v) + q*div(u), with opposite signs"
                )

    def bounded_fields(self) -> list[np.ndarray | slice]:
        return [self._dofs[k] for k in self._bounded]

    def spread(self, u_values: np.ndarray) -> np.ndarray:
        found = np.zeros(self.owned)
        for dofs in self._dofs:
            found[dofs] = largest(self.comm, u_values[dofs]) - smallest(self.comm, u_values[dofs])
        return found

    def undetermined(self, active: np.ndarray) -> str | None:
        """A component that round-off of the residual, with random signs, moves by a part of its size: one step of
        inverse iteration."""
        inner, scales = self.matrices.forces_within()[1], self.matrices.scales
        signs = np.random.default_rng(1 + self.comm.rank).choice([-1.0, 1.0], self.owned)
        pressed = np.where(np.abs(self.elastic.array_r) > ROUNDED * inner, active, 0)  # not by round-off
        moved = displacements(self, pressed, EPSILON * inner * signs)
        assert moved is not None
        zero = NEAR * np.divide(inner, scales, out=np.zeros(self.owned), where=scales > 0)  # is as good as 0
        for k, dofs in enumerate(self._dofs):
            size = max(largest(self.comm, np.maximum(np.abs(self.u), zero)[dofs]), 0.0)
            most = largest(self.comm, np.abs(moved[dofs]))
            if not most <= LIMIT * size:
                which = f"component {k}" if np.isfinite(most) else "some component, such as a pressure"
                return (
                    f"the data do not determine {which}: round-off changes it by more than 1 % of its size; "
                    "prescribe it by bcs somewhere"
                )
        return None

    def solve(self, options: SolverOptions, rtol: float, monitor: StepMonitor | None) -> ComponentSolution:
        """Solve from the start, into u.

        Raises:
            InputError: For a bad eps.
            NotConverged: With the reason; u is then unchanged.
        """
        method = method_of(self, options)
        outcome = method.solve(self, multigrid=None, tolerance=rtol, monitor=monitor)
        warn_of_indefinite(self, self._residual, self._name)
        p, parts = method.pressure(self), [(k, part, self._dofs[k]) for k, part in self._bounded.items()]
        pressure, contact = (fem.Function(self._u.function_space) for _ in range(2))
        for f, values in ((self._u, self.u), (pressure, p), (contact, p != 0)):
            f.x.array[: self.owned] = values
            f.x.scatter_forward()
        beyond = np.where(self.touchable, np.maximum(-np.minimum(*self.gaps()), 0.0), 0.0)
        return ComponentSolution(
            self._u.copy(), {k: part.function(pressure, "pressure") for k, part, _ in parts},
            {k: part.function(contact, "contact") for k, part, _ in parts},
            {k: part.force((self.weights * p)[dofs]) for k, part, dofs in parts},
            {k: total(self.comm, self.weights[dofs & (p != 0)]) for k, _, dofs in parts},
            {k: largest(self.comm, beyond[dofs]) for k, _, dofs in parts},
            options.method, outcome.eps, outcome.iterations, outcome.history, self._name,
        )  # fmt: skip

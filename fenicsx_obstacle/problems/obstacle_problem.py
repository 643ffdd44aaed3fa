"""ObstacleProblem: a residual in UFL and obstacles, solved by the penalty method or as a variational inequality."""

from __future__ import annotations

import numbers
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from itertools import count
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import garbage, releases
from fenicsx_obstacle.algebra.linear_solvers import overriding, unread
from fenicsx_obstacle.algebra.nested import Levels
from fenicsx_obstacle.algebra.newton import diagonal_of
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.penalty_parameter import NoPositiveDiagonal
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.stopping import ON_THE_WAY, TOLERANCE, Step, StepMonitor
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.model import Model, Part
from fenicsx_obstacle.discrete.hierarchy import has_levels, levels_of
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.mesh.levels import Level, of_space
from fenicsx_obstacle.mesh.shared_dofs import share
from fenicsx_obstacle.parallel import agree, largest, smallest, total, warn
from fenicsx_obstacle.problems.form_checks import (
    check_energy,
    check_form,
    check_integrals,
    check_stiffness,
    check_tagged,
    flat_start,
    naming_compiler_errors,
    refuse_no_positive_diagonal,
    refuse_not_finite,
    warn_of_indefinite,
)
from fenicsx_obstacle.problems.input_checks import (
    check_measure,
    check_not_moved,
    check_unknown,
    checked_options,
    conditions,
    facets_of,
    number_of,
    obstacle,
    vertex_digests,
    warn_of_conditions,
)
from fenicsx_obstacle.problems.record import record_of
from fenicsx_obstacle.problems.residual_form import ResidualForm, by_one_rule
from fenicsx_obstacle.problems.solution import Solution
from fenicsx_obstacle.problems.solve import State, solve
from fenicsx_obstacle.signatures import names_checked
from fenicsx_obstacle.text import shown

if TYPE_CHECKING:
    from fenicsx_obstacle.check.verification import Verification
    from fenicsx_obstacle.discrete.contact_set import Contact
    from fenicsx_obstacle.estimation.bound import Estimator
    from fenicsx_obstacle.problems.components import ComponentSolution, ComponentSystem

Monitor = Callable[[int, Step], None]


class ObstacleProblem:
    """A residual F(u; v) = 0 with obstacles, lower <= u <= upper.

    The penalty method solves F(u; v) + (1/eps) I((u - upper)^+ - (lower - u)^+, v) = 0 for all v. I is a quadrature
    rule, equations (3.5) and (3.6) of Kikuchi (1981). Its points are the nodes of u; for scalar u and P2 on triangles
    they are the midpoints of edges. The penalty acts at each of these contact nodes separately. `solve(method="vi")`
    solves the variational inequality without a penalty.

    The arguments F, u, bcs, J and those for PETSc and the form compiler are those of DOLFINx's NonlinearProblem. All
    arguments except F and u need a keyword. All methods are collective.

    - Linear or nonlinear. The class detects whether F is linear in u. If it is, the matrix is assembled once, and
      reused while the values of its coefficients stay the same.
    - Second solve. If Constants, Functions, obstacles or Dirichlet values have changed, `solve` uses the new values. It
      starts from u, so that a loop over time or load steps may call it repeatedly.
    - Initial guess. If F is linear and symmetric, and u is constant or a bad initial guess, the problem is first solved
      on algebraic coarse levels.
    - Symmetric F that is not positive definite. A warning says so where the solution shows it: u is then no minimum of
      an energy, and need not be the only solution.
    - Mesh. The mesh must not move. After a move create a new ObstacleProblem.

    Attributes:
        u: The unknown: before a solve the initial guess, after it the solution.
        solver: The SNES of the last solve, with its counts, reason and options; None before the first solve. Each solve
            makes a new SNES. Use `petsc_options` to change its options, and `monitor` to follow its steps.
        A: The matrix of the last linear system. Rows of Dirichlet dofs are those of the identity.
        b: The residual F(u; v_i) at the last u, without the contact forces. At Dirichlet dofs it is the reaction force.
    """

    name = "ObstacleProblem"  # in messages
    _vector_valued = False
    _von_mises: Callable[[], fem.Function] | None = None
    _once: tuple[ufl.Form, dict[Any, np.ndarray]] | None = None  # what is evaluated once, and the values in it
    _components: ComponentSystem | None = None  # where lower or upper is a dict

    @names_checked
    def __init__(
        self,
        F: ufl.Form,
        u: fem.Function,
        *,
        bcs: Any = (),
        lower: Any = None,
        upper: Any = None,
        energy: ufl.Form | None = None,
        J: ufl.Form | None = None,
        of: Any = None,
        measure: Any = None,
        stress: Any = None,
        petsc_options_prefix: str = "",
        petsc_options: Mapping[str, Any] | None = None,
        form_compiler_options: Mapping[str, Any] | None = None,
        jit_options: Mapping[str, Any] | None = None,
    ):
        """Compile and assemble (collective).

        A warning names each condition in bcs without dofs.

        Args:
            F: Residual without contact, such as a(u, v) - L(v): a form with the Function u and one test function. It
                may be linear or nonlinear in u.
            u: Unknown of F, a continuous Lagrange Function of degree 1 or 2, scalar or vector-valued. Its values are
                the initial guess, and after a solve the solution. If only the obstacle supports u, because no
                Dirichlet condition does, the iteration starts from contact instead.
            bcs: Dirichlet conditions, a list or a single one.
            lower: Lower obstacle, in the unit of u. It is evaluated at the nodes. It may be a number; a Constant; a
                Function of any continuous space, also on another mesh that covers this one; a UFL expression without
                u that has one value at each node; or a callable of x, an array of shape (3, n), as for
                Function.interpolate. Its value is -inf, or -1e20 or less, where there is no obstacle. If it is an
                earlier solution of the penalty method, copy that by np.clip: it is beyond the obstacles by eps*p.
                In a blocked or mixed space, a dict of these bounds components: {1: 0.0} is for u.sub(1).
            upper: Upper obstacle, of the same kinds; inf, or 1e20 or more, where there is none.
            energy: The functional whose derivative is F (optional, for nonlinear F). A line search then decreases this
                energy, which makes Newton's method more robust.
            J: The derivative of F. By default UFL computes it. It is not used if F is linear.
            of: For vector-valued u, the scalar that the obstacles bound: a UFL expression linear in u, such as
                `ufl.dot(u, n)`, where n is a constant vector, a field or `ufl.FacetNormal(mesh)`. It is evaluated once.
                Each contact node has one unit normal, the mean over its facets.
            measure: Where contact can happen: `ds(3)` for the facets with the tag 3, `ds((3, 4))` for two tags. By
                default the whole domain. On facets the pressure is a force per area (in the plane, per length). For
                vector-valued u the measure is required. It may have a factor, as `x[0] * ds(3)` in axial symmetry.
            stress: For vector-valued u, its stress in UFL (optional): a tensor with three rows (also in plane strain
                and axial symmetry) or, in plane stress, with two. The solution then has the von Mises stress of each
                cell.
            petsc_options_prefix: Prefix of the options of SNES, KSP and PC; by default `penalty_` or `vi_`.
            petsc_options: PETSc options without the prefix, for this problem only. They take precedence over those of
                the command line. By default the linear solver is conjugate gradients with algebraic multigrid if the
                derivative of F is symmetric, and GMRES otherwise.
            form_compiler_options: As for dolfinx.fem.form.
            jit_options: As for dolfinx.fem.form.

        Raises:
            InputError: If an argument is invalid, or no u can satisfy the data.
        """
        check_unknown(u, self.name, lower=lower, upper=upper, of=of, measure=measure, stress=stress)
        V, name = u.function_space, self.name
        mesh, compiled = V.mesh, (form_compiler_options, jit_options)
        in_components = isinstance(lower, Mapping) or isinstance(upper, Mapping)
        self._vector_valued = V.dofmap.index_map_bs > 1 and not in_components
        if in_components:  # a scalar problem does not load this
            from fenicsx_obstacle.problems.components import ComponentSystem, bounds_of
        elif not self._vector_valued:
            facets = None if measure is None else facets_of(measure, mesh, name)
            level = of_space(V, name, None if facets is None else {"contact": facets})
        with agree(mesh.comm):
            check_form(F, u, f"{name}: F", arguments=1)
            if energy is not None:
                check_form(energy, u, f"{name}: energy", arguments=0)
            if J is not None:
                check_form(J, u, f"{name}: J", arguments=2)
            given = {key: g for key, g in (("lower", lower), ("upper", upper)) if g is not None}
            bounds = bounds_of(u, name, **given) if in_components else {}
            sides: dict[str, Any] = {}
            if not in_components:
                sides = {key: obstacle(g, u, f"{name}: {key}") for key, g in given.items()}
            held = conditions(bcs, V, name)
        for key, form in (("F", F), ("energy", energy), ("J", J)):
            if form is not None:
                for integral in form.integrals():
                    check_measure(integral, mesh, f"{name}: {key}: a measure")
                check_tagged(form, mesh, f"{name}: {key}")
        warn_of_conditions(held, mesh.comm, name)
        residual = ResidualForm(F=F, u=u, functional=energy, J=J)
        if residual.affine:
            residual = replace(residual, F=by_one_rule(F), J=None)
        if not isinstance(petsc_options_prefix, str):
            raise InputError(f"{name}: petsc_options_prefix = {shown(petsc_options_prefix)}: expected a text")
        checked_options(form_compiler_options, f"{name}: form_compiler_options", "{'scalar_type': 'float64'}")
        checked_options(jit_options, f"{name}: jit_options", "{'cffi_extra_compile_args': ['-O2']}")
        with releases.compiled_with(*compiled):
            check_integrals(residual, held, name)
        if in_components:
            garbage.free_before(self, mesh.comm)
            self.u, self._compiled = u, compiled
            self._options = checked_options(petsc_options, f"{name}: petsc_options")
            with naming_compiler_errors(mesh.comm, name), releases.compiled_with(*compiled):
                self._components = ComponentSystem(residual, bounds, held, name, petsc_options_prefix)
                self._components.begin()
            self._components.check_signs()
            return
        on_facets = Model((residual,), boundary=(Part("measure", ("contact",), **sides),), source=name)
        if self._vector_valued:  # a scalar problem does not load this
            from fenicsx_obstacle.discrete.contact_nodes import VectorData
            from fenicsx_obstacle.problems.vector_valued import facets_and_weight, von_mises_of

            facets, weight = facets_and_weight(measure, mesh, name)
            if of is None:
                raise InputError(f"{name}: u is vector-valued: say what the obstacles bound, of=ufl.dot(u, n)")
            nodes = of_space(V, name, {"contact": facets}, vector=True)
            data: Data = VectorData(on_facets, nodes, held, of=of, u=u, weight=weight)
            with releases.compiled_with(*compiled):
                self._von_mises = None if stress is None else von_mises_of(stress, mesh, name)
        else:
            model = Model((residual,), **sides, source=name) if facets is None else on_facets
            data = Data(model, level, bcs=held, live=True)
        with naming_compiler_errors(mesh.comm, name):
            self._set_up(data, u, residual, petsc_options_prefix, petsc_options, compiled)
            if self._vector_valued:
                once = (of if weight is None else weight * of) * ufl.ds(domain=mesh)
                self._once = once, _values_in(once)
            if energy is not None:
                with releases.compiled_with(*compiled):
                    check_energy(self._problem, self._diagonal(), residual, name)

    @classmethod
    def of_model(cls, model: Model, level: Level) -> ObstacleProblem:
        """A problem made of effects, for which there are error bounds (collective).

        Args:
            model: Effects, obstacles and boundary values, none of which depends on time.
            level: Mesh and spaces; those of the levels below it give a start.

        Raises:
            InputError: If the model has time, or no u can satisfy the data.
        """
        if model.time is not None:
            raise InputError(f"{model.source}: an ObstacleProblem is one equilibrium; solve() takes [time]")
        self = cls.__new__(cls)
        u = fem.Function(level.V, name="u")
        self._set_up(Data(model, level), u, None, "", None, (None, None))
        u.x.array[:] = self._problem.solution().x.array
        return self

    def _set_up(
        self,
        data: Data,
        u: fem.Function,
        form: ResidualForm | None,
        prefix: str,
        options: Mapping[str, Any] | None,
        compiled: tuple[Mapping[str, Any] | None, Mapping[str, Any] | None],
    ) -> None:
        """Assemble what stays (collective)."""
        garbage.free_before(self, data.level.comm)
        self.u, self._data, self._form, self._compiled = u, data, form, compiled
        self._vertices = vertex_digests(data.level)
        self._options = checked_options(options, f"{self.name}: petsc_options")
        started = time.perf_counter()
        kind = Problem
        if self._vector_valued:  # a scalar problem does not load this
            from fenicsx_obstacle.discrete.vector_problem import VectorProblem

            kind = VectorProblem
        with releases.compiled_with(*compiled):
            self._problem = kind(data, prefix)
        self._problem.keeps_solver = True
        self._setup_seconds = time.perf_counter() - started
        self._in_matrix = {} if form is None else _values_in(form.slope)
        self._pressure = np.zeros(len(self._problem.weights))
        self._levels: Levels | None = None
        self._solved_before = False
        self._eps: float | None = None

    @property
    def _system(self) -> System:
        return self._problem if self._components is None else self._components

    @property
    def solver(self) -> PETSc.SNES | None:
        """The SNES of the last attempt on the finest level; None before the first solve."""
        return self._system.solver

    @property
    def A(self) -> PETSc.Mat:
        """The matrix of the last linear system."""
        return self._system.A

    @property
    def b(self) -> PETSc.Vec:
        """The residual of F at the last state."""
        return self._system.elastic

    @property
    def level(self) -> Level:
        """The mesh and the spaces V_h and Q_h."""
        return self._problem.level

    @names_checked
    def solve(
        self,
        *,
        eps: float | str | fem.Constant = "auto",
        method: str = "penalty",
        rtol: float = TOLERANCE,
        bound: bool = False,
        monitor: Monitor | None = None,
    ) -> Solution:
        """Solve the problem; u holds the solution afterwards (collective).

        Args:
            eps: Penalty parameter in the unit of u/p, a number or a Constant. With "auto" it is a hundredth of the
                median of D_i/A_ii over the nodes where u is not given. A is the derivative of F at the initial guess,
                and D_i are the weights of I. For a problem made from a Scene, "auto" is h^2/100 divided by the largest
                tension. If the penetration is more than 1 % of the range of u between the obstacles, or if this eps
                does not fit the stiffness of the solution at a contact node, "auto" is lowered, and the problem is
                solved again from the solution. The next solve begins with the same eps. A given eps is not changed; a
                `PenetrationWarning` says if its penetration is large.
            method: "penalty"; "vi", the variational inequality by SNES VI, without eps; or "successive", the iteration
                (3.4)* of Kikuchi's paper, which starts without contact.
            rtol: The solver stops when the sum of unbalanced forces, divided by the sum of acting forces, is below this
                number, which is less than 0.01.
            bound: Also compute a bound of the energy error. This needs a problem made from a Scene.
            monitor: A function that is called on all ranks with the number of each Newton step and its `Step`.

        Returns:
            The solution, a `Solution`; with bounds of components a `ComponentSolution`. It is a copy, which later
            solves do not change.

        Raises:
            InputError: If an argument is invalid, or no u can satisfy the data.
            NotConverged: If the solver fails, with PETSc's reason; u is then unchanged.
        """
        started = time.perf_counter()
        if self._components is not None:
            return cast(Any, self._solved_in_components(self._components, eps, method, rtol, bound, monitor))
        estimator = self._estimator if bound else None  # raises before anything is solved
        self._set_load(bound)
        outcome, state = self._solved(eps, method, rtol, monitor)
        problem, level = self._problem, self._problem.level
        began = started - self._setup_seconds
        record = record_of(problem, method, outcome, state, began) | {"scene": self.name}
        certified = None if estimator is None else estimator.bound()
        if certified is not None:
            record["bound"] = {**certified.record, "effectivity": None}
        self._setup_seconds = 0.0
        # clocks differ between ranks: rank 0 speaks for all
        record, history = level.comm.bcast((record, outcome.history))
        fields = state.fields
        fields.u.name = self.u.name
        tension = self._data.model.elastic.tension_at(fields.u, self._data)
        if self._vector_valued:
            from fenicsx_obstacle.problems.vector_valued import vector_fields

            von_mises = None if self._von_mises is None else self._von_mises()
            fields, more = vector_fields(problem, state.contact, fields, von_mises)
            record["contact"] |= more
        return Solution(fields, history, record, certified, tension, _problem=weakref.ref(self))

    def verify(self, solution: Solution) -> Verification:
        """Check a solution of this problem, for the data as they are now (collective).

        Balance of forces, given values, obstacles, the law of the penalty or (3.20), and contact set, area and forces
        are computed anew. Small linear symmetric problems with contact at nodes are solved once more, by active sets
        and a direct solver.

        Returns:
            The findings. It is true if all hold, and prints as a table.

        Raises:
            InputError: If the solution is of another mesh or element, or data are invalid.
        """
        from fenicsx_obstacle.check.verification import verify  # only if requested

        if self._components is not None:
            raise InputError(f"{self.name}: verify is not for bounds of components")
        self._check_kept()
        self._set_load(solution.bound is not None and self._form is None)
        with releases.compiled_with(*self._compiled):
            return verify(self._problem, solution, self._of_contact(solution) if self._vector_valued else None)

    def _check_kept(self) -> None:
        """Reject changes of what is evaluated once (collective).

        Raises:
            InputError: On all ranks, with the remedy.
        """
        check_not_moved(self.level, self._vertices, self.name)
        if self._once is not None:
            form, before = self._once
            now = {one: value for one, value in _values_in(form).items() if one is not self.u}
            if total(self.level.comm, any(not np.array_equal(now[one], before[one]) for one in now)) > 0:
                raise InputError(
                    f"{self.name}: a value in `of` or in the factor of measure has changed, but they are evaluated "
                    "once: move it to lower or upper, or create a new ObstacleProblem"
                )

    def _of_contact(self, solution: Solution) -> Callable[[Contact], tuple[Any, dict[str, Any]]]:
        """Makes the fields of a body, and what its record says of contact, from the state of the problem."""
        from fenicsx_obstacle.problems.vector_valued import vector_fields

        def made(contact: Contact) -> tuple[Any, dict[str, Any]]:
            kept, von_mises = self.u.x.array.copy(), None
            if self._von_mises is not None:
                self.u.x.array[:] = solution.u.x.array
                von_mises = self._von_mises()
                self.u.x.array[:] = kept
            return vector_fields(self._problem, contact, solution.fields, von_mises)

        return made

    def _solved_in_components(
        self, system: ComponentSystem, eps: Any, method: str, rtol: float, bound: bool, monitor: Monitor | None
    ) -> ComponentSolution:
        """Solve with bounds of components, for the data of now (collective)."""
        if bound:
            raise InputError(f"{self.name}: bound=True is not for bounds of components")
        garbage.free_unreferenced(system.comm)
        options = self._options_of(eps, method, rtol, monitor)
        with self._settings():
            system.begin()
            return system.solve(options, rtol, None if monitor is None else _on_finest(monitor, system))

    def _options_of(self, eps: Any, method: str, rtol: float, monitor: Monitor | None) -> SolverOptions:
        """Method and eps, checked like the other arguments."""
        if not isinstance(rtol, numbers.Real) or isinstance(rtol, bool) or not 0 < rtol < ON_THE_WAY:
            given = f"{rtol:g}" if isinstance(rtol, numbers.Real) else shown(rtol)
            raise InputError(f"{self.name}: rtol = {given}: expected a number between 0 and {ON_THE_WAY:g}")
        value = number_of(eps, self.name)
        if monitor is not None and not callable(monitor):
            raise InputError(f"{self.name}: monitor = {shown(monitor)}: expected a function of a number and a Step")
        return SolverOptions(method, "auto" if method == "vi" else value, source=f"{self.name}:")

    def _solved(self, eps: Any, method: str, rtol: float, monitor: Monitor | None) -> tuple[Outcome, State]:
        """Solve, into u (collective)."""
        garbage.free_unreferenced(self.level.comm)  # such as the solver of the solve before the last one
        self._check_kept()
        options = self._options_of(eps, method, rtol, monitor)
        with self._settings():
            self._begin()
            problem = self._problem
            levels = self._levels_for(options)
            start = self._press if len(levels) == 1 or self._has_start() else None
            numbered = None if monitor is None else _on_finest(monitor, problem)
            try:
                outcomes, state = solve(levels, options, known=self._eps, start=start, tolerance=rtol, monitor=numbered)
            except NoPositiveDiagonal:
                refuse_no_positive_diagonal(problem, self._diagonal(), self._form, self.name)
            except NotConverged as error:
                if self._form is None:
                    raise
                refuse_not_finite(problem, self._form, self.name)
                problem.set_reference(self.u.x.array[: problem.owned].copy())
                raise error.changed(reason=error.reason + flat_start(problem, self._form)) from None
            warn_of_indefinite(problem, self._form, self.name)
        self.u.x.array[:], self._pressure, self._solved_before = state.fields.u.x.array, state.contact.pressure, True
        if options.eps == "auto" and outcomes[-1].eps is not None:
            self._eps = outcomes[-1].eps  # so that the next solve gives the same solution
        return outcomes[-1], state

    def _levels_for(self, options: SolverOptions) -> Levels:
        """The levels of a solve, with the data of now (first use is collective)."""
        if not has_levels(self._problem, options):
            return levels_of(self._problem, options)
        if self._levels is None:
            self._levels = levels_of(self._problem, options)
        elif self._form is not None:
            for system in reversed(self._levels.below):
                system.renew(stiffness=False)  # which algebraic levels notice themselves
        return self._levels

    def _has_start(self) -> bool:
        """Whether u is more than one number, or contact alone holds it (collective)."""
        problem = self._problem
        if problem.floating or self._solved_before:
            return True
        if self._form is None:
            return False
        free, comm = self.u.x.array[: problem.level.owned][~problem.fixed], problem.level.comm
        return largest(comm, free) > smallest(comm, free)

    @contextmanager
    def _settings(self) -> Iterator[None]:
        """Set the PETSc options of this problem during a solve."""
        prefixes = [self._system.prefix] if self._system.prefix else ["penalty_", "vi_"]
        options = {prefix + key: value for prefix in prefixes for key, value in self._options.items()}
        with overriding(options), releases.compiled_with(*self._compiled):
            try:
                yield
            except PETSc.Error as error:
                if not options:
                    raise
                why = str(error).strip().splitlines()[-1]
                raise InputError(f"{self.name}: petsc_options = {self._options}: PETSc: {why}") from error
            left = unread(options)
        ignored = [key for key in self._options if all(prefix + key in left for prefix in prefixes)]
        if ignored:
            words = f"{self.name}: petsc_options that no solver uses: {', '.join(ignored)}"
            warn(self._system.comm, words, stacklevel=6)

    def _begin(self) -> None:
        """Update changed data, and start from u (collective)."""
        problem = self._problem
        if self._form is not None:
            values = _values_in(self._form.slope)
            moved = [one for one, now in values.items() if not np.array_equal(now, self._in_matrix[one])]
            stiffness = total(problem.level.comm, len(moved)) > 0
            if total(problem.level.comm, len([one for one in moved if one is not self.u])) > 0:
                self._eps = None  # it was that of another stiffness
            problem.renew(stiffness=stiffness)
            self._in_matrix = values
            if stiffness and self._form.affine:
                self._form.look_again(problem.matrices.stiffness)
            check_stiffness(problem, self._form, self.name)
        share(self.u)
        self._data.refuse_infinite(self.u, words=f"{self.name}: u, the start,")
        if problem.floating:
            problem.set_reference(problem.cold_start())
        else:
            start = np.where(problem.fixed, problem.given, self.u.x.array[: problem.owned])
            problem.set_reference(problem.between(start))
        problem.judge_load()

    @cached_property
    def _estimator(self) -> Estimator:
        """Bounds of the energy error (first use is collective).

        Raises:
            InputError: If there are none for a form, the elements or the effects.
        """
        if self._form is not None:
            raise InputError(
                f"{self.name}: bound=True needs tension and load as data, which cannot be read from a form: "
                "use Scene(mesh=..., tension=..., load=...)"
            )
        from fenicsx_obstacle.estimation.bound import Estimator  # only if requested

        return Estimator(self._problem)

    def _set_load(self, bounded: bool) -> None:
        """The load of solutions with an error bound, or that of others (collective)."""
        if bounded or "_estimator" in self.__dict__:
            self._estimator.set_load(resolved=bounded)

    def _diagonal(self) -> np.ndarray:
        """A_ii at owned nodes where u is free, for A the derivative of F at the present state (collective)."""
        return diagonal_of(self._problem)[~self._problem.fixed]

    def _press(self, eps: float | None) -> None:
        """Let nodes of u that are at an obstacle, and pressed against it in the last solution, do so again: w = -eps p
        there (collective)."""
        problem = self._problem
        if eps is not None and not problem.floating:
            w = problem.w[: len(self._pressure)]
            w -= eps * np.where((np.minimum(*problem.gaps()) == 0) & ~problem.fixed, self._pressure, 0.0)
            problem.state.share()


def _on_finest(monitor: Monitor, finest: System) -> StepMonitor:
    """A monitor as solvers take it: of the steps on the finest level."""
    numbers = count()

    def numbered(problem: System, step: Step, active: np.ndarray) -> None:
        if problem is finest:
            with agree(problem.comm):
                monitor(next(numbers), step)

    return numbered


def _values_in(form: ufl.Form) -> dict[Any, np.ndarray]:
    """Copies of the values of Functions and Constants in a form, that u is not known to change."""
    flat = ufl.algorithms.expand_derivatives(form)
    functions = {one: one.x.array.copy() for one in flat.coefficients()}
    return functions | {one: np.array(one.value) for one in flat.constants()}

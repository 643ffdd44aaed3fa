"""Time stepping of a scene: a sequence of stationary problems with the same mesh and matrices."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.methods import method_of
from fenicsx_obstacle.algebra.nested import Levels, as_it_is, solve_nested
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.stopping import StepMonitor
from fenicsx_obstacle.answers.data_within_steps import DataWithinSteps
from fenicsx_obstacle.answers.steps import Steps, read_checkpoint, write_checkpoint
from fenicsx_obstacle.answers.time_history import Course, Row, at_time
from fenicsx_obstacle.data.admissible import giver, worst
from fenicsx_obstacle.data.time_discretization import EQUILIBRIA, INERTIA, NO_STEP, TimeDiscretization
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.residence_time import check_drift_in_time
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.io.folder import frame_of, gather
from fenicsx_obstacle.parallel import first_given, largest, smallest, total
from fenicsx_obstacle.problems.solve import State, state_of
from fenicsx_obstacle.text import one_line

_log = logging.getLogger(__name__)
EVERY = 20.0  # seconds between states on the disk
CROSSES = 1e-9  # of the range of u: how far initial values may be beyond an obstacle, or from boundary values


class TimeStepper:
    """Time stepping of a scene.

    Attributes:
        problem: On the finest level.
        below: Those of the levels below, whose matrices keep step.
        course: The moments so far.
    """

    def __init__(
        self,
        levels: Levels,
        options: SolverOptions,
        reported: Callable[[State], Row],
        monitor: StepMonitor | None = None,
    ):
        """Take the data of the start, and choose eps (collective).

        Args:
            levels: On which the scene is solved.
            options: Of the solves.
            reported: Figures of [report] for a state (collective).
            monitor: Called after each Newton step.

        Raises:
            InputError: For a bad eps.
        """
        problem = levels.finest
        assert isinstance(problem, Problem)
        self.problem, self.below, self._levels = problem, levels.below, levels
        self._reported, self._monitor = reported, monitor
        assert problem.model.time is not None
        self.moments: TimeDiscretization = problem.model.time
        if problem.data.moment is not None and problem.data.moment.t > 0:  # time stepping before has left it there
            self._go_back()
        self._method = method_of(problem, options)
        self._penalty = self._method.penalty
        self._newton = self._krylov = self._rejected = self._shortened = 0
        self._within: DataWithinSteps | None = None
        self._size = 0.0
        self._kinetic_energy: Any = None

    def run(self, restart: Path | None, keep: Path | None) -> Outcome:
        """Go to the end; the problem then holds the last state (collective).

        Args:
            restart: Folder with the state to begin from.
            keep: Folder for states on the way, or None.

        Returns:
            The outcome of the last step.

        Raises:
            InputError: If data are wrong at some moment.
            NotConverged: At a step that cannot be shortened. The state before it is in `keep` then.
        """
        self._begin(restart)
        while (outcome := self._advance(keep)) is None:
            self._go_back()
            self._begin(restart)
        return outcome

    def _go_back(self) -> None:
        """Take the data of the beginning again, on all levels."""
        assert self.problem.data.moment is not None
        self.problem.data.moment.go_back(self.moments)
        for one in (self.problem, *reversed(self.below)):
            one.move(one.cold_start())

    def _solve(self) -> list[Outcome]:
        """Solve for the present data: equilibria from coarser levels on, others from the last moment (collective)."""
        if self.moments.order == EQUILIBRIA and len(self._levels) > 1:
            return solve_nested(self._levels, self._method, monitor=self._monitor)
        return solve_nested(self._levels[-1:], self._method, start=as_it_is, monitor=self._monitor)

    @property
    def state(self) -> State:
        """The present state, solved (collective)."""
        return state_of(self.problem, self._method)

    def _advance(self, keep: Path | None) -> Outcome | None:
        """All steps; None where one of them has lowered eps (collective)."""
        times, dt, written = self.steps.times, self.moments.step, self._now()
        if self.moments.tolerance is not None and len(times) > 1:  # it goes on with the last step
            dt = times[0] - times[1]
        while (t := self.course.following(dt)) is not None:
            before = self.steps.times[0]
            if self._misses_data(before, t):
                dt, self._shortened = (t - before) / 2, self._shortened + 1
                continue
            try:
                with at_time(self.moments, t):
                    outcomes = self._step(t)
            except NotConverged:
                if self.moments.tolerance is None or dt < NO_STEP * self.moments.end:
                    self._keep(keep)
                    raise
                dt, self._rejected = (t - before) / 4, self._rejected + 1
                continue
            if self._lowers_eps(outcomes[-1]):
                self._count(outcomes)
                return None
            u = self._heights()
            if self.moments.tolerance is not None:
                added = self.steps.error(self.problem, t, u)
                wanted = self.steps.next_length(t - before, added, self.moments.tolerance)
                if added > self.moments.tolerance and t - before > NO_STEP * self.moments.end:
                    dt, self._rejected = wanted, self._rejected + 1
                    continue
                if self._misses_data(before, t, u):
                    dt, self._shortened = (t - before) / 2, self._shortened + 1
                    continue
                dt = max(wanted, dt) if wanted >= t - before else wanted
            self.steps.accept(t, u)
            self._count(outcomes)
            self._row(t, outcomes)
            if keep is not None and self._now() - written > EVERY:
                self._keep(keep)
                written = self._now()
        self._keep(keep)
        return outcomes[-1]

    def _lowers_eps(self, last: Outcome) -> bool:
        """Whether the last step needed a smaller eps; those that follow begin with it.

        Penetrations of another eps differ, which `rate` and `inertia` would take for a motion with a force of its own:
        all steps have the same eps.
        """
        penalty = self._penalty
        if penalty is None or self.moments.order == EQUILIBRIA or last.eps is None or last.eps == penalty.eps:
            return False
        _log.info("eps is lowered to %.2g: all steps begin anew with it", last.eps)
        penalty.eps = last.eps
        return True

    def _misses_data(self, before: float, t: float, u: np.ndarray | None = None) -> bool:
        """Whether data change within the step from `before` to t in a way that the step misses (collective).

        Args:
            before: Start of the step.
            t: Its end.
            u: The solution there, for the obstacles; None for the other data, before the step.

        Raises:
            InputError: If the step is too short to be divided.
        """
        if self.moments.tolerance is None:
            return False
        if self._within is None:
            self._within = DataWithinSteps(self.problem.data, self.moments.tolerance)
        u_before = self.steps.u_values[0]
        if u is None:
            self._size = max(self._size, largest(self.problem.level.comm, np.abs(u_before)))
        found = self._within.excess(before, t, self._size, None if u is None else (u_before, u))
        if found is not None and t - before <= NO_STEP * self.moments.end:
            name, (datum, when, size) = one_line(self.moments.name), found
            raise InputError(
                f"{datum}: at {name} = {when:.9g} it is {size:.3g} beyond its values at both ends of "
                f"the smallest time step, {t - before:.1e}: [time] tolerance cannot follow a change that is so short; "
                "let it last longer, or leave out the key 'tolerance'"
            )
        return found is not None

    @property
    def counts(self) -> dict[str, Any]:
        """Steps and iterations, as in answer.json."""
        moments = {**self.course.record, "rejected": self._rejected}
        counts: dict[str, Any] = {"time": moments, "newton_total": self._newton, "krylov_total": self._krylov}
        if self._within is not None:
            moments["shortened"] = self._shortened
            if self._within.sampled:
                counts["remarks"] = [
                    f"{datum}: sampled within the time steps; changes between the samples are not seen"
                    for datum in self._within.sampled
                ]
        return counts

    def _begin(self, restart: Path | None) -> None:
        problem, moments = self.problem, self.moments
        self.course = Course(moments)
        if restart is not None:
            mesh = gather(self.state.fields)
            self.steps, time_history = read_checkpoint(restart, problem.model, problem.level, mesh)
            self.course = Course(moments, time_history)
            if self._penalty is not None and self._penalty.automatic and self.steps.eps is not None:
                self._penalty.eps = min(self._penalty.eps, self.steps.eps)
            self._move(self.steps.times[0], self.steps.u_values[0])
            self._remember()
            return
        if moments.order == EQUILIBRIA:
            self.steps = Steps(moments, problem.cold_start())
            problem.set_reference(self.steps.u_values[0])
            with at_time(self.moments, 0.0):
                outcomes = self._solve()
            self.steps.u_values = [self._heights()]
            self._count(outcomes)
            self._row(0.0, outcomes)
            return
        check_drift_in_time(problem)
        self.steps = Steps(moments, self._start(), self._velocity())
        self._move(0.0, self.steps.u_values[0])
        self.steps.u_values = [self._heights()]  # with the boundary values
        self._remember()
        self._row(0.0, [])

    def _start(self) -> np.ndarray:
        """u at t = 0, ghosts included."""
        problem, start = self.problem, self.moments.start
        assert start is not None
        u = problem.data.nodal(start).x.array.copy()
        if self.moments.order == INERTIA:
            self._check_edge(u)
        sides = (problem.data.lower, -np.inf), (problem.data.upper, np.inf)
        lower, upper = (np.full(len(u), none) if side is None else side.x.array for side, none in sides)
        beyond = np.maximum(lower - u, u - upper)
        beyond[problem.data.fixed[0]] = -np.inf
        comm = problem.level.comm
        height = largest(comm, u) - smallest(comm, u)
        size = max(height, largest(comm, np.abs(u)))

        def words(dof: int, place: str) -> str:
            below = lower[dof] > u[dof]
            side, limit, of_both = ("below the lower", lower, "max") if below else ("above the upper", upper, "min")
            return (
                f"lies {side} obstacle: {u[dof]:.6g} against {limit[dof]:.6g} at {place}; take "
                f"a start between the obstacles, for example {of_both}(a, b) of both formulas"
            )

        self._reject_start(beyond, CROSSES * size, words)
        return np.clip(u, lower, upper)

    def _check_edge(self, u: np.ndarray) -> None:
        """Reject a start that is not the boundary value where u is given: the energy of a jump is infinite, and that of
        its interpolant grows like 1/h. With `rate` alone a jump is smoothed (collective).

        Raises:
            InputError: Naming place and values.
        """
        data = self.problem.data
        (dofs, values), comm = data.fixed, data.level.comm
        off = np.full(len(u), -np.inf)
        off[dofs] = np.abs(u - values.x.array)[dofs]
        size = largest(comm, np.abs(np.concatenate([u, values.x.array[dofs]])))

        def words(dof: int, place: str) -> str:
            name = giver(data, dof).removeprefix(f"{data.model.source}: ")
            return (
                f"is {u[dof]:.6g} at {place}, where {name} gives {values.x.array[dof]:.6g}; "
                "with inertia such a jump has infinite energy: both must agree at t = 0, so change one"
            )

        self._reject_start(off, CROSSES * size, words)

    def _reject_start(self, beyond: np.ndarray, tolerance: float, words: Callable[[int, str], str]) -> None:
        """Raise an error with words about the worst dof, if a nodal number is beyond its tolerance (collective)."""
        data = self.problem.data
        if (found := worst(data, beyond, tolerance)) is not None:
            _, point, dof = found
            mine = None if dof is None else words(dof, data.place(point))
            raise InputError(f"{self.moments.start}: {first_given(data.level.comm, mine)}")

    def _velocity(self) -> np.ndarray | None:
        """u_t at t = 0, ghosts included, with inertia."""
        if self.moments.order != INERTIA:
            return None
        data = self.problem.data
        edges_move = data.fixed[1] in data.moving
        if self.moments.velocity is None:
            if edges_move:
                raise InputError(f"{data.model.source}: [time] velocity: is needed if boundary values depend on t")
            return np.zeros(len(data.fixed[1].x.array))
        velocity = data.nodal(self.moments.velocity).x.array.copy()
        if not edges_move:
            velocity[data.fixed[0]] = 0.0
        return velocity

    def _now(self) -> float:
        """Seconds by the clock of rank 0: all ranks must write together (collective)."""
        return float(self.problem.level.comm.bcast(time.perf_counter()))

    def _step(self, t: float) -> list[Outcome]:
        self.steps.prepare(self.problem, t)
        self._move(t, self.steps.u_values[0])
        return self._solve()

    def _move(self, t: float, u_values: np.ndarray) -> None:
        """Set the data of a time on all levels."""
        assert self.problem.data.moment is not None
        self.problem.data.moment.t = t
        changed = self.problem.move(u_values[: self.problem.owned])
        if changed or self.moments.order == EQUILIBRIA:
            for problem in reversed(self.below):  # algebraic levels take their data from the finer one
                problem.move(problem.cold_start())

    def _heights(self) -> np.ndarray:
        """u, ghosts included."""
        return self.problem.solution().x.array

    def _count(self, outcomes: Sequence[Outcome]) -> None:
        self._newton += sum(outcome.iterations for outcome in outcomes)
        self._krylov += sum(outcome.krylov for outcome in outcomes)

    def _remember(self) -> None:
        """With inertia: the forces of the newest moment, which the next step averages with its own."""
        if self.moments.order == INERTIA:
            out = self.problem.law.vector()
            self.problem.law.at_rest(out)
            self.steps.impulse = out.array_r.copy()
            out.destroy()

    def _row(self, t: float, outcomes: Sequence[Outcome]) -> None:
        """Append the output quantities of a step, and its fields if they are to be saved."""
        self._remember()
        state, last = self.state, outcomes[-1] if outcomes else None
        if last is None:  # nothing is in balance yet: there is no pressure
            state.fields.pressure.x.array[:] = state.fields.contact.x.array[:] = 0.0
        figures: dict[str, Any] = {"energy": state.energy}
        if self.steps.velocity is not None:
            kinetic = self._kinetic()
            figures = {"energy": None if state.energy is None else state.energy + kinetic, "kinetic": kinetic}
        if last is not None:
            figures["contact_area"] = state.contact.area
            figures |= {f"force_{side}": force for side, force in state.sides(self.problem).items()}
            figures["penetration"] = state.contact.penetration
            figures |= self._reported(state)
        counts = (None, None) if last is None else (last.iterations, last.krylov)
        self.course.add(t, counts, figures, lambda: frame_of(state.fields))

    def _kinetic(self) -> float:
        """rho v^2/2, by the nodal rule."""
        assert self.steps.velocity is not None
        data = self.problem.data
        data.motion.velocity.x.array[:] = self.steps.velocity
        if self._kinetic_energy is None:
            densities = [effect.value for effect in self.problem.model.effects if effect.order == INERTIA]
            parts = (0.5 * data.cellwise(rho, positive=True) * data.motion.velocity**2 * data.dI for rho in densities)
            self._kinetic_energy = releases.form(sum(parts))
        return total(self.problem.level.comm, fem.assemble_scalar(self._kinetic_energy))

    def _keep(self, folder: Path | None) -> None:
        if folder is not None:
            self.steps.eps = None if self._penalty is None else self._penalty.eps
            model, level, mesh = self.problem.model, self.problem.level, gather(self.state.fields)
            write_checkpoint(folder, model, level, self.steps, self.course.history, mesh)

"""Solves a scene: mesh, problem, solver, output quantities."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import garbage
from fenicsx_obstacle.algebra.nested import Levels
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.stopping import StepMonitor
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.truncated_multigrid import Multigrid
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.poisson_baseline import poisson_seconds
from fenicsx_obstacle.answers.profiles import check_profiles
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.discrete.hierarchy import has_levels, levels_of, nested
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.estimation.norms import Distance, Exact
from fenicsx_obstacle.mesh.levels import Level, refined_where
from fenicsx_obstacle.parallel import largest, return_freed_memory
from fenicsx_obstacle.problems.record import record_of
from fenicsx_obstacle.problems.solve import State, solve
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.scene import Scene

if TYPE_CHECKING:
    from fenicsx_obstacle.estimation.bound import Estimator
    from fenicsx_obstacle.scenes.functionals import Report

_log = logging.getLogger(__name__)


class SolverContext:
    """Mesh and discrete problem of a scene, for several solves that differ in their options only.

    Attributes:
        scene: What is solved.
        problem: The discrete problem.
    """

    def __init__(
        self,
        scene: Scene,
        comm: MPI.Comm = MPI.COMM_WORLD,
        level: Level | None = None,
        before: SolverContext | None = None,
    ):
        """Assemble (collective).

        Args:
            scene: What to solve.
            comm: Communicator; not used if the scene has a DOLFINx mesh.
            level: The scene's mesh, where it is made already.
            before: A solver context on the level below, whose solution is the start.
        """
        scene.only_scalar("error bounds, adaptive meshes, Newton pictures and costs")
        self.started = time.perf_counter()
        if level is None:
            level = meshes.build(scene, comm)
            scene = scene.with_pair(level.pair)
        self.scene = scene
        self.mesh_seconds = time.perf_counter() - self.started
        _log.info("mesh: %d cells, %d unknowns, h = %.3g", level.cells, level.dofs, level.h)
        self.problem = Problem(Data(scene.model, level))
        self._levels: Levels | None = None
        self._on_meshes = False
        self._ready = 0  # coarsest levels that hold their solutions
        if before is not None and nested(scene.effects, scene.pair, scene.options):
            self._levels = self._above(before)
        self.setup_seconds = time.perf_counter() - self.started - self.mesh_seconds
        self._report: Report | None = None
        if scene.report:
            from fenicsx_obstacle.scenes.functionals import Report  # only where a scene names it

            self._report = Report(self.problem.data, scene)
            self._report.check()
        check_profiles(scene, level)

    def renewed(self, scene: Scene) -> SolverContext:
        """A solver context for other data on the same mesh; this one is freed, except for the mesh (collective).

        Args:
            scene: With the mesh and the element of the present one.
        """
        level = self.problem.level
        self._free()
        return SolverContext(scene, level.comm, level)

    def _free(self) -> None:
        """Free everything but the mesh (collective)."""
        del self.problem
        self._levels = self._report = None
        for cached in ("exact", "estimator", "distance", "inequality"):
            self.__dict__.pop(cached, None)

    def close(self) -> None:
        """Free matrices and solvers; answers stay (collective)."""
        close([self])

    def refined(self, marked: np.ndarray) -> SolverContext:
        """A solver context on the mesh with marked owned cells refined; it starts from the solution here (collective).

        Raises:
            InputError: For cells that are no simplices.
        """
        level = self.problem.level
        return SolverContext(self.scene, level.comm, refined_where(level, marked), self)

    @property
    def multigrid(self) -> Multigrid | None:
        """That of this mesh, if solves use it (first use is collective)."""
        return self._levels_for(self.scene.options).multigrids[-1]

    @cached_property
    def exact(self) -> Exact | None:
        """The exact solution on this mesh, if the scene has one."""
        solution = self.scene.exact
        return None if solution is None else Exact(self.problem, solution)

    @cached_property
    def estimator(self) -> Estimator:
        """Bounds of the energy error on this mesh (first use is collective).

        Raises:
            InputError: If there are none for its elements.
        """
        from fenicsx_obstacle.estimation.bound import Estimator  # only if requested

        estimator = Estimator(self.problem)
        estimator.set_load(resolved=True)
        return estimator

    @cached_property
    def distance(self) -> Distance:
        """Norms of differences on this mesh (first use is collective)."""
        return Distance(self.problem)

    @cached_property
    def inequality(self) -> Answer:
        """The solution of the variational inequality on this mesh (first use is collective).

        Raises:
            NotConverged: With PETSc's reason.
        """
        return self.answer(replace(self.scene.options, method="vi"), errors=False)

    @cached_property
    def poisson(self) -> float:
        """Seconds of one linear Poisson solve on this mesh (first use is collective)."""
        _log.info("timing a Poisson solve")
        return self.problem.level.comm.bcast(poisson_seconds(self.problem.level))

    def forget_estimator(self) -> None:
        """Free the estimator, some kB per node, and norms when this mesh becomes a coarse level of another one."""
        for cached in ("estimator", "distance"):
            self.__dict__.pop(cached, None)

    def forget_levels(self) -> None:
        """Free problems and multigrid of the coarser levels; the next solve creates them again (collective)."""
        self._levels, self._ready = None, 0
        garbage.free(level.comm for level in self.problem.level.with_meshes)
        return_freed_memory()

    def answer(
        self,
        options: SolverOptions | None = None,
        *,
        yardstick: bool = False,
        bound: bool = False,
        restart: Path | None = None,
        keep: Path | None = None,
        monitor: StepMonitor | None = None,
        errors: bool = True,
        near: np.ndarray | None = None,
    ) -> Answer:
        """Solve (collective).

        Args:
            options: How; by default as the scene says.
            yardstick: Time one linear Poisson solve as well.
            bound: Bound the energy error as well.
            restart: With [time]: folder with the state to begin from.
            keep: With [time]: folder for states on the way.
            monitor: Called after each Newton step, on all levels.
            errors: Measure them, if the scene has an exact solution.
            near: Without [time]: owned values of u, of a solution that is near, to begin from.

        Raises:
            InputError: For a bad eps, or elements that the bound is not for.
            NotConverged: With PETSc's reason.
        """
        problem, scene, options = self.problem, self.scene, options or self.scene.options
        estimator = self.estimator if bound else None  # raises before anything is solved
        levels = self._levels_for(options, on_meshes=monitor is not None)
        start = time.perf_counter()
        if problem.state.multiplier is not None:  # of an earlier solve
            problem.state.multiplier[:] = 0.0
            problem.state.share_all()
        time_history = None
        if scene.time is None:
            begin = None if near is None else lambda _: problem.set_reference(near)
            ready = self._ready if len(levels) > 1 else 0
            outcomes, state = solve(levels, options, start=begin, ready=ready, monitor=monitor)
            last = outcomes[-1]
            counts = {"newton_total": sum(one.iterations for one in outcomes),
                      "krylov_total": sum(one.krylov for one in outcomes)}  # fmt: skip
        else:
            from fenicsx_obstacle.answers.time_stepper import TimeStepper  # only where a scene has time

            stepper = TimeStepper(levels, options, self._reported, monitor)
            last = stepper.run(restart, keep)
            time_history, counts, state = stepper.course.history, stepper.counts, stepper.state
        seconds = time.perf_counter() - start + self.setup_seconds
        if yardstick:
            _ = self.poisson
        certified = None if estimator is None else estimator.bound()
        record = self._record(options, last, state, seconds, counts)
        if certified is not None:
            record["bound"] = {**certified.record, "effectivity": None}
            if last.eps is not None and (problem.below is None) != (problem.above is None):
                # u_eps - eps max|p_eps| <= u_h <= u_eps at every node, mirrored for a lower obstacle
                width = last.eps * largest(problem.level.comm, np.abs(state.contact.pressure))
                record["enclosure"] = {"width": width, "guaranteed": problem.m_matrix}
        if self._report is not None:
            record |= {"report": self._reported(state), **self._report.extremes}
        # clocks differ between ranks: rank 0 speaks for all
        record, history = problem.level.comm.bcast((record, last.history))
        fields, scene = state.fields, scene.with_options(options)
        tension = problem.model.elastic.tension_at(fields.u, problem.data)
        answer = Answer(fields, history, record, certified, tension, scene=scene, time_history=time_history)
        return self.measured(answer) if errors else answer

    def measured(self, answer: Answer) -> Answer:
        """The answer with its errors and the effectivity of its bound, if the scene has an exact solution (collective).

        Raises:
            InputError: If the exact solution is not a number somewhere.
        """
        if self.exact is None:
            return answer
        errors, difference = self.exact.errors(answer.u, answer.pressure, answer.record["eps"])
        record: dict[str, Any] = {**answer.record, "errors": errors}
        if answer.bound is not None and errors["energy"] > 0:
            record["bound"] = {**record["bound"], "effectivity": answer.bound.total / errors["energy"]}
        return replace(answer, record=record, fields=replace(answer.fields, error=difference))

    def _reported(self, state: State) -> dict[str, float | None]:
        """The output quantities of [report] (collective)."""
        if self._report is None:
            return {}
        fields = {"u": state.fields.u, "p": state.fields.pressure, "contact": state.fields.contact}
        return self._report.evaluate(fields, self.problem.reactions())

    def _above(self, before: SolverContext) -> Levels:
        """The levels of the mesh below, which holds its solution, with those of this mesh (collective)."""
        below, level, finer = before._levels_for(before.scene.options), self.problem.level, list[System]()
        if level.pair.has_p1_coarse_space:  # P1 on this mesh is above P1 on the other
            assert level.coarse is not None
            below = below[:-1]
            finer = [Problem(Data(self.problem.model, level.coarse))]
        self._ready = len(below)
        return below.with_finer([*finer, self.problem])

    def _levels_for(self, options: SolverOptions, *, on_meshes: bool = False) -> Levels:
        """The levels of a solve, kept like the problem (first use is collective).

        Args:
            options: Of the solve.
            on_meshes: As for `hierarchy`; what was made with meshes serves otherwise too.
        """
        if not has_levels(self.problem, options):
            return levels_of(self.problem, options)
        if self._levels is None or (on_meshes and not self._on_meshes):
            start = time.perf_counter()
            self._levels, self._on_meshes = levels_of(self.problem, options, on_meshes=on_meshes), on_meshes
            self._ready = 0
            for level in self.problem.level.with_meshes:
                level.forget_points()
            self.setup_seconds += time.perf_counter() - start
        return self._levels

    def _record(
        self, options: SolverOptions, outcome: Outcome, state: State, seconds: float, counts: Mapping[str, Any]
    ) -> dict[str, Any]:
        """The record of a solve but for bound and [report] (collective)."""
        table = self.scene.tables
        poisson = self.__dict__.get("poisson")  # where it was timed
        figures = record_of(self.problem, options.method, outcome, state, self.started)
        remarks = [*figures.get("remarks", ()), *counts.get("remarks", ())]
        return {
            **figures, "scene": self.scene.name, "title": table.title, "refine": table.mesh.refine,
            "seconds": {**figures["seconds"], "mesh": self.mesh_seconds, "solve": seconds},
            **counts, "poisson_seconds": poisson,
            "poisson_units": None if poisson is None else seconds / poisson,
            **({"remarks": remarks} if remarks else {}),
        }  # fmt: skip


def close(benches: Sequence[SolverContext]) -> None:
    """Free the matrices and solvers of solver contexts; answers stay (collective)."""
    # communicators live until the end
    meshes = [level for context in benches for level in context.problem.level.with_meshes]
    for context in benches:
        context._free()
    garbage.free(level.comm for level in meshes)

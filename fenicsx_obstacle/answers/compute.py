"""From a scene to an answer: mesh, problem, solver, figures."""

from __future__ import annotations

import logging
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import dolfinx
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.accuracy.contact import contact_of
from fenicsx_obstacle.accuracy.norms import Exact
from fenicsx_obstacle.accuracy.round_off import round_off
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.choose import chain, nested, penalty_parameter, stepwise
from fenicsx_obstacle.discrete import levels
from fenicsx_obstacle.discrete.duality import in_q
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, peak_memory_mb, smallest, total
from fenicsx_obstacle.scenes.formulas import nearest
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.tables import Tables
from fenicsx_obstacle.solvers import multigrid
from fenicsx_obstacle.solvers.augmented import solve_augmented
from fenicsx_obstacle.solvers.multigrid import Multigrid
from fenicsx_obstacle.solvers.nested import solve_nested
from fenicsx_obstacle.solvers.newton import penalty_pressure, solve_penalty
from fenicsx_obstacle.solvers.snes import Outcome
from fenicsx_obstacle.solvers.vi import residual_pressure, solve_vi
from fenicsx_obstacle.solvers.yardstick import poisson_seconds

if TYPE_CHECKING:
    from fenicsx_obstacle.accuracy.bound import Bound, Estimator
    from fenicsx_obstacle.accuracy.functionals import Report

_log = logging.getLogger(__name__)
_SHORT = {"cells": "mesh.cells", "refine": "mesh.refine", "eps": "solve.eps", "method": "solve.method",
          "start": "solve.start", "element": "solve.element"}  # fmt: skip


def changed(scene: Scene, options: dict[str, Any]) -> Scene:
    """The scene with options that are not None; cells, refine, eps, method, start and element by their short names.

    Raises:
        InputError: If a key is unknown or a value does not fit it.
    """
    known = {*_SHORT, *Tables.__struct_fields__}
    for key in options:
        if "." not in key and key not in known:
            raise InputError(f"{scene.source}: unknown key '{key}'" + nearest(key, known))
    changes = {_SHORT.get(key, key): value for key, value in options.items() if value is not None}
    if "mesh.cells" in changes and (scene.mesh is not None or scene.tables.mesh.file is not None):
        raise InputError(f"{scene.source}: cells are for shapes; a mesh of your own is refined with 'refine'")
    return scene.change(changes) if changes else scene


class Workbench:
    """A scene's mesh and problem, kept for several solves that differ in eps and method only.

    Attributes:
        problem: The discrete problem.
    """

    def __init__(
        self,
        scene: Scene,
        comm: MPI.Comm = MPI.COMM_WORLD,
        level: levels.Level | None = None,
        before: Workbench | None = None,
    ):
        """Assemble (collective).

        Args:
            scene: What to solve.
            comm: Communicator; a mesh of the scene's own brings its own.
            level: The scene's mesh, where it is made already.
            before: A workbench on the level below, whose solution is the start.
        """
        self.started = time.perf_counter()
        if level is None:
            level = levels.build(scene, scene.mesh.comm if scene.mesh is not None else comm)
        self.mesh_seconds = time.perf_counter() - self.started
        _log.info("mesh: %d cells, %d unknowns, h = %.3g", level.cells, level.dofs, level.h)
        self.problem = Problem(scene, level)
        self._grids: list[Multigrid] | None = None
        self._problems: list[Problem] | None = None
        self._solved_below = before is not None and nested(scene)
        if before is not None and self._solved_below:
            below = before._hierarchy()
            self._grids = [*below, Multigrid(self.problem, below[-1])]
        self.setup_seconds = time.perf_counter() - self.started - self.mesh_seconds
        self._report: Report | None = None
        if scene.report:
            from fenicsx_obstacle.accuracy.functionals import Report  # only where a scene names it

            self._report = Report(self.problem.data)
            self._report.check()
        self._exact: Exact | None = None
        self._estimator: Estimator | None = None
        self._poisson: float | None = None

    def close(self) -> None:
        """Free matrices and solvers; answers stay (collective)."""
        meshes = [self.problem.level]  # with their communicators alive until the end
        while meshes[-1].coarse is not None:
            meshes.append(meshes[-1].coarse)
        del self.problem
        self._grids = self._problems = self._report = self._exact = self._estimator = None
        releases.free(level.comm for level in meshes)

    def refined(self, marked: np.ndarray) -> Workbench:
        """A workbench on the mesh with marked owned cells refined, which starts from the solution here (collective).

        Raises:
            InputError: For other cells than intervals and triangles.
        """
        level = self.problem.level
        return Workbench(self.problem.scene, level.comm, levels.refined_where(level, marked), self)

    @property
    def exact(self) -> Exact | None:
        """The exact solution on this mesh, if the scene has one."""
        if self._exact is None and self.problem.scene.tables.exact is not None:
            self._exact = Exact(self.problem)
        return self._exact

    @property
    def estimator(self) -> Estimator:
        """Bounds of the energy error on this mesh (first use is collective).

        Raises:
            InputError: If there are none for its elements.
        """
        if self._estimator is None:
            from fenicsx_obstacle.accuracy.bound import Estimator  # only where it is asked for

            self._estimator = Estimator(self.problem)
            if self.problem.affine:
                self._estimator.lend_load()
        return self._estimator

    def forget_estimator(self) -> None:
        """Free what bounds need, some kB per node, where this mesh is only a level below another from now on."""
        self._estimator = None

    def answer(self, scene: Scene | None = None, *, yardstick: bool = False, bound: bool = False) -> Answer:
        """Solve with the [solve] table of `scene` (collective).

        Args:
            scene: The same scene with another [solve] table; by default the one of the problem.
            yardstick: Time one linear Poisson solve as well.
            bound: Bound the energy error as well.

        Raises:
            InputError: For a bad eps, or elements that the bound is not for.
            NotConverged: With PETSc's reason.
        """
        problem, scene = self.problem, scene or self.problem.scene
        estimator = self.estimator if bound else None  # refuses before anything is solved
        levels_serve = nested(scene) and problem.level.coarse is not None
        grids: Sequence[Multigrid | Problem] = self._hierarchy() if levels_serve else []
        if stepwise(scene) and problem.level.coarse is not None:
            grids = self._chain()
        start = time.perf_counter()
        method, eps = scene.tables.solve.method, None
        if problem.forms.multiplier is not None:  # of an earlier solve
            problem.forms.multiplier.x.array[:] = 0.0
        exact = method == "vi"
        if exact:
            solver: Callable[..., Outcome] = solve_vi if problem.level.pair.nodal else solve_augmented
        elif not problem.constrained:
            solver = partial(solve_penalty, eps=1.0)
        else:
            eps = penalty_parameter(problem, scene)
            solver = partial(solve_penalty, eps=eps, successive=method == "successive")
        if grids:
            stiffness = np.inf if eps is None else 1.0 / eps
            if self._solved_below:
                outcomes = solve_nested(grids[-1:], solver, stiffness, self._hierarchy()[-2].problem)
            else:
                outcomes = solve_nested(grids, solver, stiffness)
        else:
            problem.refer(problem.cold_start())
            outcomes = [solver(problem)]
        of_bounds = exact and problem.level.pair.nodal
        pressure = residual_pressure(problem) if of_bounds else penalty_pressure(problem)
        seconds = time.perf_counter() - start
        if yardstick and self._poisson is None:
            _log.info("timing a Poisson solve")
            self._poisson = poisson_seconds(problem.level)
        return self._answer(scene, outcomes, eps, pressure, seconds, None if estimator is None else estimator.bound())

    def _flow(self) -> dict[str, Any]:
        """The Peclet number, where a scene has drift."""
        problem = self.problem
        for effect in problem.scene.effects:
            if effect.key == "drift":
                from fenicsx_obstacle.discrete.flow import peclet  # only where a scene names it

                return {"peclet": peclet(problem.data, effect)}
        return {}

    def _chain(self) -> list[Problem]:
        """Problems of all levels, kept like the problem of the finest (first use is collective)."""
        if self._problems is None:
            start = time.perf_counter()
            self._problems = chain(self.problem)
            self.setup_seconds += time.perf_counter() - start
        return self._problems

    def _hierarchy(self) -> list[Multigrid]:
        """Problems and multigrid of all levels, kept like the problem of the finest (first use is collective)."""
        if self._grids is None:
            start = time.perf_counter()
            self._grids = multigrid.chain(chain(self.problem))
            self.setup_seconds += time.perf_counter() - start
        return self._grids

    def _answer(
        self,
        scene: Scene,
        outcomes: list[Outcome],
        eps: float | None,
        p: np.ndarray,
        seconds: float,
        bound: Bound | None,
    ) -> Answer:
        outcome = outcomes[-1]
        problem, level = self.problem, self.problem.level
        contact = contact_of(problem, p)
        u = problem.heights()
        pressure = in_q(level, p * problem.thickness)
        touching = in_q(level, (contact.lower | contact.upper).astype(float))
        errors: dict[str, Any] = {} if self.exact is None else {"errors": self.exact.errors(u, pressure, eps)}
        state = problem.state()
        energy = problem.energy(state, penalised=eps is not None) if problem.has_energy else None
        state.destroy()
        seconds += self.setup_seconds
        method = scene.tables.solve.method
        sides = {"lower": (problem.below, contact.lower_force), "upper": (problem.above, contact.upper_force)}
        record = {
            "scene": scene.name, "title": scene.tables.title, "method": method,
            **({"m_matrix": problem.m_matrix} if method == "successive" else {}),
            "element": scene.pair.name, "ranks": level.comm.size,
            "cells": None if level.shape is None else level.shape.cells[0], "refine": scene.tables.mesh.refine,
            "cells_total": level.cells, "dofs": level.dofs,
            "free": int(total(level.comm, np.count_nonzero(~problem.fixed))),
            "h": level.h, "h_max": level.h_max, "eps": eps,
            **self._flow(), "converged": outcome.converged, "reason": "CONVERGED_FNORM_ABS",
            "newton_iterations": outcome.iterations, "krylov_iterations": outcome.krylov,
            "newton_total": sum(o.iterations for o in outcomes), "krylov_total": sum(o.krylov for o in outcomes),
            "seconds": {"total": time.perf_counter() - self.started, "mesh": self.mesh_seconds, "solve": seconds},
            "poisson_seconds": self._poisson,
            "poisson_units": None if self._poisson is None else seconds / self._poisson,
            "memory_mb": peak_memory_mb(level.comm), "energy": energy, **errors,
            "penetration": contact.penetration,
            "u_range": largest(level.comm, u.x.array) - smallest(level.comm, u.x.array),
            "contact": {"area": contact.area, **{k: {"force": f} for k, (g, f) in sides.items() if g is not None}},
            "versions": versions(), "command": command(level.comm.size),
        }  # fmt: skip
        if problem.constrained and problem.affine and level.pair.nodal:
            record["round_off"] = round_off(problem, p, eps)
        if bound is not None:
            true = record.get("errors", {}).get("energy")
            record["bound"] = {**bound.record, "effectivity": bound.total / true if true else None}
            if eps is not None and (problem.below is None) != (problem.above is None):
                # u_eps - eps max|p_eps| <= u_h <= u_eps at every node, mirrored for a lower obstacle
                width = eps * largest(level.comm, np.abs(p))
                record["enclosure"] = {"width": width, "guaranteed": problem.m_matrix}
        if self._report is not None:
            record["report"] = self._report.evaluate(u, pressure, touching, problem.elastic.array_r)
        error = None
        if self.exact is not None:
            error = fem.Function(level.V)
            error.x.array[:] = u.x.array - self.exact.nodal(eps)
        data = problem.data
        shown = (None, None) if data.thin else (data.lower, data.upper)
        # clocks differ between ranks: rank 0 speaks for all
        record, history = level.comm.bcast((record, outcome.history))
        return Answer(
            scene, level, u, pressure, touching, *shown, error, history, record, bound,
        )  # fmt: skip


def command(ranks: int) -> str:
    """The command that this process runs, as one types it."""
    program, *arguments = sys.argv
    if program.endswith(("__main__.py", "fenicsx-obstacle")):
        words = ["./obstacle", *(["--ranks", str(ranks)] if ranks > 1 else []), *arguments]
    else:
        words = [*(["mpirun", "-n", str(ranks)] if ranks > 1 else []), "python3", program, *arguments]
    return shlex.join(words)


def versions() -> dict[str, str]:
    """Versions that figures depend on."""
    from importlib.metadata import version

    petsc = ".".join(str(part) for part in PETSc.Sys.getVersion())
    return {"fenicsx_obstacle": version("fenicsx_obstacle"), "dolfinx": dolfinx.__version__, "petsc": petsc}

"""Solves scenes with an elastic body: mesh, ObstacleProblem, output quantities."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.time_history import Frame, TimeHistory, at_time
from fenicsx_obstacle.discrete.levels import Level, with_parts
from fenicsx_obstacle.discrete.time_discretization import TimeDiscretization
from fenicsx_obstacle.fields.vector import VectorFields
from fenicsx_obstacle.io.folder import frame_of
from fenicsx_obstacle.problems.solution import Solution
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.bodies import Body
from fenicsx_obstacle.scenes.body_report import BodyReport, contact_quantities, contact_remarks
from fenicsx_obstacle.scenes.profiles import check_profiles
from fenicsx_obstacle.scenes.scene import Scene

SAME_FORCE = 1e-6  # relative: of moments whose contact forces differ less, the last one is shown


class BodyContext:
    """Mesh and ObstacleProblem of a scene with an elastic body, for several solves that differ in their options only.

    Attributes:
        scene: What is solved.
        body: The problem on the mesh.
    """

    exact = None

    def __init__(self, scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD, level: Level | None = None):
        """Assemble (collective).

        Args:
            scene: What to solve.
            comm: Communicator; not used if the scene has a DOLFINx mesh.
            level: The scene's mesh, where it is made already.
        """
        self.scene, started = scene, time.perf_counter()
        if level is None:
            level = meshes.build(scene, scene.mesh.comm if scene.mesh is not None else comm)
        self.mesh_seconds = time.perf_counter() - started
        self.body = Body(scene.model, level)
        self._report = BodyReport(self.body, scene)
        self._report.check()
        check_profiles(scene, self.body.level)
        self.setup_seconds = time.perf_counter() - started - self.mesh_seconds

    def renewed(self, scene: Scene) -> BodyContext:
        """The same mesh with other data, and this solution as the start (collective)."""
        level, u_values = self.body.level, self.body.u.x.array.copy()
        self.close()
        new = BodyContext(scene, level.comm, level)
        new.body.u.x.array[:] = u_values
        return new

    def close(self) -> None:
        """Free matrices and solvers; answers stay (collective)."""
        del self.body, self._report

    def answer(self, options: SolverOptions | None = None) -> Answer:
        """Solve, from the last solution of the ObstacleProblem (collective).

        Args:
            options: How; by default as the scene says.

        Raises:
            InputError: For a bad eps, or displacements that are not small.
            NotConverged: With PETSc's reason.
        """
        scene, body, options = self.scene, self.body, options or self.scene.options
        start = time.perf_counter()
        if scene.time is None:
            solution, history, totals = body.solve(options), None, dict[str, Any]()
        else:
            solution, history, totals = self._equilibria(scene.time, options)
        known = contact_quantities(body, solution)
        record = dict(solution.record)
        numbers = {name: value if np.isfinite(value) else None for name, value in known.items()}
        shape, table = body.level.shape, scene.tables
        solve = self.setup_seconds + time.perf_counter() - start
        record |= {
            "scene": scene.name, "title": table.title, "refine": table.mesh.refine, "h": body.level.h,
            "cells": None if shape is None else shape.cells[0],
            "contact": {**record["contact"], **{key: numbers[key] for key in ("half_width", "peak", "approach")}},
            "newton_total": record["newton_iterations"], "krylov_total": record["krylov_iterations"],
            "seconds": {"total": self.mesh_seconds + solve, "mesh": self.mesh_seconds, "solve": solve},
            "poisson_seconds": None, "poisson_units": None, **totals,
        }  # fmt: skip
        if body.level.remarks:
            record["mesh_remarks"] = list(body.level.remarks)
        if remarks := [*record.get("remarks", ()), *body.law.remarks, *contact_remarks(body, solution)]:
            record["remarks"] = remarks
        if scene.report:
            record["report"] = self._report.of(solution, known)
            if self._report.places:
                record["report_places"] = self._report.places
        # clocks differ between ranks: rank 0 speaks for all
        fields = solution.fields
        assert isinstance(fields, VectorFields)
        fields = replace(fields, level=with_parts(fields.level, body.level))
        return Answer(fields, solution.history, body.level.comm.bcast(record), scene=scene.with_options(options),
                      time_history=history)  # fmt: skip

    def _equilibria(
        self, moments: TimeDiscretization, options: SolverOptions
    ) -> tuple[Solution, TimeHistory, dict[str, Any]]:
        """An equilibrium at each time, each from the last one; the solution at the end, all rows, counts (collective).

        The fields of the moment with the largest contact force are kept, whatever other moments are.

        Raises:
            InputError: If data are wrong at some time, with it.
            NotConverged: The same.
        """
        rows, frames = list[dict[str, Any]](), list[Frame]()
        kept = {round(k * moments.steps / max(moments.frames, 1)) for k in range(moments.frames + 1)}
        most, largest, loaded = 0.0, 0.0, None
        for step in range(moments.steps + 1):
            t = moments.end * step / moments.steps
            with at_time(moments, t):
                self.body.go_to(t)
                solution = self.body.solve(options)
            known, record = contact_quantities(self.body, solution), solution.record
            reported = self._report.of(solution, known) if self.scene.report else {}
            rows.append({  # no -0.0
                "step": step, "t": t, "dt": moments.step if step else None, "newton": record["newton_iterations"],
                "krylov": record["krylov_iterations"], "energy": record["energy"],
                "penetration": record["penetration"],
                **{key: float(value) + 0.0 for key, value in known.items() if np.isfinite(value)},
                **{key: None if value is None else value + 0.0 for key, value in reported.items()},
            })  # fmt: skip
            if moments.frames and step in kept:
                frames.append(Frame(t, frame_of(solution.fields)))
            force = float(np.abs(solution.nodes.pressure) @ solution.nodes.areas)
            if force >= (1 - SAME_FORCE) * largest:
                most, largest, loaded = t, force, solution
        if loaded is not None and loaded is not solution and all(frame.t != most for frame in frames):
            frames = sorted([*frames, Frame(most, frame_of(loaded.fields))], key=lambda frame: frame.t)
        times = {"t": t, "name": moments.name, "scheme": moments.scheme, "steps": moments.steps, "rejected": 0,
                 "largest": most}  # fmt: skip
        newton, krylov = (sum(row[key] for row in rows) for key in ("newton", "krylov"))
        counts = {"time": times, "newton_total": newton, "krylov_total": krylov}
        rows = self.body.level.comm.bcast(rows)
        return solution, TimeHistory(tuple(rows), tuple(frames)), counts

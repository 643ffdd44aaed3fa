"""Solves scenes with an elastic body: mesh, ObstacleProblem, output quantities."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.profiles import check_profiles
from fenicsx_obstacle.data.time_discretization import TimeDiscretization
from fenicsx_obstacle.effects.boundary.obstacle import HERTZ
from fenicsx_obstacle.fields.contact_table import ContactTable
from fenicsx_obstacle.fields.vector import VectorFields
from fenicsx_obstacle.mesh.levels import Level, with_parts
from fenicsx_obstacle.problems.solution import Solution
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.bodies import Body, Facing, part_of
from fenicsx_obstacle.scenes.functionals import Report
from fenicsx_obstacle.scenes.report import BODY_QUANTITIES
from fenicsx_obstacle.scenes.scene import Scene

if TYPE_CHECKING:
    from fenicsx_obstacle.answers.time_history import TimeHistory

SAME_FORCE = 1e-6  # relative: of moments whose contact forces differ less, the last one is shown
MIN_NODES_ACROSS = 3  # in contact: with fewer the pressure has no shape, and the width is that of the cells
LOADED = 1e-9  # of the largest pressure: a node with more is in contact
SAME_PLACE = 1e-6  # of the width: nodes so near each other are at one place across the contact
SAME_ROW = 0.25  # the same in space, of the root of the area of a node
INNER = 0.9  # of the half-width: the pressure at its edge says little about the peak


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
        started = time.perf_counter()
        if level is None:
            level = meshes.build(scene, comm)
            scene = scene.with_pair(level.pair)
        self.scene = scene
        self.mesh_seconds = time.perf_counter() - started
        self.body = Body(scene.model, level)
        self._report = Report(self.body.data, scene)
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
        if remarks := [*record.get("remarks", ()), *body.law.remarks, *contact_remarks(body, known)]:
            record["remarks"] = remarks
        if scene.report:
            record |= {"report": self._reported(solution, known), **self._report.extremes}
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
        # only where a scene has time
        from fenicsx_obstacle.answers.time_history import Course, Frame, at_time
        from fenicsx_obstacle.io.folder import frame_of

        course = Course(moments)
        t: float | None = 0.0
        most, largest, loaded = 0.0, 0.0, None
        while t is not None:
            with at_time(moments, t):
                self.body.go_to(t)
                solution = self.body.solve(options)
            known, record = contact_quantities(self.body, solution), solution.record
            figures = {"energy": record["energy"], "penetration": record["penetration"],
                       **{key: value for key, value in known.items() if np.isfinite(value)},
                       **self._reported(solution, known)}  # fmt: skip
            figures = {key: None if value is None else float(value) + 0.0 for key, value in figures.items()}  # no -0.0
            counts = record["newton_iterations"], record["krylov_iterations"]
            course.add(t, counts, figures, partial(frame_of, solution.fields))
            force = float(np.abs(solution.nodes.pressure) @ solution.nodes.areas)
            if force >= (1 - SAME_FORCE) * largest:
                most, largest, loaded = t, max(force, largest), solution
            t = course.following(moments.step)
        if loaded is not None and loaded is not solution and all(frame.t != most for frame in course.frames):
            course.frames = sorted([*course.frames, Frame(most, frame_of(loaded.fields))], key=lambda frame: frame.t)
        newton, krylov = (sum(row[key] for row in course.rows) for key in ("newton", "krylov"))
        totals = {"time": {**course.record, "largest": most}, "newton_total": newton, "krylov_total": krylov}
        course.rows = self.body.level.comm.bcast(course.rows)
        return solution, course.history, totals

    def _reported(self, solution: Solution, known: Mapping[str, float]) -> dict[str, float | None]:
        """The output quantities of [report] (collective)."""
        found = solution.functions()
        parts = {f"u_{axis}": found[f"u{k}"] for k, axis in enumerate("xyz") if f"u{k}" in found}
        fields = {**parts, "p": solution.pressure, "contact": solution.contact}
        if solution.von_mises is not None:
            fields["von_mises"] = solution.von_mises
        return self._report.evaluate(fields, known=known)


def contact_quantities(body: Body, solution: Solution) -> dict[str, float]:
    """Numbers of the contact by their names in [report]; those that a body does not have are not-a-number.

    half_width and peak are those of the first sphere or cylinder: the half-width by the second moment of the pressure
    about its centre, for a pressure of Hertz's shape; the peak by a fit of p^2, linear in the square of the distance
    from the centre. Both are not-a-number if the contact has fewer than `MIN_NODES_ACROSS` nodes across. Other
    obstacles have the largest pressure as peak.
    """
    nodes, found = solution.nodes, dict.fromkeys(BODY_QUANTITIES, np.nan)
    moment = np.atleast_1d(nodes.moment())
    found |= {f"force_{axis}": float(x) for axis, x in zip("xyz", nodes.resultant, strict=False)}
    names = ("moment",) if len(moment) == 1 else ("moment_x", "moment_y", "moment_z")
    found |= {name: float(x) for name, x in zip(names, moment, strict=True)}
    found |= {"contact_area": solution.area, "peak": float(nodes.pressure.max(initial=0.0))}
    round_one = _round(body)
    if round_one is not None:
        found["half_width"], found["peak"] = _hertzian(round_one, part_of(round_one, nodes))
    moved = body.pressing or next((one for one in body.facing if one.obstacle.moves), None)
    if moved is not None:
        found["approach"] = float(moved.travel.value)
    return found


def contact_remarks(body: Body, known: Mapping[str, float]) -> tuple[str, ...]:
    """What the user should know of the contact with these numbers, in words."""
    one = _round(body)
    if one is None or not np.isnan(known["half_width"]):
        return ()
    return (
        f"the contact with the {one.obstacle.kind} has fewer than {MIN_NODES_ACROSS} nodes across: it is narrower than "
        "the cells, so that half-width and peak are not known; take smaller cells there ([mesh] cells or refine, or "
        "a mesh graded towards the contact)",
    )


def _round(body: Body) -> Facing | None:
    """The first sphere or cylinder."""
    return next((one for one in body.facing if one.obstacle.kind in HERTZ), None)


def _hertzian(one: Facing, nodes: ContactTable) -> tuple[float, float]:
    """Half-width and peak of the pressure below a sphere or a cylinder; 0 without contact, not-a-number if too few
    nodes are in contact."""
    forces = nodes.pressure * nodes.areas
    if not forces.sum() > 0:
        return 0.0, 0.0
    arms = nodes.points - one.place
    across = [nodes.resultant / np.linalg.norm(nodes.resultant)]
    across += [np.array(one.obstacle.direction)] if one.obstacle.direction else []
    for unit in across:
        arms = arms - (arms @ unit)[:, None] * unit
    loaded = nodes.pressure > LOADED * nodes.pressure.max()
    if _nodes_across(arms[loaded], nodes.areas[loaded], arms.shape[1] - len(across)) < MIN_NODES_ACROSS:
        return np.nan, np.nan
    square = (arms**2).sum(axis=1)
    half_width = float(np.sqrt(HERTZ[one.obstacle.kind] * (forces @ square) / forces.sum()))
    peak = float(nodes.pressure.max())
    inner = square < (INNER * half_width) ** 2
    if np.count_nonzero(inner) > 2:
        peak = float(np.sqrt(max(np.polyfit(square[inner], nodes.pressure[inner] ** 2, 1)[1], 0.0)))
    return half_width, peak


def _nodes_across(arms: np.ndarray, areas: np.ndarray, dim: int) -> int:
    """How many nodes in contact lie side by side, in the direction where they are fewest.

    Nodes on one side of the centre only are those of one half of a symmetric contact: they count with their mirror
    images.

    Args:
        arms: Positions of the nodes from the centre, shape (nodes, gdim).
        areas: Of the nodes.
        dim: Of the space that contains the arms: 1 or 2.
    """
    tolerance = SAME_PLACE * float(np.linalg.norm(arms, axis=1).max())
    if arms.shape[1] == 3:
        tolerance = max(tolerance, SAME_ROW * float(np.sqrt(areas.mean())))
    counts = []
    for unit in np.linalg.eigh(arms.T @ arms)[1].T[-dim:]:
        places, count, last = np.sort(arms @ unit), 0, -np.inf
        for place in places:
            if place - last > tolerance:
                count, last = count + 1, place
        if places[0] >= -tolerance or places[-1] <= tolerance:
            at_centre = np.abs(places).min() <= tolerance
            count = 2 * count - int(at_centre)
        counts.append(count)
    return min(counts)

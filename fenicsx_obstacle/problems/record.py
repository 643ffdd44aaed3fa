"""The record of a solution: output quantities, counts, times."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.penalty_parameter import large_penetration
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.data.measured.surface import MeasuredField
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.estimation.round_off import round_off
from fenicsx_obstacle.origin import command, versions
from fenicsx_obstacle.parallel import largest, peak_memory_mb, smallest, total
from fenicsx_obstacle.problems.solve import State

COARSE = 1.5  # distance of nodes over that of measured data from which on the mesh is said to be too coarse


def record_of(
    problem: Problem,
    method: str,
    outcome: Outcome,
    state: State,
    started: float,
) -> dict[str, Any]:
    """Description of the problem, output quantities of its solution, counts, times and memory (collective).

    Args:
        problem: Just solved.
        method: By which method.
        outcome: Of the iteration.
        state: What came out.
        started: When it began, by `time.perf_counter`.
    """
    level, contact, eps, u = problem.level, state.contact, outcome.eps, state.fields.u.x.array
    peclet = {} if problem.drift is None else {"peclet": problem.drift.number}
    figures: dict[str, Any] = {
        "scene": "", "title": "", "method": method,
        **({"m_matrix": problem.m_matrix} if method == "successive" else {}),
        "element": level.pair.name, "ranks": level.comm.size,
        "cells": None if level.shape is None else level.shape.cells[0], "refine": 0,
        "cells_total": level.cells, "dofs": level.dofs,
        "free": int(total(level.comm, np.count_nonzero(~problem.fixed))),
        "h": level.h, "h_max": level.h_max, "eps": eps, **peclet, "energy": state.energy,
        "penetration": contact.penetration,
        "u_range": largest(level.comm, u) - smallest(level.comm, u),
        "contact": {"area": contact.area, **{side: {"force": f} for side, f in state.sides(problem).items()}},
    }  # fmt: skip
    if remarks := [*level.remarks, *_too_coarse(problem)]:
        figures["mesh_remarks"] = remarks
    if eps is not None and (large := large_penetration(problem)) is not None:
        figures["remarks"] = [large]
    if _may_jump(problem):
        from fenicsx_obstacle.estimation.edges import boundary_jump  # only where a scene has such values

        if (jump := boundary_jump(problem.data)) is not None:
            figures["boundary_jump"] = jump
    if problem.constrained and problem.affine and level.pair.nodal and problem.model.time is None:
        figures["round_off"] = round_off(problem, contact.pressure, eps)
    spent = time.perf_counter() - started
    return {
        **figures, "converged": outcome.converged, "reason": "CONVERGED_FNORM_ABS",
        "newton_iterations": outcome.iterations, "krylov_iterations": outcome.krylov,
        "seconds": {"total": spent, "mesh": 0.0, "solve": spent},
        "memory_mb": peak_memory_mb(level.comm), "versions": versions(), "command": command(level.comm.size),
    }  # fmt: skip


def _may_jump(problem: Problem) -> bool:
    """Whether boundary values are others than one number, on plane triangles without time."""
    model, mesh = problem.model, problem.level.mesh
    values = [part.value for part in model.boundary if part.value is not None]
    numbers = {float(value.at(np.zeros((3, 1)), {})[0]) for value in values if value.uniform and not value.moves}
    plane = releases.cell_name(mesh) == "triangle" and mesh.geometry.dim == 2
    return plane and model.time is None and (len(numbers) > 1 or any(not value.uniform for value in values))


def _too_coarse(problem: Problem) -> list[str]:
    """Remarks about measured data that the mesh does not resolve."""
    level = problem.level
    h, found = level.h / level.pair.degree, []
    for datum in problem.model.data:
        if isinstance(datum, MeasuredField) and h > COARSE * datum.spacing:
            times = f"{h / datum.spacing:.2g} times as far apart as the data, {h:.3g} for {datum.spacing:.3g}"
            found.append(f"nodes are {times}: data between them are not resolved ({datum.source})")
    return found

"""The figures of an answer that say what was solved, and what came out; how long it took is not among them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.state import State
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.estimation.norms import Exact
from fenicsx_obstacle.estimation.round_off import round_off
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.solvers.options import SolverOptions


def figures_of(
    problem: Problem, scene: Scene, options: SolverOptions, eps: float | None, state: State
) -> dict[str, Any]:
    """Part of answer.json (collective).

    Args:
        problem: Just solved.
        scene: Its scene.
        options: That it was solved with.
        eps: Penalty parameter, or None.
        state: What came out.
    """
    level, asked, contact = problem.level, options.method, state.contact
    figures: dict[str, Any] = {
        "scene": scene.name, "title": scene.tables.title, "method": asked,
        **({"m_matrix": problem.m_matrix} if asked == "successive" else {}),
        "element": scene.pair.name, "ranks": level.comm.size,
        "cells": None if level.shape is None else level.shape.cells[0], "refine": scene.tables.mesh.refine,
        "cells_total": level.cells, "dofs": level.dofs,
        "free": int(total(level.comm, np.count_nonzero(~problem.fixed))),
        "h": level.h, "h_max": level.h_max, "eps": eps, **_of_effects(problem), "energy": state.energy,
        "penetration": contact.penetration,
        "u_range": largest(level.comm, state.u.x.array) - smallest(level.comm, state.u.x.array),
        "contact": {"area": contact.area, **{side: {"force": f} for side, f in state.sides(problem).items()}},
    }  # fmt: skip
    if level.remarks:
        figures["mesh_remarks"] = list(level.remarks)
    if _may_jump(problem):
        from fenicsx_obstacle.estimation.edges import boundary_jump  # only where a scene has such values

        if (jump := boundary_jump(problem.data)) is not None:
            figures["boundary_jump"] = jump
    if problem.constrained and problem.affine and level.pair.nodal and scene.time is None:
        figures["round_off"] = round_off(problem, state.p, eps)
    return figures


def with_errors(answer: Answer, exact: Exact) -> Answer:
    """The answer with its errors, and with the effectivity of its bound (collective).

    Raises:
        InputError: If the exact solution is not a number somewhere.
    """
    eps = answer.record["eps"]
    record: dict[str, Any] = {**answer.record, "errors": exact.errors(answer.u, answer.pressure, eps)}
    if answer.bound is not None and record["errors"]["energy"] > 0:
        record["bound"] = {**record["bound"], "effectivity": answer.bound.total / record["errors"]["energy"]}
    error = fem.Function(answer.level.V)
    error.x.array[:] = answer.u.x.array - exact.nodal(eps)
    return replace(answer, record=record, error=error)


def _may_jump(problem: Problem) -> bool:
    """Whether boundary values are others than one number, on plane triangles without time."""
    model, mesh = problem.model, problem.level.mesh
    values = [part.value for part in model.boundary if part.value is not None]
    numbers = {float(value.at(np.zeros((3, 1)), {})[0]) for value in values if value.uniform and not value.moves}
    plane = releases.cell_name(mesh) == "triangle" and mesh.geometry.dim == 2
    return plane and model.time is None and (len(numbers) > 1 or any(not value.uniform for value in values))


def _of_effects(problem: Problem) -> dict[str, float]:
    """Those that belong to effects (collective)."""
    outputs = (effect.outputs(problem.data) for effect in problem.model.effects)
    return {name: value for found in outputs for name, value in found.items()}

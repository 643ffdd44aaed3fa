"""The active set of each Newton step on all levels, from a second solve; for animations."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from fenicsx_obstacle.algebra.stopping import Step
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.fields.scalar import Fields
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.scenes.scene import Scene


@dataclass(frozen=True, eq=False)
class Iterate:
    """The state of a solver after a step.

    Attributes:
        step: Its figures.
        number: Steps on this mesh so far; 0 is the start.
        dofs: Unknowns of the mesh.
        mesh: Its `points` and `cells` as `gather` has them, one object for all steps on it; on rank 0, empty elsewhere.
        contact: Whether the points of the mesh are in contact, shape (n,); on rank 0, empty elsewhere.
    """

    step: Step
    number: int
    dofs: int
    mesh: Mapping[str, np.ndarray]
    contact: np.ndarray


def iterates(scene: Scene, level: Level) -> list[Iterate]:
    """All steps of a solve on a mesh and the levels below it (collective).

    Args:
        scene: At rest.
        level: Its mesh.

    Raises:
        NotConverged: With PETSc's reason.
    """
    found: list[Iterate] = []

    def monitor(problem: System, step: Step, active: np.ndarray) -> None:
        assert isinstance(problem, Problem)
        contact = problem.in_q((active != 0).astype(float))
        arrays = gather(Fields(problem.level, problem.solution(), contact, contact))
        dofs = problem.level.dofs
        before = found[-1] if found and found[-1].dofs == dofs else None
        touching = arrays.pop("contact", np.empty(0)) > 0.5
        if before is None:
            mesh = {name: values for name, values in arrays.items() if name in ("points", "cells")}
            found.append(Iterate(step, 0, dofs, mesh, touching))
        else:
            found.append(replace(before, step=step, number=before.number + 1, contact=touching))

    with closing(SolverContext(scene, level=level)) as context:
        context.answer(monitor=monitor)
    return found

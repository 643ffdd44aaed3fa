"""Animation of the active sets of Newton's method and of the paper's (3.4)*. Rank 0 draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.algebra.stopping import Step
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import NotConverged
from fenicsx_obstacle.fields.scalar import Fields
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show.figures import BLUE, figure, heading, legend_below, write_gif
from fenicsx_obstacle.show.free_boundary import Patch, free_boundary, patch_of
from fenicsx_obstacle.show.maps import draw_domain, draw_lines, triangles
from fenicsx_obstacle.text import counted, title_of

PER_SECOND = 2  # steps
REST = 4  # frames that the end stays
KEPT, LEFT, ENTERED = BLUE, "#F0B27A", "#009E73"  # told apart by colour-blind readers, and by lightness

Arrays = Mapping[str, np.ndarray]


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


def animate_newton(answer: Answer, path: Path) -> str:
    """Solve once more for the steps, by (3.4)* and by the answer's own method, and draw them as a GIF (collective).

    Returns:
        One line: what is drawn, or why nothing is.
    """
    comm, scene, options = answer.level.comm, answer.scene, answer.scene.options
    arrays = gather(answer.fields)
    flat = answer.level.mesh.topology.dim == 2 == answer.level.mesh.geometry.dim
    if not flat or scene.time is not None or (answer.lower is None and answer.upper is None):
        return f"{path.name} is for stationary plane problems: not drawn"
    if answer.record["eps"] is not None:  # the one that was chosen
        options = replace(options, eps=answer.record["eps"])
    courses, failed = dict[str, list[Iterate]](), ""
    for method in dict.fromkeys(("successive", options.method)):
        try:
            courses[method] = iterates(scene.with_options(replace(options, method=method)), answer.level)
        except NotConverged as error:  # (3.4)* where the theory does not hold
            failed = f"; {method}: {error}"
    return on_root(comm, _animate, answer, arrays, courses, path) + failed


def _animate(answer: Answer, arrays: Arrays, courses: Mapping[str, Sequence[Iterate]], path: Path) -> str:
    patch = patch_of(arrays)
    line = free_boundary(patch)
    page, axes = figure(4.9 * len(courses), 5.6, columns=len(courses))
    panels = np.atleast_1d(axes)
    names = [_name(method, steps) for method, steps in courses.items()]
    colours = {"in contact": KEPT, "left in this step": LEFT, "entered": ENTERED}
    swatches = {label: {"facecolor": colour} for label, colour in colours.items()}
    legend_below(page, swatches, "final free boundary" if line else "")
    eps = answer.record["eps"]
    title = heading(title_of(answer.scene.tables.title, answer.scene.name))
    page.suptitle(title if eps is None else f"{title}, eps = {eps:.2g}", fontsize=12)

    def draw(frame: int) -> None:
        for axis, name, steps in zip(panels, names, courses.values(), strict=True):
            _draw(axis, patch, name, steps, min(frame, len(steps) - 1))
            draw_lines(axis, line)

    count = max(len(steps) for steps in courses.values())
    write_gif(page, path, PER_SECOND, [*range(count), *[count - 1] * REST], draw)
    return f"{path}: " + "; ".join(
        f"{name}: {counted(steps[-1].number, 'step')}" for name, steps in zip(names, courses.values(), strict=True)
    )


def _draw(axis: Any, patch: Patch, name: str, steps: Sequence[Iterate], number: int) -> None:
    """The active set of one step, and what has changed since the last."""
    now = steps[number]
    before = steps[number - 1].contact if now.number else now.contact
    axis.clear()
    draw_domain(axis, patch)
    shown = triangles(now.mesh["points"], now.mesh["cells"])
    for nodes, colour in ((now.contact | before, LEFT), (now.contact, ENTERED), (now.contact & before, KEPT)):
        if nodes.any():
            axis.tricontourf(shown, nodes.astype(float), levels=[0.5, 1.5], colors=[colour], zorder=1)
    axis.set(xticks=[], yticks=[], frame_on=False)
    what = f"step {now.number}: {now.step.changed} nodes changed" if now.number else "start"
    title = f"{name}\n{counted(now.dofs, 'node')}, {what}, {now.step.active} in contact"
    axis.set_title(title, fontsize=9.5, linespacing=1.4)


def _name(method: str, steps: Sequence[Iterate]) -> str:
    if method == "successive":
        return "(3.4)*, from no contact"
    solver = {"penalty": "Newton", "vi": "SNES VI"}[method]
    levels = len({one.dofs for one in steps})
    return f"{solver}, from {counted(levels - 1, 'coarser level')}" if levels > 1 else f"{solver}, cold"

"""All hard scenes of the plane in one picture: u, the contact set, and the verdict that a run of `hard` gave."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from fenicsx_obstacle import InputError, NotConverged, checkout
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.show.figures import figure
from fenicsx_obstacle.show.free_boundary import Patch, patch_of
from fenicsx_obstacle.show.maps import draw_domain, triangles

checkout.add_tests("the mosaic")
from tests.hard.cases import Case, cases  # noqa: E402

COLUMNS = 12
BANDS = 10  # of heights
INKS = {"right": "#0072B2", "rejected": "#7A7A7A", "FAILED": "#D55E00"}
MARKS = {"right": "\N{CHECK MARK}", "rejected": "\N{MULTIPLICATION X}", "FAILED": ""}


def mosaic(rows: Sequence[Mapping[str, Any]]) -> Any:
    """A small picture for each scene in these rows that lies in a plane.

    Args:
        rows: Of hard.jsonl.
    """
    judged = {row["case"]: set[str]() for row in rows}
    for row in rows:
        judged[row["case"]].add(row["verdict"])
    shown = [(one, patch) for one in cases() if one.name in judged and (patch := drawn(one)) is not False]
    lines = -(-len(shown) // COLUMNS)
    page, grid = figure(15.0, 1.48 * lines + 0.4, rows=lines, columns=COLUMNS)
    panels = np.atleast_1d(grid).ravel()
    for axes, (one, patch) in zip(panels, shown, strict=False):
        verdict = verdict_of(judged[one.name])
        if (patch is None) != (verdict == "rejected"):
            raise RuntimeError(f"{one.name}: {verdict} in the file, but not so here: a file of another version?")
        if patch is None:
            axes.text(0.5, 0.5, "no solution:\nrejected", ha="center", va="center", fontsize=8, color=INKS[verdict])
            axes.set_box_aspect(1)
        else:
            draw(axes, patch)
        axes.set_xlabel(f"{one.name} {MARKS[verdict] or verdict}", fontsize=7, color=INKS[verdict], labelpad=2)
    count = Counter(verdict_of(judged[one.name]) for one, _ in shown)
    words = ", ".join(f"{count[verdict]} {verdict} {mark}".strip() for verdict, mark in MARKS.items() if count[verdict])
    page.suptitle(f"{len(shown)} hard scenes of the plane: {words}", fontsize=12)
    for axes in panels:
        axes.set(xticks=[], yticks=[])
        axes.set_frame_on(False)
    return page


def verdict_of(found: set[str]) -> str:
    """Of all rows of a scene."""
    return next(verdict for verdict in ("FAILED", "right", "rejected") if verdict in found)


def drawn(one: Case) -> Any:
    """The answer on the coarse mesh as a patch; None where the scene is rejected, False where it is of no plane."""
    scene = one.on(0)
    try:
        with closing(SolverContext(scene)) as context:
            mesh = context.problem.level.mesh
            if mesh.topology.dim != 2 or mesh.geometry.dim != 2:
                return False
            return patch_of(gather(context.answer().fields))
    except (InputError, NotConverged):
        return None


def draw(axes: Any, patch: Patch) -> None:
    """u in bands of colours, contact with a lower or an upper obstacle over it."""
    u, contact, p = (patch.fields[name] for name in ("u", "contact", "pressure"))
    shape = triangles(patch.points, patch.cells)
    axes.tricontourf(shape, u, levels=BANDS, cmap="Greys", vmin=u.min() - 0.3 * np.ptp(u), vmax=u.max() + np.ptp(u))
    for colour, here in (("#E69F00", (contact > 0.5) & (p >= 0)), ("#56B4E9", (contact > 0.5) & (p < 0))):
        if here.any():
            axes.tricontourf(shape, here.astype(float), levels=[0.5, 1.5], colors=[colour])
            if not here.all():
                axes.tricontour(shape, here.astype(float), levels=[0.5], colors="black", linewidths=0.6)
    draw_domain(axes, patch)
    axes.set_aspect("auto")
    axes.set_box_aspect(1)

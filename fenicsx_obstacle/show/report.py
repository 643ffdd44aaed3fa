"""Files in the folder of an answer for people: the free boundary, pictures, tables of profiles, a page."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.fields.cut import OnNodes, global_dofs
from fenicsx_obstacle.fields.scalar import Fields
from fenicsx_obstacle.io.folder import STEPS, gather, write_record
from fenicsx_obstacle.origin import program
from fenicsx_obstacle.parallel import gathered, largest, on_root, peak_memory_mb, smallest
from fenicsx_obstacle.safe_writing import write_text
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show.explain import explained
from fenicsx_obstacle.show.free_boundary import RINGS, SIDES, Patch, free_boundary, pressed, with_levels
from fenicsx_obstacle.show.template import filled
from fenicsx_obstacle.text import title_of

PAGE, PICTURE = "report.html", "answer.png"
BOUND = "bound.png"
EARLIER = (BOUND, "history.png", "answer.gif")  # where there is a bound, and a course in time


def report_answer(
    answer: Answer, folder: Path, *, picture: bool, newton: bool = False, started: float | None = None
) -> tuple[Answer, str]:
    """Write free_boundary.csv, the page and, if asked for, the picture of an answer into its folder (collective).

    Args:
        answer: That was saved in the folder.
        folder: Of the answer.
        picture: Whether to draw it; otherwise a picture that an earlier answer left there is removed.
        newton: Whether to draw the way to the answer as well.
        started: `time.perf_counter()` at the beginning of a command: page and answer.json get its seconds and its
            memory. None leaves the record as it is.

    Returns:
        The answer with these values in its record; and one line: who drew it, and why, or how to draw it.

    Raises:
        InputError: If the folder cannot be written.
    """
    comm = answer.level.comm
    of_body = answer.scene.model.vector_valued  # which has nodes.csv instead of a free boundary
    if of_body:
        on_root(comm, (folder / "free_boundary.csv").unlink, True)
    else:
        write_free_boundary(answer.fields, folder / "free_boundary.csv")
    on_root(comm, _remove_earlier, folder)
    file = folder / PICTURE if picture and has_picture(answer) else None
    others = dict[str, Path]()
    if file is not None:
        said = answer.plot(file).said
        if answer.bound is not None and answer.bound.indicator is not None:  # which is not saved
            from fenicsx_obstacle.show.maps import draw_bound  # only where there is a bound

            indicator = gathered(comm, answer.bound.indicator)
            words = on_root(comm, draw_bound, indicator, gather(answer.fields), answer.bound, folder / BOUND)
            said += f"\n  {words}"
            others["Contribution of each cell to the bound"] = folder / BOUND
    else:
        said = f"{folder}: a network of intervals has no picture" if picture else f"{program()} plot {folder} draws it"
    if newton:
        from fenicsx_obstacle.show.newton import animate_newton  # only if requested

        said += "\n  " + animate_newton(answer, folder / STEPS)
        others["Newton steps"] = folder / STEPS
    drawn = dict[str, Path]()
    if answer.scene.tables.profile:
        from fenicsx_obstacle.show.profiles import draw_profiles  # only where a scene names one

        drawn = draw_profiles(answer, folder)
    moving = None
    if answer.time_history is not None:
        from fenicsx_obstacle.show.time_history import draw_course  # only where a scene has time

        moving, words = on_root(comm, draw_course, answer, gather(answer.fields), folder, picture)
        said += words
    if started is not None:
        seconds = {**answer.record["seconds"], "total": time.perf_counter() - started}
        spent = {"seconds": comm.bcast(seconds), "memory_mb": peak_memory_mb(comm)}
        answer = replace(answer, record={**answer.record, **spent})
        on_root(comm, write_record, folder, answer.record)
    record = answer.record
    on_root(comm, partial(
        write_page, folder / PAGE, "answer", answer.scene, record["versions"], record["command"],
        record=record, picture=file, time_history=moving, profiles=drawn, others=others,
    ))  # fmt: skip
    return answer, said


def write_page(path: Path, kind: str, scene: Scene, versions: Mapping[str, str], command: str, **values: Any) -> None:
    """Write the page of a result: one file, which fetches nothing, needs no JavaScript, and prints (one rank).

    Args:
        path: The file.
        kind: `answer`, `study` or `cost`: its template.
        scene: What was solved.
        versions: Of the program and its libraries.
        command: What made it.
        **values: Further ones, which the template names.
    """
    title = title_of(scene.tables.title, scene.name)
    write_text(path, filled(f"{kind}.html", title=title, scene=scene, explained=explained(scene), versions=versions,
                            command=command, **values))  # fmt: skip


def _remove_earlier(folder: Path) -> None:
    """Remove what an earlier answer has drawn: nothing of it is left where a new one is not drawn (one rank)."""
    for name in (PICTURE, PAGE, *EARLIER):
        (folder / name).unlink(missing_ok=True)
    for table in folder.glob("profile-*.csv"):
        if table.with_suffix(".png").exists():  # which makes it one of a profile
            table.with_suffix(".png").unlink()
            table.unlink()


def has_picture(answer: Answer) -> bool:
    """Whether pictures can show it: networks of intervals are for ParaView."""
    return answer.level.mesh.topology.dim > 1 or answer.level.mesh.geometry.dim == 1


def write_free_boundary(fields: Fields, path: Path) -> None:
    """Write one line per piece of the free boundary: the coordinates of its ends, or of its corners (collective).

    Raises:
        InputError: If the file cannot be written.
    """
    on_root(fields.level.comm, _write, near_free_boundary(fields), path)


def near_free_boundary(fields: Fields) -> Patch | None:
    """The cells within `RINGS` of a free boundary with their levels, on rank 0; None elsewhere (collective)."""
    shown = fields.on_nodes() or fields.plain.on_nodes()
    assert shown is not None  # plain has the nodes of P1
    level, owned, values = shown.level, shown.level.owned, shown.fields
    sides = [side for side in SIDES if side in values]
    range_of_u = largest(level.comm, values["u"][:owned]) - smallest(level.comm, values["u"][:owned])
    near, nodes = _near(shown, [pressed(values, side) for side in sides])
    rows = np.flatnonzero(nodes[:owned])
    parts: dict[str, np.ndarray] = {
        "numbers": global_dofs(level, rows),
        "cells": global_dofs(level, shown.cells[near]),
        "points": level.points.T[rows],
        **{name: values[name][rows] for name in ("u", "pressure", "contact", *sides)},
    }
    found = {name: gathered(level.comm, part) for name, part in parts.items()}
    whole = {name: part for name, part in found.items() if part is not None}
    if not whole:
        return None
    # owned numbers rise from rank to rank: the nodes stay in their order
    renumbered = np.searchsorted(whole.pop("numbers"), whole.pop("cells"))
    return with_levels(Patch(whole.pop("points"), renumbered, whole), range_of_u)


def _near(shown: OnNodes, touching: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Whether each owned simplex, and each local node of these, is near the edge of a set of nodes (collective).

    Args:
        shown: The simplices.
        touching: Sets of local nodes, ghosts included.
    """
    level, cells = shown.level, shown.cells
    corners = cells.T.astype(np.intp)  # once: indices of another type are converted in each use
    near = np.zeros(len(cells), dtype=bool)
    for nodes in touching:
        inside = [nodes[corner] for corner in corners]
        near |= np.logical_or.reduce(inside) & ~np.logical_and.reduce(inside)
    marked = fem.Function(level.V)
    for _ in range(RINGS + 1):  # cells of nodes that are told to touch lie beside the edge
        marked.x.array[:] = 0.0
        marked.x.array[cells[near]] = 1.0
        releases.add_ghosts(marked)
        marked.x.scatter_forward()
        nodes = marked.x.array > 0
        near = np.logical_or.reduce([nodes[corner] for corner in corners])
    marked.x.array[:] = 0.0
    marked.x.array[cells[near]] = 1.0
    releases.add_ghosts(marked)
    return near, marked.x.array > 0


def _write(patch: Patch, path: Path) -> None:
    lines = free_boundary(patch)
    pieces = [line.points[line.cells].reshape(len(line.cells), -1) for line in lines]
    table = np.concatenate([*pieces, np.empty((0, pieces[0].shape[1] if pieces else 6))])
    heads = [f"{axis}{corner}" for corner in range(1, table.shape[1] // 3 + 1) for axis in "xyz"]
    rows = [",".join(heads), *(",".join(f"{x:.9g}" for x in row) for row in table)]
    write_text(path, "\n".join(rows) + "\n")

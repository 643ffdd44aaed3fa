"""A study as a person sees it: rows as they are computed, files, pictures; and the demo made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.compute import solve
from fenicsx_obstacle.answers.folder import gather
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import on_root, write_text
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show import page, plots
from fenicsx_obstacle.show.boundary import free_boundary
from fenicsx_obstacle.show.figures import save
from fenicsx_obstacle.show.simplices import patch_of
from fenicsx_obstacle.show.tables import EARLIER, StudyTable
from fenicsx_obstacle.studies.convergence import Row, Study
from fenicsx_obstacle.studies.rows import RowStore
from fenicsx_obstacle.studies.theory import quantities

DEMOS = Path(__file__).parent.parent.parent / "demos"
Say = Callable[[str], None]


def report_study(
    scene: Scene,
    vary: Mapping[str, Sequence[Any]],
    options: Mapping[str, Any],
    folder: Path,
    say: Say,
    *,
    fresh: bool = False,
    latex: Path | None = None,
) -> list[Row]:
    """Run a study, or go on with an interrupted one; print, save and draw it (collective).

    Args:
        scene: What to solve.
        vary: Values of each key.
        options: Fixed values.
        folder: Where rows.jsonl, rows.csv, the pictures and the last answer go.
        say: Prints a line on rank 0.
        fresh: Forget the rows that are there.
        latex: File for the table in LaTeX.

    Raises:
        InputError: For bad data or a folder that cannot be written.
        NotConverged: With PETSc's reason; the rows before it are on the disk.
    """
    comm = MPI.COMM_WORLD if scene.mesh is None else scene.mesh.comm
    stores: list[RowStore] = []  # on rank 0 alone: it holds a lock
    run = on_root(comm, _open_store, stores, folder, fresh)
    study = Study(scene, vary, options, comm, stores[0] if stores else None)
    table = StudyTable(study.varied, run)
    answers: list[Answer | None] = []

    def on_row(row: Row, answer: Answer | None) -> None:
        for line in table.lines(row):
            say(line)
        answers[:] = [answer]

    rows = study.run(on_row)
    if any(row["run"] != run for row in rows):
        say(EARLIER)
    if latex is not None:
        on_root(comm, write_text, latex, table.latex())
    last = answers[0] or (None if on_root(comm, _is_drawn, folder, rows[-1]) else study.last_answer())
    if last is not None:
        last.save(folder / "last")
        if answer_has_picture(last):
            say(last.plot(folder / "last" / "answer.png"))
        on_root(comm, write_text, folder / "last" / "row", rows[-1]["key"])
    drawn, plotted = ["last/"], bool(len(rows) > 1 and study.by and quantities(study.varied, rows[-1]))
    if plotted:
        on_root(comm, _draw_plots, rows, study.varied, folder)
        drawn += ["convergence.png", "cost.png"]
    on_root(comm, _study_page, folder, study, rows, table, plotted)
    drawn.append(page.NAME)
    say(f"saved in {folder}: rows.csv, rows.jsonl, {', '.join(drawn)}")
    for store in stores:
        store.close()
    return rows


def _open_store(stores: list[RowStore], folder: Path, fresh: bool) -> int:
    stores.append(RowStore(folder, fresh=fresh))
    return stores[0].run


def _draw_plots(rows: list[Row], varied: list[str], folder: Path) -> None:
    save(plots.convergence(rows, varied), folder / "convergence.png")
    save(plots.cost(rows, varied), folder / "cost.png")


def _is_drawn(folder: Path, row: Row) -> bool:
    """Whether last/ holds the answer of this row."""
    mark = folder / "last" / "row"
    return mark.exists() and mark.read_text() == row["key"]


def _study_page(folder: Path, study: Study, rows: list[Row], table: StudyTable, plotted: bool) -> None:
    picture = folder / "last" / "answer.png"
    page.write_page(folder / page.NAME, study.last, rows[-1], picture if picture.exists() else None,
                    rows=rows, table=table.rows, varied=study.varied, plotted=plotted)  # fmt: skip


def report_answer(answer: Answer, folder: Path) -> str:
    """Draw an answer and write its page into its folder (collective).

    Returns:
        One line: who drew it, and why.

    Raises:
        InputError: If the folder cannot be written.
    """
    picture = folder / "answer.png" if answer_has_picture(answer) else None
    who = answer.plot(picture) if picture is not None else f"{folder}: a network of intervals has no picture"
    comm, path = answer.level.comm, folder / page.NAME
    on_root(comm, page.write_page, path, answer.scene, answer.record, picture)
    arrays = gather(answer)
    on_root(comm, _write_free_boundary, arrays, folder / "free_boundary.csv")
    return who


def _write_free_boundary(arrays: Mapping[str, Any], path: Path) -> None:
    """One line of the table per piece of the free boundary: the coordinates of its ends, or of its corners."""
    pieces = [line.points[line.cells].reshape(len(line.cells), -1) for line in free_boundary(patch_of(arrays))]
    table = np.concatenate([*pieces, np.empty((0, pieces[0].shape[1] if pieces else 6))])
    heads = [f"{axis}{corner}" for corner in range(1, table.shape[1] // 3 + 1) for axis in "xyz"]
    rows = [",".join(heads), *(",".join(f"{x:.9g}" for x in row) for row in table)]
    write_text(path, "\n".join(rows) + "\n")


def answer_has_picture(answer: Answer) -> bool:
    """Whether pictures can show it: networks of intervals are for ParaView."""
    return answer.level.mesh.topology.dim > 1 or answer.level.mesh.geometry.dim == 1


def run_demo(folder: Path, say: Say) -> None:
    """Solve the scenes of demos/, then the eps-study and the h-study (collective)."""
    if not DEMOS.is_dir():
        raise InputError("the demo runs from a checkout of the project, where demos/ is")
    for name in ("string", "disk", "ball", "two_sided"):
        answer = solve(Scene.read(DEMOS / f"{name}.toml"))
        answer.save(folder / name)
        drawn = report_answer(answer, folder / name)
        say(f"{answer.summary()}\n  {drawn}\n")
    studies: list[tuple[str, str, dict[str, Any], dict[str, Any]]] = [
        ("disk", "h fixed: u_eps tends to the solution of the variational inequality with order eps",
         {"eps": [10.0**-k for k in range(1, 11)]}, {"cells": 64}),
        ("disk", "eps = h^2: order 1 in H1, and at least 1 for the pressure in the dual norm",
         {"cells": [16, 32, 64, 128]}, {"eps": "h^2"}),
        ("ball", "eps = h^2 again, on Bueler's ball", {"cells": [16, 32, 64, 128]}, {"eps": "h^2"}),
    ]  # fmt: skip
    for name, headline, vary, options in studies:
        scene = Scene.read(DEMOS / f"{name}.toml")
        say(f"{scene.tables.title}. {headline}")
        report_study(scene, vary, options, folder / name / "-".join(vary), say)
        say("")

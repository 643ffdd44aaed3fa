"""A study as a person sees it: rows as they are computed, files, pictures; and the demo made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.compute import solve
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import on_root, write_text
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show import plots
from fenicsx_obstacle.show.figures import save
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
            last.plot(folder / "last" / "answer.png")
        on_root(comm, write_text, folder / "last" / "row", rows[-1]["key"])
    drawn = ["last/"]
    if len(rows) > 1 and study.by and quantities(study.varied, rows[-1]):
        on_root(comm, _draw_plots, rows, study.varied, folder)
        drawn += ["convergence.png", "cost.png"]
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


def answer_has_picture(answer: Answer) -> bool:
    """Whether pictures can show it: solids are for ParaView."""
    return answer.level.mesh.topology.dim < 3


def run_demo(folder: Path, say: Say) -> None:
    """Solve the scenes of demos/, then the eps-study and the h-study (collective)."""
    if not DEMOS.is_dir():
        raise InputError("the demo runs from a checkout of the project, where demos/ is")
    for name in ("string", "disk", "ball", "two_sided"):
        answer = solve(Scene.read(DEMOS / f"{name}.toml"))
        answer.save(folder / name)
        answer.plot(folder / name / "answer.png")
        say(answer.summary() + "\n")
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

"""A study as a person sees it: rows as they are computed, files, pictures; and the demo made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.compute import solve
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show.pictures import draw_convergence, draw_cost
from fenicsx_obstacle.show.tables import StudyTable
from fenicsx_obstacle.studies.convergence import Row, study
from fenicsx_obstacle.studies.rows import RowFile
from fenicsx_obstacle.studies.theory import quantities

DEMOS = Path(__file__).parent.parent.parent / "demos"
Say = Callable[[str], None]


def report_study(
    scene: Scene, vary: Mapping[str, Sequence[Any]], options: Mapping[str, Any], folder: Path, say: Say
) -> list[Row]:
    """Run a study; print, save and draw it (collective).

    Args:
        scene: What to solve.
        vary: Values of each key.
        options: Fixed values.
        folder: Where rows.jsonl, rows.csv and the pictures go.
        say: Prints a line on rank 0.

    Raises:
        InputError: For bad data or a folder that cannot be written.
        NotConverged: With PETSc's reason; the rows before it are on the disk.
    """
    comm = MPI.COMM_WORLD if scene.mesh is None else scene.mesh.comm
    on_root(comm, RowFile, folder)  # an unwritable folder is reported before anything is computed
    file = RowFile(folder) if comm.rank == 0 else None
    table = StudyTable(list(vary))
    last: list[Answer] = []

    def on_row(row: Row, answer: Answer) -> None:
        if file is not None:
            on_disk(file, row)
        for line in table.lines(row):
            say(line)
        last[:] = [answer]

    rows = study(scene, vary, on_row=on_row, **options)
    drawn = ["answer.png"] if answer_has_picture(last[0]) else []
    if drawn:
        last[0].plot(folder / "answer.png")
    if len(rows) > 1 and quantities(list(vary), rows[-1]):
        on_root(comm, draw_convergence, rows, list(vary), folder / "convergence.png")
        on_root(comm, draw_cost, rows, list(vary), folder / "cost.png")
        drawn += ["convergence.png", "cost.png"]
    say(f"saved in {folder}: rows.csv, rows.jsonl" + "".join(f", {name}" for name in drawn))
    return rows


def on_disk(file: RowFile, row: Row) -> None:
    """Write a row; a full disk must not lose the rows to come, so it ends the study here."""
    try:
        file.add(row)
    except OSError as error:
        raise InputError(f"{file.folder}: {error.strerror}") from None


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

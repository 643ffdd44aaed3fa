"""Files in the folder of a result for people: pictures, plots, tables, a page."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.io.folder import STEPS, gather, write_record
from fenicsx_obstacle.io.origin import command, program
from fenicsx_obstacle.parallel import on_root, peak_memory_mb, write_text
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show import page
from fenicsx_obstacle.show.free_boundary import write_free_boundary
from fenicsx_obstacle.show.profiles import draw_profiles, draw_rows
from fenicsx_obstacle.show.tables import StudyTable
from fenicsx_obstacle.studies.convergence import Row, Study
from fenicsx_obstacle.studies.find import Find
from fenicsx_obstacle.studies.rows import RowStore
from fenicsx_obstacle.text import counted

PICTURE = "answer.png"
Say = Callable[[str], None]


def report_answer(answer: Answer, folder: Path, *, picture: bool, newton: bool = False) -> str:
    """Write free_boundary.csv, the page and, if asked for, the picture of an answer into its folder (collective).

    Without `picture`, one that an earlier answer left there is removed. `newton` draws the way to the answer as well.

    Returns:
        One line: who drew it, and why; or how to draw it.

    Raises:
        InputError: If the folder cannot be written.
    """
    return report_command(answer, folder, None, picture=picture, newton=newton)[1]


def report_command(
    answer: Answer, folder: Path, started: float | None, *, picture: bool, newton: bool = False
) -> tuple[Answer, str]:
    """The same at the end of a command: page and answer.json get its seconds and its memory (collective).

    Args:
        answer: That was saved in the folder.
        folder: As for `report_answer`.
        started: `time.perf_counter()` at the beginning of the command; None leaves the record as it is.
        picture: As for `report_answer`.
        newton: As for `report_answer`.

    Returns:
        The answer with these values in its record, and what `report_answer` returns.
    """
    comm = answer.level.comm
    of_body = answer.scene.model.vector_valued  # which has nodes.csv instead of a free boundary
    if of_body:
        on_root(comm, (folder / "free_boundary.csv").unlink, True)
    else:
        write_free_boundary(answer, folder / "free_boundary.csv")
    file = folder / PICTURE if picture and _has_picture(answer) else None
    others = dict[str, Path]()
    if file is not None:
        said = answer.plot(file).said
        if answer.bound is not None:
            from fenicsx_obstacle.show.indicator import NAME, draw_bound  # only where there is a bound

            said += "\n  " + draw_bound(answer.bound, gather(answer), comm, folder / NAME)
            others["Contribution of each cell to the bound"] = folder / NAME
    else:
        on_root(comm, (folder / PICTURE).unlink, True)
        said = f"{folder}: a network of intervals has no picture" if picture else f"{program()} plot {folder} draws it"
    if newton:
        from fenicsx_obstacle.show.newton import animate_newton  # only if requested

        said += "\n  " + animate_newton(answer, folder / STEPS)
        others["Newton steps"] = folder / STEPS
    drawn = draw_profiles(answer, folder)
    moving = None
    if answer.time_history is not None:
        moving, words = on_root(comm, _draw_course, answer, gather(answer), folder, picture)
        said += words
    if started is not None:
        seconds = {**answer.record["seconds"], "total": time.perf_counter() - started}
        spent = {"seconds": comm.bcast(seconds), "memory_mb": peak_memory_mb(comm)}
        answer = replace(answer, record={**answer.record, **spent})
        on_root(comm, write_record, folder, answer.record)
    record = answer.record
    on_root(comm, partial(
        page.write_page, folder / page.NAME, "answer", answer.scene, record["versions"], record["command"],
        record=record, picture=file, time_history=moving, profiles=drawn, others=others,
    ))  # fmt: skip
    return answer, said


def _draw_course(answer: Answer, arrays: Mapping[str, Any], folder: Path, picture: bool) -> tuple[Path, str]:
    """The picture of the course and, if asked for, the animation, with what is said of them (one rank)."""
    from fenicsx_obstacle.show import time_history  # only where a scene has time

    said = ["", time_history.draw_course(answer, arrays, folder / time_history.HISTORY)]
    (folder / time_history.ANIMATION).unlink(missing_ok=True)
    if picture and time_history.is_animated(answer, arrays):
        said.append(time_history.animate(answer, arrays, folder / time_history.ANIMATION))
    return folder / time_history.HISTORY, "\n  ".join(said)


def report_study(
    scene: Scene,
    vary: Mapping[str, Sequence[Any]],
    options: Mapping[str, Any],
    folder: Path,
    say: Say,
    *,
    uncertainty: bool = False,
    fresh: bool = False,
    latex: Path | None = None,
) -> list[Row]:
    """Run a study, or go on with an interrupted one; print, save and draw it (collective).

    Args:
        scene: What to solve.
        vary: Values of each key.
        options: Fixed values.
        folder: Where rows.jsonl, rows.csv, the plots, the page and the last answer go.
        say: Prints a line on rank 0.
        uncertainty: Of each quantity in each row.
        fresh: Forget the rows that are there.
        latex: File for the table in LaTeX.

    Raises:
        InputError: For bad data or a folder that cannot be written.
        NotConverged: With PETSc's reason; the rows before it are on the disk.
    """
    study = Study(scene, vary, options, uncertainty=uncertainty)
    with closing(RowStore(folder, study.comm, fresh=fresh)) as store:
        return _report(study, store, say, latex)


def report_find(search: Find, folder: Path, say: Say, *, fresh: bool = False) -> list[Row]:
    """Find the value of a key for a target, or go on with an interrupted search; print, save and draw (collective).

    Args:
        search: The key, its interval and the target.
        folder: As for `report_study`; the last answer is the one that was found.
        say: Prints a line on rank 0.
        fresh: Forget the rows that are there.

    Raises:
        InputError: For a target that is not between the values at both ends, or a folder that cannot be written.
        NotConverged: With PETSc's reason; the rows before it are on the disk.
    """
    with closing(RowStore(folder, search.comm, fresh=fresh)) as store:
        rows = _report(search, store, say)
    words = f"{search.quantity} = {search.reached(rows[-1]):.6g}, the target is {search.target:g}"
    say(f"{search.key} = {search.found:.6g}: {words}; {counted(len(rows), 'solve')}")
    return rows


def _report(study: Study, store: RowStore, say: Say, latex: Path | None = None) -> list[Row]:
    """Run a study, print its rows, and draw them into the folder of its store (collective)."""
    comm, folder, table = study.comm, store.folder, StudyTable(study.vary, store.run, penalised=study.penalised)
    answers: list[Answer | None] = [None]

    def on_row(row: Row, answer: Answer | None) -> None:
        for line in table.lines(row):
            say(line)
        if not isinstance(study, Find):  # a search has found its last row
            answers[:] = [answer]

    rows = study.run(on_row, store)
    if isinstance(study, Find):  # on the page the last row is the one that was found
        table.rows.clear()
        for row in rows:
            table.lines(row)
    for note in table.notes():
        say(fill(note, 110))
    if latex is not None:
        on_root(comm, write_text, latex, table.latex())
    last = answers[0] or (None if on_root(comm, _is_drawn, folder, rows[-1]) else study.last_answer())
    if last is not None:
        last.save(folder / "last")
        if _has_picture(last):
            say(last.plot(folder / "last" / PICTURE).said)
        on_root(comm, write_text, folder / "last" / "row", rows[-1]["key"])
    drawn = on_root(comm, _draw_study, folder, study, rows, table)
    say(f"saved in {folder}: {', '.join(['rows.csv', 'rows.jsonl', 'last/', *drawn, page.NAME])}")
    return rows


def _is_drawn(folder: Path, row: Row) -> bool:
    """Whether last/ holds the answer of this row."""
    mark = folder / "last" / "row"
    return mark.exists() and mark.read_text() == row["key"]


def _draw_study(folder: Path, study: Study, rows: list[Row], table: StudyTable) -> list[str]:
    """Draw the plots and write the page (one rank).

    Returns:
        The names of the plots.
    """
    from fenicsx_obstacle.show.figures import save
    from fenicsx_obstacle.show.plots import drawings

    drawn, picture = dict[str, Path](), folder / "last" / PICTURE
    for name, figure in drawings(rows, study.vary, study.last.tables.report):
        drawn[name] = folder / f"{name}.png"
        save(figure, drawn[name])
    drawn |= draw_rows(rows, study.vary, study.last.tables.u, folder)
    page.write_page(
        folder / page.NAME, "study", study.last, rows[-1]["versions"], command(study.comm.size), record=rows[-1],
        table=table, drawn=drawn, picture=picture if picture.exists() else None,
    )  # fmt: skip
    return [file.name for file in drawn.values()]


def _has_picture(answer: Answer) -> bool:
    """Whether pictures can show it: networks of intervals are for ParaView."""
    return answer.level.mesh.topology.dim > 1 or answer.level.mesh.geometry.dim == 1

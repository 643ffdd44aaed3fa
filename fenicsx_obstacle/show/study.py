"""Output of studies and searches: rows while they run, tables, plots, a page, and the last answer."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from textwrap import fill

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.origin import command
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.problems.summary import remarks_in_words
from fenicsx_obstacle.safe_writing import write_text
from fenicsx_obstacle.show.figures import save
from fenicsx_obstacle.show.plots import drawings
from fenicsx_obstacle.show.profiles import draw_rows
from fenicsx_obstacle.show.report import PAGE, PICTURE, has_picture, write_page
from fenicsx_obstacle.show.tables import StudyTable
from fenicsx_obstacle.studies.convergence import Row, Study
from fenicsx_obstacle.studies.find import Find
from fenicsx_obstacle.studies.rows import RowStore
from fenicsx_obstacle.text import counted

Say = Callable[[str], None]


def report_study(study: Study, folder: Path, say: Say, *, fresh: bool = False, latex: Path | None = None) -> list[Row]:
    """Run a study or a search, or go on with an interrupted one; print, save and draw it (collective).

    Args:
        study: Nothing of it is computed yet.
        folder: Where rows.jsonl, rows.csv, the plots, the page and the last answer go; of a search the one that was
            found.
        say: Prints a line on rank 0.
        fresh: Forget the rows that are there.
        latex: File for the table in LaTeX.

    Raises:
        InputError: For bad data, a target that is not between the values at both ends, or a folder that cannot be
            written.
        NotConverged: With PETSc's reason; the rows before it are on the disk.
    """
    with closing(RowStore(folder, study.comm, fresh=fresh)) as store:
        rows = _report(study, store, say, latex)
    if isinstance(study, Find):
        words = f"{study.quantity} = {study.reached(rows[-1]):.6g}, the target is {study.target:g}"
        say(f"{study.key} = {study.found:.6g}: {words}; {counted(len(rows), 'solve')}")
        for name, remark in remarks_in_words(rows[-1]):
            say(f"{name}: {remark}")
    return rows


def _report(study: Study, store: RowStore, say: Say, latex: Path | None) -> list[Row]:
    """Run a study, print its rows, and draw them into the folder of its store (collective)."""
    comm, folder = study.comm, store.folder
    # one is printed while rows come; in the other the last row of a search is the one that was found
    printed, table = (StudyTable(study.vary, store.run, penalised=study.penalised) for _ in range(2))
    latest: tuple[Row | None, Answer | None] = None, None

    def on_row(row: Row, answer: Answer | None) -> None:
        nonlocal latest
        latest = row, answer
        for line in printed.lines(row):
            say(line)

    rows = study.run(on_row, store)
    for row in rows:
        table.lines(row)
    for note in table.notes():
        say(fill(note, 110))
    if latex is not None:
        on_root(comm, write_text, latex, table.latex())
    last = latest[1] if latest[0] is rows[-1] else None
    if last is None and not on_root(comm, _is_drawn, folder, rows[-1]):
        last = study.solve(rows[-1]["vary"], study.last)
    if last is not None:
        last.save(folder / "last")
        if has_picture(last):
            say(last.plot(folder / "last" / PICTURE).said)
        on_root(comm, write_text, folder / "last" / "row", rows[-1]["key"])
    drawn = on_root(comm, _draw_study, folder, study, rows, table)
    say(f"saved in {folder}: {', '.join(['rows.csv', 'rows.jsonl', 'last/', *drawn, PAGE])}")
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
    drawn, picture = dict[str, Path](), folder / "last" / PICTURE
    for name, figure in drawings(rows, study.vary, study.last.tables.report):
        drawn[name] = folder / f"{name}.png"
        save(figure, drawn[name])
    drawn |= draw_rows(rows, study.vary, study.last.tables.u, folder)
    write_page(
        folder / PAGE, "study", study.last, rows[-1]["versions"], command(study.comm.size), record=rows[-1],
        table=table, drawn=drawn, picture=picture if picture.exists() else None,
    )  # fmt: skip
    return [file.name for file in drawn.values()]

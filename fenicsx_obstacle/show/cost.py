"""Output of `cost`: lines while it runs, tables at the end, pictures and a page (see `studies.cost`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from textwrap import fill
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.origin import command, versions
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show import cost_tables as tables
from fenicsx_obstacle.show import page
from fenicsx_obstacle.show.cost_plots import drawings
from fenicsx_obstacle.show.figures import save
from fenicsx_obstacle.show.study import Say
from fenicsx_obstacle.show.tables import columns
from fenicsx_obstacle.studies import price
from fenicsx_obstacle.studies.cost import CostStudy, Row
from fenicsx_obstacle.studies.price import NORMS, Rows
from fenicsx_obstacle.studies.rows import RowStore

LINE = "{:14} {:>9} {:>8} {:>8} {:>7}  " + " ".join(["{:>8}"] * len(NORMS)) + "  {:>5} {:>5} {:>5}"


def report_cost(
    scene: Scene, options: Mapping[str, Any], budget: str | None, folder: Path, say: Say, *, fresh: bool = False
) -> list[Row]:
    """Run the study, or continue an interrupted one; print, save and draw it (collective).

    Args:
        scene: What to solve.
        options: Changes of the scene.
        budget: Of one row, in words.
        folder: Where rows.jsonl, pictures and the page go.
        say: Prints a line on rank 0.
        fresh: Forget the rows that are there.

    Raises:
        InputError: For bad data or a folder that cannot be written.
    """
    study = CostStudy(scene, options, budget, folder, MPI.COMM_WORLD)
    with closing(RowStore(folder, study.comm, fresh=fresh)) as store:
        say(LINE.format(*tables.HEADS).rstrip())
        rows = study.run(lambda row: _say_row(row, say), store)
        say("")
        for line in summary(rows, study):
            say(line)
        store.write_table([row for row in rows if row["choice"] not in ("", "map")])
        names = on_root(study.comm, _draw, folder, study, rows)
        say(f"saved in {folder}: {', '.join(['rows.csv', 'rows.jsonl', *names, page.NAME])}")
        return rows


def _say_row(row: Row, say: Say) -> None:
    if row["choice"] == "map":
        return
    if "errors" not in row:
        say(fill(f"{row['choice']:14} none: {row['reason']}", 110, subsequent_indent=" " * 15))
        return
    say(LINE.format(*tables.cells(row)).rstrip())


def summary(rows: Rows, study: CostStudy) -> Iterator[str]:
    """The tables after the rows: time for one more digit, fastest methods, where methods end, the reference
    solution."""
    yield from columns([tables.NEXT, *tables.next_digit(rows)])
    yield ""
    yield from columns([tables.tolerance_heads(rows), *tables.by_tolerance(rows)])
    yield "in brackets: extrapolated from the last rows"
    yield ""
    best = tables.best_eps(rows)
    if best:
        yield from columns([tables.BEST, *best])
        yield ""
    yield fill(tables.against(rows), 110)
    for name, why in tables.ended(rows, study):
        yield fill(f"{name}: {why}", 110, subsequent_indent="  ")


def headline(rows: Rows) -> str:
    """Time for one more digit in one line."""
    p = price.price(rows, "energy")
    if p is None:
        return "Cost of accuracy."
    far = (
        "; one more digit is not reached by extrapolation"
        if p.factor is None
        else f"; one more digit takes {p.factor:.2g} times that"
    )
    return f"Cost of accuracy: an energy error of {p.error:.1e} in {tables.duration(p.seconds)} by {p.choice}{far}."


def _draw(folder: Path, study: CostStudy, rows: Rows) -> list[str]:
    """Draw the plots and write the page (one rank).

    Returns:
        Names of the pictures.
    """
    drawn = dict[str, Path]()
    for name, figure in drawings(rows):
        drawn[name] = folder / f"{name}.png"
        save(figure, drawn[name])
    page.write_page(
        folder / page.NAME, "cost", study.full, versions(), command(study.comm.size), headline=headline(rows),
        rows=rows, study=study, drawn=drawn, tables=tables,
    )  # fmt: skip
    return [file.name for file in drawn.values()]

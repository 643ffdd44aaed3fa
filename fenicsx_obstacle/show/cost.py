"""Output of `cost`: lines while it runs, tables at the end, pictures and a page (see `studies.cost`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from textwrap import fill
from typing import Any

from fenicsx_obstacle.origin import command, versions
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.show.cost_plots import drawings
from fenicsx_obstacle.show.figures import save
from fenicsx_obstacle.show.report import PAGE, write_page
from fenicsx_obstacle.show.study import Say
from fenicsx_obstacle.show.tables import duration, megabytes
from fenicsx_obstacle.studies import price
from fenicsx_obstacle.studies.cost import CostStudy, Row
from fenicsx_obstacle.studies.price import NORMS, TOLERANCES, Rows
from fenicsx_obstacle.studies.rows import RowStore
from fenicsx_obstacle.text import columns

LINE = "{:14} {:>9} {:>8} {:>8} {:>7}  " + " ".join(["{:>8}"] * len(NORMS)) + "  {:>5} {:>5} {:>5}"
HEADS = ["choice", "unknowns", "eps", "seconds", "MB", *NORMS, "DoA", "DoS", "DoE"]
THEORY = {"energy": "4/3", "l2": "2", "max": "2", "force": "2", "area": "2", "pressure": "2"}
NEXT = ["next digit of", "error so far", "by", "in", "a tenth of it", "by", "more time", "unknowns", "memory",
        "round-off at"]  # fmt: skip
BEST = ["error in", "best eps ~ h^q: q", "theory", "h", "best eps", "paper's eps", "auto"]


def report_cost(study: CostStudy, say: Say, *, fresh: bool = False) -> list[Row]:
    """Run the study, or continue an interrupted one; print, save and draw it (collective).

    Args:
        study: Its folder gets rows.jsonl, pictures and the page.
        say: Prints a line on rank 0.
        fresh: Forget the rows that are there.

    Raises:
        InputError: For bad data or a folder that cannot be written.
    """
    folder = study.folder
    with closing(RowStore(folder, study.comm, fresh=fresh)) as store:
        say(LINE.format(*HEADS).rstrip())
        rows = study.run(lambda row: _say_row(row, say), store)
        say("")
        for line in summary(rows, study):
            say(line)
        store.write_table([row for row in rows if row["choice"] not in ("", "map")])
        names = on_root(study.comm, _draw, folder, study, rows)
        say(f"saved in {folder}: {', '.join(['rows.csv', 'rows.jsonl', *names, PAGE])}")
        return rows


def _say_row(row: Row, say: Say) -> None:
    if row["choice"] == "map":
        return
    if "errors" not in row:
        say(fill(f"{row['choice']:14} none: {row['reason']}", 110, subsequent_indent=" " * 15))
        return
    say(LINE.format(*cells(row)).rstrip())


def summary(rows: Rows, study: CostStudy) -> Iterator[str]:
    """The tables after the rows: time for one more digit, fastest methods, where methods end, the reference
    solution."""
    found = tables_of(rows)
    yield from columns(found["next"])
    yield ""
    yield from columns(found["tolerance"])
    yield "in brackets: extrapolated from the last rows"
    yield ""
    if len(found["best"]) > 1:
        yield from columns(found["best"])
        yield ""
    yield fill(against(rows), 110)
    for name, why in ended(rows, study):
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
    return f"Cost of accuracy: an energy error of {p.error:.1e} in {duration(p.seconds)} by {p.line.name}{far}."


def _draw(folder: Path, study: CostStudy, rows: Rows) -> list[str]:
    """Draw the plots and write the page (one rank).

    Returns:
        Names of the pictures.
    """
    drawn = dict[str, Path]()
    for name, figure in drawings(rows):
        drawn[name] = folder / f"{name}.png"
        save(figure, drawn[name])
    write_page(
        folder / PAGE, "cost", study.full, versions(), command(study.comm.size), headline=headline(rows),
        study=study, drawn=drawn, tables=tables_of(rows), against=against(rows), ended=ended(rows, study),
    )  # fmt: skip
    return [file.name for file in drawn.values()]


def cells(row: Mapping[str, Any]) -> list[str]:
    """A row below `HEADS`."""
    errors = [price.relative(row, norm) for norm in NORMS]
    digits = price.digits(row, "energy")
    return [
        row["choice"], str(row["dofs"]), "none" if row["eps"] is None else f"{row['eps']:.1e}", f"{row['seconds']:.3g}",
        f"{max(row['memory_mb'], 0):.0f}", *("" if e is None else f"{e:.1e}" for e in errors),
        *(["", "", ""] if digits is None else [f"{digit:.2f}" for digit in digits]),
    ]  # fmt: skip


def tables_of(rows: Rows) -> dict[str, list[list[str]]]:
    """The tables of a study, each with its heads first."""
    norms = [NORMS[norm] for norm in price.norms(rows)]
    return {
        "next": [NEXT, *next_digit(rows)],
        "tolerance": [["relative error", *norms], *by_tolerance(rows)],
        "best": [BEST, *best_eps(rows)],
        "rows": [HEADS, *map(cells, price.solved(rows))],
    }


def next_digit(rows: Rows) -> list[list[str]]:
    """Time for one more digit, a line for each norm."""
    found = []
    for norm in price.norms(rows):
        p = price.price(rows, norm)
        if p is None:
            continue
        after = ["not in sight", "", "", "", ""]
        if p.way is not None:
            seconds, dofs, memory = (p.way.cost(p.error / 10, key) or 0.0 for key in ("seconds", "dofs", "memory_mb"))
            size = [f"{dofs:.2g}" if dofs else "", megabytes(memory)]
            after = [duration(seconds), p.way.name, f"x {p.factor:.2g}", *size]
        floor = p.line.rows[-1]["floor"]
        found.append([NORMS[norm], f"{p.error:.1e}", p.line.name, duration(p.seconds), *after, f"{floor:.0e}"])
    return found


def by_tolerance(rows: Rows) -> list[list[str]]:
    """The cheapest choice for each tolerance and norm."""
    found = []
    for tolerance in TOLERANCES:
        fastest = []
        for norm in price.norms(rows):
            first = next(iter(price.cheapest(rows, norm, tolerance)), None)
            text = "-"
            if first is not None:
                line, seconds = first
                text = f"{line.name}, {duration(seconds)}"
                text = text if line.measured(tolerance) else f"({text})"
            fastest.append(text)
        if any(text != "-" for text in fastest):
            found.append([f"{tolerance:g}", *fastest])
    return found


def best_eps(rows: Rows) -> list[list[str]]:
    """The largest eps without effect on the error, read off the map, beside theory and the two rules."""
    found, places = [], [row for row in rows if row["choice"] == "map"]
    for norm in (*price.norms(rows), "pressure"):
        pairs = price.largest_harmless_eps(rows, norm)
        power = price.power_of_h(pairs)
        if power is None:
            continue
        h, eps = pairs[-1]
        row = next(row for row in places if row["h"] == h)
        found.append([NORMS.get(norm, "pressure"), f"{power:.2f}", THEORY[norm], f"{h:.3g}", f"{eps:.1e}",
                      f"{row['paper']:.1e}", f"{row['auto']:.1e}"])  # fmt: skip
    return found


def against(rows: Rows) -> str:
    """A text about the reference solution of the errors."""
    first = price.truth(rows)
    if first["exact"]:
        parts = [f"contact {name} {first[name]:.9g}" for name in ("area", "force") if name in first]
        return "Errors are measured against the exact solution" + (f": {', '.join(parts)}." if parts else ".")
    changed = ", ".join(f"{NORMS[norm]} {value:.1e}" for norm, value in first["changed"].items())
    bound = first.get("bound")
    if bound is None:
        how = "No bound of its own error is known for this scene."
    else:
        kind = "at most" if bound["words"].startswith("certified") else "about"
        how = f"Its own energy error is {kind} {bound['total']:.2e} ({bound['words']})."
    return (
        "No exact solution is known: errors are measured against a reference solution with "
        f"{first['dofs']} unknowns. {how} Its last refinement changed it by: {changed}. "
        f"Errors within {price.TRUSTED:g} times that, or in the energy norm within the bound, are not included in "
        "curves and tables."
    )


def ended(rows: Rows, study: CostStudy) -> list[tuple[str, str]]:
    """The reason why each method has no further row."""
    failed = {row["choice"] for row in price.failures(rows)}
    return [
        (choice.name, ("failed: " if choice.name in failed else "ends: ") + study.ends[choice.name])
        for choice in study.choices
        if choice.name in study.ends
    ]

"""Output of `theory`: a conclusion, a table of claims and observations, a picture for each statement, JSON lines."""

from __future__ import annotations

import re
import textwrap
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.forms.pairs import pairs
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.safe_writing import write_lines
from fenicsx_obstacle.scenes.catalogue import names
from fenicsx_obstacle.show.figures import panels, save, style
from fenicsx_obstacle.text import counted
from tests.theory.statement import Curve, Finding, Found, Panel, find, statements

HEADS = ("quantity", "statement", "claimed", "expected", "observed", "verdict")
CONCLUSIONS = {  # by verdict
    "holds": "as stated", "sharp": "with exactly the claimed order or constant (sharp)",
    "not sharp": "better than claimed (not sharp)", "needs hypothesis": "only under a further hypothesis",
    "misprint": "after the correction of a misprint",
}  # fmt: skip
LINES = "theory.jsonl"
CROWDED = 6  # curves that leave no room for a legend


def show_theory(number: str | None, folder: Path, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Measure one statement, or all: tables as they come, a picture each, and JSON lines (collective).

    Args:
        number: Of the statement; None for all.
        folder: Where pictures and JSON lines go: theory.jsonl for all statements, NUMBER.jsonl for one.
        say: Takes text.

    Returns:
        The rows.

    Raises:
        InputError: If there is no such statement.
    """
    comm, rows = MPI.COMM_WORLD, []
    for one in statements() if number is None else [find(number)]:
        start = time.perf_counter()
        found = one.measure(comm)
        rows += [{"number": one.number, **finding.record} for finding in found.findings]
        lines = folder / (LINES if number is None else f"{slug(one.number)}.jsonl")
        on_root(comm, write_lines, lines, rows)
        say(f"\n{one.number}  {one.title}\n\n  {conclusion(found.findings)}\n\n{table(found.findings)}")
        told = f"{time.perf_counter() - start:.0f} s"
        if found.panels:
            picture = folder / f"{slug(one.number)}.png"
            on_root(comm, _draw, found, one.title, picture)
            told = f"{picture}, {told}"
        say(f"\n  {told}")
    return rows


def conclusion(findings: Sequence[Finding]) -> str:
    """One sentence: how many rows of a table fail, or how many have each verdict."""
    verdicts = Counter(finding.verdict for finding in findings)
    if failed := verdicts.pop("FAILS", 0):
        return f"Conclusion: FAILS in {failed} of {counted(len(findings), 'row')}."
    parts = [f"{verdicts[verdict]} {words}" for verdict, words in CONCLUSIONS.items() if verdict in verdicts]
    return f"Conclusion: no value contradicts the theory ({counted(len(findings), 'row')}): {', '.join(parts)}."


def table(findings: Sequence[Finding]) -> str:
    """Claims and observations, as lines of text: a group of rows for each scene or pair."""
    groups: dict[str, list[tuple[str, ...]]] = {}
    for one in findings:
        quantity, scene = split(one.quantity)
        row = (quantity, one.statement, one.claimed, _number(one.expected), _number(one.observed), one.verdict)
        groups.setdefault(scene, []).append(row)
    rows = [HEADS, *(row for group in groups.values() for row in group)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEADS))]
    sides = [str.rjust if head in ("expected", "observed") else str.ljust for head in HEADS]

    def line(row: Sequence[str]) -> str:
        cells = (put(cell, width) for put, cell, width in zip(sides, row, widths, strict=True))
        return "    " + "  ".join(cells).rstrip()

    lines = [line(HEADS)]
    for scene, group in groups.items():
        lines += [f"  {scene}"] if scene else []
        lines += [line(row) for row in group]
    return "\n".join(lines)


def split(quantity: str) -> tuple[str, str]:
    """What is measured, and the scene of the catalogue, or the pair, on which it is measured; "" if it names none."""
    known = "|".join(map(re.escape, sorted([*names(), *pairs()], key=len, reverse=True)))
    found = re.search(rf", ((?:{known})(?:,.*)?)$", quantity)
    return (quantity[: found.start()], found[1]) if found else (quantity, "")


def slug(number: str) -> str:
    """A number of the paper as the name of a file."""
    return re.sub(r"[^0-9A-Za-z.]+", "-", number.replace("*", "-star")).strip("-.")


def drawing(found: Found, title: str) -> Any:
    """The picture of a statement: panels side by side, at most three in a row."""
    columns = min(len(found.panels), 3)
    labels = {tuple(curve.label for curve in panel.curves) for panel in found.panels}
    crowded = len(labels) == 1 and len(found.panels[0].curves) > CROWDED
    page, flat = panels(len(found.panels), 4.6 * columns + 1.5 * crowded, 3.9)
    for part, panel in zip(flat, found.panels, strict=True):
        _panel(part, panel)
        if not crowded:
            part.legend(fontsize=7)
    if crowded:  # one legend outside of all panels: within them it would cover curves
        flat[columns - 1].legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False,
                                 handlelength=4)  # fmt: skip
    page.suptitle(textwrap.fill(title, 55 * columns), fontsize=11)
    return page


def _draw(found: Found, title: str, path: Path) -> None:
    save(drawing(found, title), path)


def _panel(axes: Any, panel: Panel) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.set_xscale(panel.scales[0])
    axes.set_yscale(panel.scales[1])
    for number, curve in enumerate(panel.curves):
        look = style(number, dashed=4)
        axes.plot(curve.x, curve.y, label=curve.label, **look)
        if curve.slope is not None:
            _slope(axes, curve, look["color"])
    axes.margins(y=0.12)  # room for the orders below the last values
    if panel.scales[1] == "linear" and all(float(y).is_integer() for curve in panel.curves for y in curve.y):
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_title(panel.title, fontsize=9)
    axes.set_xlabel(panel.x)
    axes.set_ylabel(panel.y)
    axes.tick_params(which="minor", labelsize=6)
    axes.grid(True, which="major", color="0.9")


def _slope(axes: Any, curve: Curve, colour: str) -> None:
    """The expected order, through a point just below the last value, where orders are seen best."""
    assert curve.slope is not None
    end = min(range(len(curve.x)), key=lambda k: curve.x[k])
    values = [0.7 * curve.y[end] * (x / curve.x[end]) ** curve.slope for x in curve.x]
    axes.plot(curve.x, values, ":", color=colour, linewidth=1)
    axes.annotate(f"{curve.slope:.3g}", (curve.x[end], values[end]), textcoords="offset points", xytext=(2, -10),
                  fontsize=7, color=colour)  # fmt: skip


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if float(value).is_integer() and abs(value) < 1e6 else f"{value:.3g}"

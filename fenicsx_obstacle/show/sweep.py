"""Plots of output quantities over the key that varies: those of [report], or those of the contact (one rank)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fenicsx_obstacle.show.figures import BESIDE, COLOURS, GRID, heading, panels, plain, steady, style, terms_of
from fenicsx_obstacle.studies.grid import Vary, along, figures_of, last_part, lines_of
from fenicsx_obstacle.studies.orders import lookup
from fenicsx_obstacle.text import short

DECADES = 1.5  # values of a key that spread farther stand on a logarithmic axis


def sweep(rows: Sequence[Mapping[str, Any]], vary: Vary, report: Mapping[str, Any] | None = None) -> Any:
    """One small plot for each output quantity, with a line for each combination of the values of the other keys.

    Args:
        rows: Of a study.
        vary: Its keys and their values.
        report: The formulas of [report].
    """
    names = figures_of(rows[-1])
    columns = min(len(names), 2 if len(names) < 5 else 3)
    page, every = panels(len(names), max(3.4 * columns, 4.8), 3.9 if len(names) <= columns else 2.85, columns)
    key = along(vary)
    lines = lines_of(rows, key)
    for axes, (name, label) in zip(every, names.items(), strict=True):
        terms = terms_of((report or {}).get(name.removeprefix("report.")), report or {})
        size = max((abs(lookup(row, f"report.{term}") or 0.0) for row in rows for term in terms), default=0.0)
        for number, (line, part) in enumerate(lines.items()):
            x = np.array([_place(vary[key], row["vary"][key]) for row in part])
            y = np.array([lookup(row, name) for row in part], dtype=float)  # not a number where it is None
            order = np.argsort(x)
            axes.plot(x[order], steady(y, size)[order], label=plain(line), **style(number, len(COLOURS)))
        axes.set(xlabel=plain(last_part(key)), ylabel=plain(label))
        axes.grid(True, color=GRID)
        _scale(axes, vary[key])
    if len(lines) > 1:
        every[columns - 1].legend(fontsize=8, **BESIDE)
    page.suptitle(heading(rows[0]["title"] or rows[0]["scene"]), fontsize=11)
    return page


def _place(values: Sequence[Any], value: Any) -> float:
    """A number stands where it is; words stand in their order."""
    return float(value) if _are_numbers(values) else float(list(values).index(value))


def _scale(axes: Any, values: Sequence[Any]) -> None:
    # a number of ticks that depended on the size of the axes would move the labels that the layout has made room for
    axes.yaxis.get_major_locator().set_params(nbins=5)
    axes.xaxis.get_major_locator().set_params(nbins=6, integer=all(isinstance(value, int) for value in values))
    if not _are_numbers(values):
        axes.set_xticks(range(len(values)), [plain(short(value)) for value in values])
    elif min(values) > 0 and np.log10(max(values) / min(values)) > DECADES:
        axes.set_xscale("log")


def _are_numbers(values: Sequence[Any]) -> bool:
    return all(isinstance(value, int | float) for value in values)

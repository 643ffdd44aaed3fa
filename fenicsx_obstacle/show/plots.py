"""Plots of a study: orders of convergence beside the paper's, what accuracy costs, and output quantities (one rank).

A grid of several keys has one line for each combination of the values of the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fenicsx_obstacle.problems.summary import lookup
from fenicsx_obstacle.show.figures import (
    BESIDE,
    COLOURS,
    DASHES,
    GRID,
    figure,
    heading,
    log_ticks,
    panels,
    plain,
    steady,
    style,
    terms_of,
)
from fenicsx_obstacle.studies.orders import (
    Quantity,
    Vary,
    along,
    figures_of,
    last_part,
    lines_of,
    parameter,
    quantities,
)
from fenicsx_obstacle.text import counted, short

Rows = Sequence[Mapping[str, Any]]
DECADES = 1.5  # values of a key that spread farther stand on a logarithmic axis


def drawings(rows: Rows, vary: Vary, report: Mapping[str, Any] | None = None) -> Iterator[tuple[str, Any]]:
    """The plots of a study by name: orders and cost where errors are measured, otherwise figures against a key.

    Args:
        rows: Of the study.
        vary: Its keys and their values.
        report: The formulas of [report].
    """
    if len(rows) < 2:
        return
    if parameter(list(vary)) and quantities(list(vary), rows[-1]):
        yield "convergence", convergence(rows, vary)
        yield "cost", cost(rows, vary)
    else:
        yield "sweep", sweep(rows, vary, report)


def convergence(rows: Rows, vary: Vary) -> Any:
    """Measured quantities against eps or h; a dotted line has the order to expect, written at its end."""
    by, drawn = parameter(list(vary)), quantities(list(vary), rows[-1])
    lines = lines_of(rows, along(vary))
    page, axes = figure(8.4, 4.8)
    for line, part in enumerate(lines.values()):
        x = np.array([row[by] for row in part], dtype=float)
        for number, quantity in enumerate(drawn):
            y = np.array([lookup(row, quantity.key) for row in part], dtype=float)
            look = {**style(number), "linestyle": _dash(line)}
            axes.loglog(x, y, label=quantity.tex if line == 0 else None, **look)
            if line == 0:
                _expected(axes, quantity, by, x, y, look["color"])
    stated = {quantity.stated for quantity in drawn}
    words = {True: "orders of the paper", False: "best orders of P1"}
    dotted = " and ".join(words[kind] for kind in (True, False) if kind in stated)
    axes.plot([], [], ":", color="grey", label=dotted)
    if len(lines) > 1:
        for line, name in enumerate(lines):
            axes.plot([], [], linestyle=_dash(line), color="grey", label=plain(name))
    axes.margins(x=0.12)
    axes.set_xlabel(f"{by}   ({'h' if by == 'eps' else 'eps'}: {_other(rows, by)})")
    axes.set_ylabel("against the solution of SNES VI" if by == "eps" else "error")
    _finish(axes, rows)
    return page


def cost(rows: Rows, vary: Vary) -> Any:
    """The first measured quantity against the time of the solve."""
    page, axes = figure(8.4, 4.8)
    by, quantity = parameter(list(vary)), quantities(list(vary), rows[-1])[0]
    for number, (name, part) in enumerate(lines_of(rows, along(vary)).items()):
        seconds = [lookup(row, "seconds.solve") for row in part]
        values = [lookup(row, quantity.key) for row in part]
        # the time hardly depends on eps: a line through the points would only show noise
        look = {**style(number), "linestyle": "-" if by == "h" else ""}
        axes.loglog(seconds, values, label=plain(name) or quantity.tex, **look)
        for row, at in zip(part, zip(seconds, values, strict=True), strict=True):
            label = counted(row["dofs"], "unknown") if by == "h" else f"eps = {row['eps']:.0e}"
            if number == 0:  # those of other lines are about the same
                axes.annotate(label, at, textcoords="offset points", xytext=(7, 4), fontsize=7.5)
    axes.set_xlabel("seconds of the solve")
    axes.set_ylabel(quantity.tex)
    axes.margins(x=0.3, y=0.1)
    _finish(axes, rows)
    return page


def sweep(rows: Rows, vary: Vary, report: Mapping[str, Any] | None = None) -> Any:
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


def _dash(line: int) -> Any:
    return DASHES[line % len(DASHES)]


def _expected(axes: Any, quantity: Quantity, by: str, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    """The expected slope, through a point just below the last value, where orders are seen best."""
    end = int(np.argmin(x))
    slope = 0.7 * y[end] * (x / x[end]) ** quantity.order
    axes.loglog(x, slope, ":", color=colour, linewidth=1)
    axes.annotate(
        by if quantity.order == 1 else f"{by}$^{{{quantity.order:g}}}$", (x[end], slope[end]),
        textcoords="offset points", xytext=(-5, -2), ha="right", fontsize=8, color=colour,
    )  # fmt: skip


def _other(rows: Rows, by: str) -> str:
    values = [value for row in rows if (value := row["h" if by == "eps" else "eps"]) is not None]
    if not values:
        return "none, SNES VI"
    low, high = min(values), max(values)
    return f"{low:.3g}" if low == high else f"{high:.1e} to {low:.1e}"


def _finish(axes: Any, rows: Rows) -> None:
    """Ticks, title, and the legend beside the axes."""
    for axis, limits in ((axes.xaxis, axes.set_xlim), (axes.yaxis, axes.set_ylim)):
        low, high = axis.get_view_interval()
        if high / low < 4:  # a factor of 4 at least, or noise looks like a trend
            low, high = np.sqrt(low * high) * np.array([0.5, 2.0])
            limits(low, high)
    log_ticks(axes)
    axes.legend(fontsize=8, **BESIDE)
    title, methods = heading(rows[0]["title"] or rows[0]["scene"]), dict.fromkeys(row["method"] for row in rows)
    axes.set_title(f"{title} ({rows[0]['element']}, {', '.join(methods)})", fontsize=10)


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

"""Plots of a study: orders of convergence beside the paper's, and what accuracy costs (one rank)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fenicsx_obstacle.show.figures import COLOURS, MARKERS, figure
from fenicsx_obstacle.studies.theory import lookup, parameter, quantities

Rows = Sequence[Mapping[str, Any]]


def convergence(rows: Rows, varied: Sequence[str]) -> Any:
    """Measured quantities against eps or h; a dotted line has the order to expect, written at its end."""
    by = parameter(varied)
    page, axes = figure(6.4, 4.8)
    x = np.array([row[by] for row in rows], dtype=float)
    drawn = quantities(varied, rows[-1])
    for number, quantity in enumerate(drawn):
        y = np.array([lookup(row, quantity.key) for row in rows], dtype=float)
        style = {"color": COLOURS[number], "marker": MARKERS[number], "markersize": 5}
        axes.loglog(x, y, label=quantity.tex, **style)
        # the expected slope, through a point just below the last value, where orders are seen best
        end = int(np.argmin(x))
        slope = 0.7 * y[end] * (x / x[end]) ** quantity.order
        axes.loglog(x, slope, ":", color=COLOURS[number], linewidth=1)
        axes.annotate(
            by if quantity.order == 1 else f"{by}$^{{{quantity.order:g}}}$", (x[end], slope[end]),
            textcoords="offset points", xytext=(-5, -2), ha="right", fontsize=8, color=COLOURS[number],
        )  # fmt: skip
    stated = {quantity.stated for quantity in drawn}
    words = {True: "orders of the paper", False: "best orders of P1"}
    dotted = " and ".join(words[kind] for kind in (True, False) if kind in stated)
    axes.plot([], [], ":", color="grey", label=dotted)
    axes.margins(x=0.12)
    axes.set_xlabel(f"{by}   ({'h' if by == 'eps' else 'eps'}: {_other(rows, by)})")
    axes.set_ylabel("against the solution of SNES VI" if by == "eps" else "error")
    _finish(axes, rows)
    return page


def cost(rows: Rows, varied: Sequence[str]) -> Any:
    """The first measured quantity against the time of the solve."""
    page, axes = figure(6.4, 4.8)
    quantity = quantities(varied, rows[-1])[0]
    seconds = [lookup(row, "seconds.solve") for row in rows]
    values = [lookup(row, quantity.key) for row in rows]
    # the time hardly depends on eps: a line through the points would only show the jitter of the clock
    axes.loglog(seconds, values, "o-" if parameter(varied) == "h" else "o", color=COLOURS[0], label=quantity.tex)
    for row, at in zip(rows, zip(seconds, values, strict=True), strict=True):
        label = f"{row['dofs']} unknowns" if parameter(varied) == "h" else f"eps = {row['eps']:.0e}"
        axes.annotate(label, at, textcoords="offset points", xytext=(7, 4), fontsize=7.5)
    axes.set_xlabel("seconds of the solve")
    axes.set_ylabel(quantity.tex)
    axes.margins(x=0.3, y=0.1)
    _finish(axes, rows)
    return page


def _other(rows: Rows, by: str) -> str:
    values = [row["h" if by == "eps" else "eps"] for row in rows]
    if None in values:
        return "none, SNES VI"
    return f"{values[0]:.3g}" if len(set(values)) == 1 else f"{values[0]:.1e} to {values[-1]:.1e}"


def _finish(axes: Any, rows: Rows) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for axis, limits in ((axes.xaxis, axes.set_xlim), (axes.yaxis, axes.set_ylim)):
        low, high = axis.get_view_interval()
        if high / low < 4:  # a factor of 4 at least, or noise looks like a trend
            low, high = np.sqrt(low * high) * np.array([0.5, 2.0])
            limits(low, high)
        # within one and a half decades the decades alone would leave an axis without figures
        few = np.log10(high / low) < 1.5
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,), numticks=12))
        axis.set_minor_locator(NullLocator())
        if few and low > 1e-4 and high < 1e5:
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.grid(True, which="major", color="0.9")
    axes.legend(fontsize=8)
    axes.set_title(f"{rows[0]['title'] or rows[0]['scene']} ({rows[0]['element']}, {rows[0]['method']})", fontsize=10)

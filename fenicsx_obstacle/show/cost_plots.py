"""Plots of `cost`: error against time and other prices, the parts of h and eps, the map over both (one rank)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from fenicsx_obstacle.show.figures import figure, heading, log_ticks, panels
from fenicsx_obstacle.studies.price import NORMS, Rows, largest_harmless_eps, norms, relative, solved, trusted, unit

_BLUE, _GREEN, _ORANGE, _RED, _PINK, _GREY = "#0072B2", "#009E73", "#E69F00", "#D55E00", "#CC79A7", "#777777"
_COLOURS = {"VI": _BLUE, "VI cold": _GREY, "eps fixed": _PINK, "eps = h": _RED, "eps = h^2": _ORANGE, "auto": _GREEN,
            "adaptive": "#111111"}  # fmt: skip
_MARKERS = {"VI": "o", "VI cold": "x", "eps fixed": "D", "eps = h": "s", "eps = h^2": "^", "auto": "v",
            "adaptive": "*"}  # fmt: skip
PARTS = ("eps = h", "eps = h^2", "auto")
_WORDS = {"auto": "eps = h$^2$/100 (auto)", "eps = h^2": "eps = h$^2$ (paper)", "eps = h": "eps = h"}


def drawings(rows: Rows) -> Iterator[tuple[str, Any]]:
    """Each plot with its name."""
    yield "seconds", against_seconds(rows)
    yield "prices", against_prices(rows)
    if any(row.get("parts") for row in solved(rows)):
        yield "parts", parts(rows)
    if any(row["choice"] == "map" and "errors" in row for row in rows):
        yield "map", over_h_and_eps(rows)


def against_seconds(rows: Rows) -> Any:
    """One panel for each norm, the legend in a panel of its own."""
    measured = norms(rows)
    page, every = panels(len(measured) + 1, 11.5, 3.6)
    for axes, norm in zip(every, measured, strict=False):
        _draw(axes, rows, norm, lambda row: row["seconds"], floor=True)
        axes.set(title=NORMS[norm], xlabel="seconds, mesh and estimate included", ylabel="relative error")
    every[-1].axis("off")
    _legend(every[-1], rows)
    page.suptitle(_title(rows, "What accuracy costs"), fontsize=11)
    return page


def against_prices(rows: Rows) -> Any:
    """Energy error against Poisson solves, memory and unknowns."""
    page, every = panels(3, 11.5, 4.4)
    scale = unit(rows) or 1.0
    keys = {
        "Poisson solves (one linear solve on the finest uniform mesh is 1)": lambda row: row["seconds"] / scale,
        "memory of the row, MB": lambda row: max(row["memory_mb"], 0.1),
        "unknowns": lambda row: row["dofs"],
    }
    for axes, (label, value) in zip(every, keys.items(), strict=True):
        _draw(axes, rows, "energy", value)
        axes.set(xlabel=label, ylabel="relative error, energy norm")
        axes.xaxis.label.set_fontsize(8.5)
    if trusted(rows, "energy"):
        _legend(every[0], rows, inside=True)
    page.suptitle(_title(rows, "The same error against other costs"), fontsize=11)
    return page


def parts(rows: Rows) -> Any:
    """Total error, part of the mesh (without penalty) and part of the penalty, for three rules of eps."""
    own = next(row["element"] for row in solved(rows) if row.get("parts"))
    shown = [norm for norm in ("energy", "l2", "max") if norm in norms(rows)]
    page, grid = figure(11.5, 3.1 * len(shown), rows=len(shown), columns=3)
    of_mesh = [row for row in solved(rows) if row["choice"] == f"{own} VI"]
    for line, norm in zip(np.atleast_2d(grid), shown, strict=True):
        low, high = np.inf, 0.0
        for axes, rule in zip(line, PARTS, strict=True):
            part = [row for row in solved(rows) if row["choice"] == f"{own} {rule}" and "eps" in row["parts"]]
            h = [row["h"] for row in part]
            eps = [row["parts"]["eps"][norm] / row["sizes"][norm] for row in part]
            whole = [relative(row, norm) or 0.0 for row in part]
            axes.loglog([row["h"] for row in of_mesh], [relative(row, norm) for row in of_mesh], "o-", color=_BLUE,
                        label="part of the mesh (no penalty)")  # fmt: skip
            axes.loglog(h, eps, "s--", color=_RED, label="part of eps")
            axes.loglog(h, whole, "-", color="#111111", linewidth=2.2, label="error")
            low, high = min([low, *eps]) / 2, max([high, *whole]) * 2
            floor = max((row["floor"] for row in part), default=0.0)
            axes.annotate(f"floor of round-off: {floor:.0e}", (0.98, 0.03), xycoords="axes fraction", ha="right",
                          fontsize=7.5, color=_GREY)  # fmt: skip
            axes.axhline(floor, linestyle=":", color=_GREY)
            axes.set(xlabel="h", ylabel=f"relative, {NORMS[norm]}")
            if norm == shown[0]:
                axes.set_title(_WORDS[rule])
        for axes in line:
            axes.set_ylim(low, high)
            log_ticks(axes)
    page.axes[0].legend(fontsize=7.5)
    page.suptitle(_title(rows, f"Where the error of {own} comes from"), fontsize=11)
    return page


def over_h_and_eps(rows: Rows) -> Any:
    """The error as the colour of a square for each solve, with the paper's rule, ours, the best eps, and those that are
    rejected."""
    from matplotlib.colors import LogNorm

    places = [row for row in rows if row["choice"] == "map"]
    shown = [norm for norm in (*NORMS, "pressure") if any(relative(row, norm) for row in places)]
    shown = [norm for norm in shown if norm in ("energy", "l2", "max", "pressure") or norm in norms(rows)][:6]
    page, every = panels(len(shown), 11.5, 4.3)
    line = list({row["h"]: row for row in places}.values())
    rejected = [(row["h"], row["eps"]) for row in places if "reason" in row]
    for axes, norm in zip(every, shown, strict=True):
        found = [(row["h"], row["eps"], error) for row in places if (error := relative(row, norm))]
        h, eps, errors = np.array(found).T
        axes.set(xscale="log", yscale="log", xlabel="h", ylabel="eps", title=NORMS.get(norm, "pressure, L2 norm"))
        drawn = axes.scatter(h, eps, 60, errors, "s", norm=LogNorm(), cmap="viridis_r")
        page.colorbar(drawn, ax=axes, shrink=0.85).ax.tick_params(labelsize=7)
        curves: dict[str, tuple[Any, dict[str, Any]]] = {
            "paper: eps = h$^2$": ([(row["h"], row["paper"]) for row in line], {"color": _ORANGE, "marker": "^"}),
            "auto: h$^2$/100": ([(row["h"], row["auto"]) for row in line], {"color": _PINK, "marker": "v"}),
            "largest eps without effect on the error": (
                largest_harmless_eps(rows, norm), {"color": _RED, "marker": "*", "linestyle": "--", "markersize": 10}),
            "rejected": (rejected, {"color": _GREY, "marker": "x", "linestyle": ""}),
        }  # fmt: skip
        for label, (points, look) in curves.items():
            if points:
                axes.plot(*np.array(points).T, label=label, **look)
        axes.margins(x=0.15)
    every[0].legend(fontsize=7, loc="upper left")
    page.suptitle(_title(rows, "Relative error over mesh and penalty parameter"), fontsize=11)
    return page


def _draw(axes: Any, rows: Rows, norm: str, price: Callable[[Any], float], *, floor: bool = False) -> None:
    """The error of each choice against a price of its rows, and the error due to round-off along those of the
    default."""
    lines = trusted(rows, norm)
    for name, part in lines.items():
        axes.loglog([price(row) for row in part], [relative(row, norm) for row in part], **_look(name))
    if not lines:
        axes.set(xticks=[], yticks=[])
        axes.text(0.5, 0.5, "all errors are smaller than the\nuncertainty of the reference", ha="center",
                  va="center", fontsize=9, color=_GREY, transform=axes.transAxes)  # fmt: skip
        return
    part = [row for row in lines.get("P1 auto", []) if floor and row["floor"] > 0]
    if part and max(row["floor"] for row in part) > axes.get_ylim()[0] / 1e3:
        axes.loglog([price(row) for row in part], [row["floor"] for row in part], ":", color=_GREY)
    log_ticks(axes)


def _look(name: str) -> dict[str, Any]:
    element, _, rule = name.partition(" ")
    quadratic = element == "P2"
    return {
        "color": _COLOURS[rule], "marker": _MARKERS[rule], "linestyle": "--" if quadratic else "-",
        "markerfacecolor": "white" if quadratic else _COLOURS[rule], "markersize": 8 if rule == "adaptive" else 5,
        "linewidth": 2.0 if rule in ("adaptive", "auto") else 1.2, "label": name.replace("h^2", "h$^2$"),
    }  # fmt: skip


def _legend(axes: Any, rows: Rows, *, inside: bool = False) -> None:
    names = dict.fromkeys(row["choice"] for row in solved(rows))
    for name in names if not inside else ():
        axes.plot([], [], **_look(name))
    axes.legend(fontsize=6.5 if inside else 9, loc="best" if inside else "center")


def _title(rows: Rows, words: str) -> str:
    title = next((row["title"] for row in rows if row.get("title")), "")
    return heading(f"{words}: {title}" if title else words)

"""Pictures by matplotlib: an answer, orders of convergence, error against time. Rank 0 draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.folder import gather
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.studies.theory import lookup, parameter, quantities

# Okabe and Ito's colours, told apart by colour-blind readers; each line has a marker of its own as well
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
MARKERS = ("o", "s", "^", "D")


def draw_answer(answer: Answer, path: Path) -> None:
    """u with its obstacles, contact set and pressure in one picture (collective).

    Raises:
        InputError: If the file cannot be written.
    """
    arrays = gather(answer)
    on_root(answer.level.comm, _answer, answer, arrays, path)


def draw_convergence(rows: Sequence[Mapping[str, Any]], varied: Sequence[str], path: Path) -> None:
    """Measured quantities against eps or h, with the slopes of the paper (one rank)."""
    by = parameter(varied)
    figure, axes = _figure(6.0, 4.6)
    drawn = quantities(varied, rows[-1])
    x = np.array([row[by] for row in rows], dtype=float)
    for number, quantity in enumerate(drawn):
        y = np.array([lookup(row, quantity.key) for row in rows], dtype=float)
        style = {"color": COLOURS[number], "marker": MARKERS[number], "markersize": 5}
        axes.loglog(x, y, label=quantity.tex, **style)
        # the expected slope, from just below the first value
        slope = 0.75 * y[0] * (x / x[0]) ** quantity.order
        axes.loglog(x, slope, ":", color=COLOURS[number], linewidth=1)
    axes.plot([], [], ":", color="grey", label="expected slopes")
    axes.set_xlabel(f"{by}   ({'h' if by == 'eps' else 'eps'}: {_other(rows, by)})")
    axes.set_ylabel("against the solution of SNES VI" if by == "eps" else "error")
    _finish(figure, axes, rows, path)


def draw_cost(rows: Sequence[Mapping[str, Any]], varied: Sequence[str], path: Path) -> None:
    """What accuracy costs: the first measured quantity against the time of the solve (one rank)."""
    figure, axes = _figure(6.0, 4.6)
    quantity = quantities(varied, rows[-1])[0]
    seconds = [lookup(row, "seconds.solve") for row in rows]
    axes.loglog(seconds, [lookup(row, quantity.key) for row in rows], "o-", color=COLOURS[0], label=quantity.tex)
    for row, time in zip(rows, seconds, strict=True):
        label = f"{row['dofs']} unknowns" if parameter(varied) == "h" else f"eps = {row['eps']:.0e}"
        at = (time, lookup(row, quantity.key))
        axes.annotate(label, at, textcoords="offset points", xytext=(6, 4), fontsize=7)
    axes.set_xlabel("seconds of the solve")
    axes.set_ylabel(quantity.tex)
    axes.margins(x=0.2)
    _finish(figure, axes, rows, path)


def _answer(answer: Answer, arrays: Mapping[str, np.ndarray], path: Path) -> None:
    draw: dict[int, Callable[..., Any]] = {2: _line, 3: _surface}
    vertices = arrays["cells"].shape[1]
    if vertices not in draw:
        raise InputError("pictures are drawn of intervals and surfaces; open fields.xdmf in ParaView for a solid")
    figure = draw[vertices](answer, arrays)
    figure.suptitle(answer.scene.tables.title or answer.scene.name, fontsize=11)
    _save(figure, path)


def _line(answer: Answer, arrays: Mapping[str, np.ndarray]) -> Any:
    order = np.argsort(arrays["points"][:, 0])
    x = arrays["points"][order, 0]
    figure, (top, bottom) = _figure(6.4, 5.4, rows=2)
    for side in ("lower", "upper"):
        if side in arrays:
            top.plot(x, arrays[side][order], color="0.55", linestyle="--", label=f"{side} obstacle")
    top.plot(x, arrays["u"][order], color=COLOURS[0], label=answer.scene.tables.u)
    touching = arrays["contact"][order] > 0
    top.plot(x[touching], arrays["u"][order][touching], ".", color=COLOURS[1], markersize=4, label="contact")
    top.set_ylabel(answer.scene.tables.u)
    top.legend(fontsize=8)
    bottom.plot(x, arrays["pressure"][order], color=COLOURS[1])
    bottom.set_ylabel("contact pressure p")
    bottom.set_xlabel("x")
    return figure


def _surface(answer: Answer, arrays: Mapping[str, np.ndarray]) -> Any:
    from matplotlib.tri import Triangulation

    x, y = arrays["points"][:, 0], arrays["points"][:, 1]
    mesh = Triangulation(x, y, arrays["cells"])
    figure, axes = _figure(11.0, 4.2, columns=2)
    fields = (("u", answer.scene.tables.u, "viridis"), ("pressure", "contact pressure p", "cividis"))
    for axis, (name, label, colours) in zip(axes, fields, strict=True):
        image = axis.tripcolor(mesh, arrays[name], shading="gouraud", cmap=colours)
        figure.colorbar(image, ax=axis, label=label, shrink=0.9)
        if 0 < arrays["contact"].sum() < len(x):
            # the free boundary: halfway between nodes in and out of contact
            axis.tricontour(mesh, arrays["contact"], levels=[0.5], colors=COLOURS[1], linewidths=1.2)
        axis.set_aspect("equal")
        axis.set_xlabel("x")
        axis.set_ylabel("y")
    axes[0].plot([], [], color=COLOURS[1], label="free boundary")
    axes[0].legend(fontsize=8, loc="lower left")
    return figure


def _other(rows: Sequence[Mapping[str, Any]], by: str) -> str:
    values = [row["h" if by == "eps" else "eps"] for row in rows]
    if None in values:
        return "none, SNES VI"
    return f"{values[0]:.3g}" if len(set(values)) == 1 else f"{values[0]:.1e} to {values[-1]:.1e}"


def _figure(width: float, height: float, rows: int = 1, columns: int = 1) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=150, constrained_layout=True)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, sharex=rows > 1)


def _finish(figure: Any, axes: Any, rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    axes.grid(True, which="major", color="0.9")
    axes.legend(fontsize=8)
    axes.set_title(f"{rows[0]['title'] or rows[0]['scene']} ({rows[0]['element']}, {rows[0]['method']})", fontsize=10)
    _save(figure, path)


def _save(figure: Any, path: Path) -> None:
    scratch = path.with_name(f".{path.stem}.part.png")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(scratch)
    scratch.replace(path)

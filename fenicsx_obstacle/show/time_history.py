"""Pictures of a scene with [time]: output quantities over t, contact sets, and an animation. Rank 0 draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.time_history import Frame, TimeHistory
from fenicsx_obstacle.show.boundary import Patch, free_boundary, patch_of
from fenicsx_obstacle.show.figures import (
    BLUE,
    COLOURS,
    VERMILION,
    blank,
    figure,
    heading,
    plain,
    save,
    steady,
    terms_of,
    write_gif,
)
from fenicsx_obstacle.show.maps import colours, draw_edges, hatch_obstacles, triangles
from fenicsx_obstacle.text import title_of

HISTORY, ANIMATION = "history.png", "answer.gif"
COUNTS = ("step", "t", "dt", "newton", "krylov")
USUAL = ("energy", "kinetic", "contact_area", "force_lower", "force_upper", "penetration")
SHOWN = 6  # moments in the picture of the fields
LINES = 9  # free boundaries in it
PER_SECOND = 10  # frames of the animation

Arrays = Mapping[str, np.ndarray]


def draw_course(answer: Answer, arrays: Arrays, path: Path) -> str:
    """Draw the figures of all steps over t, with the fields at some moments where there are any (one rank).

    Args:
        answer: With its course.
        arrays: Points and cells of the answer.
        path: PNG, PDF or SVG.

    Returns:
        One line: what is drawn.
    """
    time_history, name = _course(answer), plain(_moments(answer).name)
    columns = [column for column in _columns(time_history) if np.isfinite(time_history.column(column)).any()]
    report = answer.scene.tables.report
    fields = bool(time_history.frames) and _drawable(arrays)
    heights = [3.4] * fields + [2.1] * -(-len(columns) // 3)  # fields in one row, then three figures in each
    page = blank(10.0, sum(heights) + 0.5)
    grid = page.add_gridspec(len(heights), 6, height_ratios=heights)
    if fields:
        draw = _lines if arrays["cells"].shape[1] == 2 else _maps
        draw(page, grid, answer, arrays, [time_history.frames[k] for k in _chosen(time_history.frames)])
    for number, column in enumerate(columns):
        row, place = divmod(number, 3)
        axis = page.add_subplot(grid[fields + row, 2 * place : 2 * place + 2])
        terms = terms_of(report.get(column), report)
        size = max((float(np.nanmax(np.abs(time_history.column(one)), initial=0.0)) for one in terms), default=0.0)
        values = steady(time_history.column(column), size)
        axis.plot(time_history.column("t"), values, color=COLOURS[number % len(COLOURS)], linewidth=1.6)
        axis.set_xlabel(name)
        axis.set_title(plain(column.replace("_", " ")), fontsize=9)
    page.suptitle(heading(title_of(answer.scene.tables.title, answer.scene.name)), fontsize=12)
    save(page, path)
    return f"{path}: {', '.join(column.replace('_', ' ') for column in columns)} over {_moments(answer).name}"


def _chosen(frames: Sequence[Frame]) -> list[int]:
    """Numbers of the moments that are drawn: at equal distances, but one has the largest contact set."""
    chosen = np.unique(np.linspace(0, len(frames) - 1, SHOWN).round().astype(int))
    sizes = [np.count_nonzero(frame.fields["contact"] > 0.5) for frame in frames]
    most = int(np.argmax(sizes))
    if sizes[most] > 0 and most not in chosen and len(chosen) > 2:
        inner = chosen[1:-1]
        inner[np.argmin(np.abs(inner - most))] = most
    return sorted(map(int, chosen))


def animate(answer: Answer, arrays: Arrays, path: Path) -> str:
    """Draw the fields at all moments that were kept, as a GIF (one rank).

    Returns:
        One line: what is drawn.
    """
    frames = _course(answer).frames
    page, draw = (_moving_line if arrays["cells"].shape[1] == 2 else _moving_map)(answer, arrays)

    def draw_moment(frame: Frame) -> None:
        draw(frame)
        page.suptitle(f"{plain(_moments(answer).name)} = {frame.t:.4g}", fontsize=11)

    write_gif(page, path, PER_SECOND, frames, draw_moment)
    return f"{path}: {len(frames)} moments"


def is_animated(answer: Answer, arrays: Arrays) -> bool:
    """Whether an animation can show it: plane fields at several moments."""
    return len(_course(answer).frames) > 1 and _drawable(arrays)


def _drawable(arrays: Arrays) -> bool:
    """Whether u is scalar, on an interval or a plane mesh: others are for ParaView."""
    dim = arrays["cells"].shape[1] - 1
    return arrays["u"].ndim == 1 and dim == int(arrays["gdim"]) and dim < 3


def _course(answer: Answer) -> TimeHistory:
    assert answer.time_history is not None
    return answer.time_history


def _moments(answer: Answer) -> Any:
    assert answer.scene.time is not None
    return answer.scene.time


def _columns(time_history: TimeHistory) -> list[str]:
    """Names of the figures: those of [report] first."""
    names = list(dict.fromkeys(name for row in time_history.rows for name in row if name not in COUNTS))
    return [name for name in names if name not in USUAL] + [name for name in names if name in USUAL[:-1]]


def _lines(page: Any, grid: Any, answer: Answer, arrays: Arrays, chosen: Sequence[Frame]) -> None:
    """u over the interval at some moments; beside it, where it was in contact at all of them."""
    from matplotlib import colormaps

    left, right = page.add_subplot(grid[0, :3]), page.add_subplot(grid[0, 3:])
    x, order = _from_left(arrays)
    name = plain(_moments(answer).name)
    hatch_obstacles(left, x, _ordered(chosen[-1], order), _range(chosen, "u"))
    for frame, shade in zip(chosen, np.linspace(0.0, 0.9, len(chosen)), strict=True):
        left.plot(x, frame.fields["u"][order], color=colormaps["viridis"](shade), linewidth=1.6, label=f"{frame.t:.3g}")
    left.set(xlabel="x", ylabel=plain(answer.scene.tables.u))
    moments = left.lines[-len(chosen) :]  # beside the panel: within it they would cover some of its lines
    left.legend(handles=moments, fontsize=7, title=name, title_fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
    frames = _course(answer).frames[1:]
    touching = np.array([frame.fields["contact"][order] > 0.5 for frame in frames])
    if touching.any():
        times = np.array([frame.t for frame in frames])
        pressed = np.where(touching, 1.0, np.nan)
        right.pcolormesh(x, times, pressed, cmap="autumn", vmin=0, vmax=4, shading="nearest")
        right.set(xlabel="x", ylabel=name, xlim=(x[0], x[-1]))
        right.set_title("in contact", fontsize=9)
    else:
        right.set_axis_off()
        right.text(0.5, 0.5, "no contact at these times", ha="center", transform=right.transAxes)


def _maps(page: Any, grid: Any, answer: Answer, arrays: Arrays, chosen: Sequence[Frame]) -> None:
    """u from above when the contact set is largest and at the end, contact outlined; the free boundary over time."""
    scale, name = colours(*_range(chosen, "u"), "viridis"), plain(_moments(answer).name)
    most = max(chosen, key=lambda frame: float(np.count_nonzero(frame.fields["contact"] > 0.5)))
    shown = [most, chosen[-1]] if most is not chosen[-1] else [chosen[len(chosen) // 2], most]
    for number, frame in enumerate(shown):
        axis = page.add_subplot(grid[0, 2 * number : 2 * number + 2])
        _map(axis, arrays, frame, scale)
        axis.set_title(f"{name} = {frame.t:.3g}", fontsize=9)
    page.colorbar(scale, ax=axis, label=plain(answer.scene.tables.u), shrink=0.8)
    axis = page.add_subplot(grid[0, 4:])
    _free_boundaries(page, axis, arrays, _course(answer).frames, name)


def _free_boundaries(page: Any, axis: Any, arrays: Arrays, frames: Sequence[Frame], name: str) -> None:
    """The edge of the contact set at `LINES` moments, in colours that stand for the time."""
    scale = colours(frames[0].t, frames[-1].t, "plasma")
    for number in np.unique(np.linspace(0, len(frames) - 1, LINES).round().astype(int)):
        frame = frames[number]
        patch = patch_of({**frame.fields, "points": arrays["points"], "cells": arrays["cells"]})
        for line in free_boundary(patch):
            draw_edges(axis, line.points, line.cells, colors=[scale.to_rgba(frame.t)], linewidths=1.2)
    low, high = arrays["points"].min(axis=0), arrays["points"].max(axis=0)
    axis.set(aspect="equal", xlabel="x", ylabel="y", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axis.set_title("free boundary", fontsize=9)
    page.colorbar(scale, ax=axis, label=name, shrink=0.8)


def _map(axis: Any, arrays: Arrays, frame: Frame, scale: Any) -> None:
    """u in colours, the edge of contact as a line."""
    surface = triangles(Patch(arrays["points"], arrays["cells"], {}))
    axis.tripcolor(surface, frame.fields["u"], shading="gouraud", norm=scale.norm, cmap=scale.cmap)
    contact = frame.fields["contact"]
    if 0 < contact.sum() < len(contact):
        axis.tricontour(surface, contact, levels=[0.5], colors="white", linewidths=1.2)
    axis.set(aspect="equal", xlabel="x", ylabel="y")


def _moving_line(answer: Answer, arrays: Arrays) -> tuple[Any, Callable[[Frame], None]]:
    page, (top, bottom) = figure(6.4, 4.6, rows=2, sharex=True)
    frames, (x, order) = _course(answer).frames, _from_left(arrays)
    limits, (least, most) = _range(frames, "u"), _range(frames[1:] or frames, "pressure")

    def draw(frame: Frame) -> None:
        top.clear()
        bottom.clear()
        fields = _ordered(frame, order)
        hatch_obstacles(top, x, fields, limits)
        top.plot(x, fields["u"], color=BLUE, linewidth=2)
        top.set_ylabel(plain(answer.scene.tables.u))
        bottom.fill_between(x, fields["pressure"], color=VERMILION, alpha=0.4, linewidth=0)
        bottom.set(ylim=(least, most or 1.0), xlabel="x", ylabel="contact pressure p")

    return page, draw


def _moving_map(answer: Answer, arrays: Arrays) -> tuple[Any, Callable[[Frame], None]]:
    page, axis = figure(5.6, 4.8)
    scale = colours(*_range(_course(answer).frames, "u"), "viridis")
    page.colorbar(scale, ax=axis, label=plain(answer.scene.tables.u))

    def draw(frame: Frame) -> None:
        axis.clear()
        _map(axis, arrays, frame, scale)

    return page, draw


def _from_left(arrays: Arrays) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the nodes of an interval from left to right, and their numbers."""
    order = np.argsort(arrays["points"][:, 0])
    return arrays["points"][order, 0], order


def _ordered(frame: Frame, order: np.ndarray) -> dict[str, np.ndarray]:
    return {name: values[order] for name, values in frame.fields.items()}


def _range(frames: Sequence[Frame], name: str) -> tuple[float, float]:
    values = [frame.fields[name] for frame in frames]
    return float(min(v.min() for v in values)), float(max(v.max() for v in values))

"""Pictures of a scene with [time]: output quantities over t, contact sets, and an animation. Rank 0 draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.time_history import Frame
from fenicsx_obstacle.scenes.from_tables import COUNTS, USUAL
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
from fenicsx_obstacle.show.free_boundary import free_boundary, patch_of
from fenicsx_obstacle.show.maps import colours, draw_edges, hatch_obstacles, triangles

HISTORY, ANIMATION = "history.png", "answer.gif"
SHOWN = 6  # moments in the picture of the fields, beside the one with the largest contact set
LINES = 9  # free boundaries in it
PER_SECOND = 10  # frames of the animation

Arrays = Mapping[str, np.ndarray]


def draw_course(answer: Answer, arrays: Arrays, folder: Path, picture: bool) -> tuple[Path, str]:
    """Draw the course of an answer and, if asked for, the animation (one rank).

    Args:
        answer: With its course.
        arrays: Points and cells of the answer.
        folder: Where the pictures go.
        picture: Whether to draw the animation, if one can show it: scalar u on an interval or a plane mesh, at several
            moments.

    Returns:
        The picture of the course; and what is drawn, a line for each file.
    """
    course, path, animation = _Course(answer, arrays), folder / HISTORY, folder / ANIMATION
    said = f"\n  {path}: {course.draw(path)}"
    if picture and course.is_animated:
        said += f"\n  {animation}: {course.animate(animation)}"
    return path, said


class _Course:
    """The course of an answer in pictures; what is drawn is returned in words."""

    def __init__(self, answer: Answer, arrays: Arrays):
        assert answer.time_history is not None
        assert answer.scene.time is not None
        self._history, self._frames = answer.time_history, answer.time_history.frames
        self._name, self._report, self._title = answer.scene.time.name, answer.scene.tables.report, answer.title
        self._t, self._u = plain(self._name), plain(answer.scene.tables.u)
        self._arrays, dim = arrays, arrays["cells"].shape[1] - 1
        self._drawable = arrays["u"].ndim == 1 and dim == int(arrays["gdim"]) and dim < 3  # others are for ParaView
        self._order = np.argsort(arrays["points"][:, 0])  # of the nodes of an interval, from left to right
        self._x, self._on_line = arrays["points"][self._order, 0], dim == 1
        self.is_animated = len(self._frames) > 1 and self._drawable

    def draw(self, path: Path) -> str:
        """Draw the figures of all steps over t, with the fields at some moments where there are any."""
        names = list(dict.fromkeys(name for row in self._history.rows for name in row if name not in ("t", *COUNTS)))
        names = [name for name in names if name not in USUAL] + [name for name in names if name in USUAL[:-1]]
        values = {name: self._history.column(name) for name in names}
        columns = {name: column for name, column in values.items() if np.isfinite(column).any()}
        fields = bool(self._frames) and self._drawable
        heights = [3.4] * fields + [2.1] * -(-len(columns) // 3)  # fields in one row, then three figures in each
        page = blank(10.0, sum(heights) + 0.5)
        grid = page.add_gridspec(len(heights), 6, height_ratios=heights)
        if fields:
            draw = self._lines if self._on_line else self._maps
            draw(page, grid, [self._frames[k] for k in _chosen(self._frames)])
        for number, (name, column) in enumerate(columns.items()):
            row, place = divmod(number, 3)
            axis = page.add_subplot(grid[fields + row, 2 * place : 2 * place + 2])
            terms = terms_of(self._report.get(name), self._report)
            size = max((float(np.nanmax(np.abs(values[one]), initial=0.0)) for one in terms), default=0.0)
            colour = COLOURS[number % len(COLOURS)]
            axis.plot(self._history.column("t"), steady(column, size), color=colour, linewidth=1.6)
            axis.set_xlabel(self._t)
            axis.set_title(plain(name.replace("_", " ")), fontsize=9)
        page.suptitle(heading(self._title), fontsize=12)
        save(page, path)
        return f"{', '.join(name.replace('_', ' ') for name in columns)} over {self._name}"

    def animate(self, path: Path) -> str:
        """Draw the fields at all moments that were kept, as a GIF."""
        page, draw = self._moving_line() if self._on_line else self._moving_map()

        def draw_moment(frame: Frame) -> None:
            draw(frame)
            page.suptitle(f"{self._t} = {frame.t:.4g}", fontsize=11)

        write_gif(page, path, PER_SECOND, self._frames, draw_moment)
        return f"{len(self._frames)} moments"

    def _lines(self, page: Any, grid: Any, chosen: Sequence[Frame]) -> None:
        """u over the interval at some moments; beside it, where it was in contact at all of them."""
        from matplotlib import colormaps

        left, right = page.add_subplot(grid[0, :3]), page.add_subplot(grid[0, 3:])
        x, order = self._x, self._order
        hatch_obstacles(left, x, self._ordered(chosen[-1]), _range(chosen, "u"))
        for frame, shade in zip(chosen, np.linspace(0.0, 0.9, len(chosen)), strict=True):
            colour = colormaps["viridis"](shade)
            left.plot(x, frame.fields["u"][order], color=colour, linewidth=1.6, label=f"{frame.t:.3g}")
        left.set(xlabel="x", ylabel=self._u)
        moments = left.lines[-len(chosen) :]  # beside the panel: within it they would cover some of its lines
        left.legend(handles=moments, fontsize=7, title=self._t, title_fontsize=7, loc="center left",
                    bbox_to_anchor=(1, 0.5))  # fmt: skip
        touching = np.array([frame.fields["contact"][order] > 0.5 for frame in self._frames])
        if touching.any():
            times = np.array([frame.t for frame in self._frames])
            pressed = np.where(touching, 1.0, np.nan)
            right.pcolormesh(x, times, pressed, cmap="autumn", vmin=0, vmax=4, shading="nearest")
            right.set(xlabel="x", ylabel=self._t, xlim=(x[0], x[-1]), ylim=(times[0], times[-1]))
            right.set_title("in contact", fontsize=9)
        else:
            right.set_axis_off()
            right.text(0.5, 0.5, "no contact at these times", ha="center", transform=right.transAxes)

    def _maps(self, page: Any, grid: Any, chosen: Sequence[Frame]) -> None:
        """u from above when the contact set is largest and at the end, contact outlined; the free boundary over
        time."""
        scale = colours(*_range(chosen, "u"), "viridis")
        most = max(chosen, key=lambda frame: float(np.count_nonzero(frame.fields["contact"] > 0.5)))
        shown = [most, chosen[-1]] if most is not chosen[-1] else [chosen[len(chosen) // 2], most]
        for number, frame in enumerate(shown):
            axis = page.add_subplot(grid[0, 2 * number : 2 * number + 2])
            self._map(axis, frame, scale)
            axis.set_title(f"{self._t} = {frame.t:.3g}", fontsize=9)
        page.colorbar(scale, ax=axis, label=self._u, shrink=0.8)
        self._free_boundaries(page, page.add_subplot(grid[0, 4:]))

    def _free_boundaries(self, page: Any, axis: Any) -> None:
        """The edge of the contact set at `LINES` moments, in colours that stand for the time."""
        frames, points = self._frames, self._arrays["points"]
        scale = colours(frames[0].t, frames[-1].t, "plasma")
        for number in np.unique(np.linspace(0, len(frames) - 1, LINES).round().astype(int)):
            frame = frames[number]
            patch = patch_of({**frame.fields, "points": points, "cells": self._arrays["cells"]})
            for line in free_boundary(patch):
                draw_edges(axis, line.points, line.cells, colors=[scale.to_rgba(frame.t)], linewidths=1.2)
        low, high = points.min(axis=0), points.max(axis=0)
        axis.set(aspect="equal", xlabel="x", ylabel="y", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axis.set_title("free boundary", fontsize=9)
        page.colorbar(scale, ax=axis, label=self._t, shrink=0.8)

    def _map(self, axis: Any, frame: Frame, scale: Any) -> None:
        """u in colours, the edge of contact as a line."""
        surface = triangles(self._arrays["points"], self._arrays["cells"])
        axis.tripcolor(surface, frame.fields["u"], shading="gouraud", norm=scale.norm, cmap=scale.cmap)
        contact = frame.fields["contact"]
        if 0 < contact.sum() < len(contact):
            axis.tricontour(surface, contact, levels=[0.5], colors="white", linewidths=1.2)
        axis.set(aspect="equal", xlabel="x", ylabel="y")

    def _moving_line(self) -> tuple[Any, Callable[[Frame], None]]:
        page, (top, bottom) = figure(6.4, 4.6, rows=2, sharex=True)
        limits, (least, most) = _range(self._frames, "u"), _range(self._frames[1:] or self._frames, "pressure")

        def draw(frame: Frame) -> None:
            top.clear()
            bottom.clear()
            fields = self._ordered(frame)
            hatch_obstacles(top, self._x, fields, limits)
            top.plot(self._x, fields["u"], color=BLUE, linewidth=2)
            top.set_ylabel(self._u)
            bottom.fill_between(self._x, fields["pressure"], color=VERMILION, alpha=0.4, linewidth=0)
            bottom.set(ylim=(least, most or 1.0), xlabel="x", ylabel="contact pressure p")

        return page, draw

    def _moving_map(self) -> tuple[Any, Callable[[Frame], None]]:
        page, axis = figure(5.6, 4.8)
        scale = colours(*_range(self._frames, "u"), "viridis")
        page.colorbar(scale, ax=axis, label=self._u)

        def draw(frame: Frame) -> None:
            axis.clear()
            self._map(axis, frame, scale)

        return page, draw

    def _ordered(self, frame: Frame) -> dict[str, np.ndarray]:
        return {name: values[self._order] for name, values in frame.fields.items()}


def _chosen(frames: Sequence[Frame]) -> list[int]:
    """Numbers of the moments that are drawn: at equal distances, and the one with the largest contact set."""
    sizes = [np.count_nonzero(frame.fields["contact"] > 0.5) for frame in frames]
    most = [int(np.argmax(sizes))] if any(sizes) else []
    return sorted({*np.linspace(0, len(frames) - 1, SHOWN).round().astype(int).tolist(), *most})


def _range(frames: Sequence[Frame], name: str) -> tuple[float, float]:
    values = [frame.fields[name] for frame in frames]
    return float(min(v.min() for v in values)), float(max(v.max() for v in values))

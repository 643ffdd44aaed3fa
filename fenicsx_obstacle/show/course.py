"""Pictures of a scene with [time]: its figures over t, where it was in contact, and an animation. Rank 0 draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.course import Course, Frame
from fenicsx_obstacle.show.boundary import SIDES, Patch
from fenicsx_obstacle.show.figures import BLUE, COLOURS, VERMILION, figure, heading, plain, save, write_gif
from fenicsx_obstacle.show.maps import hatch_obstacles, triangles
from fenicsx_obstacle.words import title_of

HISTORY, ANIMATION = "history.png", "answer.gif"
COUNTS = ("step", "t", "dt", "newton", "krylov")
SHOWN = 6  # moments in the picture of the fields
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
    course, name = _course(answer), plain(_moments(answer).name)
    columns = [column for column in _columns(course) if np.isfinite(course.column(column)).any()]
    fields = _fields_of(answer, arrays)
    rows = -(-len(columns) // 3)
    page = _page(fields is not None, rows, len(columns))
    if fields is not None:
        fields(page)
    t = course.column("t")
    for number, column in enumerate(columns):
        axis = page.panels[number]
        values = course.column(column)
        axis.plot(t, values, color=COLOURS[number % len(COLOURS)], linewidth=1.6)
        axis.set(title=plain(column.replace("_", " ")), xlabel=name)
        axis.title.set_fontsize(9)
    page.sheet.suptitle(heading(title_of(answer.scene.tables.title, answer.scene.name)), fontsize=12)
    save(page.sheet, path)
    return f"{path}: {', '.join(column.replace('_', ' ') for column in columns)} over {_moments(answer).name}"


def animate(answer: Answer, arrays: Arrays, path: Path) -> str:
    """Draw the fields at all moments that were kept, as a GIF (one rank).

    Returns:
        One line: what is drawn.
    """
    course, (page, draw) = _course(answer), moving(answer, arrays)
    write_gif(page, path, PER_SECOND, course.frames, draw)
    return f"{path}: {len(course.frames)} moments"


def moving(answer: Answer, arrays: Arrays) -> tuple[Any, Callable[[Frame], None]]:
    """A figure of the fields, and what draws one moment into it (one rank)."""
    course, dim = _course(answer), arrays["cells"].shape[1] - 1
    page, draw = (_moving_line if dim == 1 else _moving_map)(answer, course, arrays)

    def draw_moment(frame: Frame) -> None:
        draw(frame)
        page.suptitle(f"{plain(_moments(answer).name)} = {frame.t:.4g}", fontsize=11)

    return page, draw_moment


def is_animated(answer: Answer, arrays: Arrays) -> bool:
    """Whether an animation can show it: plane fields at several moments."""
    return len(_course(answer).frames) > 1 and _drawable(arrays)


def _drawable(arrays: Arrays) -> bool:
    """Whether it is an interval or a plane mesh: others are for ParaView."""
    dim = arrays["cells"].shape[1] - 1
    return dim == int(arrays["gdim"]) and dim < 3


class _page:
    """Panels of a sheet: one wide row for fields, then three columns of figures."""

    def __init__(self, fields: bool, rows: int, count: int):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        heights = [3.4] * fields + [2.1] * rows
        self.sheet = Figure(figsize=(10.0, sum(heights) + 0.5), dpi=150, constrained_layout=True)
        FigureCanvasAgg(self.sheet)
        grid = self.sheet.add_gridspec(len(heights), 6, height_ratios=heights)
        self.grid = grid
        self.panels = [
            self.sheet.add_subplot(grid[fields + number // 3, 2 * (number % 3) : 2 * (number % 3) + 2])
            for number in range(count)
        ]


def _course(answer: Answer) -> Course:
    assert answer.course is not None
    return answer.course


def _moments(answer: Answer) -> Any:
    assert answer.scene.time is not None
    return answer.scene.time


def _columns(course: Course) -> list[str]:
    """Names of the figures: those of [report] first."""
    names = list(dict.fromkeys(name for row in course.rows for name in row if name not in COUNTS))
    usual = ("energy", "kinetic", "contact_area", "force_lower", "force_upper", "penetration")
    return [name for name in names if name not in usual] + [name for name in names if name in usual[:-1]]


def _fields_of(answer: Answer, arrays: Arrays) -> Callable[[Any], None] | None:
    """What draws the fields at some moments: lines and a map of contact, or maps; None without frames."""
    frames, size = _course(answer).frames, arrays["cells"].shape[1]
    if not frames or not _drawable(arrays):
        return None
    chosen = [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, SHOWN).round().astype(int))]
    draw = _lines if size == 2 else _maps
    return lambda page: draw(page, answer, arrays, chosen)


def _lines(page: Any, answer: Answer, arrays: Arrays, chosen: list[Frame]) -> None:
    """u over the interval at some moments; beside it, where it was in contact at all of them."""
    left, right = (page.sheet.add_subplot(page.grid[0, place]) for place in (slice(0, 3), slice(3, 6)))
    order = np.argsort(arrays["points"][:, 0])
    x, name = arrays["points"][order, 0], plain(_moments(answer).name)
    import matplotlib

    fields = {side: chosen[-1].fields[side][order] for side in SIDES if side in chosen[-1].fields}
    hatch_obstacles(left, x, fields, _range(chosen, "u"))
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, len(chosen)))
    for frame, shade in zip(chosen, shades, strict=True):
        left.plot(x, frame.fields["u"][order], color=shade, linewidth=1.6, label=f"{frame.t:.3g}")
    left.set(xlabel="x", ylabel=plain(answer.scene.tables.u))
    left.legend(fontsize=7, title=name, title_fontsize=7)
    frames = _course(answer).frames[1:]
    touching = np.array([frame.fields["contact"][order] > 0.5 for frame in frames])
    pressed = np.where(touching, 1.0, np.nan)
    times = np.array([frame.t for frame in frames])
    if touching.any():
        right.pcolormesh(x, times, pressed, cmap="autumn", vmin=0, vmax=4, shading="nearest")
        right.set(xlabel="x", ylabel=name, title="in contact", xlim=(x[0], x[-1]))
        right.title.set_fontsize(9)
    else:
        right.set_axis_off()
        right.text(0.5, 0.5, "no contact at these moments", ha="center", transform=right.transAxes)


def _maps(page: Any, answer: Answer, arrays: Arrays, chosen: list[Frame]) -> None:
    """u from above at some moments, contact outlined."""
    low, high = _range(chosen, "u")
    shown = chosen[-3:] if len(chosen) < SHOWN else [chosen[k] for k in (1, 3, 5)]
    for number, frame in enumerate(shown):
        axis = page.sheet.add_subplot(page.grid[0, 2 * number : 2 * number + 2])
        colours = _map(axis, answer, arrays, frame, low, high)
        axis.set_title(f"{plain(_moments(answer).name)} = {frame.t:.3g}", fontsize=9)
    page.sheet.colorbar(colours, ax=axis, label=plain(answer.scene.tables.u), shrink=0.8)


def _map(axis: Any, answer: Answer, arrays: Arrays, frame: Frame, low: float, high: float) -> Any:
    """u in colours, the edge of contact as a line."""
    surface = triangles(Patch(arrays["points"], arrays["cells"], {}))
    colours = axis.tripcolor(surface, frame.fields["u"], shading="gouraud", vmin=low, vmax=high, cmap="viridis")
    contact = frame.fields["contact"]
    if 0 < contact.sum() < len(contact):
        axis.tricontour(surface, contact, levels=[0.5], colors="white", linewidths=1.2)
    axis.set(aspect="equal", xlabel="x", ylabel="y")
    return colours


def _range(frames: Any, name: str) -> tuple[float, float]:
    values = [frame.fields[name] for frame in frames]
    return float(min(v.min() for v in values)), float(max(v.max() for v in values))


def _moving_line(answer: Answer, course: Course, arrays: Arrays) -> tuple[Any, Callable[[Frame], None]]:
    page, (top, bottom) = figure(6.4, 4.6, rows=2, sharex=True)
    order = np.argsort(arrays["points"][:, 0])
    x = arrays["points"][order, 0]
    limits = _range(course.frames, "u")
    pressures = _range(course.frames[1:] or course.frames, "pressure")

    def draw(frame: Frame) -> None:
        top.clear()
        bottom.clear()
        fields = {name: values[order] for name, values in frame.fields.items()}
        hatch_obstacles(top, x, fields, limits)
        top.plot(x, fields["u"], color=BLUE, linewidth=2)
        top.set_ylabel(plain(answer.scene.tables.u))
        bottom.fill_between(x, fields["pressure"], color=VERMILION, alpha=0.4, linewidth=0)
        bottom.set(ylim=(pressures[0], pressures[1] or 1.0), xlabel="x", ylabel="contact pressure p")

    return page, draw


def _moving_map(answer: Answer, course: Course, arrays: Arrays) -> tuple[Any, Callable[[Frame], None]]:
    page, axis = figure(5.6, 4.8)
    low, high = _range(course.frames, "u")
    bar: list[Any] = []

    def draw(frame: Frame) -> None:
        axis.clear()
        colours = _map(axis, answer, arrays, frame, low, high)
        if not bar:
            bar.append(page.colorbar(colours, ax=axis, label=plain(answer.scene.tables.u)))

    return page, draw

"""Matplotlib figures without a display, written to files."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.safe_writing import replaced
from fenicsx_obstacle.text import one_line

# Okabe and Ito's colours, told apart by colour-blind readers; each line has a marker of its own as well
BLUE, VERMILION, *_ = COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
INK = "#111111"  # of free boundaries
MARKERS = ("o", "s", "^", "D")
KINDS = (".png", ".pdf", ".svg")
ROUND_OFF = 1e-11  # relative
BESIDE: Mapping[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5)}  # a legend that covers no data
# a legend above the axes, on the right: on the left is the power of ten of the upright one
ABOVE: Mapping[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncol": 4, "frameon": False}
LABEL, LINE = 60, 64  # characters of a label, and of each line of a title
FEW = 2.2  # decades
GRID = "0.9"
DASHES = ("-", "--", "-.", (0, (6, 1, 1, 1, 1, 1)))  # dots are for what is expected


def blank(width: float, height: float) -> Any:
    """A figure without axes, sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    page = Figure(figsize=(width, height), dpi=150, constrained_layout=True)
    FigureCanvasAgg(page)
    return page


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **look: Any) -> Any:
    """A figure and its axes, sizes in inches; further arguments are those of matplotlib's `subplots`."""
    page = blank(width, height)
    return page, page.subplots(rows, columns, **look)


def panels(count: int, width: float, height: float, columns: int = 3) -> tuple[Any, list[Any]]:
    """A figure with so many axes, row by row; `height` is that of a row."""
    columns = min(count, columns)
    page, grid = figure(width, height * -(-count // columns), rows=-(-count // columns), columns=columns)
    every = list(np.atleast_1d(grid).ravel())
    for axes in every[count:]:
        axes.remove()
    return page, every[:count]


def log_ticks(axes: Any) -> None:
    """Grid and ticks of two logarithmic axes: decades and, within `FEW` of them, also 2 and 5, without exponents."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        few = low > 0 and np.log10(high / low) < FEW
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,), numticks=9))
        axis.set_minor_locator(NullLocator())
        if few and low > 1e-4 and high < 1e5:
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.grid(True, color=GRID)


def legend_below(page: Any, swatches: Mapping[str, Mapping[str, Any]], line: str) -> None:
    """A legend below all panels: the look of each colour by its label, and the name of the black line, or none."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(**look, label=label) for label, look in swatches.items()]
    handles += [Line2D([], [], color=INK, label=line)] if line else []
    page.legend(handles=handles, loc="lower center", ncol=len(handles), fontsize=8, frameon=False)
    page.get_layout_engine().set(rect=(0, 0.06, 1, 0.94))


def style(number: int, dashed: int = 1) -> dict[str, Any]:
    """Colour, marker and dash of line `number`; dashes change after `dashed` lines, and later lines are thinner.

    Where lines coincide, all are seen; where colours come again, they have other markers, hollow every second time.
    """
    again, place = divmod(number, len(COLOURS))
    return {
        "color": COLOURS[place], "marker": MARKERS[(place + again) % len(MARKERS)], "markersize": 7 - 1.2 * place,
        "markerfacecolor": "white" if again % 2 else COLOURS[place],
        "linewidth": 2.4 - 0.5 * place, "linestyle": DASHES[number // dashed % len(DASHES)],
    }  # fmt: skip


def steady(values: np.ndarray, size: float = 0.0) -> np.ndarray:
    """The values, or their mean where they differ by round-off only: axes would magnify it.

    Args:
        values: What is drawn.
        size: Of the same quantity elsewhere, beside which it may be round-off.
    """
    known = values[np.isfinite(values)]
    if not known.size or np.ptp(known) > ROUND_OFF * max(np.abs(known).max(), size):
        return values
    mean = known.mean()
    return np.where(np.isfinite(values), 0.0 if abs(mean) <= ROUND_OFF * size else mean, values)


def terms_of(formula: Any, known: Mapping[str, Any]) -> list[str]:
    """The names of known quantities whose sum or difference a formula is; none of another formula.

    Such a sum may be round-off beside its terms.
    """
    names = re.split(r"\s*[+-]\s*", str(formula).strip().lstrip("+-"))
    return names if len(names) > 1 and all(name in known for name in names) else []


def digits(value: float, size: float, form: str = "g") -> str:
    """A number in digits; 0 where it is round-off beside a size, never -0."""
    return format(0.0 if abs(value) <= ROUND_OFF * size else value, form)


def plain(text: str, longest: int = LABEL) -> str:
    """A user's text for matplotlib, in one line: a dollar sign begins no formula, and long texts are cut."""
    return one_line(text, longest).replace("$", r"\$")


def heading(text: str) -> str:
    """A user's title for matplotlib, in two lines at most, without formulas."""
    lines = wrap(one_line(text), LINE, max_lines=2, placeholder=" ...")
    return "\n".join(lines).replace("$", r"\$")


def power(low: float, high: float) -> int:
    """The power of ten that leaves figures of a few digits; 0 where they are short as they are."""
    size = max(abs(low), abs(high))
    return 0 if size == 0 or 1e-2 <= size < 1e4 else 3 * math.floor(math.log10(size) / 3)


def over(label: str, exponent: int) -> str:
    """A label whose figures are divided by a power of ten."""
    return f"{label} / $10^{{{exponent}}}$" if exponent else label


@contextmanager
def missing_glyphs() -> Iterator[None]:
    """Draw within: characters that the font does not have become boxes, without a warning for each."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+", UserWarning)
        yield


def check_name(path: Path) -> None:
    """Reject an unknown format of pictures.

    Raises:
        InputError: Naming those that are.
    """
    if path.suffix.lower() not in KINDS:
        raise InputError(f"{path}: pictures are written as {', '.join(KINDS)}; the name says which")


def save(page: Any, path: Path) -> None:
    """Write a figure in one step, as its name says (one rank)."""
    with replaced(path) as scratch, missing_glyphs():
        page.savefig(scratch)


def write_gif(page: Any, path: Path, per_second: float, frames: Iterable[Any], draw: Callable[[Any], None]) -> None:
    """Write an animation in one step (one rank).

    Args:
        page: Figure.
        path: GIF.
        per_second: Frames in a second; such as are alike become one that stays longer.
        frames: What `draw` is called with.
        draw: Changes the figure.
    """
    from matplotlib.animation import PillowWriter

    writer = PillowWriter(fps=per_second)
    with replaced(path) as scratch, missing_glyphs(), writer.saving(page, str(scratch), dpi=90):
        for frame in frames:
            draw(frame)
            writer.grab_frame()

"""Figures of matplotlib without a display, and how they are written: PNG for a folder, SVG for a page."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

# Okabe and Ito's colours, told apart by colour-blind readers; each line has a marker of its own as well
BLUE, VERMILION, GREEN, PINK = COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
MARKERS = ("o", "s", "^", "D")


def figure(width: float, height: float, rows: int = 1, columns: int = 1, widths: Sequence[float] | None = None) -> Any:
    """A figure and its axes, sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    page = Figure(figsize=(width, height), dpi=150, constrained_layout=True)
    FigureCanvasAgg(page)
    return page, page.subplots(rows, columns, sharex=rows > 1, gridspec_kw={"width_ratios": widths})


def save(page: Any, path: Path) -> None:
    """Write a figure as PNG, in one step (one rank)."""
    scratch = path.with_name(f".{path.stem}.part.png")
    path.parent.mkdir(parents=True, exist_ok=True)
    page.savefig(scratch)
    scratch.replace(path)


def svg(page: Any, name: str) -> str:
    """A figure as an <svg> element for a page: it fetches nothing, and its ids begin with `name`."""
    text = io.StringIO()
    page.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    element = text.getvalue()
    element = element[element.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>", "", element, flags=re.DOTALL)
    # HTML knows the namespaces; several figures on one page must not share ids
    element = re.sub(r'\s(xmlns(:\w+)?|width|height)="[^"]*"', "", element, count=4).replace("xlink:href", "href")
    return re.sub(r'(\bid="|href="#|url\(#)', rf"\1{name}-", element)

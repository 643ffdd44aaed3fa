"""Picture of the contribution of each cell to the error bound (one rank)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.estimation.bound import Bound
from fenicsx_obstacle.show.figures import BLUE, figure, save

NAME = "bound.png"
DECADES = 4  # of shares that are told apart
MOST = 0.5  # of the bound


def draw_bound(indicator: np.ndarray, arrays: Mapping[str, np.ndarray], bound: Bound, path: Path) -> str:
    """Draw the indicator of a bound into a file.

    Args:
        indicator: Of all cells.
        arrays: The gathered answer.
        bound: Its bound.
        path: Of the picture.

    Returns:
        One line: the file, and how many cells carry most of the bound.
    """
    whole = indicator.sum()
    shares = indicator / whole if whole > 0 else np.full(len(indicator), 1 / len(indicator))
    count = np.searchsorted(np.sort(shares)[::-1].cumsum(), MOST) + 1
    words = f"{count / len(shares):.1%} of the cells contribute half of the bound"
    page, axes = figure(6.4, 5.2)
    _cells(page, axes, shares, arrays)
    most = "at most" if bound.certified else "about"
    axes.set_title(f"energy error {most} {bound.total:.3g}; {words}", fontsize=9)
    save(page, path)
    return f"{path}: {words}"


def _cells(page: Any, axes: Any, shares: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
    """The share of each cell: over an interval as steps, in the plane in colours, of solids summed along y."""
    cells, (x, y, z) = arrays["cells"], arrays["points"].T
    low = shares.max() / 10**DECADES
    if cells.shape[1] == 2:
        order = np.argsort(x[cells].min(axis=1))
        edges = np.append(x[cells[order]].min(axis=1), x.max())
        axes.stairs(np.maximum(shares[order], low), edges, baseline=low, color=BLUE, fill=True)
        axes.set(yscale="log", xlabel="x", ylabel="share of the cell in the bound", xlim=(edges[0], edges[-1]))
        return
    colours: dict[str, Any] = {"cmap": "viridis"}
    if cells.shape[1] == 3:
        norm, label, up = _norm(shares, low), "share of the cell in the bound", "y"
        drawn = axes.tripcolor(x, y, cells, facecolors=np.maximum(shares, low), norm=norm, **colours)
    else:
        across, height = (values[cells].mean(axis=1) for values in (x, z))
        count = max(round((len(cells) / 6) ** (1 / 3)), 1)
        ends = [(values.min(), values.max()) for values in (x, z)]
        summed, left, below = np.histogram2d(across, height, bins=count, range=ends, weights=shares)
        label, up = "share in the bound, summed along y", "z"
        drawn = axes.pcolormesh(left, below, summed.T, norm=_norm(summed, summed.max() / 10**DECADES), **colours)
    axes.set(aspect="equal", xlabel="x", ylabel=up)
    axes.margins(0)
    page.colorbar(drawn, ax=axes, label=label)


def _norm(values: np.ndarray, low: float) -> Any:
    from matplotlib.colors import LogNorm

    return LogNorm(low, values.max(), clip=True)

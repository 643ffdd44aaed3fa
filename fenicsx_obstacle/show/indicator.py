"""Picture of the contribution of each cell to the error bound (one rank)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.estimation.bound import Bound
from fenicsx_obstacle.parallel import gathered, on_root
from fenicsx_obstacle.show.figures import BLUE, figure, save

NAME = "bound.png"
DECADES = 4  # of shares that are told apart
MOST = 0.5  # of the bound


def draw_bound(bound: Bound, arrays: dict[str, np.ndarray], comm: MPI.Comm, path: Path) -> str:
    """Draw the indicator of a bound into a file (collective).

    Args:
        bound: With its indicator on owned cells.
        arrays: The gathered answer, on rank 0.
        comm: Of the mesh.
        path: Of the picture.

    Returns:
        One line: the file, and how many cells carry most of the bound.
    """
    assert bound.indicator is not None
    return on_root(comm, _draw, gathered(comm, bound.indicator), arrays, bound, path)


def _draw(indicator: np.ndarray, arrays: dict[str, np.ndarray], bound: Bound, path: Path) -> str:
    shares = np.sort(_shares(indicator))[::-1].cumsum()
    words = f"{(np.searchsorted(shares, MOST) + 1) / len(shares):.1%} of the cells contribute half of the bound"
    page, axes = figure(6.4, 5.2)
    _cells(page, axes, indicator, arrays)
    most = "at most" if bound.certified else "about"
    axes.set_title(f"energy error {most} {bound.total:.3g}; {words}", fontsize=9)
    save(page, path)
    return f"{path}: {words}"


def _shares(indicator: np.ndarray) -> np.ndarray:
    """The share of each cell in the bound; of a bound that is 0 all have the same."""
    whole = indicator.sum()
    return indicator / whole if whole > 0 else np.full(len(indicator), 1 / len(indicator))


def _cells(page: Any, axes: Any, indicator: np.ndarray, arrays: dict[str, np.ndarray]) -> None:
    """The share of each cell: over an interval as steps, in the plane in colours, of solids summed along y."""
    shares, cells, (x, y, z) = _shares(indicator), arrays["cells"], arrays["points"].T
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

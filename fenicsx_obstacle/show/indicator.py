"""Picture of the contribution of each cell to the error bound (one rank)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.estimation.bound import Bound
from fenicsx_obstacle.parallel import gathered, on_root
from fenicsx_obstacle.show.figures import figure, save

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
    most = "at most" if bound.words.startswith("certified") else "about"
    axes.set_title(f"energy error {most} {bound.total:.3g}; {words}", fontsize=9)
    save(page, path)
    return f"{path}: {words}"


def _shares(indicator: np.ndarray) -> np.ndarray:
    """The share of each cell in the bound; of a bound that is 0 all have the same."""
    whole = indicator.sum()
    return indicator / whole if whole > 0 else np.full(len(indicator), 1 / len(indicator))


def _cells(page: Any, axes: Any, indicator: np.ndarray, arrays: dict[str, np.ndarray]) -> None:
    from matplotlib.colors import LogNorm

    shares = _shares(indicator)
    top = shares.max()
    low = top / 10**DECADES
    x, y, _ = arrays["points"].T
    norm = LogNorm(low, top)
    drawn = axes.tripcolor(x, y, arrays["cells"], facecolors=np.maximum(shares, low), norm=norm, cmap="viridis")
    axes.set_aspect("equal")
    axes.margins(0)
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    page.colorbar(drawn, ax=axes, label="share of the cell in the bound")

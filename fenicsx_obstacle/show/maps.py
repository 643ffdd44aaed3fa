"""Fields over intervals and plane domains: obstacles, maps of the pressure and u, shares in a bound. One rank."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from fenicsx_obstacle.show.figures import BLUE, INK, figure, over, power, save
from fenicsx_obstacle.show.free_boundary import LEVELS, Patch, free_boundary, rim

if TYPE_CHECKING:
    from fenicsx_obstacle.estimation.bound import Bound

DECADES = 4  # of shares in a bound that are told apart
MOST = 0.5  # of the bound
OUT_OF_CONTACT = "#D9E7F4"  # what `render.FREE` looks like on white: outside of the domain the page stays white


def hatch_obstacles(axis: Any, x: np.ndarray, fields: Mapping[str, np.ndarray], limits: tuple[float, float]) -> None:
    """Fill the region beyond the obstacles over an interval, near u.

    Args:
        axis: Axes of matplotlib.
        x: Coordinates of the nodes, from left to right.
        fields: Values at these nodes; the obstacles among them are drawn.
        limits: Least and greatest value of u.
    """
    margin = 0.15 * (limits[1] - limits[0] or 1.0)
    low, high = limits[0] - margin, limits[1] + margin
    for side, outside in (("lower", low), ("upper", high)):
        if side in fields:
            edge = np.clip(fields[side], low, high)
            axis.fill_between(x, edge, outside, color="0.88", hatch="////", edgecolor="0.7", linewidth=0)
            if np.any(near := edge == fields[side]):
                axis.plot(x, np.where(near, edge, np.nan), color="0.35", linewidth=1, label=f"{side} obstacle")
    axis.set(xlim=(x[0], x[-1]), ylim=(low, high))


def draw_map(axis: Any, patch: Patch, scale: Any, u: str) -> None:
    """Draw the pressure and contour lines of u.

    The pressure is linear between the nodes, as the contact pressure is; it is cut at the free boundary.

    Args:
        axis: Axes of matplotlib.
        patch: Triangles in the plane, with levels.
        scale: Colours of the pressure.
        u: Name of u, for matplotlib.
    """
    from matplotlib.ticker import MaxNLocator

    shape, values = triangles(patch.points, patch.cells), patch.fields["u"]
    levels = [patch.fields[name] for name in LEVELS.values() if name in patch.fields]
    draw_domain(axis, patch)
    if levels:
        axis.tripcolor(shape, patch.fields["pressure"], shading="gouraud", cmap=scale.cmap, norm=scale.norm, zorder=1)
        apart = np.min(levels, axis=0)
        if np.any(apart > 0):
            axis.tricontourf(shape, apart, levels=[0, np.inf], colors=[OUT_OF_CONTACT], zorder=1.1)
    elif patch.fields["contact"].any():
        edges = rim(patch.cells)  # obstacles on the boundary: a wide line where there is contact
        pressed = patch.fields["contact"][edges] > 0
        within = pressed.all(axis=1)
        edges = edges[within if within.any() else pressed.any(axis=1)]  # contact of a single node has no edge within
        line = draw_edges(axis, patch.points, edges, cmap=scale.cmap, norm=scale.norm, linewidths=5, zorder=3.5)
        line.set_array(patch.fields["pressure"][edges].mean(axis=1))
    ticks = MaxNLocator(8).tick_values(values.min(), values.max())
    if np.ptp(values) > 0:
        axis.tricontour(shape, values, levels=ticks, colors="0.45", linewidths=0.6, linestyles="solid", zorder=2)
    draw_lines(axis, free_boundary(patch))
    for direction in (axis.xaxis, axis.yaxis):
        direction.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axis.set(xlabel="x", ylabel="y", frame_on=False)
    axis.tick_params(labelsize=8)
    exponent = power(values.min(), values.max())
    title = f"grey lines: {over(u, exponent)}, every {(ticks[1] - ticks[0]) / 10.0**exponent:g}"
    if np.ptp(values) == 0:
        title = f"{u} = {values[0]:.6g} everywhere"
    axis.set_title(fill(title, 48), fontsize=9)


def draw_domain(axis: Any, patch: Patch) -> None:
    """The domain in one colour, with all its boundaries as thin lines, and its frame."""
    from matplotlib.colors import ListedColormap

    shape, colour = triangles(patch.points, patch.cells), ListedColormap([OUT_OF_CONTACT])
    axis.tripcolor(shape, np.zeros(len(patch.cells)), cmap=colour, zorder=0)
    draw_edges(axis, patch.points, rim(patch.cells), colors="0.2", linewidths=0.9, zorder=3, capstyle="round")
    low, high = patch.points[:, :2].min(axis=0), patch.points[:, :2].max(axis=0)
    margin = 0.01 * max(high - low)  # for the line around the domain
    axis.set(aspect="equal", xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))


def draw_lines(axis: Any, lines: Sequence[Patch]) -> None:
    """Draw free boundaries in the plane."""
    for line in lines:
        draw_edges(axis, line.points, line.cells, colors=INK, linewidths=1.6, zorder=4)


def draw_edges(axis: Any, points: np.ndarray, edges: np.ndarray, **look: Any) -> Any:
    """Draw edges in the plane, pairs of points, as a collection of matplotlib."""
    from matplotlib.collections import LineCollection

    return axis.add_collection(LineCollection(points[edges][..., :2], **look))


def triangles(points: np.ndarray, cells: np.ndarray) -> Any:
    """Cells in the plane as a triangulation of matplotlib."""
    from matplotlib.tri import Triangulation

    return Triangulation(*points[:, :2].T, cells)


def colours(low: float, high: float, name: str) -> Any:
    """The colours of a colormap from one value to another."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(low, high), name)


def heights(values: np.ndarray) -> Any:
    """Colours from the least to the greatest value."""
    return colours(values.min(), values.max(), "YlGnBu")


def pressures(values: np.ndarray) -> Any:
    """Colours of a pressure: none is light; both signs, where there are two obstacles, go to different dark colours."""
    low, high = min(values.min(), 0.0), max(values.max(), 0.0)
    if low < 0 < high:
        both = max(-low, high)
        return colours(-both, both, "PuOr_r")
    return colours(low, 0.0, "YlOrRd_r") if low < 0 else colours(0.0, high or 1.0, "YlOrRd")


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
    _draw_shares(page, axes, shares, arrays)
    most = "at most" if bound.certified else "about"
    axes.set_title(f"energy error {most} {bound.total:.3g}; {words}", fontsize=9)
    save(page, path)
    return f"{path}: {words}"


def _draw_shares(page: Any, axes: Any, shares: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
    """The share of each cell: over an interval as steps, in the plane in colours, of solids summed along y."""
    from matplotlib.colors import LogNorm

    cells, (x, y, z) = arrays["cells"], arrays["points"].T
    low, pieces = shares.max() / 10**DECADES, len(cells) // len(shares)
    shares = np.repeat(shares, pieces)  # cells of quadratic elements are drawn in pieces
    if cells.shape[1] == 2:
        order = np.argsort(x[cells].min(axis=1))
        edges = np.append(x[cells[order]].min(axis=1), x.max())
        axes.stairs(np.maximum(shares[order], low), edges, baseline=low, color=BLUE, fill=True)
        axes.set(yscale="log", xlabel="x", ylabel="share of the cell in the bound", xlim=(edges[0], edges[-1]))
        return
    if cells.shape[1] == 3:
        norm, label, up = LogNorm(low, shares.max(), clip=True), "share of the cell in the bound", "y"
        drawn = axes.tripcolor(x, y, cells, facecolors=np.maximum(shares, low), norm=norm, cmap="viridis")
    else:
        across, height = (values[cells].mean(axis=1) for values in (x, z))
        count = max(round((len(cells) / 6) ** (1 / 3)), 1)
        ends = [(values.min(), values.max()) for values in (x, z)]
        summed, left, below = np.histogram2d(across, height, bins=count, range=ends, weights=shares / pieces)
        label, up = "share in the bound, summed along y", "z"
        norm = LogNorm(summed.max() / 10**DECADES, summed.max(), clip=True)
        drawn = axes.pcolormesh(left, below, summed.T, norm=norm, cmap="viridis")
    axes.set(aspect="equal", xlabel="x", ylabel=up)
    axes.margins(0)
    page.colorbar(drawn, ax=axes, label=label)

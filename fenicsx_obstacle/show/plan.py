"""A flat domain from above: contact in the colours of the pressure, u as contour lines, all boundaries."""

from __future__ import annotations

from typing import Any

import numpy as np

from fenicsx_obstacle.show import relief
from fenicsx_obstacle.show.boundary import free_boundary
from fenicsx_obstacle.show.figures import over, power
from fenicsx_obstacle.show.simplices import Patch, rims

OUT_OF_CONTACT = "#D9E7F4"  # what `relief.FREE` looks like on white: outside of the domain the page stays white
WIDTH = 3.4  # inches, about, of the longer side on the page
# least distances of a label's middle, in inches, from boundaries, other labels, other contour lines
ROOM = (0.2, 0.5, 0.08)


def draw_plan(page: Any, axis: Any, patch: Patch, scale: Any, u: str, pressure: str) -> None:
    """Draw it.

    Args:
        page: Figure of matplotlib.
        axis: Its axes.
        patch: Triangles in the plane, from `with_levels`.
        scale: Colours of the pressure.
        u: Name of u, for matplotlib.
        pressure: Name of the pressure.
    """
    from matplotlib.ticker import MaxNLocator

    low, high = patch.points[:, :2].min(axis=0), patch.points[:, :2].max(axis=0)
    contact, lines = relief.touching(patch), free_boundary(patch)
    axis.set(aspect="equal", xlabel="x", ylabel="y", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    edges = rims(patch)
    outline(axis, edges)
    if len(contact.cells):
        axis.tripcolor(triangles(contact), contact.fields["pressure"], shading="gouraud",
                       cmap=scale.cmap, norm=scale.norm, zorder=1)  # fmt: skip
    values = patch.fields["u"]
    ticks = MaxNLocator(8).tick_values(values.min(), values.max())
    exponent = power(values.min(), values.max())
    for part, labelled in ((contact, False), (relief.free(patch), True)):
        heights = part.fields["u"][part.cells]
        levels = ticks[(ticks > heights.min(initial=np.inf)) & (ticks < heights.max(initial=-np.inf))]
        if len(levels):
            look = {"colors": "0.45", "linewidths": 0.6, "linestyles": "solid", "alpha": 1.0 if labelled else 0.6}
            drawn = axis.tricontour(triangles(part), part.fields["u"], levels=levels, zorder=2, **look)
            if labelled:
                near = np.concatenate([*edges, *(line.points[:, :2] for line in lines)])
                places = _places(drawn.allsegs, near, low, high)
                text = {level: f"{level / 10.0**exponent:g}".replace("-", "\N{MINUS SIGN}") for level in drawn.levels}
                axis.clabel(drawn, fontsize=6.5, inline=True, inline_spacing=3, fmt=text, manual=places)
    strokes(axis, lines, (0, 1))
    for direction in (axis.xaxis, axis.yaxis):
        direction.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axis.tick_params(labelsize=8)
    axis.set_title(f"grey lines: {over(u, exponent)}", fontsize=9)
    page.colorbar(scale, ax=axis, label=pressure, shrink=0.85)


def strokes(axis: Any, lines: list[Patch], plane: tuple[int, int]) -> None:
    """The free boundary, in a plane of two coordinates."""
    from matplotlib.collections import LineCollection

    for line in lines:
        pieces = line.points[:, plane][line.cells]
        axis.add_collection(LineCollection(pieces, colors=relief.INK, linewidths=1.6, zorder=4))


def triangles(patch: Patch, plane: tuple[int, int] = (0, 1)) -> Any:
    """A patch as a triangulation of matplotlib, in a plane of two coordinates."""
    from matplotlib.tri import Triangulation

    return Triangulation(*patch.points[:, plane].T, patch.cells)


def outline(axis: Any, edges: list[np.ndarray]) -> None:
    """The domain: filled, and all its boundaries as thin lines; lines around holes run the other way round."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    whole = Path.make_compound_path(*(Path(edge, closed=True) for edge in edges))
    axis.add_patch(PathPatch(whole, facecolor=OUT_OF_CONTACT, edgecolor="none", zorder=0))
    axis.add_patch(PathPatch(whole, facecolor="none", edgecolor="0.2", linewidth=0.9, zorder=3))


def _places(
    contours: list[list[np.ndarray]], near: np.ndarray, low: np.ndarray, high: np.ndarray
) -> list[tuple[float, float]]:
    """Where contour lines have room for a label; lines without room have none.

    Args:
        contours: Pieces of each contour line, each of shape (n, 2).
        near: Points of boundaries, which labels keep away from, as they do from each other and from other lines.
        low: Lower corner of the frame, which would cut a label.
        high: Upper corner.
    """
    inch = max(high - low) / WIDTH
    whole = [np.concatenate([*pieces, np.empty((0, 2))]) for pieces in contours]
    chosen: list[np.ndarray] = []
    for number, points in enumerate(whole):
        points = points[:: 1 + len(points) // 200]
        if not len(points):
            continue
        others = np.concatenate([np.empty((0, 2)), *(line for k, line in enumerate(whole) if k != number)])
        frame = np.minimum(points - low, high - points).min(axis=1)
        distances = [np.minimum(_distance(points, near), frame), _distance(points, np.array(chosen).reshape(-1, 2)),
                     _distance(points, others)]  # fmt: skip
        room = np.min([distance / (least * inch) for distance, least in zip(distances, ROOM, strict=True)], axis=0)
        if room.max() >= 1:
            chosen.append(points[np.argmax(room)])
    return [(float(x), float(y)) for x, y in chosen]


def _distance(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """From each point to the nearest of the others."""
    gaps = points[:, None] - others[:: 1 + len(others) // 5000][None]
    return np.linalg.norm(gaps, axis=2).min(axis=1, initial=np.inf)

"""A view in space on a page: box, ticks and letters by matplotlib, the inside by pyvista or by matplotlib too."""

from __future__ import annotations

from typing import Any

import numpy as np

from fenicsx_obstacle.show.figures import over, power
from fenicsx_obstacle.show.relief import View, axes_of_view, rgb
from fenicsx_obstacle.show.warped import rendered

LIGHT = np.array([-0.25, -0.45, 0.86])


def draw_view(axis: Any, view: View, pixels: int = 1500) -> str:
    """Draw a view (one rank).

    Args:
        axis: Axes of matplotlib.
        view: What to draw.
        pixels: Width of the picture.

    Returns:
        Who drew it, and why.
    """
    corners = np.array([[(view.lower, view.upper)[b][i] for i, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)])
    flat = _project(view, corners)
    (left, bottom), (right, top) = flat.min(axis=0) - 0.02, flat.max(axis=0) + 0.02
    extent = (left, right, bottom, top)
    _box(axis, view)
    picture, who = rendered(view, extent, pixels)
    if picture is None:
        _paint(axis, view)
        who = f"matplotlib, because {who}"
    else:
        axis.imshow(picture, extent=extent, zorder=3, interpolation="antialiased")
    axis.set_aspect("equal")
    axis.set_xlim(left - 0.16, right + 0.12)
    axis.set_ylim(bottom - 0.12, top + 0.02)
    axis.set_axis_off()
    return who


def _project(view: View, points: np.ndarray) -> np.ndarray:
    return view.place(np.asarray(points, dtype=float)) @ axes_of_view()[:2].T


def _box(axis: Any, view: View) -> None:
    """Floor and the two walls behind; ticks on the floor's front edges and on the left edge."""
    from matplotlib.ticker import MaxNLocator

    low, high = view.lower, view.upper
    middle = (low + high) / 2
    # an axis, the edge its ticks stand on, and where its letters go: outwards in the projection
    edges = ((0, np.array([np.nan, low[1], low[2]])), (1, np.array([high[0], np.nan, low[2]])),
             (2, np.array([low[0], low[1], np.nan])))  # fmt: skip
    walls = {0: [(1, high[1]), (2, low[2])], 1: [(0, low[0]), (2, low[2])], 2: [(0, low[0]), (1, high[1])]}
    for number, edge in edges:
        ends = np.array([np.where(np.isnan(edge), bound, edge) for bound in (low, high)])
        axis.plot(*_project(view, ends).T, color="0.4", linewidth=0.8, zorder=2)
        outwards = _outwards(view, number, edge, middle)
        wanted = MaxNLocator(4, steps=[1, 2, 5, 10]).tick_values(low[number], high[number])
        size = high[number] - low[number]
        # at the foot of the upright edge a figure of the x-axis stands already
        first = low[number] + (0.08 if number == 2 else -1e-9) * size
        ticks = [tick for tick in wanted if first <= tick <= high[number] + 1e-9 * size]
        exponent = power(low[number], high[number])
        texts = _texts(ticks, exponent)
        for tick, text in zip(ticks, texts, strict=True):
            at = np.where(np.isnan(edge), tick, edge)
            for fixed, value in walls[number]:
                other = next(i for i in range(3) if i not in (number, fixed))
                stroke = np.array([at, at])
                stroke[:, fixed], stroke[:, other] = value, (low[other], high[other])
                axis.plot(*_project(view, stroke).T, color="0.9", linewidth=0.7, zorder=1)
            place = _project(view, at) + 0.035 * outwards
            axis.text(*place, text, fontsize=7.5, ha=_side(outwards), va="center", color="0.2")
        beyond = 0.09 + 0.019 * max(map(len, texts), default=0) if number == 2 else 0.12
        label = _project(view, np.where(np.isnan(edge), middle, edge)) + beyond * outwards
        turned = {"rotation": 90, "ha": "center"} if number == 2 else {"ha": "center"}
        axis.text(*label, over(view.labels[number], exponent), fontsize=9, va="center", **turned)


def _outwards(view: View, number: int, edge: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Direction on the page that leads away from the box."""
    if number == 2:
        return np.array([-1.0, 0.0])
    on_edge = np.where(np.isnan(edge), middle, edge)
    inside = np.where(np.arange(3) == 2, edge, middle)
    away = _project(view, on_edge) - _project(view, inside)
    return away / np.linalg.norm(away)


def _side(outwards: np.ndarray) -> str:
    return "right" if outwards[0] < -0.2 else "left" if outwards[0] > 0.2 else "center"


def _texts(ticks: list[float], exponent: int) -> list[str]:
    step = abs(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0
    figures = [0.0 if abs(tick) < 1e-9 * step else tick / 10.0**exponent for tick in ticks]
    return [f"{figure:g}".replace("-", "\N{MINUS SIGN}") for figure in figures]


def _paint(axis: Any, view: View) -> None:
    """The painter's way: all triangles from the farthest to the nearest."""
    from matplotlib.collections import PolyCollection

    camera = axes_of_view()
    corners = np.concatenate([s.points[s.triangles] for s in view.surfaces])
    colours = np.concatenate([s.colours[s.triangles].mean(axis=1) for s in view.surfaces])
    opacity = np.concatenate([np.full(len(s.triangles), s.opacity) for s in view.surfaces])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    shade = 0.62 + 0.38 * np.abs(normals @ LIGHT)
    faces = np.column_stack([np.clip(colours * shade[:, None], 0, 1), opacity])
    # edges are drawn where triangles are opaque: without them antialiasing leaves hairlines
    edges = np.where(faces[:, 3:] > 0.9, faces, 0.0)
    widths, count = np.full(len(faces), 0.25), len(faces)
    # pieces of lines are triangles without area, a little nearer than what they lie on
    for lines in view.lines:
        corners = np.concatenate([corners, lines.ends[:, [0, 1, 1]]])
        paint = np.tile(np.append(rgb(lines.colour), 1.0), (len(lines.ends), 1))
        faces, edges = np.concatenate([faces, paint]), np.concatenate([edges, paint])
        widths = np.concatenate([widths, np.full(len(paint), 460 * lines.radius)])
    depth = (corners @ camera[2]).mean(axis=1)
    depth[count:] += 0.02
    order = np.argsort(depth)
    axis.add_collection(
        PolyCollection((corners @ camera[:2].T)[order], facecolors=faces[order], edgecolors=edges[order],
                       linewidths=widths[order], zorder=3)
    )  # fmt: skip

"""Views in space: axes by matplotlib, surfaces by pyvista."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from textwrap import fill
from typing import Any

import numpy as np

from fenicsx_obstacle.show import render
from fenicsx_obstacle.show.figures import digits, over, power
from fenicsx_obstacle.show.free_boundary import Patch
from fenicsx_obstacle.show.render import View

HEIGHT = 0.42  # of the graph of u, in units of its widest side
MARGIN = 0.12  # of the box above and below the graph, in units of the range of u
THINNEST = 0.01  # of the widest side of a box
RESOLVED = 1e-2  # heights that differ by less than `THINNEST` times that, beside their size, are drawn as one
VISIBLE = 0.01  # of the height of the box
ZOOM = {"graph": 1.2, "surface": 0.95, "solid": 0.95, "body": 0.95}  # of the box within its place on the page


def draw_views(
    page: Any, places: Sequence[Any], patch: Patch, scales: Mapping[str, Any], kind: str, label: str, *,
    facets: np.ndarray | None = None, eye: tuple[float, float] = render.EYE,
    box: tuple[np.ndarray, np.ndarray] | None = None,
) -> str:  # fmt: skip
    """Draw some fields in space, each in a view of its own (one rank).

    Args:
        page: Figure of matplotlib.
        places: Where each view goes: parts of a grid.
        patch: Triangles or tetrahedra, with levels.
        scales: Colours of each field.
        kind: `graph`, `surface`, `solid` or `body`.
        label: Name of the third axis.
        facets: Of a body, the triangles that show the pressure.
        eye: Azimuth and elevation, degrees.
        box: Lower and upper corner of the part that is drawn; by default everything.

    Returns:
        Who drew it. Without pyvista there is a note in the place of each view, which says why.
    """
    arrays = {**patch.fields, "points": patch.points, "cells": patch.cells}
    arrays |= {} if facets is None else {"facets": facets}
    if kind == "graph":
        patch = _graph(patch)
        arrays["seen"] = patch.points[:, 2]
    lower, upper = box or (patch.points.min(axis=0), patch.points.max(axis=0))
    if kind == "solid":
        lower[1] = cut_at(patch)
    if kind == "graph":
        margin = MARGIN * (upper[2] - lower[2] or 1.0)
        lower[2], upper[2] = lower[2] - margin, upper[2] + margin
    in_plane = 2 if kind == "graph" else 3  # the height has a unit of its own
    widest = np.full(3, np.max((upper - lower)[:in_plane]))
    widest[in_plane:] = RESOLVED * np.abs([lower[2], upper[2]]).max()
    thin = (upper - lower < THINNEST * widest) * THINNEST * widest
    lower, upper = lower - thin, upper + thin
    size = upper - lower
    scale = np.ones(3) / max(size[:in_plane])
    if kind == "graph":
        scale[2] = HEIGHT / size[2]
    views = [
        View(kind, name, shown.cmap.name, shown.get_clim(), lower, upper, scale, eye) for name, shown in scales.items()
    ]
    pictures, who = render.rendered(arrays, views)
    if not pictures:
        for place in places:
            note = page.add_subplot(place, frame_on=False, xticks=[], yticks=[])
            note.text(0.5, 0.5, fill(f"not drawn, because {who}", 40), ha="center", fontsize=9)
        return f"matplotlib, without views in space: {who}"
    for place, view, picture in zip(places, views, pictures, strict=True):
        axis = _box(page, place, view, label)
        if kind == "graph" and np.abs(patch.points[:, 2] - patch.fields["u"]).max() > VISIBLE * size[2]:
            axis.set_title("beyond an obstacle, u is drawn on its surface", fontsize=9)
        _put(axis, view, picture)
    return who


def cut_at(patch: Patch) -> float:
    """The y where a solid is cut open: the middle of the contact set, or of the solid."""
    where = patch.points[patch.fields["contact"] > 0]
    return float((where if len(where) else patch.points)[:, 1].mean())


def _graph(patch: Patch) -> Patch:
    """The graph of u over the plane, as it is seen: what has penetrated an obstacle lies on the obstacle's surface."""
    nothing = np.array(np.inf)
    u = np.clip(patch.fields["u"], patch.fields.get("lower", -nothing), patch.fields.get("upper", nothing))
    return Patch(np.column_stack([patch.points[:, :2], u]), patch.cells, patch.fields)


def _box(page: Any, place: Any, view: View, label: str) -> Any:
    """Axes of matplotlib in space, with the projection of pyvista's picture."""
    from matplotlib import rc_context
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    with rc_context({"grid.color": "0.9", "grid.linewidth": 0.7}):
        axis = page.add_subplot(place, projection="3d", proj_type="ortho", azim=view.eye[0], elev=view.eye[1])
    axis.computed_zorder = False
    axis.set_box_aspect((view.upper - view.lower) * view.scale, zoom=ZOOM[view.kind])
    limits = list(zip(view.lower, view.upper, strict=True))
    axis.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes = (axis.xaxis, axis.yaxis, axis.zaxis)
    for line, (low, high), name in zip(axes, limits, ("x", "y", label), strict=True):
        exponent = power(low, high)
        line.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        line.set_major_formatter(FuncFormatter(partial(_tick, 10.0**exponent, high - low)))
        line.set_label_text(over(name, exponent), fontsize=9)
        line.set_tick_params(labelsize=7.5, pad=0)
        line.labelpad = 1
        line.set_pane_color((1.0, 1.0, 1.0, 0.0))
        line.pane.set_edgecolor("0.8")
    return axis


def _tick(ten: float, size: float, value: float, _: int) -> str:
    return digits(value / ten, size / ten)


def _put(axis: Any, view: View, picture: np.ndarray) -> None:
    """A picture of pyvista where the projection of matplotlib has the same points."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    def projected(point: np.ndarray) -> np.ndarray:
        return np.array(proj_transform(*point, axis.get_proj())[:2], dtype=float)

    middle = projected(view.centre)
    _, up, _ = render.axes_of_view(view.eye)
    half = np.linalg.norm(projected(view.centre + up * view.half / view.scale) - middle)
    (left, bottom), (right, top) = middle - half, middle + half
    axis.imshow(picture, extent=(left, right, bottom, top), aspect="auto", zorder=3, interpolation="antialiased",
                clip_on=False)  # fmt: skip

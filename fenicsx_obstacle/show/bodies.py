"""The picture of an elastic body: deformed, with its von Mises stress, the obstacles and their pressure. One rank."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from fenicsx_obstacle.mesh.cells import chains
from fenicsx_obstacle.show.figures import BLUE, ROUND_OFF, VERMILION, blank, legend_below
from fenicsx_obstacle.show.free_boundary import Patch, rim
from fenicsx_obstacle.show.maps import draw_edges, heights, pressures, triangles
from fenicsx_obstacle.show.render import EYE, FREE, OBSTACLE, axes_of_view
from fenicsx_obstacle.show.space import draw_views

if TYPE_CHECKING:
    from fenicsx_obstacle.fields.contact_table import ContactTable

AROUND = 4.0  # half the side of the part that is drawn, in units of the size of the contact set
WHOLE = 0.7  # of the size of the body: a part as large as that is the body
VISIBLE = 0.03  # of the size of the picture: smaller displacements are magnified
ARROWS = 25  # of the pressure
ARROW = 0.18  # length of the longest one, in units of the side of the picture
ALONG = 1e-6  # cosine of the angle between the normal of a facet and a direction along it
EYES = [(azimuth, sign * EYE[1]) for sign in (1, -1) for azimuth in (EYE[0] + 90.0 * np.arange(4)).tolist()]
BETWEEN = 0.1  # of the size of the contact boundary: between its parts in a profile


def draw_body(arrays: dict[str, np.ndarray], nodes: ContactTable, sides: Sequence[float]) -> tuple[Any, str]:
    """The page, and who drew it.

    Args:
        arrays: Points, simplices and fields of a vector-valued solution.
        nodes: Its contact nodes.
        sides: Where along their normals the obstacles are: 1, -1.
    """
    if int(arrays["gdim"]) == 2:
        return _flat(arrays, nodes, sides), "matplotlib, as plane bodies need no third dimension"
    return _in_space(arrays, nodes, sides)


def _flat(arrays: dict[str, np.ndarray], nodes: ContactTable, sides: Sequence[float]) -> Any:
    """The body near the contact set, and pressure and gap along the contact boundary."""
    page = blank(10.4, 4.6)
    grid = page.add_gridspec(2, 2, width_ratios=(1.25, 1), height_ratios=(1.6, 1))
    left, upper = page.add_subplot(grid[:, 0]), page.add_subplot(grid[0, 1])
    lower = page.add_subplot(grid[1, 1], sharex=upper)
    points, u, cells = arrays["points"][:, :2], arrays["u"][:, :2], arrays["cells"]
    low, high, whole, factor = _near(points, u, nodes)
    side, moved = float(np.max(high - low)), points + factor * u
    values, label = _coloured(arrays)
    colours = heights(values)
    left.tripcolor(triangles(moved, cells), values, shading="gouraud", cmap=colours.cmap, norm=colours.norm)
    page.colorbar(colours, ax=left, shrink=0.85).set_label(fill(label, 42), fontsize=8.5)
    edges, ours = rim(cells), _rows(points, nodes.points)
    draw_edges(left, moved, edges, colors="0.2", linewidths=0.9, zorder=3)
    if len(sides) == 1:
        place = _obstacle(points, u, ours, nodes, factor, sides[0])
        known = edges[np.isfinite(place[edges]).all(axis=(1, 2))]
        draw_edges(left, place, known, colors=OBSTACLE, linewidths=2.4, zorder=4)
    _arrows(left, moved[ours], nodes, side)
    room = 0.02 * side + (ARROW * side if whole else 0.0)
    left.set(aspect="equal", xlabel="x", ylabel="y", xlim=(low[0] - room, high[0] + room),
             ylim=(low[1] - room, high[1] + room))  # fmt: skip
    grey = "; grey: obstacle" if len(sides) == 1 else ""
    left.set_title(fill(f"{_scaled(whole, factor)}; arrows: contact pressure{grey}", 58), fontsize=9)
    _profile(upper, lower, nodes, _curves(edges, ours))
    return page


def _curves(edges: np.ndarray, ours: np.ndarray) -> list[np.ndarray]:
    """Contact nodes in their order along each connected part of the contact boundary.

    Args:
        edges: Of the boundary, pairs of points.
        ours: The point of each contact node.
    """
    node_of = np.full(max(edges.max(), ours.max()) + 1, -1)
    node_of[ours] = np.arange(len(ours))
    ends = node_of[edges]
    return sorted(chains(ends[(ends >= 0).all(axis=1)], len(ours)), key=min)


def _profile(upper: Any, lower: Any, nodes: ContactTable, curves: Sequence[np.ndarray]) -> None:
    """Pressure and gap over the position along the contact boundary, a line for each connected part of it."""
    places, name = _positions(nodes.points, curves)
    gaps = np.where(np.isfinite(nodes.gap), nodes.gap, np.nan)
    for place, curve in zip(places, curves, strict=True):
        upper.fill_between(place, nodes.pressure[curve], color=VERMILION, alpha=0.25, linewidth=0)
        upper.plot(place, nodes.pressure[curve], color=VERMILION, marker=".", markersize=4)
        lower.plot(place, gaps[curve], color=BLUE, marker=".", markersize=4)
    s, order = np.concatenate(places), np.concatenate(curves)
    for axis in (upper, lower):
        axis.axhline(0, color="0.6", linewidth=0.8)
    pressed = s[nodes.pressure[order] != 0]
    if len(pressed):
        middle, half = (pressed.max() + pressed.min()) / 2, max(np.ptp(pressed), 0.1 * np.ptp(s))
        low, high = max(s.min(), middle - half), min(s.max(), middle + half)
        lower.set_xlim(low, high)
        seen = gaps[order][(s >= low) & (s <= high) & np.isfinite(gaps[order])]
        if len(seen) and np.ptp(seen) > 0:
            lower.set_ylim(seen.min() - 0.05 * np.ptp(seen), seen.max() + 0.05 * np.ptp(seen))
    upper.set_ylabel("contact pressure p,\nat nodes", fontsize=9)
    lower.set_ylabel("gap at nodes", fontsize=9)
    lower.set_xlabel(fill(name, 42))


def _in_space(arrays: dict[str, np.ndarray], nodes: ContactTable, sides: Sequence[float]) -> tuple[Any, str]:
    """The deformed body near the contact set, seen from there: its stress, and the pressure on the contact boundary."""
    points, cells, u = arrays["points"], arrays["cells"], arrays["u"]
    low, high, whole, factor = _near(points, u, nodes)
    values, label = _coloured(arrays)
    moved, page = points + factor * u, blank(10.4, 4.5)
    patch = Patch(moved, cells, {"stress": values, "pressure": arrays["pressure"], "contact": arrays["contact"]})
    scales = {"stress": heights(values), "pressure": pressures(nodes.pressure)}
    given, kind = dict[str, Any](), "surface"
    if cells.shape[1] == 4:
        low, high = np.maximum(low, moved.min(axis=0)), np.minimum(high, moved.max(axis=0))
        apart = np.isnan(arrays["gap"])
        patch.fields.update(pressure=np.where(apart, np.nan, arrays["pressure"]), contact=~apart)
        given, kind = {"facets": contact_facets(arrays, nodes), "box": (low, high)}, "body"
    eye = eye_of(nodes, sides)
    who = draw_views(page, list(page.add_gridspec(1, 2)), patch, scales, kind, "z", eye=eye, **given)
    labels = (label, "contact pressure p, computed at nodes, linear between")
    for axis, scale, text in zip(page.axes, scales.values(), labels, strict=True):
        page.colorbar(scale, ax=axis, shrink=0.7, pad=0.16).set_label(fill(text, 42), fontsize=8.5)
        axis.set_title(_scaled(whole or kind == "surface", factor), fontsize=9)
    if kind == "body":
        legend_below(page, {"no obstacle faces it": {"facecolor": FREE, "edgecolor": "0.2", "linewidth": 0.5}}, "")
    return page, who


def contact_facets(arrays: dict[str, np.ndarray], nodes: ContactTable) -> np.ndarray:
    """The triangles of the contact boundary of tetrahedra: each corner has a gap, and it is not measured along the
    triangle."""
    points, facets = arrays["points"], rim(arrays["cells"])
    facets = facets[~np.isnan(arrays["gap"][facets]).any(axis=1)]
    corners = points[facets]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = nodes.normals[_rows(nodes.points, corners.mean(axis=1))]
    along = np.einsum("ij,ij->i", across, normals) / np.linalg.norm(across, axis=1)
    return np.asarray(facets[np.abs(along) > ALONG])


def eye_of(nodes: ContactTable, sides: Sequence[float]) -> tuple[float, float]:
    """Azimuth and elevation, of `EYES`, from which most of the contact forces are seen; without contact, most of the
    contact boundary."""
    pressed = np.where(nodes.pressure != 0, -np.sign(nodes.pressure), sides[0])
    sizes = nodes.areas * (np.abs(nodes.pressure) if nodes.pressure.any() else 1.0)
    outwards = pressed[:, None] * nodes.normals
    seen = [sizes @ np.maximum(outwards @ axes_of_view(eye)[2], 0.0) for eye in EYES]
    return EYES[int(np.argmax(np.array(seen) > (1 - ROUND_OFF) * max(seen)))]


def _near(points: np.ndarray, u: np.ndarray, nodes: ContactTable) -> tuple[np.ndarray, np.ndarray, bool, float]:
    """Corners of the part of the deformed body to be drawn, whether it is the whole body, and the factor of u."""
    low, high, whole = _window(points, nodes)
    inside = np.all((points >= low) & (points <= high), axis=1)
    there = u[inside] if inside.any() else u
    factor = _magnified(there, float(np.max(high - low)))
    if whole:
        moved = points + factor * u
        return moved.min(axis=0), moved.max(axis=0), whole, factor
    shift = factor * there.mean(axis=0)
    return low + shift, high + shift, whole, factor


def _scaled(whole: bool, factor: float) -> str:
    scale = "to scale" if factor == 1.0 else f"displacements {factor:g} times as large"
    return scale if whole else f"near the contact, {scale}"


def _coloured(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, str]:
    """Values at the nodes that colour the body, and what they are."""
    if "von_mises" not in arrays:
        return np.linalg.norm(arrays["u"], axis=1), "size of the displacement"
    cells, count = arrays["cells"], len(arrays["points"])
    sums = np.bincount(cells.ravel(), np.repeat(arrays["von_mises"], cells.shape[1]), count)
    around = np.maximum(np.bincount(cells.ravel(), minlength=count), 1)
    return sums / around, "von Mises stress, mean of the cells around each node"


def _window(points: np.ndarray, nodes: ContactTable) -> tuple[np.ndarray, np.ndarray, bool]:
    """Corners of the part of the body to be drawn, and whether that is the whole body."""
    low, high = points.min(axis=0), points.max(axis=0)
    pressed = nodes.points[nodes.pressure != 0]
    if not len(pressed):
        return low, high, True
    half = AROUND * float(np.max(np.ptp(pressed, axis=0))) / 2
    if 2 * half >= WHOLE * np.max(high - low) or half == 0:
        return low, high, True
    middle = (pressed.min(axis=0) + pressed.max(axis=0)) / 2
    return np.maximum(middle - half, low - half / 2), np.minimum(middle + half, high + half / 2), False


def _magnified(u: np.ndarray, side: float) -> float:
    """The factor 1, 2 or 5 times a power of ten by which displacements are drawn so that they are seen."""
    spread = float(np.max(np.ptp(u, axis=0))) if len(u) else 0.0
    if spread <= ROUND_OFF * side or spread >= VISIBLE * side:
        return 1.0
    wanted = VISIBLE * side / spread
    ten = 10.0 ** np.floor(np.log10(wanted))
    return float(max(one for one in (1.0, 2.0, 5.0) if one * ten <= wanted or one == 1.0) * ten)


def _rows(points: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The nearest of the points to each that is wanted."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(points).query(wanted)[1])


def _obstacle(
    points: np.ndarray, u: np.ndarray, ours: np.ndarray, nodes: ContactTable, factor: float, towards: float
) -> np.ndarray:
    """The surface of the obstacle: where the contact boundary would be if it were moved by its gap; not-a-number
    elsewhere."""
    place = np.full((len(points), 2), np.nan)
    known = np.where(np.isfinite(nodes.gap), nodes.gap, np.nan)
    place[ours] = points[ours] + factor * (u[ours] + towards * known[:, None] * nodes.normals)
    return place


def _arrows(axis: Any, points: np.ndarray, nodes: ContactTable, side: float) -> None:
    """The pressure, as arrows that end on the body."""
    most = np.abs(nodes.pressure).max(initial=0.0)
    if most == 0:
        return
    pressed = np.flatnonzero(nodes.pressure)
    some = pressed[:: max(1, len(pressed) // ARROWS)]
    arrows = (ARROW * side / most * nodes.pressure[some])[:, None] * nodes.normals[some]
    axis.quiver(*(points[some] - arrows).T, *arrows.T, angles="xy", scale_units="xy", scale=1, color=VERMILION,
                width=0.004, zorder=5)  # fmt: skip


def _positions(points: np.ndarray, curves: Sequence[np.ndarray]) -> tuple[list[np.ndarray], str]:
    """Positions along each part of the contact boundary, and what they are called: a coordinate, where it orders the
    nodes of all parts, otherwise the distance along the parts, one after the other."""
    for axis in np.argsort(-np.ptp(points, axis=0)):
        places = [points[curve, axis] for curve in curves]
        spans = np.array(sorted((place.min(), place.max()) for place in places))
        steps = [np.diff(place) for place in places]
        if all((step > 0).all() or (step < 0).all() for step in steps) and (spans[1:, 0] >= spans[:-1, 1]).all():
            return places, "xyz"[axis]
    places, start = [], 0.0
    apart = BETWEEN * float(np.ptp(points, axis=0).max())
    for curve in curves:
        lengths = np.linalg.norm(np.diff(points[curve], axis=0), axis=1)
        places.append(start + np.concatenate([[0.0], np.cumsum(lengths)]))
        start = places[-1][-1] + apart
    return places, "distance along the contact boundary" + ", its parts one after the other" * (len(curves) > 1)

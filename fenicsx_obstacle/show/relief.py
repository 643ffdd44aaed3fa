"""What a picture in space shows: surfaces, lines, colours and the box around them; who draws it comes later."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenicsx_obstacle.show.boundary import LEVELS, SIDES, free_boundary
from fenicsx_obstacle.show.simplices import Patch, above, boundary

FREE, OBSTACLE, INK, EDGE = "#97C0E4", "#8A8178", "#111111", "#66788A"
AZIMUTH, ELEVATION = np.radians(-58.0), np.radians(32.0)
CLEAR = 0.42  # opacity of u out of contact: a wall in front must not hide the contact behind it
HEIGHT = 0.42  # of the relief, in units of its widest side


@dataclass(frozen=True)
class Surface:
    """Triangles with one colour per node.

    Attributes:
        points: In the units of the picture, shape (n, 3).
        triangles: Nodes, shape (m, 3).
        colours: Red, green, blue in [0, 1], shape (n, 3).
        opacity: 1 hides what is behind.
    """

    points: np.ndarray
    triangles: np.ndarray
    colours: np.ndarray
    opacity: float


@dataclass(frozen=True)
class Lines:
    """Pieces of lines of one colour.

    Attributes:
        ends: End points of the pieces, in the units of the picture, shape (m, 2, 3).
        colour: #RRGGBB.
        radius: Half the width, in the units of the picture.
    """

    ends: np.ndarray
    colour: str
    radius: float


@dataclass(frozen=True)
class View:
    """A picture in space.

    Attributes:
        surfaces: What is seen.
        lines: The edge of u, and the free boundary.
        lower: Lower corner of the box, in the units of the data.
        upper: Upper corner.
        scale: From data to picture, per axis.
        labels: Of the three axes.
    """

    surfaces: list[Surface]
    lines: list[Lines]
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray
    labels: tuple[str, str, str]

    def place(self, points: np.ndarray) -> np.ndarray:
        """From the units of the data to those of the picture."""
        return (points - (self.lower + self.upper) / 2) * self.scale


def axes_of_view() -> np.ndarray:
    """Rows: to the right, up, towards the eye. A parallel projection is the product with the first two."""
    (ca, sa), (ce, se) = ((np.cos(t), np.sin(t)) for t in (AZIMUTH, ELEVATION))
    return np.array([[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])


def touching(patch: Patch) -> Patch:
    """The part in contact, cut along the free boundary; its pressure is the one of the nodes in contact."""
    spread = _spread(patch)
    parts = [above(spread, -patch.fields[level]) for level in LEVELS.values() if level in patch.fields]
    return joined(parts) if parts else Patch(patch.points, patch.cells[:0], patch.fields)


def free(patch: Patch) -> Patch:
    """The part out of contact."""
    for level in LEVELS.values():
        if level in patch.fields:
            patch = above(patch, patch.fields[level])
    return patch


def membrane(patch: Patch, colouring: Any, u: str) -> View:
    """The graph of u over a flat domain: contact in the colours of the pressure, obstacles in grey.

    What has penetrated an obstacle is drawn on its surface: under it the contact could not be seen.

    Args:
        patch: Triangles in the plane, from `with_levels`.
        colouring: From pressures to colours.
        u: Name of u.
    """
    nothing = np.array(np.inf)
    seen = np.clip(patch.fields["u"], patch.fields.get("lower", -nothing), patch.fields.get("upper", nothing))
    patch = Patch(patch.points, patch.cells, {**patch.fields, "u": seen})
    low, high = patch.fields["u"].min(), patch.fields["u"].max()
    margin = 0.12 * (high - low or 1.0)
    lower, upper = patch.points.min(axis=0), patch.points.max(axis=0)
    lower[2], upper[2] = low - margin, high + margin
    size = upper - lower
    scale = np.array([1, 1, HEIGHT * max(size[:2]) / size[2]]) / max(size[:2])
    view = View([], [], lower, upper, scale, ("x", "y", u))
    inside, outside = touching(patch), free(patch)
    obstacles = {
        side: _surface(view, _graph(_visible(patch, side, lower[2], upper[2]), side), OBSTACLE, opacity)
        for side, opacity in (("lower", 1.0), ("upper", 0.4)) if side in patch.fields
    }  # fmt: skip
    # seen from above: from the lowest to the highest, so that what is translucent covers what is below
    surfaces = [
        *(obstacles[side] for side in ("lower",) if side in obstacles),
        _surface(view, _graph(inside, "u"), colouring(inside.fields["pressure"]), 1.0),
        _surface(view, _graph(outside, "u"), FREE, CLEAR),
        *(obstacles[side] for side in ("upper",) if side in obstacles),
    ]
    view.surfaces.extend(surface for surface in surfaces if len(surface.triangles))
    graph = _graph(patch, "u")
    view.lines.extend(_lines(view, graph, [_graph(line, "u") for line in free_boundary(patch)]))
    return view


def in_space(patch: Patch, colours: np.ndarray) -> View:
    """A surface in space with one colour per node.

    Args:
        patch: Triangles in space.
        colours: Red, green, blue per node, shape (n, 3).
    """
    lower, upper = patch.points.min(axis=0), patch.points.max(axis=0)
    scale = np.ones(3) / max(upper - lower)
    view = View([], [], lower, upper, scale, ("x", "y", "z"))
    view.surfaces.append(_surface(view, patch, colours, 1.0))
    view.lines.extend(_lines(view, patch, free_boundary(patch)))
    return view


def joined(parts: list[Patch]) -> Patch:
    """Several patches as one."""
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    fields = {name: np.concatenate([part.fields[name] for part in parts]) for name in parts[0].fields}
    cells = np.concatenate([part.cells + start for part, start in zip(parts, starts, strict=False)])
    return Patch(np.concatenate([part.points for part in parts]), cells, fields)


def _spread(patch: Patch) -> Patch:
    """The pressure continued from within contact to its edge, and to two rings of nodes about it.

    A node at the edge has the force of a part of its area only, which part changes from node to node; and outside
    pressures are zero. Neither is a pressure there: the edge would be a ramp, with teeth.
    """
    cells, p, contact = patch.cells, patch.fields["pressure"], patch.fields["contact"] > 0
    inside = contact.copy()
    inside[cells[~contact[cells].all(axis=1)]] = False
    known = inside
    for ring in range(3):
        p, reached = _continued(p, known, cells)
        known = reached | contact if ring == 0 else reached
    return Patch(patch.points, cells, {**patch.fields, "pressure": p})


def _continued(p: np.ndarray, known: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At the neighbours of known nodes the mean over cells of what is known there; and which are known then."""
    weights = known[cells]
    count = weights.sum(axis=1)
    mean = (p[cells] * weights).sum(axis=1) / np.maximum(count, 1)
    weight = np.bincount(cells.ravel(), np.repeat(count > 0, cells.shape[1]), len(p))
    near = np.bincount(cells.ravel(), np.repeat(mean, cells.shape[1]), len(p)) / np.maximum(weight, 1)
    return np.where(known | (weight == 0), p, near), known | (weight > 0)


def _visible(patch: Patch, side: str, low: float, high: float) -> Patch:
    """An obstacle within the box, without the part that u covers in contact."""
    patch = above(patch, patch.fields[LEVELS[side]])
    patch = above(patch, patch.fields[side] - low)
    patch = above(patch, high - patch.fields[side])
    # a little behind u: where both are equal the eye would see one through the other in patches
    patch.fields[side] -= SIDES[side] * 4e-3 * (high - low)
    return patch


def _graph(patch: Patch, name: str) -> Patch:
    return Patch(np.column_stack([patch.points[:, :2], patch.fields[name]]), patch.cells, patch.fields)


def _surface(view: View, patch: Patch, colours: str | np.ndarray, opacity: float) -> Surface:
    if isinstance(colours, str):
        colours = np.tile(rgb(colours), (len(patch.points), 1))
    return Surface(view.place(patch.points), patch.cells, colours[:, :3], opacity)


def _lines(view: View, patch: Patch, free: list[Patch]) -> list[Lines]:
    edge = boundary(patch)
    pieces = [view.place(line.points)[line.cells] for line in free]
    return [
        Lines(view.place(edge.points)[edge.cells], EDGE, 0.0012),
        Lines(np.concatenate([np.empty((0, 2, 3)), *pieces]), INK, 0.0035),
    ]


def rgb(colour: str) -> np.ndarray:
    """#RRGGBB as three numbers in [0, 1]."""
    return np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])

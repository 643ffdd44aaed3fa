"""What a picture in space shows: surfaces, lines, colours and the box around them; who draws it comes later."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenicsx_obstacle.show.boundary import SIDES, free_boundary, level_function
from fenicsx_obstacle.show.simplices import Patch, above

FREE, OBSTACLE, INK = "#8FB8DE", "#8A8178", "#111111"
AZIMUTH, ELEVATION = np.radians(-58.0), np.radians(28.0)
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
class View:
    """A picture in space.

    Attributes:
        surfaces: What is seen.
        line: The free boundary: end points of its pieces, shape (m, 2, 3).
        lower: Lower corner of the box, in the units of the data.
        upper: Upper corner.
        scale: From data to picture, per axis.
        labels: Of the three axes.
    """

    surfaces: list[Surface]
    line: np.ndarray
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
    parts = [above(_spread(patch), -level_function(patch, side)) for side in SIDES if side in patch.fields]
    return joined(parts) if parts else Patch(patch.points, patch.cells[:0], patch.fields)


def free(patch: Patch) -> Patch:
    """The part out of contact."""
    for side in SIDES:
        if side in patch.fields:
            patch = above(patch, level_function(patch, side))
    return patch


def membrane(patch: Patch, colouring: Any, u: str) -> View:
    """The graph of u over a flat domain: contact in the colours of the pressure, obstacles in grey.

    Args:
        patch: Triangles in the plane.
        colouring: From pressures to colours.
        u: Name of u.
    """
    low, high = patch.fields["u"].min(), patch.fields["u"].max()
    margin = 0.12 * (high - low or 1.0)
    lower, upper = patch.points.min(axis=0), patch.points.max(axis=0)
    lower[2], upper[2] = low - margin, high + margin
    size = upper - lower
    scale = np.array([1, 1, HEIGHT * max(size[:2]) / size[2]]) / max(size[:2])
    view = View([], np.empty((0, 2, 3)), lower, upper, scale, ("x", "y", u))
    inside, outside = touching(patch), free(patch)
    obstacles = {
        side: _surface(view, _graph(_visible(patch, side, lower[2], upper[2]), side), OBSTACLE, opacity)
        for side, opacity in (("lower", 1.0), ("upper", 0.4)) if side in patch.fields
    }  # fmt: skip
    # seen from above: from the lowest to the highest, so that what is translucent covers what is below
    surfaces = [
        *(obstacles[side] for side in ("lower",) if side in obstacles),
        _surface(view, _graph(inside, "u"), colouring(inside.fields["pressure"]), 1.0),
        _surface(view, _graph(outside, "u"), FREE, 0.55),
        *(obstacles[side] for side in ("upper",) if side in obstacles),
    ]
    lines = [_graph(line, "u") for line in free_boundary(patch)]
    return View([s for s in surfaces if len(s.triangles)], _pieces(view, lines), lower, upper, scale, view.labels)


def in_space(patch: Patch, colours: np.ndarray) -> View:
    """A surface in space with one colour per node.

    Args:
        patch: Triangles in space.
        colours: Red, green, blue per node, shape (n, 3).
    """
    lower, upper = patch.points.min(axis=0), patch.points.max(axis=0)
    scale = np.ones(3) / max(upper - lower)
    view = View([], np.empty((0, 2, 3)), lower, upper, scale, ("x", "y", "z"))
    surface = _surface(view, patch, colours, 1.0)
    return View([surface], _pieces(view, free_boundary(patch)), lower, upper, scale, view.labels)


def joined(parts: list[Patch]) -> Patch:
    """Several patches as one."""
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    fields = {name: np.concatenate([part.fields[name] for part in parts]) for name in parts[0].fields}
    cells = np.concatenate([part.cells + start for part, start in zip(parts, starts, strict=False)])
    return Patch(np.concatenate([part.points for part in parts]), cells, fields)


def _spread(patch: Patch) -> Patch:
    """The pressure continued to the neighbours of the contact set, so that its edge is no ramp to zero."""
    cells, p = patch.cells, patch.fields["pressure"]
    contact = patch.fields["contact"] > 0
    inside = contact[cells]
    count = inside.sum(axis=1)
    mean = (p[cells] * inside).sum(axis=1) / np.maximum(count, 1)
    weight = np.bincount(cells.ravel(), np.repeat(count > 0, cells.shape[1]), len(p))
    near = np.bincount(cells.ravel(), np.repeat(mean, cells.shape[1]), len(p)) / np.maximum(weight, 1)
    return Patch(patch.points, cells, {**patch.fields, "pressure": np.where(contact, p, near)})


def _visible(patch: Patch, side: str, low: float, high: float) -> Patch:
    """An obstacle within the box, without the part that u covers in contact."""
    patch = above(patch, level_function(patch, side))
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


def _pieces(view: View, lines: list[Patch]) -> np.ndarray:
    return np.concatenate([np.empty((0, 2, 3)), *(view.place(line.points)[line.cells] for line in lines)])


def rgb(colour: str) -> np.ndarray:
    """#RRGGBB as three numbers in [0, 1]."""
    return np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])

"""The picture of a solution: u with its obstacles, the free boundary, the contact pressure. Rank 0 draws."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.scalar import Fields
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.show.figures import (
    ABOVE,
    BLUE,
    INK,
    VERMILION,
    blank,
    check_name,
    digits,
    figure,
    heading,
    legend_below,
    missing_glyphs,
    plain,
    save,
    steady,
)
from fenicsx_obstacle.show.free_boundary import LEVELS, SIDES, Patch, free_boundary, patch_of
from fenicsx_obstacle.show.maps import OUT_OF_CONTACT, draw_map, hatch_obstacles, heights, pressures
from fenicsx_obstacle.show.render import FREE, OBSTACLE, UPPER
from fenicsx_obstacle.show.space import cut_at, draw_views

BELOW = "#8F9BA5"  # what `render.OBSTACLE` looks like below u, which is `render.FREE` with an opacity
PLANE = 1e-12  # of the extent: a mesh in space is plane where z differs less
MAX_DRAWN = 1e150  # matplotlib squares what it draws
# where each family of pressures is computed, and what is done to it besides
COMPUTED = {"Lagrange": "at nodes", "CR": "at midpoints of edges, averaged at vertices",
            "DG": "at centres of cells, averaged at vertices"}  # fmt: skip


@dataclass(frozen=True, repr=False)
class Picture:
    """A picture of a solution; a notebook shows it where it is the last line of a cell.

    Attributes:
        said: One line: the file, if there is one, who drew it, and why.
        page: Figure of matplotlib on rank 0, None elsewhere.
    """

    said: str
    page: Any

    def __repr__(self) -> str:
        return self.said

    def _repr_png_(self) -> bytes | None:
        if self.page is None:
            return None
        data = io.BytesIO()
        with missing_glyphs():
            self.page.savefig(data, format="png")
        return data.getvalue()


def draw(fields: Fields, sides: Sequence[str], title: str, symbol: str, path: Path | None) -> Picture:
    """Draw a solution, into a file, PNG, PDF or SVG by its name, if there is one (collective).

    Args:
        fields: Of the solution.
        sides: Its obstacles, "lower" and "upper".
        title: Above the picture.
        symbol: The label of u.
        path: The file.

    Raises:
        InputError: If the name has another ending, the file cannot be written, or the mesh is a network of intervals.
    """
    if path is not None:
        check_name(path)
    arrays, pages = gather(fields), list[Any]()  # the page stays on rank 0

    def drawn() -> str:
        if (largest := max(np.abs(arrays[name]).max() for name in ("u", "pressure"))) > MAX_DRAWN:
            raise InputError(f"values up to {largest:.3g} are not drawn: at most {MAX_DRAWN:g}; choose another unit")
        page, who = _drawn(fields, sides, symbol, arrays)
        page.suptitle(heading(title), fontsize=12)
        pages.append(page)
        if path is None:
            return f"drawn by {who}"
        save(page, path)
        return f"{path}: drawn by {who}"

    return Picture(on_root(fields.level.comm, drawn), pages[0] if pages else None)


def _drawn(fields: Fields, sides: Sequence[str], symbol: str, arrays: dict[str, np.ndarray]) -> tuple[Any, str]:
    """The page without its title, and who drew it."""
    if arrays["u"].ndim == 2:
        from fenicsx_obstacle.fields.vector import VectorFields  # no scalar solution needs them
        from fenicsx_obstacle.show.bodies import draw_body

        assert isinstance(fields, VectorFields)
        along = {"upper": 1.0, "lower": -1.0}
        return draw_body(arrays, fields.nodes, [along[one] for one in along if one in sides])
    patch, u = patch_of({**arrays, "u": steady(arrays["u"])}), plain(symbol)
    kind, gdim = patch.cells.shape[1], int(arrays["gdim"])
    if kind == 2 and gdim > 1:
        raise InputError("intervals in the plane or in space are not drawn; open fields.xdmf in ParaView")
    family, _ = fields.level.pair.pressure_on(releases.cell_name(fields.level.mesh))
    p = f"contact pressure p, computed {COMPUTED[family]}, linear between"
    if np.any(patch.fields["pressure"] != arrays["pressure"]):
        p += " (where u is given: the mean of the neighbours)"
    if kind == 2:
        return _line(patch, u, p)
    if kind == 3 and np.ptp(patch.points[:, 2]) <= PLANE * np.ptp(patch.points, axis=0).max():
        return _flat(patch, u, p)
    return _in_space(patch, u, p, "solid" if kind == 4 else "surface")


def _line(patch: Patch, u: str, p: str) -> tuple[Any, str]:
    """u over an interval, and the pressure below."""
    order = np.argsort(patch.points[:, 0])
    x, fields = patch.points[order, 0], {name: values[order] for name, values in patch.fields.items()}
    if not any(side in fields for side in SIDES) and not fields["pressure"].any():
        page, axis = figure(6.4, 3.6)
        axis.plot(x, fields["u"], color=BLUE, linewidth=2)
        axis.set(xlabel="x", ylabel=u, xlim=(x[0], x[-1]))
        return page, "matplotlib, as intervals need no third dimension"
    page, (top, bottom) = figure(6.4, 5.2, rows=2, sharex=True)
    hatch_obstacles(top, x, fields, (fields["u"].min(), fields["u"].max()))
    top.plot(x, fields["u"], color=BLUE, linewidth=2, label=u)
    bottom.fill_between(x, fields["pressure"], color=VERMILION, alpha=0.25, linewidth=0)
    bottom.plot(x, fields["pressure"], color=VERMILION)
    bottom.axhline(0, color="0.6", linewidth=0.8)
    for number, end in enumerate(end for part in free_boundary(patch) for end in part.points[:, 0]):
        for axis in (top, bottom):
            axis.axvline(end, color=INK, linewidth=1, linestyle="--",
                         label="free boundary" if axis is top and number == 0 else None)  # fmt: skip
    top.set_ylabel(u)
    top.legend(fontsize=8, **ABOVE)
    bottom.set_ylabel(fill(p, 34), fontsize=8)
    bottom.set_xlabel("x")
    return page, "matplotlib, as intervals need no third dimension"


def _flat(patch: Patch, u: str, p: str) -> tuple[Any, str]:
    """The graph of u in space, and the map of the pressure beside it; without pyvista the map alone."""
    across, up, _ = np.ptp(patch.points, axis=0)
    wide = min(0.25 + 0.75 * across / up, 1.0)  # of the map with its scale, in units of its height
    page = blank(10.4 * (1.25 + wide) / 2.25, 4.5)
    left, right = page.add_gridspec(1, 2, width_ratios=(1.25, wide))
    scale = pressures(patch.fields["pressure"])
    who = draw_views(page, [left], patch, {"pressure": scale}, "graph", u)
    seen = []
    if who == "pyvista":
        axis = page.add_subplot(right)
        seen = [side for side in SIDES if _seen(patch, side, page.axes[0].get_zlim())]
    else:
        page, axis = figure(6.4, 4.8)
    draw_map(axis, patch, scale, u)
    page.colorbar(scale, ax=axis, shrink=0.85).set_label(fill(_cut(p, patch), 42), fontsize=8.5)
    _legend(page, patch, OUT_OF_CONTACT, seen)
    return page, who


def _seen(patch: Patch, side: str, limits: tuple[float, float]) -> bool:
    """Whether a part of an obstacle is drawn: within the limits of the third axis, and not covered by u."""
    if side not in patch.fields:
        return False
    values, apart = patch.fields[side][patch.cells], np.any(patch.fields[LEVELS[side]][patch.cells] > 0, axis=1)
    return bool(np.any(apart & (values.max(axis=1) >= limits[0]) & (values.min(axis=1) <= limits[1])))


def _in_space(patch: Patch, u: str, p: str, kind: str) -> tuple[Any, str]:
    """A surface in space, or a solid cut open, coloured by u and by the pressure."""
    page = blank(10.4, 4.5)
    scales = {"u": heights(patch.fields["u"]), "pressure": pressures(patch.fields["pressure"])}
    who = draw_views(page, list(page.add_gridspec(1, 2)), patch, scales, kind, "z")
    for axis, scale, label in zip(page.axes, scales.values(), (u, _cut(p, patch)), strict=True):
        page.colorbar(scale, ax=axis, shrink=0.7, pad=0.1).set_label(fill(label, 42), fontsize=8.5)
        if kind == "solid":
            axis.set_title(f"cut open at y = {digits(cut_at(patch), np.ptp(patch.points), '.3g')}", fontsize=9)
    if any(side in patch.fields for side in SIDES):
        _legend(page, patch, FREE)
    return page, who


def _cut(pressure: str, patch: Patch) -> str:
    """The name of the pressure where it is shown within the free boundary only."""
    return f"{pressure}, cut at the free boundary" if any(side in patch.fields for side in SIDES) else pressure


def _legend(page: Any, patch: Patch, free: str, obstacles: Sequence[str] = ()) -> None:
    inside = any(side in patch.fields for side in SIDES)  # not where obstacles are on the boundary
    out = "out of contact" if inside else "no obstacle inside"
    swatches = {out: {"facecolor": free, "edgecolor": "0.2", "linewidth": 0.5}}
    for side in obstacles:  # the lower one is seen through u
        swatches[f"{side} obstacle"] = (
            {"facecolor": BELOW} if side == "lower" else {"facecolor": OBSTACLE, "alpha": UPPER}
        )
    legend_below(page, swatches, "free boundary" if free_boundary(patch) else "")
    page.get_layout_engine().set(wspace=0.08)  # for the name of the upright axis

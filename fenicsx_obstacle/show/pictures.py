"""The picture of a solution: u with its obstacles, the free boundary, the contact pressure. Rank 0 draws."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.show import relief
from fenicsx_obstacle.show.boundary import SIDES, free_boundary, with_levels
from fenicsx_obstacle.show.figures import BLUE, VERMILION, check_name, figure, heading, missing_glyphs, plain, save
from fenicsx_obstacle.show.plan import OUT_OF_CONTACT, draw_plan, strokes, triangles
from fenicsx_obstacle.show.simplices import Patch, patch_of, rims, zero
from fenicsx_obstacle.show.space import draw_view

if TYPE_CHECKING:
    from fenicsx_obstacle.problems.solution import Solution


MAX_DRAWN = 1e150  # matplotlib squares what it draws
PRESSURE = "contact pressure p"


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


def draw_answer(solution: Solution, path: Path | None) -> Picture:
    """Draw a solution, into a file, PNG, PDF or SVG by its name, if there is one (collective).

    Raises:
        InputError: If the name has another ending, the file cannot be written, or the mesh is a network of intervals.
    """
    if path is not None:
        check_name(path)
    arrays, pages = gather(solution), list[Any]()  # the page stays on rank 0
    said = on_root(solution.level.comm, _draw, solution, arrays, path, pages)
    return Picture(said, pages[0] if pages else None)


def _draw(solution: Solution, arrays: dict[str, np.ndarray], path: Path | None, pages: list[Any]) -> str:
    patch, u = with_levels(patch_of(arrays)), plain(solution.symbol)
    kind, gdim = patch.cells.shape[1], int(arrays["gdim"])
    if (largest := max(np.abs(patch.fields[name]).max() for name in ("u", "pressure"))) > MAX_DRAWN:
        raise InputError(f"values up to {largest:.3g} are not drawn: at most {MAX_DRAWN:g}; choose another unit")
    if kind == 2 and gdim > 1:
        raise InputError("intervals in the plane or in space are not drawn; open fields.xdmf in ParaView")
    if kind == 2:
        page, who = _line(patch, u)
    elif kind == 4:
        page, who = _solid(patch, u)
    else:
        page, who = _flat(patch, u) if gdim == 2 else _curved(patch, u)
    page.suptitle(heading(solution.title), fontsize=12)
    pages.append(page)
    if path is None:
        return f"drawn by {who}"
    save(page, path)
    return f"{path}: drawn by {who}"


def _line(patch: Patch, u: str) -> tuple[Any, str]:
    """u over an interval, and the pressure below."""
    order = np.argsort(patch.points[:, 0])
    x, fields = patch.points[order, 0], {name: values[order] for name, values in patch.fields.items()}
    page, (top, bottom) = figure(6.4, 5.2, rows=2, sharex=True)
    low, high = fields["u"].min(), fields["u"].max()
    margin = 0.15 * (high - low or 1.0)
    low, high = low - margin, high + margin
    for side, outside in (("lower", low), ("upper", high)):
        if side in fields:
            edge = np.clip(fields[side], low, high)
            top.fill_between(x, edge, outside, color="0.88", hatch="////", edgecolor="0.7", linewidth=0)
            top.plot(
                x, np.where(edge == fields[side], edge, np.nan), color="0.35", linewidth=1, label=f"{side} obstacle"
            )
    top.plot(x, fields["u"], color=BLUE, linewidth=2, label=u)
    bottom.fill_between(x, fields["pressure"], color=VERMILION, alpha=0.25, linewidth=0)
    bottom.plot(x, fields["pressure"], color=VERMILION)
    bottom.axhline(0, color="0.6", linewidth=0.8)
    for number, end in enumerate(end for part in free_boundary(patch) for end in part.points[:, 0]):
        for axis in (top, bottom):
            axis.axvline(end, color=relief.INK, linewidth=1, linestyle="--",
                         label="free boundary" if axis is top and number == 0 else None)  # fmt: skip
    top.set_ylim(low, high)
    top.set_xlim(x[0], x[-1])
    top.set_ylabel(u)
    top.legend(fontsize=8, loc="best", framealpha=1)
    bottom.set_ylabel(PRESSURE)
    bottom.set_xlabel("x")
    return page, "matplotlib, as intervals need no third dimension"


def _flat(patch: Patch, u: str) -> tuple[Any, str]:
    """The graph of u in space, and the map of the pressure beside it."""
    across, up, _ = np.ptp(patch.points, axis=0)
    wide = min(0.25 + 0.75 * across / up, 1.0)  # of the map with its scale, in units of its height
    page, (left, right) = figure(12.0 * (1.25 + wide) / 2.25, 4.8, columns=2, widths=(1.25, wide))
    scale = _pressures(patch.fields["pressure"])
    who = draw_view(left, relief.membrane(patch, scale.to_rgba, u))
    draw_plan(page, right, patch, scale, u, PRESSURE)
    _legend(left, patch)
    return page, who


def _curved(patch: Patch, u: str) -> tuple[Any, str]:
    """A surface in space, coloured by u and by the pressure."""
    page, axes = figure(12.0, 5.2, columns=2)
    scales = (_heights(patch.fields["u"]), _pressures(patch.fields["pressure"]))
    for axis, name, scale, label in zip(axes, ("u", "pressure"), scales, (u, PRESSURE), strict=True):
        who = draw_view(axis, relief.in_space(patch, scale.to_rgba(patch.fields[name])))
        page.colorbar(scale, ax=axis, label=label, shrink=0.7)
    return page, who


def _solid(patch: Patch, u: str) -> tuple[Any, str]:
    """A slice through the middle of the contact set, or of the solid: y is constant on it."""
    where = patch.points[patch.fields["contact"] > 0]
    at = float((where if len(where) else patch.points)[:, 1].mean())
    cut = zero(patch, patch.points[:, 1] - at)
    lines = [zero(part, part.points[:, 1] - at) for part in free_boundary(patch)]
    page, axes = figure(12.0, 5.0, columns=2)
    scales = (_heights(cut.fields["u"]), _pressures(cut.fields["pressure"]))
    for axis, name, scale, label in zip(axes, ("u", "pressure"), scales, (u, PRESSURE), strict=True):
        axis.tripcolor(triangles(cut, (0, 2)), cut.fields[name], shading="gouraud", cmap=scale.cmap, norm=scale.norm)
        page.colorbar(scale, ax=axis, label=label, shrink=0.8)
        for rim in rims(cut, (0, 2)):
            axis.plot(*rim.T, color="0.2", linewidth=0.9)
        strokes(axis, lines, (0, 2))
        axis.set(aspect="equal", xlabel="x", ylabel="z", title=f"slice at y = {at:.3g}")
    return page, "matplotlib, as a slice through the solid; fields.xdmf shows all of it in ParaView"


def _legend(axis: Any, patch: Patch) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch as Swatch

    handles: list[Any] = [Swatch(facecolor=OUT_OF_CONTACT, edgecolor="0.2", linewidth=0.5, label="out of contact")]
    if patch.fields["contact"].any():
        handles.append(Line2D([], [], color=relief.INK, label="free boundary"))
    handles += [Swatch(facecolor=relief.OBSTACLE, alpha=1.0 if side == "lower" else 0.4, label=f"{side} obstacle")
                for side in SIDES if side in patch.fields]  # fmt: skip
    axis.legend(handles=handles, fontsize=8, loc="upper left", frameon=False, ncols=1)


def _heights(values: np.ndarray) -> Any:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(values.min(), values.max()), "YlGnBu")


def _pressures(values: np.ndarray) -> Any:
    """No pressure is light; both signs, where there are two obstacles, go to different dark colours."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high = min(values.min(), 0.0), max(values.max(), 0.0)
    if low < 0 < high:
        both = max(-low, high)
        return ScalarMappable(Normalize(-both, both), "PuOr_r")
    if low < 0:
        return ScalarMappable(Normalize(low, 0.0), "YlOrRd_r")
    return ScalarMappable(Normalize(0.0, high or 1.0), "YlOrRd")

"""Profiles as tables and plots: u and its obstacles above, the pressure below, contact shaded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.profiles import FORMULA, as_columns, as_csv, compared, moments_of, profiles_of
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, on_root, write_text
from fenicsx_obstacle.problems.values import Profile
from fenicsx_obstacle.scenes.report import DRAWN_OF_BODIES, check_formulas, compare_place
from fenicsx_obstacle.show.figures import (
    ABOVE,
    BLUE,
    COLOURS,
    DASHES,
    INK,
    VERMILION,
    check_name,
    figure,
    heading,
    plain,
    save,
    steady,
    svg,
)
from fenicsx_obstacle.text import counted, short

TOUCHING = 1e-6  # of the largest pressure: where it is less there is no contact
LISTED = 8  # curves with a name each; of more the first and the last are named


def draw_profiles(answer: Answer, folder: Path) -> dict[str, str]:
    """Write profile-NAME.csv and profile-NAME.png for each profile of the scene (collective).

    Returns:
        SVG elements by name, on rank 0.
    """
    drawn: dict[str, str] = {}
    moment = answer.shown.title.removeprefix(answer.title)
    for name, profile in (profiles_of(answer) if answer.scene.tables.profile else {}).items():
        given = answer.scene.tables.profile[name].compare
        moments, sizes = moments_of(answer, profile, given, compare_place(name)), _sizes(answer.shown)

        def write(name: str = name, profile: Profile = profile, moments: Any = moments, sizes: Any = sizes) -> None:
            parts = dict(moments) if moments else {None: profile}
            write_text(folder / f"profile-{name}.csv", as_csv(parts))
            page = _drawn(_labelled(answer, profile, moments), answer.symbol, name + moment, sizes)
            save(page, folder / f"profile-{name}.png")
            drawn[name] = svg(page, f"profile-{name}")

        on_root(answer.level.comm, write)
    return drawn


def draw_line(
    answer: Answer, start: Sequence[float], end: Sequence[float], path: Path, compare: Mapping[str, str] | None = None
) -> str:
    """Draw u and the pressure along a line, and write the table beside the picture (collective).

    Args:
        answer: A solution.
        start: First point.
        end: Last point.
        path: PNG, PDF or SVG.
        compare: Formulas by the quantity over which they are drawn.

    Returns:
        What was written, in words.

    Raises:
        InputError: If the line leaves the mesh, the name is of no picture, or a formula has no values there.
    """
    check_name(path)
    answer, given, place = answer.shown, compare or {}, "--compare"
    check_formulas(answer.scene, given, place)
    profile = answer.along(start, end)
    outside = np.isnan(profile.u.reshape(len(profile.s), -1)).any(axis=1)
    if outside.any():
        where = ", ".join(f"{x:.6g}" for x in profile.points[np.argmax(outside)])
        raise InputError(f"--along: the point ({where}) is outside the mesh")
    t = answer.record["time"]["t"] if "time" in answer.record else None
    profile = compared(answer.scene, profile, given, place, t)
    moments, sizes = moments_of(answer, profile, given, place), _sizes(answer)
    table = path.with_suffix(".csv")

    def write() -> None:
        write_text(table, as_csv(dict(moments) if moments else {None: profile}))
        save(_drawn(_labelled(answer, profile, moments), answer.symbol, answer.title, sizes), path)

    on_root(answer.level.comm, write)
    return f"{path} and {table}: {counted(len(profile.s), 'point')}"


def draw_rows(
    rows: Sequence[Mapping[str, Any]], vary: Mapping[str, Sequence[Any]], u: str, folder: Path
) -> dict[str, str]:
    """Draw each profile of the rows of a study over one another, and write its table (one rank).

    Returns:
        SVG elements by name.
    """
    drawn = {}
    for name in rows[-1].get("profiles", {}):
        curves = {
            ", ".join(f"{key} = {short(row['vary'][key])}" for key in vary): row["profiles"][name] for row in rows
        }
        page = _drawn(curves, u, name)
        save(page, folder / f"profile-{name}.png")
        lines = [",".join([*vary, *next(iter(curves.values()))])]
        for row in rows:
            values = [str(row["vary"][key]) for key in vary]
            columns = row["profiles"][name].values()
            lines += [",".join([*values, *(f"{x:.12g}" for x in one)]) for one in zip(*columns, strict=True)]
        write_text(folder / f"profile-{name}.csv", "\n".join(lines) + "\n")
        drawn[f"profile-{name}"] = svg(page, f"profile-{name}")
    return drawn


def _labelled(
    answer: Answer, profile: Profile, moments: Sequence[tuple[float, Profile]]
) -> dict[str, dict[str, list[float]]]:
    """Columns of each curve by its label: one for each moment, or the one there is."""
    time = answer.scene.tables.time
    if time is None or not moments:
        return {"": as_columns(profile)}
    return {f"{time.name} = {t:.4g}": as_columns(one) for t, one in moments}


def _sizes(answer: Answer) -> tuple[float, float]:
    """The largest abs(u) and abs(p) anywhere: along a line they may be round-off (collective)."""
    comm, fields = answer.level.comm, (answer.u, answer.pressure)
    u, p = (largest(comm, np.abs(field.x.array)) for field in fields)
    return u, p


def _drawn(
    curves: Mapping[str, Mapping[str, Sequence[float]]], u: str, title: str, sizes: tuple[float, float] = (0.0, 0.0)
) -> Any:
    """u above and the pressure below, over the distance along the line; `sizes` are those of u and p anywhere."""
    if "u" not in next(iter(curves.values())):
        return _drawn_of_body(curves, u, title, sizes)
    page, (above, below) = figure(6.4, 4.8, rows=2, sharex=True)
    several = len(curves) > 1
    for number, (label, columns) in enumerate(curves.items()):
        s, p, gap = (np.array(columns[key], dtype=float) for key in ("s", "p", "gap"))
        height, p = steady(np.array(columns["u"], dtype=float), sizes[0]), steady(p, sizes[1])
        look = _look(number, len(curves), label)
        above.plot(s, height, **look)
        below.plot(s, p, **({**look, "color": VERMILION} if not several else look))
        for axes, key in ((above, "u"), (below, "p")):
            _formula(axes, columns, key, look if several else None)
        if not several:
            if np.isfinite(gap).all():
                side = -1.0 if p.max(initial=0.0) >= -p.min(initial=0.0) else 1.0
                edge = steady(height + side * gap, sizes[0])
                above.plot(s, edge, color="0.45", linewidth=1.0, linestyle=(0, (4, 2)), label="obstacle")
                above.legend(fontsize=8, **ABOVE)
            _shade((above, below), s, p, sizes[1])
    above.set_ylabel(fill(plain(u), 24))
    below.set_ylabel("contact pressure")
    return _finished(page, (above, below), title, several=several, shaded=not several)


def _drawn_of_body(
    curves: Mapping[str, Mapping[str, Sequence[float]]], u: str, title: str, sizes: tuple[float, float]
) -> Any:
    """Components of u, and on the contact boundary gap and pressure, elsewhere the von Mises stress."""
    first, several = next(iter(curves.values())), len(curves) > 1
    on_boundary = not np.isnan(np.array(first["gap"], dtype=float)).all()
    left_out = {"von_mises"} if on_boundary else {"gap", "p"}
    keys = [key for key in DRAWN_OF_BODIES if key in first and key not in left_out]
    page, panels = figure(6.4, 0.8 + 1.6 * len(keys), rows=len(keys), sharex=True)
    words = {"gap": "gap", "p": "contact pressure", "von_mises": "von Mises stress"}
    for axes, key in zip(panels, keys, strict=True):
        for number, (label, columns) in enumerate(curves.items()):
            s, gap = (np.array(columns[one], dtype=float) for one in ("s", "gap"))
            values = steady(np.array(columns[key], dtype=float), sizes[key == "p"] if key != "von_mises" else 0.0)
            look = _look(number, len(curves), label)
            values = np.where(np.isnan(gap), np.nan, values) if key == "p" else values
            axes.plot(s, values, **({**look, "color": VERMILION} if key == "p" and not several else look))
            _formula(axes, columns, key, look if several else None)
            if not several and on_boundary:
                _shade((axes,), s, np.maximum(np.nan_to_num(np.array(columns["p"], dtype=float)), 0.0), sizes[1])
        axes.set_ylabel(words.get(key, f"{key}\n{fill(plain(u), 24)}"))
    return _finished(page, panels, title, several=several, shaded=not several and on_boundary)


def _formula(axes: Any, columns: Mapping[str, Sequence[float]], key: str, look: Mapping[str, Any] | None) -> None:
    """The formula of comparison of a column, if there is one; with the look of its curve, of several."""
    if key + FORMULA not in columns:
        return
    own = {"color": INK, "label": "formula"} if look is None else {"color": look["color"], "label": "_"}
    axes.plot(columns["s"], columns[key + FORMULA], linestyle=":", linewidth=2.0, **own)
    if look is None:
        axes.legend(fontsize=8, **ABOVE)


def _shade(panels: Sequence[Any], s: np.ndarray, p: np.ndarray, size: float) -> None:
    """Shade where there is contact."""
    for start, end in _runs(np.abs(p) > TOUCHING * np.abs(p).max(initial=size)):
        for axes in panels:
            axes.axvspan(s[start], s[end], color=BLUE, alpha=0.12, linewidth=0)


def _finished(page: Any, panels: Sequence[Any], title: str, *, several: bool, shaded: bool) -> Any:
    """The page with the label of the lower axis, the grid, the legend of several curves, and the title."""
    panels[-1].set_xlabel("distance along the line" + ("; contact is shaded" if shaded else ""))
    for axes in panels:
        axes.grid(True, color="0.9")
        axes.margins(x=0)
    if several:
        panels[0].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8, frameon=False)
    page.suptitle(heading(title), fontsize=11)
    return page


def _look(number: int, count: int, label: str) -> dict[str, Any]:
    """Colour and dash of a curve, all different; of many curves from light to dark, in order."""
    named = plain(label) if count <= LISTED or number in (0, count - 1) else "_"
    if count <= len(COLOURS):
        return {"color": COLOURS[number], "linestyle": DASHES[number % len(DASHES)], "linewidth": 1.6, "label": named}
    from matplotlib import colormaps

    shade = colormaps["viridis"](0.9 * (1 - number / (count - 1)))
    return {"color": shade, "linestyle": DASHES[number % len(DASHES)] if count <= LISTED else "-", "linewidth": 1.3,
            "label": named}  # fmt: skip


def _runs(inside: np.ndarray) -> list[tuple[int, int]]:
    """First and last number of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]

"""Profiles as tables and plots: u and its obstacles above, the pressure below, contact shaded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.profiles import (
    FORMULA,
    as_columns,
    as_csv,
    formulas_at,
    in_space,
    moments_of,
    profiles_of,
)
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, on_root
from fenicsx_obstacle.problems.values import Profile
from fenicsx_obstacle.safe_writing import write_text
from fenicsx_obstacle.scenes.report import DRAWN_OF_BODIES, compared, of_profile
from fenicsx_obstacle.show.figures import (
    ABOVE,
    BLUE,
    COLOURS,
    DASHES,
    GRID,
    INK,
    VERMILION,
    check_name,
    figure,
    heading,
    plain,
    save,
    steady,
)
from fenicsx_obstacle.text import counted, short

NEARBY = 5  # ranges of u: farther obstacles are not drawn, or u would be flat
TOUCHING = 1e-6  # of the largest pressure: where it is less there is no contact
LISTED = 8  # curves with a name each; of more the first and the last are named


def draw_profiles(answer: Answer, folder: Path) -> dict[str, Path]:
    """Write profile-NAME.csv and profile-NAME.png for each profile of the scene (collective).

    Returns:
        The pictures by name.
    """
    drawn = {name: folder / f"profile-{name}.png" for name in answer.scene.tables.profile}
    moment = answer.shown.title.removeprefix(answer.title)
    for name, profile in profiles_of(answer).items():
        moments, around = moments_of(answer, profile, of_profile(answer.scene, name)), _around(answer.shown, profile)
        on_root(answer.level.comm, _write, answer, profile, moments, name + moment, around, drawn[name])
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
    answer = answer.shown
    given = compared(answer.scene, compare or {}, "--compare")
    profile = answer.along(start, end)
    outside = np.isnan(profile.u.reshape(len(profile.s), -1)).any(axis=1)
    if outside.any():
        where = ", ".join(f"{x:.6g}" for x in profile.points[np.argmax(outside)])
        raise InputError(f"--along: the point ({where}) is outside the mesh")
    t = answer.record["time"]["t"] if "time" in answer.record else None
    profile = replace(profile, formulas=formulas_at(answer.scene, profile.points, given, t))
    moments, around = moments_of(answer, profile, given), _around(answer, profile)
    on_root(answer.level.comm, _write, answer, profile, moments, answer.title, around, path)
    return f"{path} and {path.with_suffix('.csv')}: {counted(len(profile.s), 'point')}"


def _write(
    answer: Answer, profile: Profile, moments: Sequence[tuple[float, Profile]], title: str, around: _Around, path: Path
) -> None:  # fmt: skip
    """The picture of a profile, or of it at some moments, and its table beside it."""
    columns = [(f"{t:.12g}", as_columns(one)) for t, one in moments] or [("", as_columns(profile))]
    write_text(path.with_suffix(".csv"), as_csv([({"t": t} if t else {}, one) for t, one in columns]))
    name = "" if answer.scene.time is None else answer.scene.time.name
    curves = {f"{name} = {float(t):.4g}" if t else "": one for t, one in columns}
    save(_drawn(curves, answer.symbol, title, around), path)


def draw_rows(
    rows: Sequence[Mapping[str, Any]], vary: Mapping[str, Sequence[Any]], u: str, folder: Path
) -> dict[str, Path]:
    """Draw each profile of the rows of a study over one another, and write its table (one rank).

    Returns:
        The pictures by name.
    """
    drawn = {}
    for name in rows[-1].get("profiles", {}):
        curves = {
            ", ".join(f"{key} = {short(row['vary'][key])}" for key in vary): row["profiles"][name] for row in rows
        }
        drawn[f"profile-{name}"] = path = folder / f"profile-{name}.png"
        save(_drawn(curves, u, name), path)
        table = [({key: str(row["vary"][key]) for key in vary}, row["profiles"][name]) for row in rows]
        write_text(path.with_suffix(".csv"), as_csv(table))
    return drawn


@dataclass(frozen=True)
class _Around:
    """What is known beside the columns of a single curve.

    Attributes:
        u: The largest abs(u) anywhere: along a line it may be round-off.
        p: The largest abs(p) anywhere.
        obstacles: Of a scalar u, the obstacles along the line.
        touching: Of a scalar u, whether there is contact at each point.
    """

    u: float = 0.0
    p: float = 0.0
    obstacles: Sequence[np.ndarray] = ()
    touching: np.ndarray | None = None


def _around(answer: Answer, profile: Profile) -> _Around:
    """What is around a profile of an answer (collective)."""
    comm, fields, points = answer.level.comm, answer.fields, in_space(profile.points)
    u, p = (largest(comm, np.abs(field.x.array)) for field in (answer.u, answer.pressure))
    if answer.scene.model.vector_valued:
        return _Around(u, p)
    return _Around(u, p, fields.obstacles_at(points), fields.touches_at(points))


def _drawn(curves: Mapping[str, Mapping[str, Sequence[float]]], u: str, title: str, around: _Around = _Around()) -> Any:
    """u above and the pressure below, over the distance along the line; of bodies a panel for each component of u, and
    on the contact boundary gap and pressure, elsewhere the von Mises stress.

    Args:
        curves: Columns of each curve by its label.
        u: The label of u.
        title: Of the page.
        around: Of a single curve, what is known beside its columns.
    """
    first, several = next(iter(curves.values())), len(curves) > 1
    of_body = "u" not in first
    on_boundary = not np.isnan(_column(first, "gap")).all()
    left_out = {"von_mises"} if on_boundary else {"gap", "p"}
    keys = [key for key in DRAWN_OF_BODIES if key in first and key not in left_out] if of_body else ["u", "p"]
    labels = {"u": fill(plain(u), 24), "gap": "gap", "p": "contact pressure", "von_mises": "von Mises stress"}
    page, panels = figure(6.4, 0.8 + (1.6 if of_body else 2.0) * len(keys), rows=len(keys), sharex=True)
    shaded = not several and (on_boundary or not of_body)
    for axes, key in zip(panels, keys, strict=True):
        for number, (label, columns) in enumerate(curves.items()):
            s, values, look = _column(columns, "s"), _column(columns, key), _look(number, len(curves), label)
            values = steady(values, 0.0 if key == "von_mises" else around.p if key == "p" else around.u)
            if key == "p" and of_body:
                values = np.where(np.isnan(_column(columns, "gap")), np.nan, values)
            axes.plot(s, values, **({**look, "color": VERMILION} if key == "p" and not several else look))
            _formula(axes, columns, key, look if several else None)
            if key == "u" and not several:
                _obstacles(axes, s, values, around)
            if shaded:
                _shade(axes, s, _pressed(columns, around) if of_body else around.touching)
        axes.set_ylabel(labels.get(key, f"{key}\n{fill(plain(u), 24)}"))
        axes.grid(True, color=GRID)
        axes.margins(x=0)
    panels[-1].set_xlabel("distance along the line" + ("; contact is shaded" if shaded else ""))
    if several:
        panels[0].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8, frameon=False)
    page.suptitle(heading(title), fontsize=11)
    return page


def _column(columns: Mapping[str, Sequence[float]], key: str) -> np.ndarray:
    return np.array(columns[key], dtype=float)


def _pressed(columns: Mapping[str, Sequence[float]], around: _Around) -> np.ndarray:
    """Where a body is pressed along the line."""
    p = np.nan_to_num(_column(columns, "p"))
    return p > TOUCHING * max(around.p, p.max(initial=0.0))


def _obstacles(axes: Any, s: np.ndarray, u: np.ndarray, around: _Around) -> None:
    """The obstacles of a curve of u, where there are any that are not far."""
    reach = NEARBY * np.ptp(u) or np.inf
    for one in around.obstacles:
        near = np.isfinite(one) & (np.abs(one - u) <= reach)
        if not near.any():
            continue
        edge = steady(np.where(near, one, np.nan), around.u)
        label = "_" if axes.get_legend() else "obstacle"
        axes.plot(s, edge, color="0.45", linewidth=1.0, linestyle=(0, (4, 2)), label=label)
        axes.legend(fontsize=8, **ABOVE)


def _formula(axes: Any, columns: Mapping[str, Sequence[float]], key: str, look: Mapping[str, Any] | None) -> None:
    """The formula of comparison of a column, if there is one; with the look of its curve, of several."""
    if key + FORMULA not in columns:
        return
    own = {"color": INK, "label": "formula"} if look is None else {"color": look["color"], "label": "_"}
    axes.plot(columns["s"], columns[key + FORMULA], linestyle=":", linewidth=2.0, **own)
    if look is None:
        axes.legend(fontsize=8, **ABOVE)


def _shade(axes: Any, s: np.ndarray, touching: np.ndarray | None) -> None:
    """Shade where there is contact."""
    if touching is None:
        return
    for run in np.ma.clump_unmasked(np.ma.masked_where(~touching, s)):
        axes.axvspan(s[run][0], s[run][-1], color=BLUE, alpha=0.12, linewidth=0)


def _look(number: int, count: int, label: str) -> dict[str, Any]:
    """Colour and dash of a curve, all different; of many curves from light to dark, in order."""
    named = plain(label) if count <= LISTED or number in (0, count - 1) else "_"
    if count <= len(COLOURS):
        return {"color": COLOURS[number], "linestyle": DASHES[number % len(DASHES)], "linewidth": 1.6, "label": named}
    from matplotlib import colormaps

    shade = colormaps["viridis"](0.9 * (1 - number / (count - 1)))
    return {"color": shade, "linestyle": DASHES[number % len(DASHES)] if count <= LISTED else "-", "linewidth": 1.3,
            "label": named}  # fmt: skip

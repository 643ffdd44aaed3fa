"""Profiles as tables and plots: u and its obstacles above, the pressure below, contact shaded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.profiles import as_columns, as_csv, moments_of, profiles_of
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, on_root, write_text
from fenicsx_obstacle.problems.values import Profile
from fenicsx_obstacle.show.figures import (
    ABOVE,
    BLUE,
    COLOURS,
    DASHES,
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
    for name, profile in (profiles_of(answer) if answer.scene.tables.profile else {}).items():
        moments, sizes = moments_of(answer, profile), _sizes(answer)

        def write(name: str = name, profile: Profile = profile, moments: Any = moments, sizes: Any = sizes) -> None:
            parts = dict(moments) if moments else {None: profile}
            write_text(folder / f"profile-{name}.csv", as_csv(parts))
            page = _drawn(_labelled(answer, profile, moments), answer.symbol, name, sizes)
            save(page, folder / f"profile-{name}.png")
            drawn[name] = svg(page, f"profile-{name}")

        on_root(answer.level.comm, write)
    return drawn


def draw_line(answer: Answer, start: Sequence[float], end: Sequence[float], path: Path) -> str:
    """Draw u and the pressure along a line, and write the table beside the picture (collective).

    Returns:
        What was written, in words.

    Raises:
        InputError: If the line leaves the mesh, or the name is of no picture.
    """
    check_name(path)
    if answer.scene.model.vector_valued:
        raise InputError(
            "--along: draws scalar u; of an elastic body nodes.csv has pressure and gap, and in Python "
            "solution.along(start, end) has all quantities"
        )
    profile = answer.along(start, end)
    outside = np.isnan(profile.u)
    if outside.any():
        place = ", ".join(f"{x:.6g}" for x in profile.points[np.argmax(outside)])
        raise InputError(f"--along: the point ({place}) is outside the mesh")
    moments, sizes = moments_of(answer, profile), _sizes(answer)
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
    page, (above, below) = figure(6.4, 4.8, rows=2, sharex=True)
    several = len(curves) > 1
    for number, (label, columns) in enumerate(curves.items()):
        s, p, gap = (np.array(columns[key], dtype=float) for key in ("s", "p", "gap"))
        height, p = steady(np.array(columns["u"], dtype=float), sizes[0]), steady(p, sizes[1])
        look = _look(number, len(curves), label)
        above.plot(s, height, **look)
        below.plot(s, p, **({**look, "color": VERMILION} if not several else look))
        if not several:
            if np.isfinite(gap).all():
                side = -1.0 if p.max(initial=0.0) >= -p.min(initial=0.0) else 1.0
                edge = steady(height + side * gap, sizes[0])
                above.plot(s, edge, color="0.45", linewidth=1.0, linestyle=(0, (4, 2)), label="obstacle")
                above.legend(fontsize=8, **ABOVE)
            for start, end in _runs(np.abs(p) > TOUCHING * np.abs(p).max(initial=sizes[1])):
                for axes in (above, below):
                    axes.axvspan(s[start], s[end], color=BLUE, alpha=0.12, linewidth=0)
    above.set_ylabel(fill(plain(u), 24))
    below.set(xlabel="distance along the line" if several else "distance along the line; contact is shaded",
              ylabel="contact pressure")  # fmt: skip
    for axes in (above, below):
        axes.grid(True, color="0.9")
        axes.margins(x=0)
    if several:
        above.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8, frameon=False)
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

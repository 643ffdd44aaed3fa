"""The solution along the lines and curves of [profile.NAME]."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.discrete.points import values_of
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.problems.values import Profile
from fenicsx_obstacle.scenes.profiles import compared, in_space, points_of
from fenicsx_obstacle.scenes.report import compare_place

FORMULA = "_formula"  # after the name of a column: that of the formula of comparison


def profiles_of(answer: Answer) -> dict[str, Profile]:
    """The solution that pictures show along all profiles of its scene, with formulas of comparison (collective).

    Raises:
        InputError: As `points_of`, or if a formula is not finite at a point.
    """
    scene, found = answer.scene, {}
    shown = answer.shown
    t = shown.record["time"]["t"] if "time" in shown.record else None
    for name, points in points_of(scene, answer.level).items():
        given = scene.tables.profile[name].compare
        found[name] = compared(scene, shown.on(points), given, compare_place(name), t)
    return found


def moments_of(
    answer: Answer, profile: Profile, given: Mapping[str, float | str], place: str
) -> list[tuple[float, Profile]]:
    """u, pressure, gap and formulas along the same points at each moment that was kept (collective); none without
    time.

    Args:
        answer: Solution of a scene.
        profile: It along a line, at the end.
        given: Formulas of comparison.
        place: Where they stand, for messages.

    Raises:
        InputError: As `compared`.
    """
    if answer.time_history is None or answer.scene.model.vector_valued:  # of a body at the moment that is shown
        return []
    plain, points = answer.plain.level, in_space(profile.points)
    comm, map_ = plain.comm, plain.V.dofmap.index_map
    first, found = map_.local_range[0], []
    for frame in answer.time_history.frames:
        fields = comm.bcast({name: frame.fields[name] for name in ("u", "pressure", "gap") if name in frame.fields})
        values = dict[str, Any]()
        for name, nodal in fields.items():
            function = fem.Function(plain.V)
            function.x.array[: plain.owned] = nodal[first : first + plain.owned]
            function.x.scatter_forward()
            values[name] = values_of(function, points)
        gap = values.pop("gap", np.full(len(points), np.inf))
        at_moment = replace(profile, gap=gap, slope=None, flux=None, **values)
        found.append((frame.t, compared(answer.scene, at_moment, given, place, frame.t)))
    return found


def compare_text(text: str) -> tuple[str, str]:
    """A quantity and its formula of comparison as the command `plot` takes them: "p = 1 - x^2".

    Raises:
        InputError: If the text is of another form.
    """
    name, sign, formula = (part.strip() for part in text.partition("="))
    if not (name and sign and formula):
        raise InputError(f"--compare {text}: expected a quantity and a formula, such as 'p = 1 - x^2'")
    return name, formula


def along_text(text: str) -> tuple[list[float], list[float]]:
    """The ends of a line as the command `plot` takes them: "x0,y0:x1,y1".

    Raises:
        InputError: If the text is of another form.
    """
    try:
        start, end = ([float(word) for word in part.split(",")] for part in text.split(":"))
    except ValueError:
        raise InputError(f"--along {text}: expected two points, such as 0,0.5:1,0.5") from None
    return start, end


def as_columns(profile: Profile) -> dict[str, list[float]]:
    """Its columns by their names: the coordinates, s, the quantities that are known, and formulas of comparison."""
    axes = "xyz"[: profile.points.shape[1]]
    columns = {axis: profile.points[:, k] for k, axis in enumerate(axes)} | {"s": profile.s}
    named = {"u": profile.u, "p": profile.pressure, "gap": profile.gap, "slope": profile.slope, "flux": profile.flux,
             "von_mises": profile.von_mises}  # fmt: skip
    for name, values in named.items():
        if values is not None and values.ndim == 1:
            columns[name] = values
        elif values is not None:
            columns |= {f"{name}_{axis}": values[:, k] for k, axis in enumerate(axes)}
    columns |= {name + FORMULA: values for name, values in profile.formulas.items()}
    return {name: values.tolist() for name, values in columns.items()}


def as_csv(parts: Mapping[float | None, Profile]) -> str:
    """A line for each point; of several moments with a first column t."""
    lines: list[str] = []
    for t, profile in parts.items():
        columns = as_columns(profile)
        heads = [*([] if t is None else ["t"]), *columns]
        lines += [] if lines else [",".join(heads)]
        rows = np.column_stack(list(columns.values()))
        lines += [",".join(f"{x:.12g}" for x in (*([] if t is None else [t]), *row)) for row in rows]
    return "\n".join(lines) + "\n"

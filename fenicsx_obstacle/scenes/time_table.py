"""Checks of the table [time], and the TimeDiscretization made of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fenicsx_obstacle.discrete.time_discretization import EQUILIBRIA, INERTIA, RATE, TimeDiscretization
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.fields import FormulaField

if TYPE_CHECKING:
    from fenicsx_obstacle.scenes.scene import Scene

COLUMNS = ("step", "dt", "newton", "krylov", "energy", "kinetic", "contact_area", "force_lower", "force_upper",
           "penetration")  # fmt: skip


def moments(scene: Scene) -> TimeDiscretization | None:
    """The moments of a scene; None without [time].

    Raises:
        InputError: If [time] and the effects contradict each other.
    """
    table, source = scene.tables.time, scene.source
    moving = {effect.order: effect.key for effect in scene.effects if effect.order}
    if table is None:
        if moving:
            raise InputError(f"{source}: [effects] {moving[max(moving)]} needs a table [time] with end, steps, start")
        return None
    for name in set(scene.report) & set(COLUMNS):
        raise InputError(f"{source}: [report] {name}: history.csv has a column of this name; choose another")
    order = max(moving, default=EQUILIBRIA)
    end = scene.number(table.end, "[time] end")
    if end <= 0:
        raise InputError(f"{source}: [time] end = {table.end}: must be positive")
    without = "without rate or inertia an equilibrium is computed at each time"
    wrong = {
        "start": (order == EQUILIBRIA, without),
        "velocity": (order != INERTIA, "it needs inertia"),
        "scheme": (order != RATE, "euler and bdf2 are for rate without inertia"),
        "tolerance": (order != RATE, "it needs rate without inertia"),
    }
    for key, (refused, why) in wrong.items():
        if refused and getattr(table, key) is not None:
            raise InputError(f"{source}: [time] {key}: {why}")
    if order > EQUILIBRIA and table.start is None:
        raise InputError(f"{source}: [time]: the key 'start' is missing, u at t = 0")
    fields = {key: None if (value := getattr(table, key)) is None else scene.field(value, f"[time] {key}")
              for key in ("start", "velocity")}  # fmt: skip
    for field in fields.values():
        if isinstance(field, FormulaField):
            field.check_names(scene.known_names)
    scheme = {EQUILIBRIA: "equilibria", RATE: table.scheme or "euler", INERTIA: "midpoint"}[order]
    return TimeDiscretization(
        order, end, table.steps, fields["start"], fields["velocity"], scheme, table.tolerance, table.frames,
        table.name,
    )  # fmt: skip

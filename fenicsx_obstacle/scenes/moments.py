"""[time]: the moments of a scene, from 0 to the end, and what it begins with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.formulas import Formula

if TYPE_CHECKING:
    from fenicsx_obstacle.scenes.scene import Scene

EQUILIBRIA, RATE, INERTIA = 0, 1, 2  # orders of the derivatives in time
NO_STEP = 1e-9  # of the whole time
COLUMNS = ("step", "dt", "newton", "krylov", "energy", "kinetic", "contact_area", "force_lower", "force_upper",
           "penetration")  # fmt: skip


@dataclass(frozen=True)
class Moments:
    """The table [time], checked.

    Attributes:
        order: Highest derivative in time: 0, 1 or 2.
        end: The last moment, in the unit of t.
        steps: How many there are, or where a tolerance chooses them: end over the first one.
        start: u at t = 0; None of equilibria.
        velocity: u_t at t = 0; None unless order = 2.
        scheme: equilibria, euler, bdf2 or midpoint.
        tolerance: What a step may add to the error, in the unit of u; None for steps alike.
        frames: How many moments are kept as fields, beside t = 0.
        name: What t is, on axes.
    """

    order: int
    end: float
    steps: int
    start: Formula | None
    velocity: Formula | None
    scheme: str
    tolerance: float | None
    frames: int
    name: str

    @property
    def step(self) -> float:
        """Length of a step, or of the first one."""
        return self.end / self.steps

    @property
    def share(self) -> float:
        """Of the force that balances a step, the part that is the contact force: with inertia a step has it twice."""
        return 0.5 if self.order == INERTIA else 1.0


def moments(scene: Scene) -> Moments | None:
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
    without = "without rate or inertia every moment is an equilibrium of its own"
    wrong = {
        "start": (order == EQUILIBRIA, without),
        "velocity": (order != INERTIA, "it goes with inertia"),
        "scheme": (order != RATE, "euler and bdf2 are for rate without inertia"),
        "tolerance": (order != RATE, "it goes with rate, without inertia"),
    }
    for key, (refused, why) in wrong.items():
        if refused and getattr(table, key) is not None:
            raise InputError(f"{source}: [time] {key}: {why}")
    if order > EQUILIBRIA and table.start is None:
        raise InputError(f"{source}: [time]: the key 'start' is missing, u at t = 0")
    formulas = {key: None if (value := getattr(table, key)) is None else scene.formula(value, f"[time] {key}")
                for key in ("start", "velocity")}  # fmt: skip
    for formula in formulas.values():
        if formula is not None:
            formula.check_names(scene.known_names)
    scheme = {EQUILIBRIA: "equilibria", RATE: table.scheme or "euler", INERTIA: "midpoint"}[order]
    return Moments(
        order, end, table.steps, formulas["start"], formulas["velocity"], scheme, table.tolerance, table.frames,
        table.name,
    )  # fmt: skip

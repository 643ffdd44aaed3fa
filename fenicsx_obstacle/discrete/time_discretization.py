"""Time discretization: end, steps, scheme and initial values."""

from __future__ import annotations

from dataclasses import dataclass

from fenicsx_obstacle.effects.field import Field

EQUILIBRIA, RATE, INERTIA = 0, 1, 2  # orders of the derivatives in time
NO_STEP = 1e-9  # of the whole time


@dataclass(frozen=True)
class TimeDiscretization:
    """The time discretization of a problem.

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
    start: Field | None
    velocity: Field | None
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
        """The contact force over the contact term of a step: with inertia the step contains it twice."""
        return 0.5 if self.order == INERTIA else 1.0

"""Time discretization: end, steps, scheme and initial values; derivatives as differences c u - past.

A step in time is a static problem with a foundation c and a load `past`; so forms know nothing of steps or schemes.
Time stepping sets the number c and the Function before each step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.mesh.levels import Level

EQUILIBRIA, RATE, INERTIA = 0, 1, 2  # orders of the derivatives in time
NO_STEP = 1e-9  # of the whole time
ROUND_OFF = 1e-9  # relative difference of constants that are the same


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


@dataclass
class Moment:
    """The present time and the constants of the difference formulas, shared by all levels of a mesh.

    Attributes:
        t: Now, in the unit of the end.
        first: c of u_t = c u - past, in 1/time.
        second: c of u_tt = c u - past, in 1/time^2.
    """

    t: float
    first: float
    second: float

    @classmethod
    def at_start(cls, moments: TimeDiscretization) -> Moment:
        """The state before the first step, with the constants c of the first step."""
        moment = cls(0.0, 0.0, 0.0)
        moment.go_back(moments)
        return moment

    def go_back(self, moments: TimeDiscretization) -> None:
        """Return to t = 0, after time stepping."""
        dt = moments.step
        self.t = 0.0
        self.first, self.second = (2 / dt, 4 / dt**2) if moments.order == INERTIA else (1 / dt, 0.0)


class Motion:
    """u_t and u_tt on one level.

    Attributes:
        past: u_t = first u - past, at nodes.
        past_twice: u_tt = second u - past_twice, at nodes.
        velocity: u_t at the end of a step, at nodes.
    """

    def __init__(self, level: Level, moment: Moment):
        self.moment = moment
        self.past, self.past_twice, self.velocity = (fem.Function(level.V) for _ in range(3))
        self._first, self._second = (fem.Constant(level.mesh, PETSc.ScalarType(0.0)) for _ in range(2))
        self.follow()

    def follow(self) -> bool:
        """Update the constants c; returns whether they have changed."""
        wanted = self.moment.first, self.moment.second
        if np.allclose((float(self._first.value), float(self._second.value)), wanted, rtol=ROUND_OFF, atol=0.0):
            return False  # steps alike, up to the last digits of t
        self._first.value, self._second.value = wanted
        return True

    def rate(self, u: Any) -> Any:
        """u_t."""
        return self._first * u - self.past

    def acceleration(self, u: Any) -> Any:
        """u_tt."""
        return self._second * u - self.past_twice

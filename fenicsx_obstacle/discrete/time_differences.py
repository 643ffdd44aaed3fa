"""Time derivatives as differences c u - past; time stepping sets the number c and the Function before each step.

A step in time is a static problem with a foundation c and a load `past`; so forms know nothing of steps or schemes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.time_discretization import INERTIA, TimeDiscretization


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


ROUND_OFF = 1e-9


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

    def rate_energy(self, u: Any) -> Any:
        """The functional whose derivative is `rate`."""
        return 0.5 * self._first * u**2 - self.past * u

    def acceleration(self, u: Any) -> Any:
        """u_tt."""
        return self._second * u - self.past_twice

    def acceleration_energy(self, u: Any) -> Any:
        """The functional whose derivative is `acceleration`."""
        return 0.5 * self._second * u**2 - self.past_twice * u

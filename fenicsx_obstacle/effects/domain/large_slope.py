"""Surface tension for large slopes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from ufl import grad, inner, sqrt

from fenicsx_obstacle.effects.effect import Sampler, WithTension, register


@register
@dataclass(frozen=True)
class LargeSlope(WithTension):
    """-div(s grad u/sqrt(1 + |grad u|^2)), s the surface tension: int s grad u . grad v/sqrt(1 + |grad u|^2).

    The tension of a film whose slopes are no longer small; its energy s times the area is convex. Without load it is a
    surface of least area. Newton's matrix is the exact derivative.
    """

    key = "large_slope"
    equation = "-div(large_slope grad u/sqrt(1 + |grad u|^2))"
    term = "int large_slope grad u . grad v/sqrt(1 + |grad u|^2)"
    role = "film"
    affine = False

    def tension_at(self, u: Any, data: Sampler) -> Any:
        return data.cellwise(self.value, positive=True) / sqrt(1 + inner(grad(u), grad(u)))

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        return data.cellwise(self.value, positive=True) * sqrt(1 + inner(grad(u), grad(u))) * data.dx

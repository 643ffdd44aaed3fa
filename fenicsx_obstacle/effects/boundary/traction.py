"""A force per area on a part of the boundary of an elastic body."""

from __future__ import annotations

from typing import Any

import ufl
from ufl import as_vector, inner

from fenicsx_obstacle.effects.boundary import OfComponents
from fenicsx_obstacle.effects.effect import Sampler, register


@register
class Traction(OfComponents):
    """sigma(u) n = traction: - int traction . v; unit: force per area."""

    key = "traction"
    equation = "traction"
    term = "- int traction . v over its part"
    unit = "force/area"

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return -inner(as_vector(self.components(u, data)), v) * data.over(self.part, self.key)

"""A pressure on a part of the boundary of an elastic body."""

from __future__ import annotations

from typing import Any

import ufl
from ufl import FacetNormal, inner

from fenicsx_obstacle.effects.effect import OnPart, Sampler, register


@register
class Pressure(OnPart):
    """sigma(u) n = -pressure n with the outward normal n: + int pressure n . v; unit: force per area.

    The formula is interpolated between the nodes of the part.
    """

    key = "pressure"
    equation = "- pressure n"
    term = "+ int pressure n . v over its part"
    unit = "force/area"
    vector_valued = True

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        pressure = data.on_part(self.value, self.part)
        return pressure * inner(FacetNormal(v.ufl_domain()), v) * data.over(self.part, self.key)

"""A flux through a part of the boundary."""

from __future__ import annotations

from typing import Any

import ufl

from fenicsx_obstacle.effects.effect import OnPart, Sampler, register


@register
class Flux(OnPart):
    """tension du/dn = flux: the Neumann condition, - int flux v; unit: force per length.

    By the nodal rule of the facets, as springs are: a flux `spring*g` and a spring are in balance at each node where
    u = g, whatever their sizes. Source: natural condition of (2.2).
    """

    key = "flux"
    equation = "flux"
    term = "- int flux v over its part, nodal rule"
    unit = "force/length"
    role = "part load"

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return -data.on_part(self.value, self.part) * v * data.over(self.part, self.key, nodal=True)

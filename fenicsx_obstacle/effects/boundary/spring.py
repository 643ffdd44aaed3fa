"""Springs on a part of the boundary."""

from __future__ import annotations

from typing import Any

import ufl

from fenicsx_obstacle.effects.boundary import OnPart
from fenicsx_obstacle.effects.effect import Reader, Sampler, register


@register
class Spring(OnPart):
    """tension du/dn = -spring u: Robin's condition, int spring u v with spring >= 0; unit: force per area.

    By the nodal rule of the facets, so that it is diagonal like the penalty and keeps the signs of an M-matrix; with a
    flux `spring*g` in addition the springs are at rest at u = g.
    """

    key = "spring"
    table = "boundary"
    equation = "- spring u"
    term = "+ int spring u v over its part, nodal rule"
    unit = "force/area"
    role = "part reaction"
    holds = True

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Any:
        if isinstance(raw, list | tuple) or reader.of_body:
            from fenicsx_obstacle.effects import elastic_support as of_bodies  # only where a scene has a vector

            kind = of_bodies.ElasticSupport if isinstance(raw, list | tuple) else of_bodies.NormalSpring
            return kind.read(raw, place, reader, **more)
        return super().read(raw, place, reader, **more)

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        k = data.on_part(self.value, self.part, least=0.0)
        return k * u * v * data.over(self.part, self.key, nodal=True)

    def push(self, data: Sampler) -> tuple[float, float]:
        return 0.0, 0.0

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        k = data.on_part(self.value, self.part, least=0.0)
        return 0.5 * k * u**2 * data.over(self.part, self.key, nodal=True)

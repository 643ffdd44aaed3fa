"""What acts on a part of the boundary, or along a curve inside: a flux and springs.

On a part of the boundary  tension du/dn = flux - spring u,  n outward; along a curve inside the same is the jump of
tension du/dn, so that a flux there is a load along the curve. They are written in [[boundary]].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fenicsx_obstacle.effects.effect import Effect, Reader, Sampler, register

if TYPE_CHECKING:
    import ufl

    from fenicsx_obstacle.effects.field import Field


@dataclass(frozen=True)
class OnPart(Effect):
    """An effect on the part of a [[boundary]].

    Attributes:
        part: Which [[boundary]], counted from 0.
    """

    value: Field
    part: int

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> OnPart:
        return cls(reader.field(raw, place), **more)


@register
class Flux(OnPart):
    """tension du/dn = flux: the Neumann condition, - int flux v; unit: force per length.

    The formula is interpolated between the nodes of the part. Source: natural condition of (2.2).
    """

    key = "flux"
    table = "boundary"
    equation = "flux"
    term = "- int flux v over its part"
    unit = "force/length"

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return -data.on_part(self.value, self.part) * v * data.over(self.part, self.key)

    def push(self, data: Sampler) -> tuple[float, float]:
        values = data.on_part(self.value, self.part).x.array
        return float(values.min(initial=0.0)), float(values.max(initial=0.0))

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        return -data.on_part(self.value, self.part) * u * data.over(self.part, self.key)


@register
class Spring(OnPart):
    """tension du/dn = -spring u: Robin's condition, int spring u v with spring >= 0; unit: force per area.

    By the nodal rule of the facets, so that it is diagonal like the penalty and keeps the signs of an M-matrix; with a
    flux `spring*g` beside it the springs rest at the height g.
    """

    key = "spring"
    table = "boundary"
    equation = "- spring u"
    term = "+ int spring u v over its part, nodal rule"
    unit = "force/area"
    holds = True

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        k = data.on_part(self.value, self.part, least=0.0)
        return k * u * v * data.over(self.part, self.key, nodal=True)

    def push(self, data: Sampler) -> tuple[float, float]:
        return 0.0, 0.0

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        k = data.on_part(self.value, self.part, least=0.0)
        return 0.5 * k * u**2 * data.over(self.part, self.key, nodal=True)

"""A load per area, or per volume on an elastic body."""

from __future__ import annotations

from typing import Any

import ufl
from ufl import inner

from fenicsx_obstacle.effects.effect import Effect, OfComponents, Reader, Sampler, components_of, register


@register
class Load(Effect):
    """The load f of f(v) = int f v, sampled as `Level.W` is; unit: force per area."""

    key = "load"
    equation = "load"
    term = "- int load v"
    upwinded = True
    unit = "force/area"
    role = "load"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Effect:
        if isinstance(raw, list):
            return BodyForce.read(raw, place, reader)
        return cls(reader.value(raw, place))

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return -data.cellwise(self.value) * v * data.dx

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        return -data.cellwise(self.value) * u * data.dx

    def push(self, data: Sampler) -> tuple[float, float]:
        values = data.values(self.value)
        return float(values.min(initial=0.0)), float(values.max(initial=0.0))


class BodyForce(OfComponents):
    """The load f of f(v) = int f . v, sampled as `Level.W` is; unit: force per volume."""

    key = "load"
    equation = "load"
    term = "- int load . v"
    unit = "force/volume"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> BodyForce:
        return cls(components_of(raw, place, reader))

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return -inner(data.field(self.value), v) * data.dx

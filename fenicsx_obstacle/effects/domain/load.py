"""A load per area, or per volume on an elastic body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from ufl import inner

from fenicsx_obstacle.effects.effect import Effect, Reader, Sampler, register
from fenicsx_obstacle.effects.field import Field


@register
class Load(Effect):
    """The load f of f(v) = int f v, sampled as `Level.W` is; unit: force per area."""

    key = "load"
    equation = "load"
    term = "- int load v"
    unit = "force/area"
    role = "load"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Effect:
        if isinstance(raw, list):
            return BodyForce(reader.components(raw, place))
        return cls(reader.value(raw, place))

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return -data.cellwise(self.value) * v * data.dx


@dataclass(frozen=True)
class BodyForce(Effect):
    """The load f of f(v) = int f . v, sampled as `Level.W` is; unit: force per volume.

    Attributes:
        value: Its components.
    """

    value: tuple[Field, ...]  # type: ignore[assignment]

    key = "load"
    equation = "load"
    term = "- int load . v"
    unit = "force/volume"
    vector_valued = True

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return -inner(data.field(self.value), v) * data.dx

"""A force per area on a part of the boundary of an elastic body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from ufl import as_vector, inner

from fenicsx_obstacle.effects.body_force import OfComponents, components_of
from fenicsx_obstacle.effects.effect import Reader, Sampler, register
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import counted


@register
@dataclass(frozen=True)
class Traction(OfComponents):
    """sigma(u) n = traction: - int traction . v; unit: force per area.

    The formulas are interpolated between the nodes of the part.

    Attributes:
        part: Which [[boundary]], counted from 0.
        source: Where it stands, for messages.
    """

    part: int
    source: str

    key = "traction"
    table = "boundary"
    equation = "traction"
    term = "- int traction . v over its part"
    unit = "force/area"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Traction:
        return cls(components_of(raw, place, reader), more["part"], f"{reader.source}: {place}")

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        if len(self.value) != len(u):
            wanted = f"u has {counted(len(u), 'component')}"
            raise InputError(f"{self.source}: has {counted(len(self.value), 'component')}, but {wanted}")
        force = as_vector([data.on_part(one, self.part) for one in self.value])
        return -inner(force, v) * data.over(self.part, self.key)

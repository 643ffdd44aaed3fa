"""Springs on a part of the boundary of an elastic body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from ufl import FacetNormal, dot

from fenicsx_obstacle.effects.body_force import OfComponents, components_of
from fenicsx_obstacle.effects.boundary import OnPart
from fenicsx_obstacle.effects.effect import Reader, Sampler
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import counted

UNIT = "force/length^3"


class NormalSpring(OnPart):
    """sigma(u) n = -spring (u . n) n with the outward normal n: + int spring (u . n) (v . n), spring >= 0.

    The formula is interpolated between the nodes of the part; unit: force per area and length.
    """

    key = "spring"
    table = "boundary"
    equation = "- spring (u . n) n"
    term = "+ int spring (u . n) (v . n) over its part"
    unit = UNIT
    vector_valued = True

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        k, n = data.on_part(self.value, self.part, least=0.0), FacetNormal(v.ufl_domain())
        return k * dot(u, n) * dot(v, n) * data.over(self.part, self.key)


@dataclass(frozen=True)
class ElasticSupport(OfComponents):
    """The components of sigma(u) n are -spring_k u_k: + int sum spring_k u_k v_k, spring_k >= 0.

    The formulas are interpolated between the nodes of the part; unit: force per area and length.

    Attributes:
        part: Which [[boundary]], counted from 0.
        source: Where it stands, for messages.
    """

    part: int
    source: str

    key = "spring"
    table = "boundary"
    equation = "- diag(spring) u"
    term = "+ int diag(spring) u . v over its part"
    unit = UNIT

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> ElasticSupport:
        return cls(components_of(raw, place, reader), more["part"], f"{reader.source}: {place}")

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        if len(self.value) != len(u):
            wanted = f"u has {counted(len(u), 'component')}"
            raise InputError(f"{self.source}: has {counted(len(self.value), 'component')}, but {wanted}")
        each = [data.on_part(one, self.part, least=0.0) for one in self.value]
        return sum(k * u[i] * v[i] for i, k in enumerate(each)) * data.over(self.part, self.key)

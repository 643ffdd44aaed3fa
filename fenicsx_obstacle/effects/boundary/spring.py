"""Springs on a part of the boundary, also of an elastic body."""

from __future__ import annotations

from typing import Any

import ufl
from ufl import FacetNormal, dot

from fenicsx_obstacle.effects.boundary import OfComponents
from fenicsx_obstacle.effects.effect import OnPart, Reader, Sampler, register

OF_BODIES = "force/length^3"  # unit of springs on elastic bodies


@register
class Spring(OnPart):
    """tension du/dn = -spring u: Robin's condition, int spring u v with spring >= 0; unit: force per area.

    By the nodal rule of the facets, so that it is diagonal like the penalty and keeps the signs of an M-matrix; with a
    flux `spring*g` in addition the springs are at rest at u = g.
    """

    key = "spring"
    equation = "- spring u"
    term = "+ int spring u v over its part, nodal rule"
    unit = "force/area"
    role = "part reaction"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> OnPart:
        if isinstance(raw, list | tuple):
            return ElasticSupport.read(raw, place, reader, **more)
        return (NormalSpring if reader.of_body else cls)(reader.field(raw, place), **more)

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        k = data.on_part(self.value, self.part, least=0.0)
        return k * u * v * data.over(self.part, self.key, nodal=True)


class NormalSpring(OnPart):
    """sigma(u) n = -spring (u . n) n with the outward normal n: + int spring (u . n) (v . n), spring >= 0.

    The formula is interpolated between the nodes of the part; unit: force per area and length.
    """

    key = "spring"
    equation = "- spring (u . n) n"
    term = "+ int spring (u . n) (v . n) over its part"
    unit = OF_BODIES
    vector_valued = True

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        k, n = data.on_part(self.value, self.part, least=0.0), FacetNormal(v.ufl_domain())
        return k * dot(u, n) * dot(v, n) * data.over(self.part, self.key)


class ElasticSupport(OfComponents):
    """The components of sigma(u) n are -spring_k u_k: + int sum spring_k u_k v_k, spring_k >= 0.

    Unit: force per area and length.
    """

    key = "spring"
    equation = "- diag(spring) u"
    term = "+ int diag(spring) u . v over its part"
    unit = OF_BODIES

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        each = self.components(u, data, least=0.0)
        return sum(k * u[i] * v[i] for i, k in enumerate(each)) * data.over(self.part, self.key)

"""The stiffness of an elastic body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ufl

from fenicsx_obstacle.effects.effect import Effect, Elastic, Reader, Sampler, register
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.elasticity import Elasticity as Hooke
from fenicsx_obstacle.text import nearest

PLANES = ("strain", "stress")


@register
@dataclass(frozen=True)
class Elasticity(Elastic):
    """-div(sigma(u)) with Hooke's law for small displacements u: a(u, v) = int sigma(u) : e(v).

    Attributes:
        value: Young's modulus, force per area, positive.
        poisson: Poisson's ratio, dimensionless, above -1 and below 1/2.
        plane: strain or stress in the plane; None in space and with axial symmetry.
    """

    value: Field
    poisson: Field
    plane: str | None

    key = "elasticity"
    equation = "-div(sigma(u))"
    term = "int sigma(u) : e(v)"
    unit = "force/area"
    vector_valued = True

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Elasticity:
        keys = reader.table(raw, place, ("young", "poisson"), ("plane",))
        plane = keys.get("plane")
        if plane is not None and plane not in PLANES:
            hint = nearest(str(plane), PLANES)
            raise InputError(f"{reader.source}: {place}.plane = {plane!r}: expected {' or '.join(PLANES)}{hint}")
        young, poisson = (reader.value(keys[key], f"{place}.{key}") for key in ("young", "poisson"))
        return cls(young, poisson, plane)

    def conflict(self, effects: Sequence[Effect]) -> str | None:
        if self.plane is not None and any(effect.role == "radial weight" for effect in effects):
            return f"elasticity.plane = '{self.plane}': with axial_symmetry there is no plane; remove the key"
        return None

    def __str__(self) -> str:
        plane = "" if self.plane is None else f", plane {self.plane}"
        return f"{self.value.text}, Poisson's ratio {self.poisson.text}{plane}"

    def law(self, u: Any, data: Sampler) -> Hooke:
        """Hooke's law for a displacement (collective)."""
        return Hooke(
            u, young=data.cellwise(self.value, positive=True), poisson=data.cellwise(self.poisson),
            plane="axial" if data.axial else self.plane, name=self.value.source.removesuffix(".young"),
        )  # fmt: skip

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return self.law(u, data).residual(v)

"""A soft obstacle: an elastic one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl

from fenicsx_obstacle.effects.effect import Effect, Reader, Sampler, register
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.forms.penalty import positive_part


@register
@dataclass(frozen=True)
class SoftObstacle(Effect):
    """A soft obstacle: k (u - upper)^+ - k (lower - u)^+ on the left side; unit of k: force per volume.

    The term of (3.3) with 1/eps = k, but k is a property of the obstacle: the solution crosses it, and no eps is chosen
    for it. By the nodal rule, as the penalty (3.4). Energy: k/2 ((u - upper)^+^2 + (lower - u)^+^2), convex.

    Attributes:
        lower: The lower obstacle, or None.
        upper: The upper obstacle, or None.
    """

    lower: Field | None = None
    upper: Field | None = None

    key = "soft_obstacle"
    equation = "stiffness ((u - upper)^+ - (lower - u)^+)"
    term = "+ int stiffness ((u - upper)^+ - (lower - u)^+) v, nodal rule"
    unit = "force/volume"
    role = "soft obstacle"
    affine = False

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> SoftObstacle:
        given = reader.table(raw, place, ("stiffness",), ("lower", "upper"), ("lower", "upper"))
        sides = {side: reader.field(given[side], f"{place}.{side}") for side in ("lower", "upper") if side in given}
        return cls(reader.value(given["stiffness"], f"{place}.stiffness"), **sides)

    def __str__(self) -> str:
        sides = [f"{side} = {g.text}" for side, g in (("lower", self.lower), ("upper", self.upper)) if g is not None]
        return "{" + ", ".join([*sides, f"stiffness = {self.value.text}"]) + "}"

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        above, below = self._excess(u, data)
        return data.cellwise(self.value, least=0.0) * (above - below) * v * data.dI

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        above, below = self._excess(u, data)
        return 0.5 * data.cellwise(self.value, least=0.0) * (above**2 + below**2) * data.dI

    def _excess(self, u: Any, data: Sampler) -> tuple[Any, Any]:
        """(u - upper)^+ and (lower - u)^+."""
        above = 0.0 if self.upper is None else positive_part(u - data.height(self.upper))
        below = 0.0 if self.lower is None else positive_part(data.height(self.lower) - u)
        return above, below

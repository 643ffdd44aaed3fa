"""Drift: transport by a given velocity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ufl
from ufl import grad, inner

from fenicsx_obstacle.effects.effect import Effect, Elastic, Reader, Sampler, register
from fenicsx_obstacle.effects.field import Field


@register
@dataclass(frozen=True)
class Drift(Effect):
    """drift . grad u on the left side: int (drift . grad u) v; unit: force per area, for u in units of length.

    It is not symmetric, and there is no energy. With the Peclet number Pe = |drift| h/(2 tension) of a cell, Galerkin's
    method oscillates where Pe > 1. There, and only there, the test functions of drift, load and foundation are
    upwinded (`effects/upwinding.py`: SUPG, Brooks and Hughes 1982, with the upwinding max(0, 1 - 1/Pe)):

        v + tau drift . grad v,   tau = max(0, |drift| h/2 - tension)/|drift|^2.

    In one dimension that makes an M-matrix. As h tends to 0 the method becomes Galerkin's, cell by cell. The contact
    pressure is not upwinded: where Pe > 1 it is smeared by tau.

    Attributes:
        value: Components of the drift.
    """

    value: tuple[Field, ...]  # type: ignore[assignment]

    key = "drift"
    equation = "drift . grad u"
    term = "+ int (drift . grad u) v"
    unit = "force/area"
    role = "drift"
    symmetric = False
    convex = False

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Drift:
        return cls(reader.components(raw, place, (1, 2, 3), "a list of one number or formula per coordinate"))

    def conflict(self, effects: Sequence[Effect]) -> str | None:
        bent = [effect.key for effect in effects if isinstance(effect, Elastic) and not effect.affine]
        return f"{self.key} can only be combined with tension, not with {bent[0]}" if bent else None

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return inner(data.field(self.value), grad(u)) * v * data.dx

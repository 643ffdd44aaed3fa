"""Drift: transport by a given velocity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ufl
from ufl import conditional, grad, gt, inner, max_value, sqrt

from fenicsx_obstacle.effects.effect import Effect, Reader, Sampler, register
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError


@register
@dataclass(frozen=True)
class Drift(Effect):
    """drift . grad u on the left side: int (drift . grad u) v; unit: force per area, for u in units of length.

    It is not symmetric, and there is no energy. With the Peclet number Pe = |drift| h/(2 tension) of a cell, Galerkin's
    method oscillates where Pe > 1. There, and only there, the test functions of drift, load and foundation are
    upwinded (SUPG, Brooks and Hughes 1982, with the upwinding max(0, 1 - 1/Pe)):

        v + tau drift . grad v,   tau = max(0, |drift| h/2 - tension)/|drift|^2.

    In one dimension that makes an M-matrix. As h tends to 0 the method becomes Galerkin's, cell by cell. The contact
    pressure is not upwinded: where Pe > 1 it is smeared by tau.

    Attributes:
        value: Components of the drift.
    """

    value: tuple[Field, ...]  # type: ignore[assignment]

    key = "drift"
    equation = "drift . grad u"
    left = True
    term = "+ int (drift . grad u) v"
    note = (
        "drift: in cells with a Peclet number |drift| h/(2 tension) above 1 the test functions of drift, load and "
        "foundation are upwinded, v + tau drift . grad v (SUPG); elsewhere Galerkin's method"
    )
    unit = "force/area"
    role = "drift"
    symmetric = False
    convex = False
    upwinded = True

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Drift:
        if not isinstance(raw, list) or not 1 <= len(raw) <= 3 or any(isinstance(part, list | dict) for part in raw):
            wanted = "a list of one number or formula per coordinate"
            raise InputError(f"{reader.source}: {place} = {raw!r}: expected {wanted}")
        return cls(tuple(reader.field(part, f"{place}[{axis}]") for axis, part in enumerate(raw)))

    def conflict(self, effects: Sequence[Effect]) -> str | None:
        bent = [effect.key for effect in effects if effect.elastic and not effect.affine]
        return f"{self.key} can only be combined with tension, not with {bent[0]}" if bent else None

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return inner(data.field(self.value), grad(u)) * v * data.dx

    def push(self, data: Sampler) -> tuple[float, float]:
        return 0.0, 0.0

    def upwinding(self, v: Any, elastic: Effect, data: Sampler) -> Any:
        b, tension = data.field(self.value), elastic.tension_at(None, data)
        squared = inner(b, b)
        along = inner(tension * b, b) / squared if tension.ufl_shape else tension
        excess = max_value(sqrt(squared) * data.cell_size / 2 - along, 0.0)
        return conditional(gt(squared, 0.0), excess / squared, 0.0) * inner(b, grad(v))

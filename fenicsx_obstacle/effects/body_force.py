"""A load per volume on an elastic body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from ufl import inner

from fenicsx_obstacle.effects.effect import Effect, Reader, Sampler
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError


@dataclass(frozen=True)
class OfComponents(Effect):
    """An effect on elastic bodies whose datum is a vector.

    Attributes:
        value: Its components.
    """

    value: tuple[Field, ...]  # type: ignore[assignment]

    vector_valued = True


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


def components_of(raw: Any, place: str, reader: Reader) -> tuple[Field, ...]:
    """The components of a vector in a scene.

    Raises:
        InputError: If it is not a list of two or three numbers or formulas.
    """
    if not isinstance(raw, list | tuple) or len(raw) not in (2, 3) or any(isinstance(one, list | dict) for one in raw):
        raise InputError(f"{reader.source}: {place} = {raw!r}: expected a list of two or three numbers or formulas")
    return tuple(reader.field(one, f"{place}[{k}]") for k, one in enumerate(raw))

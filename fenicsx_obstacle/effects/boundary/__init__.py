"""Effects on a part of the boundary, or along a curve inside: flux and springs.

On a part of the boundary  tension du/dn = flux - spring u,  n outward; along a curve inside the same is the jump of
tension du/dn, so that a flux there is a load along the curve. They are written in [[boundary]].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fenicsx_obstacle.effects.effect import Effect, OfComponents, Reader, Sampler, components_of
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import counted


@dataclass(frozen=True)
class OnPart(Effect):
    """An effect on the part of a [[boundary]].

    Attributes:
        part: Which [[boundary]], counted from 0.
    """

    value: Field
    part: int

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> OnPart:
        return cls(reader.field(raw, place), **more)


@dataclass(frozen=True)
class OfComponentsOnPart(OfComponents):
    """The same of an elastic body, with a vector; its formulas are interpolated between the nodes of the part.

    Attributes:
        part: Which [[boundary]], counted from 0.
        source: Where it stands, for messages.
    """

    part: int
    source: str

    table = "boundary"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> OfComponentsOnPart:
        return cls(components_of(raw, place, reader), more["part"], f"{reader.source}: {place}")

    def components(self, u: Any, data: Sampler, *, least: float | None = None) -> list[Any]:
        """Nodal Functions with the values of its components.

        Raises:
            InputError: If u has another number of components.
        """
        if len(self.value) != len(u):
            wanted = f"u has {counted(len(u), 'component')}"
            raise InputError(f"{self.source}: has {counted(len(self.value), 'component')}, but {wanted}")
        return [data.on_part(one, self.part, least=least) for one in self.value]

"""Effects on a part of the boundary, or along a curve inside: flux and springs.

On a part of the boundary  tension du/dn = flux - spring u,  n outward; along a curve inside the same is the jump of
tension du/dn, so that a flux there is a load along the curve. They are written in [[boundary]].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fenicsx_obstacle.effects.effect import Effect, Reader
from fenicsx_obstacle.effects.field import Field


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

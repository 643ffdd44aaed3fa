"""The effects of [[boundary]], one in each module: a file is named as the key that scenes write.

On a part of the boundary  tension du/dn = flux - spring u,  n outward; along a curve inside the same is the jump of
tension du/dn, so that a flux there is a load along the curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fenicsx_obstacle.effects.effect import OnPart, Reader, Sampler
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import counted


@dataclass(frozen=True)
class OfComponents(OnPart):
    """The same of an elastic body, with a vector; its formulas are interpolated between the nodes of the part.

    Attributes:
        value: Its components.
    """

    value: tuple[Field, ...]  # type: ignore[assignment]

    vector_valued = True

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> OfComponents:
        return cls(reader.components(raw, place), **more)

    def components(self, u: Any, data: Sampler, *, least: float | None = None) -> list[Any]:
        """Nodal Functions with the values of its components.

        Raises:
            InputError: If u has another number of components.
        """
        if len(self.value) != len(u):
            place, wanted = self.value[0].source.removesuffix("[0]"), f"u has {counted(len(u), 'component')}"
            raise InputError(f"{place}: has {counted(len(self.value), 'component')}, but {wanted}")
        return [data.on_part(one, self.part, least=least) for one in self.value]

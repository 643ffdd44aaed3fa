"""Loads at single points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fenicsx_obstacle.effects.effect import Effect, Reader, register
from fenicsx_obstacle.errors import InputError


@register
@dataclass(frozen=True)
class PointLoad(Effect):
    """sum F_k delta(x - x_k) on the right side: sum F_k v(x_k); unit: force, upwards.

    Each point loads the vertices of its cell by their barycentric coordinates there. In one dimension u stays exact at
    the vertices; in two u ~ -F ln(distance)/(2 pi tension) near the point, whose energy is infinite: the L2 error is of
    order 1 (Scott 1973), and there is no bound of the energy error but on intervals.

    Attributes:
        value: Coordinates and force of each point.
    """

    value: tuple[tuple[tuple[float, ...], float], ...]  # type: ignore[assignment]

    key = "point_load"
    equation = "sum of point_load delta"
    term = "- sum point_load v(point)"
    unit = "force"
    role = "point forces"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> PointLoad:
        if not isinstance(raw, list) or not raw:
            wanted = "a list such as [{at = [0.5, 0.5], force = 1}]"
            raise InputError(f"{reader.source}: {place} = {raw!r}: expected {wanted}")
        found = []
        for number, one in enumerate(raw):
            here = f"{place}[{number}]"
            given = reader.table(one, here, ("at", "force"))
            at = given["at"] if isinstance(given["at"], list) else [given["at"]]
            force = reader.number(given["force"], f"{here}.force")
            found.append((tuple(reader.number(x, f"{here}.at") for x in at), force))
        return cls(tuple(found))

    def conflict(self, effects: Sequence[Effect]) -> str | None:
        radial = [effect.key for effect in effects if effect.role == "radial weight"]
        return f"{self.key}: with {radial[0]} a point is a circle" if radial else None

    def __str__(self) -> str:
        return ", ".join(f"{force:g} at ({', '.join(f'{x:g}' for x in at)})" for at, force in self.value)

"""Axial symmetry: a body of revolution by its meridian, a disk by its radius."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenicsx_obstacle.effects.effect import Effect, Reader, register
from fenicsx_obstacle.effects.field import Field, Names
from fenicsx_obstacle.errors import InputError


@register
@dataclass(frozen=True)
class AxialSymmetry(Effect):
    """The weight x in every integral, x >= 0 being the distance from the axis: -(1/x) div(x tension grad u) = load + p.

    It is what integrals over the body become, divided by 2 pi. For elements of degree 1 the weight is x at the middle
    of each cell, so that nodes on the axis have an area of contact too; a side on the axis is free by itself. Areas and
    forces are per radian. `Data.dx` gives integrals over cells this weight, `data/measures.py` those over facets.
    """

    value: None = None  # type: ignore[assignment]

    key = "axial_symmetry"
    role = "radial weight"
    vector_valued = None

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> AxialSymmetry:
        if raw is not True:
            raise InputError(f"{reader.source}: {place} = {raw!r}: expected true, or nothing")
        return cls()

    def __str__(self) -> str:
        return (
            "true: x is the distance from the axis, the weight of every integral of the equation, but not of those in "
            "[report]; areas and forces are per radian"
        )


class Radius(Field):
    """x, as a datum."""

    text = "x"

    def __init__(self, source: str):
        self.source = source

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        return x[0]

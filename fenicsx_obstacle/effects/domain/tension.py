"""The tension of a membrane; a matrix for cloth, wood or layered ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from ufl import grad, inner

from fenicsx_obstacle.effects.effect import Effect, Reader, Sampler, WithTension, register
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError


@register
class Tension(WithTension):
    """-div(tension grad u): a(u, v) = int tension grad u . grad v, Kikuchi (2.2) with mu = tension.

    One positive value per cell (the paper's mu >= mu_0 > 0, (2.5)); unit: force per length. A matrix in the scene makes
    it an `Anisotropic` one.
    """

    key = "tension"
    equation = "-div(tension grad u)"
    term = "int tension grad u . grad v"
    role = "tension"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Effect:
        if isinstance(raw, list):
            return Anisotropic.read(raw, place, reader)
        return cls(reader.value(raw, place))

    def tension_at(self, u: Any, data: Sampler) -> Any:
        return data.cellwise(self.value, positive=True)


@dataclass(frozen=True)
class Anisotropic(WithTension):
    """-div(tension grad u) with a matrix: a(u, v) = int (tension grad u) . grad v; unit: force per length.

    Symmetric and positive definite in each cell, which is what (2.5) asks of a tensor; as many rows as the mesh has
    coordinates.

    Attributes:
        value: Its rows, of formulas.
    """

    value: tuple[tuple[Field, ...], ...]  # type: ignore[assignment]

    key = "tension"
    equation = "-div(tension grad u)"
    term = "int (tension grad u) . grad v"
    role = "matrix tension"

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Anisotropic:
        square = len(raw) in (2, 3) and all(isinstance(row, list) and len(row) == len(raw) for row in raw)
        if not square or any(isinstance(entry, list | dict) for row in raw for entry in row):
            wanted = "2 rows of 2, or 3 rows of 3, numbers or formulas"
            raise InputError(f"{reader.source}: {place} = {raw!r}: expected {wanted}")
        rows = (
            tuple(reader.field(entry, f"{place}[{i}][{j}]") for j, entry in enumerate(row)) for i, row in enumerate(raw)
        )
        return cls(tuple(rows))

    def tension_at(self, u: Any, data: Sampler) -> Any:
        return data.matrix(self.value)

    def stiffness(self, data: Sampler) -> np.ndarray:
        return data.eigenvalues(self.value)[:, -1]

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return inner(self.tension_at(u, data) * grad(u), grad(v)) * data.dx

"""Power law: a tension that is a power of |grad u|."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from ufl import grad, inner

from fenicsx_obstacle.effects.effect import Reader, Sampler, WithTension, register
from fenicsx_obstacle.errors import InputError

_LIMITS = (
    ", which are excluded: up to 1 the energy is not strictly convex, and from 4 on Newton's matrix is nearly singular "
    "where u is flat; take an exponent such as 3.99, or an ObstacleProblem with a form of your own"
)
FLAT = 1e-6  # slope below which a power law is that of a linear membrane


@register
@dataclass(frozen=True)
class PowerLaw(WithTension):
    """-div(k |grad u|^(n-2) grad u), 1 < n < 4: int k (|grad u|^2 + d^2)^((n-2)/2) grad u . grad v.

    The n-Laplacian (Glowinski and Marrocco 1975): fluids, ice and torsion that creep by power laws. Where u is flat it
    would have no stiffness (n > 2), or an infinite one (n < 2): the regularisation d is a slope below which it is that
    of a linear membrane; energies change by less than k d^n area. Newton's matrix is the exact derivative.

    Attributes:
        exponent: n.
        regularisation: d > 0, a slope.
    """

    exponent: float = 2.0
    regularisation: float = FLAT

    key = "power_law"
    equation = "-div(coefficient (|grad u|^2 + regularisation^2)^((exponent - 2)/2) grad u)"
    term = "int coefficient (|grad u|^2 + regularisation^2)^((exponent - 2)/2) grad u . grad v"
    affine = False

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> PowerLaw:
        given = reader.table(raw, place, ("exponent",), ("coefficient", "regularisation"))
        exponent = reader.number(given["exponent"], f"{place}.exponent")
        flat = reader.number(given.get("regularisation", FLAT), f"{place}.regularisation")
        if not 1 < exponent < 4:
            raise InputError(f"{reader.source}: {place}.exponent = {exponent:g}: must be between 1 and 4{_LIMITS}")
        if flat <= 0:
            raise InputError(f"{reader.source}: {place}.regularisation = {flat:g}: must be positive")
        return cls(reader.value(given.get("coefficient", 1.0), f"{place}.coefficient"), exponent, flat)

    def __str__(self) -> str:
        return (
            f"{{exponent = {self.exponent:g}, coefficient = {self.value.text}, "
            f"regularisation = {self.regularisation:g}}}"
        )

    def tension_at(self, u: Any, data: Sampler) -> Any:
        squared = inner(grad(u), grad(u)) + data.number(self.regularisation) ** 2
        return data.cellwise(self.value, positive=True) * squared ** ((self.exponent - 2) / 2)

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        squared = inner(grad(u), grad(u)) + data.number(self.regularisation) ** 2
        return data.cellwise(self.value, positive=True) * squared ** (self.exponent / 2) / self.exponent * data.dx

"""The tension of a membrane."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from ufl import grad, inner

from fenicsx_obstacle.effects.effect import Effect, Reader, Sampler, register


@register
class Tension(Effect):
    """-div(tension grad u): a(u, v) = int tension grad u . grad v, Kikuchi (2.2) with mu = tension.

    One positive value per cell (the paper's mu >= mu_0 > 0, (2.5)); unit: force per length. A matrix in the scene makes
    it an `Anisotropic` one.
    """

    key = "tension"
    equation = "-div(tension grad u)"
    left = True
    term = "int tension grad u . grad v"
    unit = "force/length"
    role = "tension"
    elastic = True

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Effect:
        if isinstance(raw, list):
            from fenicsx_obstacle.effects.anisotropic import Anisotropic  # only where a scene has a matrix

            return Anisotropic.read(raw, place, reader)
        return cls(reader.value(raw, place))

    def push(self, data: Sampler) -> tuple[float, float]:
        return 0.0, 0.0

    def tension_at(self, u: Any, data: Sampler) -> Any:
        return data.cellwise(self.value, positive=True)

    def stiffness(self, data: Sampler) -> np.ndarray:
        return data.values(self.value, positive=True)

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return self.tension_at(u, data) * inner(grad(u), grad(v)) * data.dx

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        return 0.5 * data.cellwise(self.value, positive=True) * inner(grad(u), grad(u)) * data.dx

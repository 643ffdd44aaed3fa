"""Base class of effects whose tension depends on |grad u|."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from ufl import grad, inner

from fenicsx_obstacle.effects.effect import Effect, Sampler


@dataclass(frozen=True)
class GradientDependent(Effect):
    """An elastic effect whose tension depends on |grad u|: not affine, but its energy is convex."""

    left = True
    unit = "force/length"
    elastic = True
    affine = False

    def push(self, data: Sampler) -> tuple[float, float]:
        return 0.0, 0.0

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return self.tension_at(u, data) * inner(grad(u), grad(v)) * data.dx

    def stiffness(self, data: Sampler) -> np.ndarray:
        return data.values(self.value, positive=True)

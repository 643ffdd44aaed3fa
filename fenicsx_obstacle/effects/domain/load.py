"""A load per area."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fenicsx_obstacle.effects.effect import Effect, NodalSampler, Sampler, register

if TYPE_CHECKING:
    import numpy as np
    import ufl


@register
class Load(Effect):
    """The load f of f(v) = int f v, sampled as `Level.W` is; unit: force per area."""

    key = "load"
    equation = "load"
    term = "- int load v"
    leans = True
    unit = "force/area"

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return -data.cellwise(self.value) * v * data.dx

    def energy(self, u: Any, data: Sampler) -> ufl.Form:
        return -data.cellwise(self.value) * u * data.dx

    def push(self, data: Sampler) -> tuple[float, float]:
        values = data.values(self.value)
        return float(values.min(initial=0.0)), float(values.max(initial=0.0))

    def density(self, data: NodalSampler) -> np.ndarray:
        return data.at_nodes(self.value)

"""Inertia; `data.motion` has its time difference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ufl

from fenicsx_obstacle.effects.effect import Effect, Sampler, register


@register
class Inertia(Effect):
    """Mass: rho u_tt on the left side, int rho u_tt v with rho > 0; unit: mass/length^2.

    By the nodal rule I where the element has one of degree 1. Elastic forces are averaged over a step, which keeps
    their energy; contact acts with its force at the step's end (Kane, Repetto, Ortiz and Marsden 1999), which can only
    take energy away: the force is 0 unless contact ends the step, and so works against the motion that led there.
    """

    key = "inertia"
    equation = "inertia u_tt"
    term = "+ int inertia u_tt v, nodal rule"
    unit = "mass/length^2"
    order = 2

    def conflict(self, effects: Sequence[Effect]) -> str | None:
        others = [effect.key for effect in effects if not (effect.affine and effect.symmetric)]
        return f"{self.key} cannot be combined with {others[0]}: energy would not be conserved" if others else None

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return data.cellwise(self.value, positive=True) * data.motion.acceleration(u) * v * data.dI

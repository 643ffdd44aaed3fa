"""Rate: a term proportional to u_t; `data.motion` has its time difference."""

from __future__ import annotations

from typing import Any

import ufl

from fenicsx_obstacle.effects.effect import Effect, Sampler, register


@register
class Rate(Effect):
    """Resistance to change: c u_t on the left side, int c u_t v with c > 0; unit: force time/length^3.

    By the nodal rule I where the element has one of degree 1: a diagonal keeps the signs of an M-matrix, so that
    implicit Euler is monotone. A step is a static problem with the foundation c/dt, and falls in energy.
    """

    key = "rate"
    equation = "rate u_t"
    term = "+ int rate u_t v, nodal rule"
    unit = "force time/length^3"
    order = 1

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return data.cellwise(self.value, positive=True) * data.motion.rate(u) * v * data.dI

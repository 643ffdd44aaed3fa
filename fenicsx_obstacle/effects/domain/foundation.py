"""An elastic foundation."""

from __future__ import annotations

from typing import Any

import ufl

from fenicsx_obstacle.effects.effect import Effect, Sampler, register


@register
class Foundation(Effect):
    """Winkler's foundation: k u on the left side, int k u v with k >= 0; unit: force per volume.

    By the nodal rule I where the element has one of degree 1: diagonal, so that it keeps the signs of an M-matrix.
    In other words a reaction term, a rate of decay, or the interest of a value.
    """

    key = "foundation"
    equation = "foundation u"
    term = "+ int foundation u v"
    unit = "force/volume"
    role = "reaction"

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return data.cellwise(self.value, least=0.0) * u * v * data.dI

"""Matrix-valued tensions with closed forms, in contact or not: u is that of `touching`, the load follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from hypothesis import strategies as st
from sympy import Expr

from tests.random.families.manufactured import Piecewise, distance, expression, x, y
from tests.random.families.touching import Touching, touching

ANGLES = ("0", "0.4", "0.785398", "1.9", "x - y", "0.5*x*y", "1.5*x", "4*y")
KINDS = ("half", "strip", "band", "disc", "hole", "wedge", "two")


@dataclass(frozen=True)
class Anisotropic(Touching):
    """-div(A grad u) = load + p. A has the eigenvalue 1 along a direction, and another one across.

    Attributes:
        angle: Of the direction, a formula.
        ratio: The other eigenvalue.
        beyond: Angle and ratio beyond the line, where the contact set is a half plane; None: the same. The gradient of
            u is 0 on the line.
    """

    angle: str
    ratio: float
    beyond: tuple[str, float] | None

    name = "anisotropic"

    def entries(self) -> list[list[Piecewise]]:
        """Of A, in the parts of w."""
        parts = self.above()[0].parts
        matrices = [_matrix(self.angle, self.ratio)] * len(parts)
        if self.beyond is not None:
            matrices[-1] = _matrix(*self.beyond)
        return [
            [Piecewise([(sides, one[i][j]) for (sides, _), one in zip(parts, matrices, strict=True)]) for j in range(2)]
            for i in range(2)
        ]

    def forces(self, u: Piecewise) -> Piecewise:
        """See `Touching.forces`."""
        a, b, _, c = (entry for row in self.entries() for entry in row)

        def load(u: Expr, a: Expr, b: Expr, c: Expr) -> Expr:
            along, across = sympy.diff(u, x), sympy.diff(u, y)
            found = -sympy.diff(a * along + b * across, x) - sympy.diff(b * along + c * across, y)
            return sympy.expand(found) if found.is_polynomial(x, y) else found

        return u.map(load, a, b, c)

    def data(self) -> dict[str, Any]:
        rows = self.entries()
        uniform = self.beyond is None
        texts = [[f"({entry.parts[0][1]})" if uniform else entry.text(self.spelling) for entry in row] for row in rows]
        return {**super().data(), "tension": texts}

    def stiffness(self, px: np.ndarray, py: np.ndarray) -> np.ndarray:
        """The matrices at points."""
        return np.stack([np.stack([entry.at(px, py) for entry in row], axis=1) for row in self.entries()], axis=1)


def _matrix(angle: str, ratio: float) -> list[list[Expr]]:
    """1 along a direction, and the ratio across."""
    turned = expression(angle)
    c, s = sympy.cos(turned), sympy.sin(turned)
    a, b, d = c**2 + ratio * s**2, (1 - ratio) * c * s, s**2 + ratio * c**2
    if turned.is_number:
        a, b, d = (sympy.Float(one) for one in (a, b, d))
    return [[a, b], [b, d]]


@st.composite
def anisotropic(draw: st.DrawFn) -> Anisotropic:
    """Directions that are constant, vary smoothly or jump, mostly with contact."""
    base = draw(touching().filter(lambda one: one.kind in KINDS))
    direction = st.tuples(st.sampled_from(ANGLES), st.sampled_from([1.0, 3.0, 0.2, 30.0, 1e-3, 1e4]))
    angle, ratio = draw(direction)
    beyond = draw(st.one_of(st.none(), direction)) if base.kind == "half" else None
    obstacle = base.obstacle if beyond is None else str(sympy.expand(-0.7 * distance(base._line) ** 2))
    return Anisotropic(**{
        **vars(base), "options": {**base.options, "element": "P1"}, "obstacle": obstacle, "stiff": "1",
    }, angle=angle, ratio=ratio, beyond=beyond)  # fmt: skip

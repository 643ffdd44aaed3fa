"""Closed forms on a foundation, with fluxes and springs on sides of a rectangle: u is that of another family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy
from hypothesis import strategies as st

from tests.random.families.manufactured import SIDES, Curve, Manufactured, Piecewise, everywhere, line_at, x, y
from tests.random.families.touching import touching
from tests.random.families.varying import varying

HALF = line_at(0.0, 0.113)
# of foundations and springs, times a factor
SHAPES = {
    "even": everywhere(1), "smooth": everywhere(sympy.exp(x - y)), "linear": everywhere(3 + x + y),
    "half": Piecewise([(((HALF, True),), sympy.Integer(1)), ((), sympy.Integer(0))]),
    "two": Piecewise([(((HALF, False),), 2 + x), ((), sympy.Integer(1))]),
}  # fmt: skip


@dataclass(frozen=True)
class Supported(Manufactured):
    """-div(tension grad u) + k u = load + p with the u of another scene; flux and spring replace u on sides.

    Attributes:
        base: The other scene.
        shape: Of the foundation, in `SHAPES`.
        size: It times this.
        sides: Where u is not given.
        spring: Shape of the springs there.
        stiff: They times this.
    """

    base: Manufactured
    shape: str
    size: float
    sides: tuple[str, ...]
    spring: str
    stiff: float

    name = "supported"

    def u(self) -> list[Piecewise]:
        return self.base.u()

    def tension(self) -> Piecewise:
        return self.base.tension()

    def poles(self) -> list[tuple[float, float]]:
        return self.base.poles()

    def foundation(self) -> Piecewise | None:
        return SHAPES[self.shape].map(lambda k: self.size * k) if self.size > 0 else None

    def data(self) -> dict[str, Any]:
        data = self.base.data()
        if self.size > 0:
            foundation = f"{self.size!r}*{SHAPES[self.shape].text(self.spelling)}"
            data |= {"load": f"({data.get('load', 0)}) + {foundation}*({self.value()})", "foundation": foundation}
        return data

    def support(self) -> str:
        return f"{self.stiff!r}*{SHAPES[self.spring].text(self.spelling)}" if self.stiff > 0 else ""

    def curves(self) -> list[Curve]:
        """See `Manufactured.curves`."""
        return [*super().curves(), HALF]


@st.composite
def supported(draw: st.DrawFn) -> Supported:
    """u is smooth, or touches an obstacle."""
    base = draw(st.one_of(varying(), touching()).filter(lambda one: one.mesh["shape"] == "rectangle"))
    foundation = draw(st.sampled_from([0.0, 0.0, 0.3, 7.0, 300.0, 1e5]))
    sides = draw(st.lists(st.sampled_from(sorted(SIDES)), min_size=0 if foundation else 1, max_size=3, unique=True))
    return Supported(
        base.mesh, {**base.options, "element": "P1"}, base.spelling, base, draw(st.sampled_from(sorted(SHAPES))),
        foundation, tuple(sides), draw(st.sampled_from(sorted(SHAPES))),
        draw(st.sampled_from([0.0, 0.0, 0.5, 20.0, 1e4])),
    )  # fmt: skip

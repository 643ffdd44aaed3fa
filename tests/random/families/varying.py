"""Tensions that vary smoothly: the load of a given u is a formula."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st

from tests.random.families.closed import ClosedForm, Piecewise, everywhere, expression, load_of
from tests.random.families.meshes import meshes
from tests.random.families.strategies import bounds, power

POLYNOMIALS = ("x**2 - x*y", "x**3*y - y**2", "x*(1 - x)*y", "x + 2*y", "x**4 - y**3")
SMOOTH = (*POLYNOMIALS, "exp(x)*sin(2*y)", "sin(3*x + y)", "log(3 + x + y)", "sqrt(2 + x*y)", "exp(-2*(x**2 + y**2))",
          "x/(2 + y)", "cos(4*x)*exp(y)", "atan(x + 2*y)")  # fmt: skip
TENSIONS = ("1 + x**2", "exp(x - y)", "exp(2*x*y)", "2 + sin(5*x)*cos(3*y)", "1/(1 + x**2 + y**2)", "sqrt(2 + x)",
            "1.8 + atan(4*x)", "cosh(2*x) + y**2", "(1.5 + y)**3")  # fmt: skip


@dataclass(frozen=True)
class Varying(ClosedForm):
    """u and the tension are smooth formulas, and the load is -div(tension grad u).

    Attributes:
        formula: Of u.
        stiff: Formula of the tension.
        scale: Of the tension.
    """

    formula: str
    stiff: str
    scale: float

    name = "smooth tension"

    def u(self) -> list[Piecewise]:
        return [everywhere(expression(self.formula))]

    def tension(self) -> Piecewise:
        return everywhere(self.scale * expression(self.stiff))

    def data(self) -> dict[str, Any]:
        (one,), tension = self.u(), self.tension()
        return {"tension": tension.text(), "load": one.map(load_of, tension).text()}


@st.composite
def varying(draw: st.DrawFn) -> Varying:
    """Polynomials, mostly."""
    formula = draw(st.one_of(st.sampled_from(POLYNOMIALS), st.sampled_from(SMOOTH)))
    return Varying(
        draw(meshes()),
        draw(bounds("500", seldom=True)),
        0,
        formula,
        draw(st.sampled_from(TENSIONS)),
        draw(power(-3, 3)),
    )

"""Tensions that jump along a circle, and loads with a pole: u is harmonic in parts, or a power of r."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy
from hypothesis import strategies as st

from fenicsx_obstacle.answers.answer import Answer
from tests.random.families.family import Judgement
from tests.random.families.manufactured import Circle, Manufactured, Piecewise, everywhere, x, y
from tests.random.families.strategies import bounds, grids, place, power

CIRCLES = ("where(r < {a}, {k}, 1)", "where(x^2 + y^2 < {aa}, {k}, 1)", "({k})*(r < {a}) + (r >= {a})",
           "where(hypot(x, y) >= {a}, 1, {k})")  # fmt: skip


def squares(corner: tuple[float, float]) -> st.SearchStrategy[dict[str, Any]]:
    """The table [mesh] of a unit square with this lower left corner."""
    return grids(x=(corner[0], corner[0] + 1), y=(corner[1], corner[1] + 1))


@dataclass(frozen=True)
class Inclusion(Manufactured):
    """A disk of another tension in a square: u = x (1 + B/r^2) outside of it, A x inside.

    Attributes:
        radius: Of the disk, whose centre is the origin.
        stiff: The tension in the disk; 1 outside.
    """

    radius: float
    stiff: float

    name = "inclusion"

    def _parts(self, inside: Any, outside: Any) -> Piecewise:
        return Piecewise([([(Circle((0.0, 0.0), self.radius), True)], inside), ((), outside)])

    def tension(self) -> Piecewise:
        return self._parts(sympy.Float(self.stiff), sympy.Integer(1))

    def u(self) -> list[Piecewise]:
        a, k = self.radius, self.stiff
        return [self._parts(2 / (1 + k) * x, x * (1 + (1 - k) / (1 + k) * a**2 / (x**2 + y**2)))]

    def value(self) -> str:
        a, k = self.radius, self.stiff
        return f"where(r < {a!r}, {2 / (1 + k)!r}*x, x*(1 + ({(1 - k) / (1 + k) * a**2!r})/max(r, {a / 2!r})^2))"

    def data(self) -> dict[str, Any]:
        a, k = self.radius, self.stiff
        return {"tension": CIRCLES[self.spelling].format(a=repr(a), aa=repr(a**2), k=repr(k))}


@st.composite
def inclusions(draw: st.DrawFn) -> Inclusion:
    """Contrasts up to 1e6; the square holds all of the disk or a quarter of it."""
    corner = draw(st.sampled_from([(0.0, 0.0), (-0.5, -0.5), (-0.613, 0.0), (-0.5, -0.377)]))
    return Inclusion(
        mesh=draw(squares(corner)), options=draw(bounds()), radius=draw(place(0.1, 0.45 if corner[0] else 0.95)),
        stiff=draw(st.one_of(power(-6, 6), power(-1, 1)).filter(lambda k: k != 1)), spelling=draw(st.integers(0, 3)),
    )  # fmt: skip


@dataclass(frozen=True)
class Pole(Manufactured):
    """u = r^a: the load is a power of r, square integrable where a > 1.

    Attributes:
        power: a.
        stiff: The tension, the same everywhere.
        cut: Radius within which the load is that of this radius; 0 for a load that is set to 0 at the pole only.
    """

    power: float
    stiff: float
    cut: float

    name = "pole"

    def u(self) -> list[Piecewise]:
        return [everywhere((x**2 + y**2) ** (self.power / 2))]

    def poles(self) -> list[tuple[float, float]]:
        return [(0.0, 0.0)]

    def value(self) -> str:
        return f"r^{self.power!r}"

    def data(self) -> dict[str, Any]:
        size, exponent = -self.stiff * self.power**2, self.power - 2
        load = f"{size!r}*max(r, {self.cut!r})^({exponent!r})" if self.cut else (
            f"where(r > 0, {size!r}*r^({exponent!r}), 0)")  # fmt: skip
        return {"tension": self.stiff, "load": load}

    def more(self, judgement: Judgement, answer: Answer) -> None:
        if self.power <= 1 and not self.cut:
            judgement.not_certified(answer, "the load is not square integrable")


@st.composite
def poles(draw: st.DrawFn) -> Pole:
    """Mostly loads that are not square integrable."""
    corner = draw(st.sampled_from([(0.0, 0.0), (-0.5, -0.5), (-0.377, -0.613), (-0.377, 0.0)]))
    exponent = draw(st.one_of(place(0.05, 1), place(1, 2)))
    return Pole(draw(squares(corner)), draw(bounds()), 0, exponent, draw(st.sampled_from([1.0, 7.3])),
                draw(st.sampled_from([0.0, 0.0, 1e-12])))  # fmt: skip

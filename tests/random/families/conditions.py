"""Loads with several conditions (where, and, or, not, min, max, abs, floor, sign): u is a sum of closed forms."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, floor
from typing import Any

import sympy
from hypothesis import strategies as st
from sympy import Expr

from tests.random.families.manufactured import (
    Circle,
    Line,
    Manufactured,
    Piecewise,
    Side,
    distance,
    everywhere,
    expression,
    line_at,
    load_of,
    square,
)
from tests.random.families.meshes import meshes
from tests.random.families.strategies import bounds, place, power
from tests.random.families.varying import SMOOTH

REACH = 2.5  # no point of a mesh is farther from the origin
KINDS = ("step", "abs", "min", "max", "and", "or", "floor", "disc", "lens")


@dataclass(frozen=True)
class Term:
    """A part of u and of the load, with -Laplace u = load.

    Attributes:
        kind: One of `KINDS`.
        size: What it is multiplied by.
        angles: Of two lines; of a disc the coordinates of its centre.
        places: Of the lines; of a disc the radius first.
        spelling: How it is written.
    """

    kind: str
    size: float
    angles: tuple[float, float]
    places: tuple[float, float]
    spelling: int

    def u(self) -> Piecewise:
        """Its u."""
        (a, b, s, t, _), size, zero = self._lines(), self.size, sympy.Integer(0)
        if self.kind in ("min", "max"):
            return self._least()
        if self.kind == "floor":  # of k s, which is n between n/k and (n + 1)/k
            k, many = self._steps, floor(REACH + abs(a.place)) + 1
            ends = [line_at(self.angles[0], self.places[0] + (n + 1) / k) for n in range(-many * k, many * k)]
            values = [self._between(sympy.Integer(n), s) for n in range(-many * k, many * k)]
            return Piecewise([*(([(end, True)], one) for end, one in zip(ends[:-1], values[:-1], strict=True)),
                              ((), values[-1])])  # fmt: skip
        circle, squared, R = Circle(self.angles, self.places[0]), square(self.angles), self.places[0]
        beyond = -size * R**2 * (sympy.log(squared / R**2) + 1) / 4 if self.kind == "disc" else zero
        kinds: dict[str, tuple[list[Side], Expr, Expr]] = {
            "step": ([(a, True)], zero, -size * s**2 / 2),
            "abs": ([(a, True)], size * s**3 / 6, -size * s**3 / 6),
            "and": ([(a, False), (b, False)], -size * s**2 * t**2, zero),
            "or": ([(a, False), (b, False)], -size * (s**2 * t**2 - s**4), size * s**4),
            "disc": ([(circle, True)], -size * squared / 4, beyond),
            "lens": ([(circle, True)], size * (R**2 - squared) ** 2 / 8, zero),
        }
        sides, inside, outside = kinds[self.kind]
        return Piecewise([(sides, inside), ((), outside)])

    def load(self) -> str:
        """The load."""
        _, _, s, t, _ = self._lines()
        size, own = repr(self.size), {"abs": f"abs({s})", "floor": f"floor({self._steps}*({s}))"}
        own |= {"step": f"(1 + sign({s}))/2", **{kind: f"{kind}({s}, {t})" for kind in ("min", "max")}}
        if self.kind == "floor" or (self.kind in own and self.spelling % 4 == 3):
            return f"{size}*{own[self.kind]}"
        if self.kind == "disc":  # outside u is harmonic, which no simplification shows
            load = Piecewise([(self.u().parts[0][0], sympy.Float(self.size)), ((), sympy.Integer(0))])
        else:
            load = self.u().map(load_of, everywhere(1))
        return load.text(self.spelling, products=True)

    @property
    def _steps(self) -> int:
        """In a unit of length."""
        return 1 + self.spelling % 2

    def _lines(self) -> tuple[Line, Line, Expr, Expr, float]:
        """Two lines, the distances from them, and the cosine of their angle."""
        a, b = (line_at(angle, at) for angle, at in zip(self.angles, self.places, strict=True))
        return a, b, distance(a), distance(b), cos(self.angles[1] - self.angles[0])

    def _least(self) -> Piecewise:
        """The larger of two distances is s + max(0, t - s), the smaller one s - max(0, s - t)."""
        (a, b, s, t, angle), sign = self._lines(), 1 if self.kind == "max" else -1
        (p, q), (v, w) = a.direction, b.direction
        between = Line((v - p, w - q), b.place - a.place)  # t < s below it
        rest = sign * (t - s)
        bent = -self.size * (s**3 / 6 + sign * rest**3 / (6 * (2 - 2 * angle)))
        # max: bent where t > s; min: bent where t < s
        return Piecewise([([(between, sign < 0)], bent), ((), -self.size * s**3 / 6)])

    def value(self) -> str:
        """u as text."""
        if self.kind != "floor":
            return self.u().text(self.spelling)
        s = f"({self._lines()[2]})"
        found = str(self._between(sympy.Symbol("n"), sympy.Symbol("s")))
        return found.replace("s", s).replace("n", f"floor({self._steps}*{s})")

    def _between(self, n: Expr, s: Expr) -> Expr:
        """u where floor(k s) = n."""
        k = self._steps
        return -self.size * (n * s**2 / 2 - n * (n + 1) * s / (2 * k) + n * (n + 1) * (2 * n + 1) / (12 * k**2))


@dataclass(frozen=True)
class Conditions(Manufactured):
    """A sum of terms, each with conditions of its own, and a smooth formula.

    Attributes:
        terms: Their closed forms.
        smooth: A formula that is added to u.
        stiff: The tension.
    """

    terms: tuple[Term, ...]
    smooth: str
    stiff: float

    name = "conditions"

    def u(self) -> list[Piecewise]:
        return [everywhere(expression(self.smooth)), *(term.u() for term in self.terms)]

    def value(self) -> str:
        return " + ".join([f"({self.smooth})", *(term.value() for term in self.terms)])

    def data(self) -> dict[str, Any]:
        load = [str(load_of(expression(self.smooth), sympy.Integer(1))), *(term.load() for term in self.terms)]
        return {"tension": self.stiff, "load": f"{self.stiff!r}*({' + '.join(load)})"}


@st.composite
def terms(draw: st.DrawFn) -> Term:
    """Lines that are not parallel."""
    kind = draw(st.sampled_from(KINDS))
    size = draw(st.sampled_from([1.0, -3.0, 0.1])) * draw(st.sampled_from([1.0, 20.0]))
    if kind in ("disc", "lens"):
        return Term(kind, size, (draw(place(-0.6, 0.6)), draw(place(-0.6, 0.6))), (draw(place(0.05, 0.8)), 0.0),
                    draw(st.integers(0, 11)))  # fmt: skip
    first = draw(st.sampled_from([0.0, 0.0, 0.785398, 0.3, 2.0]))
    return Term(kind, size, (first, first + draw(st.sampled_from([0.6, 1.570796, 2.1]))),
                (draw(place(-0.4, 0.6)), draw(place(-0.4, 0.6))), draw(st.integers(0, 11)))  # fmt: skip


@st.composite
def conditions(draw: st.DrawFn) -> Conditions:
    """Up to three terms."""
    many = tuple(draw(st.lists(terms(), min_size=1, max_size=3)))
    return Conditions(draw(meshes()), draw(bounds(seldom=True)), draw(st.integers(0, 9)), many,
                      draw(st.sampled_from([*SMOOTH[:5], "0", "0", *SMOOTH])), draw(power(-3, 3)))  # fmt: skip

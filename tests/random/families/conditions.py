"""Loads with several conditions (where, and, or, not, min, max, abs, floor, sign): u is a sum of closed forms."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, floor
from typing import Any

import sympy
from hypothesis import strategies as st

from tests.random.families.manufactured import (
    Circle,
    Manufactured,
    Piecewise,
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

    def both(self) -> tuple[Piecewise, str]:
        """u and the load."""
        kinds = {
            "step": self._step, "abs": self._abs, "min": self._least, "max": self._least, "and": self._and,
            "or": self._or, "floor": self._floor, "disc": self._disc, "lens": self._lens,
        }  # fmt: skip
        return kinds[self.kind]()

    def _lines(self) -> tuple[Any, Any, Any, Any, float]:
        """Two lines, the distances from them, and the cosine of their angle."""
        a, b = (line_at(angle, at) for angle, at in zip(self.angles, self.places, strict=True))
        return a, b, distance(a), distance(b), cos(self.angles[1] - self.angles[0])

    def _spelled(self, *texts: str) -> str:
        return texts[self.spelling % len(texts)]

    def _step(self) -> tuple[Piecewise, str]:
        a, _, s, _, _ = self._lines()
        u = Piecewise([([(a, True)], sympy.Integer(0)), ((), -self.size * s**2 / 2)])
        c = repr(self.size)
        return u, self._spelled(f"where({s} < 0, 0, {c})", f"{c}*({s} >= 0)", f"{c}*(1 + sign({s}))/2",
                                f"{c}*(not {s} < 0)")  # fmt: skip

    def _abs(self) -> tuple[Piecewise, str]:
        a, _, s, _, _ = self._lines()
        u = Piecewise([([(a, True)], self.size * s**3 / 6), ((), -self.size * s**3 / 6)])
        return u, self._spelled(f"{self.size!r}*abs({s})", f"{self.size!r}*max({s}, -({s}))",
                                f"where({s} < 0, -1, 1)*({self.size!r})*({s})")  # fmt: skip

    def _least(self) -> tuple[Piecewise, str]:
        """The larger of two distances is s + max(0, t - s), the smaller one s - max(0, s - t)."""
        (a, b, s, t, angle), sign = self._lines(), 1 if self.kind == "max" else -1
        (p, q), (v, w) = a.direction, b.direction
        between = type(a)((v - p, w - q), b.place - a.place)  # t < s below it
        rest = sign * (t - s)
        bent = -self.size * (s**3 / 6 + sign * rest**3 / (6 * (2 - 2 * angle)))
        straight = -self.size * s**3 / 6
        # max: bent where t > s; min: bent where t < s
        u = Piecewise([([(between, sign < 0)], bent), ((), straight)])
        order = f"{s} > {t}" if sign > 0 else f"{s} < {t}"
        return u, self._spelled(f"{self.size!r}*{self.kind}({s}, {t})", f"{self.size!r}*where({order}, {s}, {t})",
                                f"{self.size!r}*(({s}) + ({t}) + {sign}*abs(({s}) - ({t})))/2")  # fmt: skip

    def _and(self) -> tuple[Piecewise, str]:
        a, b, s, t, angle = self._lines()
        u = Piecewise([([(a, False), (b, False)], -self.size * s**2 * t**2), ((), sympy.Integer(0))])
        load = sympy.expand(self.size * (2 * (s**2 + t**2) + 8 * angle * s * t))
        return u, self._spelled(f"where({s} > 0 and {t} > 0, {load}, 0)", f"where(min({s}, {t}) > 0, {load}, 0)",
                                f"where({s} > 0, where({t} > 0, {load}, 0), 0)",
                                f"({load})*({s} > 0)*({t} > 0)")  # fmt: skip

    def _or(self) -> tuple[Piecewise, str]:
        """As `_and`, where not (s <= 0 or t <= 0), and the Laplacian of s^4 everywhere."""
        a, b, s, t, angle = self._lines()
        inside = self.size * (s**2 * t**2 - s**4)
        u = Piecewise([([(a, False), (b, False)], -inside), ((), self.size * s**4)])
        away, load = -12 * self.size * s**2, self.size * (2 * (s**2 + t**2) + 8 * angle * s * t - 12 * s**2)
        return u, self._spelled(f"where({s} <= 0 or {t} <= 0, {away}, {load})",
                                f"where(not ({s} <= 0 or not {t} > 0), {load}, {away})",
                                f"where(({s} <= 0 and {t} > 0) or {t} <= 0, {away}, {load})")  # fmt: skip

    def value(self) -> str:
        """u as text."""
        if self.kind != "floor":
            return self.both()[0].text(self.spelling)
        k, s = 1 + self.spelling % 2, f"({self._lines()[2]})"
        return (
            str(self._between(sympy.Symbol("n"), k, sympy.Symbol("s"))).replace("s", s).replace("n", f"floor({k}*{s})")
        )

    def _between(self, n: Any, k: int, s: Any) -> Any:
        """u where floor(k s) = n."""
        return -self.size * (n * s**2 / 2 - n * (n + 1) * s / (2 * k) + n * (n + 1) * (2 * n + 1) / (12 * k**2))

    def _floor(self) -> tuple[Piecewise, str]:
        """floor(k s) is n between n/k and (n + 1)/k."""
        a, _, s, _, _ = self._lines()
        k, many = 1 + self.spelling % 2, floor(REACH + abs(a.place)) + 1
        parts: list[Any] = []
        for n in range(-many * k, many * k):
            end = line_at(self.angles[0], self.places[0] + (n + 1) / k)
            parts.append(([(end, True)], self._between(sympy.Integer(n), k, s)))
        return Piecewise([*parts[:-1], ((), parts[-1][1])]), f"{self.size!r}*floor({k}*({s}))"

    def _disc(self) -> tuple[Piecewise, str]:
        circle, squared = Circle(self.angles, self.places[0]), square(self.angles)
        R = circle.radius
        outside = -self.size * R**2 * (sympy.log(squared / R**2) + 1) / 4
        u = Piecewise([([(circle, True)], -self.size * squared / 4), ((), outside)])
        return u, self._in_disc(circle, repr(self.size))

    def _lens(self) -> tuple[Piecewise, str]:
        circle, squared = Circle(self.angles, self.places[0]), square(self.angles)
        R = circle.radius
        u = Piecewise([([(circle, True)], self.size * (R**2 - squared) ** 2 / 8), ((), sympy.Integer(0))])
        return u, self._in_disc(circle, f"({self.size * (R**2 - 2 * squared)})")

    def _in_disc(self, circle: Circle, load: str) -> str:
        (a, b), R = circle.middle, circle.radius
        far, squared = f"hypot(x - ({a!r}), y - ({b!r}))", f"(x - ({a!r}))^2 + (y - ({b!r}))^2"
        return self._spelled(f"where({far} < {R!r}, {load}, 0)", f"where({squared} >= {R**2!r}, 0, {load})",
                             f"{load}*({far} < {R!r})", f"where(sign({R!r} - {far}) > 0, {load}, 0)")  # fmt: skip


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
        return [everywhere(expression(self.smooth)), *(term.both()[0] for term in self.terms)]

    def value(self) -> str:
        return " + ".join([f"({self.smooth})", *(term.value() for term in self.terms)])

    def data(self) -> dict[str, Any]:
        load = [str(load_of(expression(self.smooth), sympy.Integer(1))), *(term.both()[1] for term in self.terms)]
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

"""Wedges: powers of r where the tension jumps between sectors, at corners, and for loads that are powers of r."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin, tan
from typing import Any

import sympy
from hypothesis import strategies as st

from tests.random.families.manufactured import Line, Manufactured, Piecewise, everywhere, line_at, x, y
from tests.random.families.meshes import meshes
from tests.random.families.strategies import bounds, grids, place, power

R = sympy.sqrt(x**2 + y**2)


@dataclass(frozen=True)
class Sectors(Manufactured):
    """Two opposite sectors of another tension (Kellogg): u = r^a cos(a t) in them, t the angle to their axis.

    Attributes:
        angle: Of the axis.
        opening: Of the sectors.
        stiff: Tension in them; 1 in the others.
    """

    angle: float
    opening: float
    stiff: float

    name = "sectors"

    @property
    def power(self) -> float:
        """a, by bisection: tan(a opening/2) tan(a (pi - opening)/2) = 1/stiff."""
        low, high = 0.0, 1.0 / max(self.opening / pi, 1 - self.opening / pi)
        for _ in range(200):
            a = (low + high) / 2
            beyond = tan(a * self.opening / 2) * tan(a * (pi - self.opening) / 2) * self.stiff > 1
            low, high = (low, a) if beyond else (a, high)
        return (low + high) / 2

    def _lines(self) -> tuple[Line, Line]:
        """Between the sectors: both are negative in the right one, and positive in the left one."""
        half, angle = self.opening / 2, self.angle
        return line_at(angle + half + pi / 2, 0.0), line_at(angle - half - pi / 2, 0.0)

    def _parts(self, right: Any, left: Any, upper: Any, lower: Any) -> Piecewise:
        a, b = self._lines()
        return Piecewise([([(a, True), (b, True)], right), ([(a, False), (b, False)], left),
                          ([(a, False)], upper), ((), lower)])  # fmt: skip

    def tension(self) -> Piecewise:
        k, one = sympy.Float(self.stiff), sympy.Integer(1)
        return self._parts(k, k, one, one)

    def u(self) -> list[Piecewise]:
        a, half = self.power, self.opening / 2
        ca, sa = cos(self.angle), sin(self.angle)
        along, across = ca * x + sa * y, ca * y - sa * x
        B = cos(a * half) / sin(a * (pi / 2 - half))

        def inside(sign: int) -> Any:
            return sign * R**a * sympy.cos(a * sympy.atan2(across, sign * along))

        def outside(sign: int) -> Any:
            return B * R**a * sympy.sin(a * sympy.atan2(along, sign * across))

        return [self._parts(inside(1), inside(-1), outside(1), outside(-1))]

    def poles(self) -> list[tuple[float, float]]:
        return [(0.0, 0.0)]

    def data(self) -> dict[str, Any]:
        (a, b), k = self._lines(), repr(self.stiff)
        s, t = ("({!r}*x + {!r}*y)".format(*line.direction) for line in (a, b))
        spellings = (
            self.tension().text(self.spelling), f"where({s}*{t} > 0, {k}, 1)",
            f"where(({s} < 0 and {t} < 0) or ({s} > 0 and {t} > 0), {k}, 1)",
            f"where({s} < 0, where({t} < 0, {k}, 1), where(not {t} < 0, {k}, 1))",
            f"where(min({s}, {t}) > 0 or max({s}, {t}) < 0, {k}, 1)",
        )  # fmt: skip
        return {"tension": spellings[self.spelling % len(spellings)]}


@st.composite
def sectors(draw: st.DrawFn) -> Sectors:
    """Quadrants along the axes or turned, and other openings; a from 0.05 to 2."""
    opening = draw(st.sampled_from([pi / 2, pi / 2, pi / 3, 2.0, 0.7]))
    angle = draw(st.sampled_from([pi / 4, pi / 4, 0.0, 0.3, 1.1]))
    return Sectors(draw(meshes()), draw(bounds(seldom=True)), draw(st.integers(0, 9)), angle, opening,
                   draw(st.one_of(power(-1, 1), power(-2.5, 2.5))))  # fmt: skip


@dataclass(frozen=True)
class Corner(Manufactured):
    """u = r^a sin(a t) + size r^(b + 2) at a corner of the domain, t the angle to its bisector; the load is like r^b.

    Attributes:
        power: a.
        even: Whether the sine is a cosine.
        exponent: b, more than -1.
        size: Of that part of u.
        stiff: The tension.
    """

    power: float
    even: bool
    exponent: float
    size: float
    stiff: float

    name = "corner"

    def u(self) -> list[Piecewise]:
        """Cut where it does not reach the domain: the bisector is (-1, 1) of an L-shape and (1, 1) of a square."""
        across = -x - y if self.mesh["shape"] == "l-shape" else y - x
        along = y - x if self.mesh["shape"] == "l-shape" else x + y
        wave = sympy.cos if self.even else sympy.sin
        return [everywhere(R**self.power * wave(self.power * sympy.atan2(across, along))
                           + self.size * R ** (self.exponent + 2))]  # fmt: skip

    def poles(self) -> list[tuple[float, float]]:
        return [(0.0, 0.0)]

    def data(self) -> dict[str, Any]:
        if not self.size:
            return {"tension": self.stiff}
        size = -self.stiff * self.size * (self.exponent + 2) ** 2
        load = f"{size!r}*r^({self.exponent!r})"
        return {"tension": self.stiff, "load": f"where(r > 0, {load}, 0)" if self.exponent < 0 else load}


@st.composite
def corners(draw: st.DrawFn) -> Corner:
    """Re-entrant corners, squares with the corner or a side at the pole."""
    if draw(st.booleans()):
        mesh = {"shape": "l-shape", "cells": draw(st.integers(4, 14)), "x": [-1.0, 1.0], "y": [-1.0, 1.0]}
    else:
        sides = draw(st.sampled_from([(0.0, 1.0), (-0.4, 0.6), (-0.5, 0.5)]))
        mesh = draw(grids(4, 14, (0.0, 0.2, 0.3), x=(0.0, 1.0), y=sides))
    exponents = st.one_of(st.just(round(2 / 3, 6)), place(0.2, 3)), st.one_of(place(-0.95, 0), place(0, 3))
    return Corner(mesh, draw(bounds(seldom=True)), 0, draw(exponents[0]), draw(st.booleans()),
                  draw(exponents[1]), draw(st.sampled_from([0.0, 1.0, -0.3])),
                  draw(st.sampled_from([1.0, 7.3, 1e-3])))  # fmt: skip

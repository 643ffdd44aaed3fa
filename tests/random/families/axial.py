"""Closed forms with axial symmetry, on meridians with and without the axis, and on radii: with contact or without.

-(1/x) div(x tension grad u) + foundation u = load + p. On the axis u, its obstacle and the tension are even in x, so
that the load is a formula without 1/x.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy
from hypothesis import strategies as st
from sympy import Expr

from tests.random.families.manufactured import (
    SIDES,
    Circle,
    Curve,
    Line,
    Manufactured,
    Piecewise,
    everywhere,
    expression,
    square,
    x,
    y,
)
from tests.random.families.strategies import bounds_by_all_ways, grids, place, power

RADII = ((0.0, 1.0), (0.0, 0.3), (0.02, 1.0), (0.5, 1.5), (4.0, 5.0))
HEIGHTS = ((-0.5, 0.5), (0.0, 0.1), (-1.0, 1.0))
KINDS = ("none", "ball", "hole", "tube", "shell", "layer", "half", "pipe")
OUTSIDE = ("hole", "shell")  # contact is beyond the curve
EVEN = ("0", "0", "x**2", "x**2*y - y**2", "exp(-x**2 + y)", "cos(3*x**2)*y", "1/(2 + x**2 + y)")
ANY = (*EVEN, "x", "x*y - x**3", "sin(3*x + y)", "log(x)", "sqrt(x)*y")
EVEN_TENSIONS = ("1", "1", "0.01", "1 + x**2", "exp(x**2/4 - y)", "2 + sin(5*y)*cos(3*x**2)")
TENSIONS = (*EVEN_TENSIONS, "1 + x", "exp(x - y)", "1/x", "x**2")
FOUNDATIONS = ("0", "0", "0", "3", "300", "1 + x**2 + y**2")
FREE = ("bottom", "right", "top")  # sides where u may be free
SPRING = "5"


@dataclass(frozen=True)
class Axial(Manufactured):
    """u = obstacle + w, w = 0 in the contact set; or two tensions in a pipe, u the logarithm.

    Attributes:
        kind: Contact nowhere; in a ball; outside of one; in a tube around the axis; outside of one; below a height;
            on one side of a line; or a pipe of two materials.
        middle: Centre, or a point of the line; its second coordinate is the height.
        radius: Of ball or tube.
        size: Of w.
        obstacle: A formula; of u itself without contact.
        stiff: Of the tension.
        inside: Of a pipe, the other tension.
        pressure: In contact.
        lowered: Whether the obstacle has a kink and falls off where u is far from it.
        upper: Whether all is upside down.
        bed: A formula, of the foundation.
        sides: Where a flux is given.
        sprung: Whether there are springs too.
    """

    kind: str
    middle: tuple[float, float]
    radius: float
    size: float
    obstacle: str
    stiff: str
    inside: float
    pressure: str
    lowered: bool
    upper: bool
    bed: str
    sides: tuple[str, ...]
    sprung: bool

    name = "axial"
    axial = True

    @property
    def _on_axis(self) -> bool:
        return self.mesh["x"][0] == 0

    def _of(self, text: str) -> Expr:
        """A formula; on an interval y is 0."""
        found = expression(text)
        return found.subs(y, 0) if self.mesh["shape"] == "interval" else found

    def _curve(self) -> tuple[Curve, Expr]:
        """Where contact ends, and a function that is 0 there and positive beyond."""
        a, b = self.middle
        if self.kind in ("ball", "hole"):
            a = 0.0 if self._on_axis else a
            return Circle((a, b), self.radius), square((a, b)) - self.radius**2
        if self.kind in ("tube", "shell", "pipe"):
            return Line((1.0, 0.0), self.radius), x**2 - self.radius**2
        if self.kind == "half":
            return Line((0.6, 0.8), 0.6 * a + 0.8 * b), 0.6 * x + 0.8 * y - (0.6 * a + 0.8 * b)
        return Line((0.0, 1.0), b), y - b

    def _parts(self, below: Expr, beyond: Expr) -> Piecewise:
        """Expressions on both sides of the curve."""
        return Piecewise([(((self._curve()[0], True),), below), ((), beyond)])

    def _psi(self) -> Expr:
        return self._of(self.obstacle)

    def u(self) -> list[Piecewise]:
        psi, phi, sign = self._psi(), self._curve()[1], self.sign
        if self.kind == "none":
            return [everywhere(psi)]
        if self.kind == "pipe":
            log = sympy.log(x / self.radius)
            return [self._parts(log / self.inside, log)]
        touching, free = sign * psi, sign * (psi + self.size * phi**2)
        return [self._parts(free, touching) if self.kind in OUTSIDE else self._parts(touching, free)]

    def tension(self) -> Piecewise:
        if self.kind == "pipe":
            return self._parts(sympy.Float(self.inside), sympy.Integer(1))
        return everywhere(self._of(self.stiff))

    def foundation(self) -> Piecewise | None:
        return everywhere(self._of(self.bed)) if self.bed != "0" else None

    def _in_contact(self) -> bool:
        return self.kind not in ("none", "pipe")

    def balance(self) -> Piecewise:
        load = super().balance().map(sympy.expand)
        if not self._in_contact():
            return load
        pressed, zero = self.sign * self._of(self.pressure), sympy.Integer(0)
        push = self._parts(zero, pressed) if self.kind in OUTSIDE else self._parts(pressed, zero)
        return load.map(lambda one, p: one - p, push)

    def data(self) -> dict[str, Any]:
        found = super().data()
        if self._in_contact():
            low, phi = str(self._psi()), self._curve()[1]
            if self.lowered:
                low = f"{low} - 0.7*max(0, {-phi if self.kind in OUTSIDE else phi} - {self.radius / 9!r})"
            found[self.side] = f"{'-' if self.upper else ''}({low})"
        return found

    def boundary(self) -> list[dict[str, Any]]:
        """On an axis nothing is given."""
        return super().boundary() if self.sides or not self._on_axis else [
            {"on": self.held_sides(), "value": self.value()}]  # fmt: skip

    def held_sides(self) -> list[str]:
        names = ["left", "right"] if self.mesh["shape"] == "interval" else list(SIDES)
        return names[1:] if self._on_axis else names

    def support(self) -> str:
        return SPRING if self.sprung else ""


@st.composite
def axial(draw: st.DrawFn) -> Axial:
    """Meridians, mostly; half of them with the axis."""
    radii = draw(st.sampled_from(RADII))
    on_axis = radii[0] == 0
    flat = draw(st.sampled_from([False, False, False, True]))
    kind = draw(st.sampled_from([one for one in KINDS if not (on_axis and one in ("half", "pipe"))
                                 and not (flat and one in ("ball", "hole", "layer", "half"))]))  # fmt: skip
    mesh: dict[str, Any] = {"shape": "interval", "cells": draw(st.integers(4, 60)), "x": list(radii)}
    heights = (0.0, 0.0)
    if not flat:
        heights = draw(st.sampled_from(HEIGHTS))
        mesh = draw(grids(4, 14, (0.0, 0.1, 0.2), x=radii, y=heights))
    width = radii[1] - radii[0]
    radius = draw(place(0.1, 0.9)) * width + (radii[0] if kind in ("tube", "shell", "pipe") else 0.0)
    a, b = (round(low + (high - low) * draw(place(0.1, 0.9)), 6) for low, high in (radii, heights))
    sides = draw(st.lists(st.sampled_from(["right"] if flat else FREE), max_size=2, unique=True))
    foundation = draw(st.sampled_from(FOUNDATIONS))
    if flat and on_axis and foundation == "0":
        sides = []
    return Axial(
        mesh, draw(bounds_by_all_ways("P1")), draw(st.integers(0, 9)), kind, (a, b), round(radius, 6),
        draw(st.sampled_from([1.0, 4.0, 0.1])), draw(st.sampled_from(EVEN if on_axis else ANY)),
        draw(st.sampled_from(EVEN_TENSIONS if on_axis else TENSIONS)), draw(power(-2, 2)),
        draw(st.sampled_from(["1", "30", "0", "1 + x**2"])), draw(st.booleans()), draw(st.booleans()), foundation,
        tuple(sides), draw(st.booleans()),
    )  # fmt: skip

"""Closed forms with axial symmetry, on meridians with and without the axis, and on radii: with contact or without.

-(1/x) div(x tension grad u) + foundation u = load + p. On the axis u, its obstacle and the tension are even in x, so
that the load is a formula without 1/x.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from hypothesis import assume
from hypothesis import strategies as st
from sympy import Expr

from tests.random.families.manufactured import (
    Circle,
    Curve,
    Line,
    Manufactured,
    Piecewise,
    expression,
    load_of,
    square,
    x,
    y,
)
from tests.random.families.meshes import DIAGONALS
from tests.random.families.strategies import place, power

RADII = ((0.0, 1.0), (0.0, 0.3), (0.02, 1.0), (0.5, 1.5), (4.0, 5.0))
HEIGHTS = ((-0.5, 0.5), (0.0, 0.1), (-1.0, 1.0))
KINDS = ("none", "ball", "hole", "tube", "shell", "layer", "half", "pipe")
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
            return [self._parts(psi, psi)]
        if self.kind == "pipe":
            log = sympy.log(x / self.radius)
            return [self._parts(log / self.inside, log)]
        touching, free = sign * psi, sign * (psi + self.size * phi**2)
        return [self._parts(free, touching) if self.kind in ("hole", "shell") else self._parts(touching, free)]

    def tension(self) -> Piecewise:
        if self.kind == "pipe":
            return self._parts(sympy.Float(self.inside), sympy.Integer(1))
        stiff = self._of(self.stiff)
        return self._parts(stiff, stiff)

    def weight(self, px: np.ndarray) -> np.ndarray:
        return px

    def data(self) -> dict[str, Any]:
        (u,), tension, k = self.u(), self.tension(), self._of(self.bed)
        found = {"tension": tension.text(self.spelling), "axial_symmetry": True}
        load = u.map(lambda u, tension: sympy.expand(load_of(u, tension, k, axial=True)), tension)
        if self.kind not in ("none", "pipe"):
            pressed, phi = self.sign * self._of(self.pressure), self._curve()[1]
            outside = self.kind in ("hole", "shell")
            zero = sympy.Integer(0)
            push = self._parts(zero, pressed) if outside else self._parts(pressed, zero)
            load = load.map(lambda one, p: one - p, push)
            low = str(self._psi())
            if self.lowered:
                low = f"{low} - 0.7*max(0, {-phi if outside else phi} - {self.radius / 9!r})"
            found[self.side] = f"{'-' if self.upper else ''}({low})"
        found["load"] = load.text(self.spelling)
        if self.bed != "0":
            found["foundation"] = str(k)
        return found

    def boundary(self) -> list[dict[str, Any]]:
        """The parts of the boundary."""
        names = ["left", "right"] if self.mesh["shape"] == "interval" else ["left", "right", "top", "bottom"]
        given = [side for side in names if side not in self.sides and not (side == "left" and self._on_axis)]
        return [*([{"on": given, "value": self.value()}] if given else []),
                *(self.natural(side, SPRING if self.sprung else "") for side in self.sides)]  # fmt: skip


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
        mesh = {"shape": "rectangle", "cells": draw(st.integers(4, 14)), "x": list(radii), "y": list(heights),
                "diagonal": draw(st.sampled_from(DIAGONALS)),
                "perturb": draw(st.sampled_from([0.0, 0.1, 0.2]))}  # fmt: skip
    width = radii[1] - radii[0]
    radius = draw(place(0.1, 0.9)) * width + (radii[0] if kind in ("tube", "shell", "pipe") else 0.0)
    a, b = (round(low + (high - low) * draw(place(0.1, 0.9)), 6) for low, high in (radii, heights))
    tolerance = draw(st.sampled_from([None] * 6 + [0.3, 0.1]))
    asked = {"bound": True} if tolerance is None else {"tol": tolerance, "budget": "500 unknowns"}
    asked |= draw(st.sampled_from([{}, {}, {"method": "vi"}, {"eps": 1e-10}, {"eps": "h"}, {"eps": "h^2"}]))
    sides = draw(st.lists(st.sampled_from(["right"] if flat else FREE), max_size=2, unique=True))
    foundation = draw(st.sampled_from(FOUNDATIONS))
    if flat and on_axis and foundation == "0":
        sides = []
    found = Axial(
        mesh, {"element": "P1", **asked}, draw(st.integers(0, 9)), kind, (a, b), round(radius, 6),
        draw(st.sampled_from([1.0, 4.0, 0.1])), draw(st.sampled_from(EVEN if on_axis else ANY)),
        draw(st.sampled_from(EVEN_TENSIONS if on_axis else TENSIONS)), draw(power(-2, 2)),
        draw(st.sampled_from(["1", "30", "0", "1 + x**2"])), draw(st.booleans()), draw(st.booleans()), foundation,
        tuple(sides), draw(st.booleans()),
    )  # fmt: skip
    assume(found.short)
    return found

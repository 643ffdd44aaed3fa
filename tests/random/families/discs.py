"""Discs and rings with different tensions and loads, not aligned with cells: u depends on the distance from a point
only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy
from hypothesis import strategies as st

from tests.random.families.manufactured import Circle, Manufactured, Piecewise, Side, square
from tests.random.families.meshes import meshes
from tests.random.families.strategies import bounds, place, power


@dataclass(frozen=True)
class Rings(Manufactured):
    """Tension and load take a value in each ring: tension u' = -D/r - load r/2 there.

    Attributes:
        middle: Of the rings.
        radii: Where they end, rising.
        tensions: One more than radii.
        loads: One more than radii.
        both: Whether the conditions of a ring name both its radii.
    """

    middle: tuple[float, float]
    radii: tuple[float, ...]
    tensions: tuple[float, ...]
    loads: tuple[float, ...]
    both: bool

    name = "rings"

    def _parts(self, values: list[Any]) -> Piecewise:
        circles = [Circle(self.middle, radius) for radius in self.radii]
        sides: list[list[Side]] = [[(circle, True)] for circle in circles]
        if self.both:
            for k, circle in enumerate(circles[:-1]):
                sides[k + 1].append((circle, False))
        return Piecewise([*zip(sides, values[:-1], strict=True), ((), values[-1])])

    def tension(self) -> Piecewise:
        return self._parts([sympy.Float(mu) for mu in self.tensions])

    def u(self) -> list[Piecewise]:
        q = sympy.Symbol("q")  # r^2
        found, total, height = [], 0.0, 0.0
        for k, (mu, load) in enumerate(zip(self.tensions, self.loads, strict=True)):
            rest, value = total, -load * q / (4 * mu)
            if k:
                start = self.radii[k - 1] ** 2
                rest -= load * start / 2
                value -= rest * sympy.log(q) / (2 * mu)
                value += height - float(value.subs({q: start}))
            found.append(value.subs({q: square(self.middle)}))
            if k < len(self.radii):
                end = self.radii[k] ** 2
                height, total = float(value.subs({q: end})), rest + load * end / 2
        return [self._parts(found)]

    def data(self) -> dict[str, Any]:
        loads = self._parts([sympy.Float(load) for load in self.loads])
        return {"tension": self.tension().text(self.spelling), "load": loads.text(self.spelling + 1)}


@st.composite
def rings(draw: st.DrawFn) -> Rings:
    """One disc, up to three rings, contrasts up to 1e6; a load in some of them, or the same everywhere."""
    radii = tuple(sorted(draw(st.sets(place(0.02, 0.9), min_size=1, max_size=3))))
    middle = draw(st.sampled_from([(0.0, 0.0), (0.5, 0.5), (0.12, -0.21), (-0.377, 0.3), (0.613, 0.377)]))
    one = draw(st.one_of(power(-3, 3), power(-0.7, 0.7)))
    tensions = tuple(draw(st.sampled_from([one, 1.0, draw(power(-3, 3))])) for _ in range(len(radii) + 1))
    loads = tuple(draw(st.sampled_from([0.0, 1.0, -2.5, draw(power(-2, 2))])) for _ in range(len(radii) + 1))
    if not any(loads):
        loads = (1.0,) * len(loads)
    return Rings(draw(meshes()), draw(bounds(seldom=True)), draw(st.integers(0, 9)), middle, radii, tensions,
                  loads, draw(st.booleans()))  # fmt: skip

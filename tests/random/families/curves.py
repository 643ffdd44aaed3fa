"""Tensions and loads that jump along circles, not aligned with cells, and loads with a pole: u depends on r, or is
harmonic in parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy
from hypothesis import strategies as st

from fenicsx_obstacle.answers.answer import Answer
from tests.random.families.family import Judgement
from tests.random.families.manufactured import Circle, Manufactured, Piecewise, Side, everywhere, square, x, y
from tests.random.families.meshes import meshes
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

"""Tensions that jump or oscillate along one direction: the flux is known, and with it the gradient of u."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sin
from typing import Any

import numpy as np
import sympy
from hypothesis import strategies as st
from sympy import Expr

from tests.random.families.manufactured import Curve, Line, Manufactured, Piecewise, everywhere, expression, x, y
from tests.random.families.strategies import bounds, grids, place, power

PIECES = 4  # of a wave
ALONG_X = (1.0, 0.0)


def layered(direction: tuple[float, float], cuts: Sequence[float], values: Sequence[float | Expr]) -> Piecewise:
    """Each value up to the next cut along a direction."""
    sides = ([(Line(direction, cut), True)] for cut in cuts)
    *first, last = map(sympy.sympify, values)
    return Piecewise([*zip(sides, first, strict=True), ((), last)])


@dataclass(frozen=True)
class Layers(Manufactured):
    """Layers across a direction, with a load; u = 0 at s = 0 and the flux 1 - load s.

    Attributes:
        angle: Of the direction to the x-axis.
        cuts: Where the tension jumps, rising.
        tensions: One more.
        load: The same everywhere.
    """

    angle: float
    cuts: tuple[float, ...]
    tensions: tuple[float, ...]
    load: float

    name = "layers"

    def _parts(self, values: Sequence[float | Expr]) -> Piecewise:
        return layered((cos(self.angle), sin(self.angle)), self.cuts, values)

    def tension(self) -> Piecewise:
        return self._parts(self.tensions)

    def u(self) -> list[Piecewise]:
        s, values, height, start = cos(self.angle) * x + sin(self.angle) * y, [], 0.0, 0.0
        for mu, end in zip(self.tensions, (*self.cuts, 2.0), strict=True):
            values.append(height + ((s - start) - self.load / 2 * (s**2 - start**2)) / mu)
            height += ((end - start) - self.load / 2 * (end**2 - start**2)) / mu
            start = end
        return [self._parts(values)]

    def data(self) -> dict[str, Any]:
        return {"tension": self.tension().text(self.spelling, products=True), "load": self.load}

    def boundary(self) -> list[dict[str, Any]]:
        """u is given on the left and the right, or on the whole boundary."""
        whole = {"value": self.value()}
        return [whole] if sin(self.angle) else [{"on": "left", "value": 0}, {"on": "right", **whole}]

    def value(self) -> str:
        return self.u()[0].text()


@st.composite
def layers(draw: st.DrawFn) -> Layers:
    """One jump or two, of contrasts up to 1e6."""
    cuts = tuple(sorted(draw(st.sets(place(0.05, 0.95), min_size=1, max_size=2))))
    tensions = tuple(draw(st.one_of(power(-3, 3), power(-0.7, 0.7))) for _ in range(len(cuts) + 1))
    angle = draw(st.sampled_from([0.0, 0.0, 0.0, pi / 4, 0.3, 1.1]))
    load = draw(st.sampled_from([0.0, 0.0, 1.0, -2.5]))
    return Layers(draw(grids()), draw(bounds()), draw(st.integers(0, 3)), angle, cuts, tensions, load)


@dataclass(frozen=True)
class LayersInContact(Manufactured):
    """Layers across x, u = 0 on the left and the right, a load that presses on a flat obstacle.

    Attributes:
        cuts: Where the tension jumps, rising.
        tensions: One more.
        load: Downwards.
        middle: A place that the contact set holds.
        share: Depth of the obstacle, over the largest for which it does.
    """

    cuts: tuple[float, ...]
    tensions: tuple[float, ...]
    load: float
    middle: float
    share: float

    name = "layers in contact"

    def _sag(self, end: float, wall: float) -> float:
        """How far below the wall u is at the end of the free part that begins there."""
        low, high = min(end, wall), max(end, wall)
        ends = np.clip(np.array([0.0, *self.cuts, 1.0]), low, high)
        return float(sum(self.load / mu * abs((b - end) ** 2 - (a - end) ** 2) / 2
                         for mu, a, b in zip(self.tensions, ends[:-1], ends[1:], strict=True)))  # fmt: skip

    def truth(self) -> tuple[float, float, float]:
        """Depth of the obstacle, and where the contact set begins and ends."""
        depth = self.share * min(self._sag(self.middle, 0.0), self._sag(self.middle, 1.0))
        ends = []
        for wall in (0.0, 1.0):
            near, far = wall, self.middle
            for _ in range(200):
                half = (near + far) / 2
                near, far = (near, half) if self._sag(half, wall) > depth else (half, far)
            ends.append((near + far) / 2)
        return depth, ends[0], ends[1]

    def tension(self) -> Piecewise:
        return layered(ALONG_X, self.cuts, self.tensions)

    def curves(self) -> list[Curve]:
        return [*super().curves(), *(Line(ALONG_X, end) for end in self.truth()[1:])]

    def gradient(self, px: np.ndarray, py: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        _, a, b = self.truth()
        slope = self.load * (np.minimum(px - a, 0) + np.maximum(px - b, 0)) / self.tension().at(px, py)
        return slope, np.zeros_like(px)

    def data(self) -> dict[str, Any]:
        tension = self.tension().text(self.spelling, products=True)
        return {"tension": tension, "load": -self.load, "lower": -self.truth()[0]}

    def boundary(self) -> list[dict[str, Any]]:
        return [{"on": ["left", "right"], "value": 0}]


@st.composite
def layers_in_contact(draw: st.DrawFn) -> LayersInContact:
    """One jump or two."""
    cuts = tuple(sorted(draw(st.sets(place(0.05, 0.95), min_size=1, max_size=2))))
    tensions = tuple(draw(power(-1.5, 1.5)) for _ in range(len(cuts) + 1))
    return LayersInContact(
        mesh=draw(grids(6)), options=draw(bounds()), cuts=cuts, tensions=tensions, load=draw(power(-2, 2)),
        middle=draw(place(0.2, 0.8)), share=draw(place(0.2, 0.95)), spelling=draw(st.integers(0, 3)),
    )  # fmt: skip


WAVES = {
    "compliance": "1/({b} + sin({w}*x))", "sine": "{b} + sin({w}*x)", "exponential": "exp({b}*sin({w}*x))",
    "steps": "{b} + sign(sin({w}*x))",
}  # fmt: skip


@dataclass(frozen=True)
class Waves(Manufactured):
    """A tension that oscillates with x, u = 0 on the left and 1 on the right, no load.

    Attributes:
        kind: Of the formula.
        base: Its constant, above 1.
        wave: Its wave number.
    """

    kind: str
    base: float
    wave: float

    name = "waves"
    accuracy = 1e-6

    def tension(self) -> Piecewise:
        return everywhere(expression(self.data()["tension"]))

    def data(self) -> dict[str, Any]:
        return {"tension": WAVES[self.kind].format(b=repr(self.base), w=repr(self.wave))}

    def boundary(self) -> list[dict[str, Any]]:
        return [{"on": "left", "value": 0}, {"on": "right", "value": 1}]

    def _places(self) -> np.ndarray:
        places = pi / self.wave * np.arange(1, int(PIECES / 2 * self.wave / pi) + 2) / (PIECES / 2)
        return places[places < 1]

    def curves(self) -> list[Curve]:
        return [Line(ALONG_X, float(place)) for place in self._places()]

    @cached_property
    def _compliance(self) -> float:
        ends = np.concatenate([[0.0], self._places(), [1.0]])
        t, weights = np.polynomial.legendre.leggauss(16)
        px = ends[:-1, None] + np.diff(ends)[:, None] * (t + 1) / 2
        return float((weights / self.tension().at(px, px) * np.diff(ends)[:, None] / 2).sum())

    def gradient(self, px: np.ndarray, py: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 1 / (self._compliance * self.tension().at(px, py)), np.zeros_like(px)


@st.composite
def waves(draw: st.DrawFn) -> Waves:
    """Short waves and long ones."""
    base = draw(st.sampled_from([1.01, 1.1, 1.5, 3.0]))
    return Waves(draw(grids()), draw(bounds()), 0, draw(st.sampled_from(list(WAVES))), base,
                 float(draw(st.integers(5, 200))))  # fmt: skip

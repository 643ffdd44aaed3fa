"""Tensions that jump or oscillate along one direction: the flux is known, and with it the gradient of u."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.elements import Field
from tests.random.families.family import Family, Judgement, toml
from tests.random.families.integrals import Pieces, energy_error
from tests.random.families.strategies import bounds, grids, place, power

SPELLINGS = ("where({s} < {c}, {a}, {b})", "({a})*({s} < {c}) + ({b})*({s} >= {c})",
             "where(sign({s} - {c}) < 0, {a}, {b})", "where(not {s} < {c}, {b}, {a})")  # fmt: skip
PIECES = 4  # of a wave


def stepped(s: str, cuts: tuple[float, ...], values: list[str], spelling: str) -> str:
    """A formula that has each value up to the next cut."""
    text = values[-1]
    for c, value in reversed(list(zip(cuts, values[:-1], strict=True))):
        text = spelling.format(s=s, c=repr(c), a=value, b=text)
    return text


@dataclass(frozen=True)
class Layers(Family):
    """Layers across a direction, with a load; u = 0 at s = 0 and the flux 1 - load s.

    Attributes:
        mesh: The table [mesh].
        options: Of `solve`.
        angle: Of the direction to the x-axis.
        cuts: Where the tension jumps, rising.
        tensions: One more.
        load: The same everywhere.
        spelling: How the jump is written.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    angle: float
    cuts: tuple[float, ...]
    tensions: tuple[float, ...]
    load: float
    spelling: str

    name = "layers"

    def scene(self) -> Scene:
        """u is given on the left and the right, or on the whole boundary."""
        ca, sa = cos(self.angle), sin(self.angle)
        s = f"({ca!r}*x + {sa!r}*y)" if sa else "x"
        values, height, start = [], 0.0, 0.0
        for mu, end in zip(self.tensions, (*self.cuts, 2.0), strict=True):
            values.append(f"{height!r} + (({s} - {start!r}) - {self.load / 2!r}*({s}^2 - {start**2!r}))/{mu!r}")
            height += ((end - start) - self.load / 2 * (end**2 - start**2)) / mu
            start = end
        u = stepped(s, self.cuts, values, SPELLINGS[0])
        boundary = [{"value": u}] if sa else [{"on": "left", "value": 0}, {"on": "right", "value": u}]
        tension = stepped(s, self.cuts, [repr(mu) for mu in self.tensions], self.spelling)
        return Scene(mesh=self.mesh, tension=tension, load=self.load, boundary=boundary)

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(self.scene, **self.options)
        if answer is not None:
            judgement.certificate(answer, *self.error(Field(answer.u)))

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, and the norm of u (collective)."""
        ca, sa = cos(self.angle), sin(self.angle)

        def tension(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return np.array(self.tensions)[np.searchsorted(self.cuts, ca * x + sa * y)]

        def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            slope = (1 - self.load * (ca * x + sa * y)) / tension(x, y)
            return slope * ca, slope * sa

        return energy_error(field, Pieces.of(field).cut((ca, sa), self.cuts), tension, gradient)

    def text(self) -> str:
        return toml(self.scene(), f"solve(scene, {self.options})")


@st.composite
def layers(draw: st.DrawFn) -> Layers:
    """One jump or two, of contrasts up to 1e6."""
    cuts = tuple(sorted(draw(st.sets(place(0.05, 0.95), min_size=1, max_size=2))))
    tensions = tuple(draw(st.one_of(power(-3, 3), power(-0.7, 0.7))) for _ in range(len(cuts) + 1))
    angle = draw(st.sampled_from([0.0, 0.0, 0.0, pi / 4, 0.3, 1.1]))
    load = draw(st.sampled_from([0.0, 0.0, 1.0, -2.5]))
    return Layers(draw(grids()), draw(bounds()), angle, cuts, tensions, load, draw(st.sampled_from(SPELLINGS)))


@dataclass(frozen=True)
class LayersInContact(Family):
    """Layers across x, u = 0 on the left and the right, a load that presses on a flat obstacle.

    Attributes:
        mesh: The table [mesh].
        options: Of `solve`.
        cuts: Where the tension jumps, rising.
        tensions: One more.
        load: Downwards.
        middle: A place that the contact set holds.
        share: Depth of the obstacle, over the largest for which it does.
        spelling: How the jump is written.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    cuts: tuple[float, ...]
    tensions: tuple[float, ...]
    load: float
    middle: float
    share: float
    spelling: str

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

    def scene(self) -> Scene:
        tension = stepped("x", self.cuts, [repr(mu) for mu in self.tensions], self.spelling)
        return Scene(mesh=self.mesh, tension=tension, load=-self.load, lower=-self.truth()[0],
                     boundary=[{"on": ["left", "right"], "value": 0}])  # fmt: skip

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(self.scene, **self.options)
        if answer is not None:
            judgement.certificate(answer, *self.error(Field(answer.u)))

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, and the norm of u (collective)."""
        _, a, b = self.truth()

        def tension(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return np.array(self.tensions)[np.searchsorted(self.cuts, x)]

        def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return self.load * (np.minimum(x - a, 0) + np.maximum(x - b, 0)) / tension(x, y), np.zeros_like(x)

        return energy_error(field, Pieces.of(field).cut((1.0, 0.0), sorted((*self.cuts, a, b))), tension, gradient)

    def text(self) -> str:
        return toml(self.scene(), f"solve(scene, {self.options})")


@st.composite
def layers_in_contact(draw: st.DrawFn) -> LayersInContact:
    """One jump or two."""
    cuts = tuple(sorted(draw(st.sets(place(0.05, 0.95), min_size=1, max_size=2))))
    tensions = tuple(draw(power(-1.5, 1.5)) for _ in range(len(cuts) + 1))
    return LayersInContact(draw(grids(6)), draw(bounds()), cuts, tensions, draw(power(-2, 2)), draw(place(0.2, 0.8)),
                           draw(place(0.2, 0.95)), draw(st.sampled_from(SPELLINGS)))  # fmt: skip


@dataclass(frozen=True)
class Waves(Family):
    """A tension that oscillates with x, u = 0 on the left and 1 on the right, no load.

    Attributes:
        mesh: The table [mesh].
        options: Of `solve`.
        kind: Of the formula.
        base: Its constant, above 1.
        wave: Its wave number.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    kind: str
    base: float
    wave: float

    name = "waves"

    def scene(self) -> Scene:
        tension = WAVES[self.kind][0].format(b=repr(self.base), w=repr(self.wave))
        boundary = [{"on": "left", "value": 0}, {"on": "right", "value": 1}]
        return Scene(mesh=self.mesh, tension=tension, boundary=boundary)

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(self.scene, **self.options)
        if answer is not None:
            judgement.certificate(answer, *self.error(Field(answer.u)), accuracy=1e-6)

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, and the norm of u (collective)."""
        tension_of = WAVES[self.kind][1]
        places = pi / self.wave * np.arange(1, int(PIECES / 2 * self.wave / pi) + 2) / (PIECES / 2)
        places = places[places < 1]
        ends = np.concatenate([[0.0], places, [1.0]])
        t, weights = np.polynomial.legendre.leggauss(16)
        x = ends[:-1, None] + np.diff(ends)[:, None] * (t + 1) / 2
        compliance = (weights / tension_of(x, self.base, self.wave) * np.diff(ends)[:, None] / 2).sum()

        def tension(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return tension_of(x, self.base, self.wave)

        def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return 1 / (compliance * tension(x, y)), np.zeros_like(x)

        return energy_error(field, Pieces.of(field).cut((1.0, 0.0), places), tension, gradient, count=10)

    def text(self) -> str:
        return toml(self.scene(), f"solve(scene, {self.options})")


WAVES = {
    "compliance": ("1/({b} + sin({w}*x))", lambda x, b, w: 1 / (b + np.sin(w * x))),
    "sine": ("{b} + sin({w}*x)", lambda x, b, w: b + np.sin(w * x)),
    "exponential": ("exp({b}*sin({w}*x))", lambda x, b, w: np.exp(b * np.sin(w * x))),
    "steps": ("{b} + sign(sin({w}*x))", lambda x, b, w: b + np.sign(np.sin(w * x))),
}


@st.composite
def waves(draw: st.DrawFn) -> Waves:
    """Short waves and long ones."""
    base = draw(st.sampled_from([1.01, 1.1, 1.5, 3.0]))
    return Waves(draw(grids()), draw(bounds()), draw(st.sampled_from(list(WAVES))), base,
                 float(draw(st.integers(5, 200))))  # fmt: skip

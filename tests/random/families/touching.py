"""Contact in closed form: u = obstacle + w, where w is a square outside of the contact set.

In the contact set -div(tension grad obstacle) - load is the contact pressure, at least 0. Where it is 0, or u does not
touch, the obstacle may be lower than u by any amount: there it has jumps and kinks. With a matrix for the tension the
load follows from the same u.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
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
    expression,
    line_at,
    load_of,
    square,
    x,
    y,
)
from tests.random.families.meshes import meshes
from tests.random.families.strategies import bounds_by_all_ways, place
from tests.random.families.varying import SMOOTH, TENSIONS

KINDS = ("half", "strip", "band", "disc", "hole", "wedge", "tent", "cone", "two")
ANGLES = ("0", "0.4", "0.785398", "1.9", "x - y", "0.5*x*y", "1.5*x", "4*y")
CHANGES = ("none", "none", "jump away", "kink away", "jump", "kink")


@dataclass(frozen=True)
class Touching(Manufactured):
    """One obstacle that u touches on a half plane, a strip, a disc, or beside these; or two obstacles.

    Attributes:
        kind: Of the contact set: a half plane; a strip; all but a strip; a disc; all but a disc; all but a wedge; a
            strip with the ridge of a tent, a disc with the tip of a cone; two half planes, one for each obstacle.
        angles: Of lines; of a disc its centre.
        place: Of a line.
        width: Of a strip, or a radius.
        size: Of w.
        obstacle: A formula.
        pressure: A formula, at least 0.
        change: What the obstacle is lowered by.
        upper: Whether all is upside down.
        stiff: Formula of the tension.
    """

    kind: str
    angles: tuple[float, float]
    place: float
    width: float
    size: float
    obstacle: str
    pressure: str
    change: str
    upper: bool
    stiff: str

    name = "touching"

    @property
    def _line(self) -> Line:
        return line_at(self.angles[0], self.place)

    def _moved(self, by: float) -> Line:
        return Line(self._line.direction, round(self.place + by, 12))

    def above(self) -> tuple[Piecewise, str]:
        """w, and as text what is negative or 0 where u touches."""
        s, zero, circle = distance(self._line), sympy.Integer(0), Circle(self.angles, self.width)
        squared, R, d = square(self.angles), self.width, self.width
        low, high = self._moved(-d), self._moved(d)
        far = f"hypot(x - ({self.angles[0]!r}), y - ({self.angles[1]!r}))"
        strip: list[tuple[list[Side], Expr]] = [
            ([(low, True)], (s + d) ** 2), ([(high, True)], zero), ([], (s - d) ** 2),
        ]  # fmt: skip
        if self.kind == "tent":
            strip = [strip[0], ([(self._line, True)], zero), *strip[1:]]
        other = line_at(self.angles[1], self.place)
        kinds: dict[str, tuple[list[tuple[list[Side], Expr]], str]] = {
            "half": ([([(self._line, True)], zero), ([], s**2)], f"({s})"),
            "strip": (strip, f"(abs({s}) - {d!r})"),
            "tent": (strip, f"(abs({s}) - {d!r})"),
            "band": ([([(low, True)], zero), ([(high, True)], (d**2 - s**2) ** 2), ([], zero)], f"({d!r} - abs({s}))"),
            "disc": ([([(circle, True)], zero), ([], (squared - R**2) ** 2)], f"({far} - {R!r})"),
            "cone": ([([(circle, True)], zero), ([], (sympy.sqrt(squared) - R) ** 2)], f"({far} - {R!r})"),
            "hole": ([([(circle, True)], (R**2 - squared) ** 2), ([], zero)], f"({R!r} - {far})"),
            "wedge": ([([(self._line, False), (other, False)], s**2 * distance(other) ** 2), ([], zero)],
                      f"min({s}, {distance(other)})"),
            "two": ([([(low, True)], zero), ([(high, True)], self._step(s)), ([], sympy.Integer(1))], f"({s} + {d!r})"),
        }  # fmt: skip
        parts, text = kinds[self.kind]
        return Piecewise([(sides, self.size * value) for sides, value in parts]), text

    def _step(self, s: Expr) -> Expr:
        """From 0 to 1 where s goes from -width to width."""
        t = (s + self.width) / (2 * self.width)
        return t**2 * (3 - 2 * t)

    def _psi(self) -> tuple[Piecewise, str]:
        """The obstacle that u touches, as it is in the parts of w, and as text."""
        w, psi = self.above()[0], expression(self.obstacle)
        s = distance(self._line)
        if self.kind == "tent":
            signs = (1, 1, -1, -1)
            return Piecewise([(sides, psi + sign * s) for (sides, _), sign in zip(w.parts, signs, strict=True)]), (
                f"{psi} - abs({s})")  # fmt: skip
        if self.kind == "cone":
            radius = sympy.sqrt(square(self.angles))
            return w.map(lambda _: psi - radius), f"{psi} - {radius}"
        return w.map(lambda _: psi), str(psi)

    def forces(self, u: Piecewise) -> Piecewise:
        """The load that a function in the parts of w is in balance with."""
        return u.map(load_of, self.tension())

    def u(self) -> list[Piecewise]:
        return [self._psi()[0].map(lambda psi, w: self.sign * (psi + w), self.above()[0])]

    def poles(self) -> list[tuple[float, float]]:
        return [self.angles] if self.kind == "cone" else []

    def lowered(self) -> tuple[str, str]:
        """By what the obstacle is lowered, and the pressure, as text."""
        gap, pressure = self.above()[1], f"({self.pressure})"
        other = distance(line_at(self.angles[0] + 0.9, 0.1))
        if "away" in self.change:
            beyond = f"{gap} - {self.width / 3!r}"
            return f"where({beyond} > 0, 0.7, 0)" if "jump" in self.change else f"0.7*max(0, {beyond})", pressure
        if self.change != "none":
            low = f"where({other} > 0, 0.7, 0)" if self.change == "jump" else f"2*max(0, {other})"
            return low, f"where({other} > 0, 0, {pressure})"
        return "0", pressure

    def data(self) -> dict[str, Any]:
        tension, (w, gap), (psi, text) = expression(self.stiff), self.above(), self._psi()
        by, pressure = self.lowered()
        own = self.forces(psi.map(lambda psi, w: psi + w, w))
        if self.kind == "cone":  # no more than 1/r in the contact set, which the obstacle bears
            inside, outside = own.parts
            tip = load_of(expression(self.obstacle), tension)
            own = Piecewise([(inside[0], tip), outside])
        load = f"{own.text(self.spelling)} - where({gap} <= 0, {pressure}, 0)"
        over = f"{text} + {self.size!r}"
        if self.kind == "two":
            load += f" + where({distance(self._line)} >= {self.width!r}, {self.pressure}, 0)"
        near, other = self.side, "lower" if self.upper else "upper"
        lower = f"{text} - ({by})" if by != "0" else text
        minus = "-" if self.upper else ""
        found = {"tension": self.stiff, "load": f"{minus}({load})", near: f"{minus}({lower})"}
        return {**found, other: f"{minus}({over})"} if self.kind == "two" else found


@st.composite
def touching(draw: st.DrawFn) -> Touching:
    """Obstacles that are polynomials, mostly; with a pressure that may be 0."""
    kind = draw(st.sampled_from(KINDS))
    round_ = kind in ("disc", "hole", "cone")
    first = draw(st.sampled_from([0.0, 0.0, 0.785398, 0.3, 2.0]))
    angles = (draw(place(-0.5, 0.5)), draw(place(-0.5, 0.5))) if round_ else (first, first + 1.3)
    # a tent or cone bears its own curvature only where the tension is constant
    constant = kind in ("tent", "cone") or draw(st.booleans())
    stiff = draw(st.sampled_from(["1", "7.3", "0.001"])) if constant else draw(st.sampled_from(TENSIONS))
    change = draw(st.sampled_from(CHANGES)) if kind not in ("two", "tent", "cone") else "none"
    mesh, options = draw(meshes()), draw(bounds_by_all_ways("P1", "P2"))
    return Touching(mesh, options, draw(st.integers(0, 9)), kind, angles, draw(place(-0.4, 0.5)),
                    draw(place(0.15, 0.5)), draw(st.sampled_from([1.0, 4.0, 0.1])),
                    draw(st.sampled_from(["0", "-x**2", *SMOOTH])), draw(st.sampled_from(["1", "30", "0", "1 + x**2"])),
                    change, draw(st.booleans()), stiff)  # fmt: skip


@dataclass(frozen=True)
class Anisotropic(Touching):
    """-div(A grad u) = load + p. A has the eigenvalue 1 along a direction, and another one across.

    Attributes:
        angle: Of the direction, a formula.
        ratio: The other eigenvalue.
        beyond: Angle and ratio beyond the line, where the contact set is a half plane; None: the same. The gradient of
            u is 0 on the line.
    """

    angle: str
    ratio: float
    beyond: tuple[str, float] | None

    name = "anisotropic"

    def entries(self) -> list[list[Piecewise]]:
        """Of A, in the parts of w."""
        parts = self.above()[0].parts
        matrices = [_matrix(self.angle, self.ratio)] * len(parts)
        if self.beyond is not None:
            matrices[-1] = _matrix(*self.beyond)
        return [
            [Piecewise([(sides, one[i][j]) for (sides, _), one in zip(parts, matrices, strict=True)]) for j in range(2)]
            for i in range(2)
        ]

    def forces(self, u: Piecewise) -> Piecewise:
        """See `Touching.forces`."""
        a, b, _, c = (entry for row in self.entries() for entry in row)

        def load(u: Expr, a: Expr, b: Expr, c: Expr) -> Expr:
            along, across = sympy.diff(u, x), sympy.diff(u, y)
            found = -sympy.diff(a * along + b * across, x) - sympy.diff(b * along + c * across, y)
            return sympy.expand(found) if found.is_polynomial(x, y) else found

        return u.map(load, a, b, c)

    def data(self) -> dict[str, Any]:
        rows = self.entries()
        uniform = self.beyond is None
        texts = [[f"({entry.parts[0][1]})" if uniform else entry.text(self.spelling) for entry in row] for row in rows]
        return {**super().data(), "tension": texts}

    def stiffness(self, px: np.ndarray, py: np.ndarray) -> np.ndarray:
        """The matrices at points."""
        return np.stack([np.stack([entry.at(px, py) for entry in row], axis=1) for row in self.entries()], axis=1)


def _matrix(angle: str, ratio: float) -> list[list[Expr]]:
    """1 along a direction, and the ratio across."""
    turned = expression(angle)
    c, s = sympy.cos(turned), sympy.sin(turned)
    a, b, d = c**2 + ratio * s**2, (1 - ratio) * c * s, s**2 + ratio * c**2
    if turned.is_number:
        a, b, d = (sympy.Float(one) for one in (a, b, d))
    return [[a, b], [b, d]]


@st.composite
def anisotropic(draw: st.DrawFn) -> Anisotropic:
    """Directions that are constant, vary smoothly or jump, mostly with contact."""
    base = draw(touching().filter(lambda one: one.kind not in ("tent", "cone")))
    direction = st.tuples(st.sampled_from(ANGLES), st.sampled_from([1.0, 3.0, 0.2, 30.0, 1e-3, 1e4]))
    angle, ratio = draw(direction)
    beyond = draw(st.one_of(st.none(), direction)) if base.kind == "half" else None
    obstacle = base.obstacle if beyond is None else str(sympy.expand(-0.7 * distance(base._line) ** 2))
    return Anisotropic(**{
        **vars(base), "options": {**base.options, "element": "P1"}, "obstacle": obstacle, "stiff": "1",
    }, angle=angle, ratio=ratio, beyond=beyond)  # fmt: skip

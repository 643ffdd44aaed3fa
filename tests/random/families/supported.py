"""Closed forms with more on sides of a rectangle than u.

On a foundation, with fluxes and springs on sides: u is that of another family. With obstacles on sides: u is a formula,
and touches along a part of a side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy
from hypothesis import strategies as st

from tests.random.families.manufactured import SIDES, Curve, Manufactured, Piecewise, everywhere, line_at, x, y
from tests.random.families.strategies import bounds_by_all_ways, grids, place
from tests.random.families.touching import touching
from tests.random.families.varying import SMOOTH, TENSIONS, varying

BOXES = (((0.0, 1.0), (0.0, 1.0)), ((-1.0, 1.0), (-1.0, 1.0)), ((0.5, 1.5), (-0.4, 0.6)))
FOUNDATIONS = ("0", "0", "0", "3", "300")
HALF = line_at(0.0, 0.113)
# of foundations and springs, times a factor
SHAPES = {
    "even": everywhere(1), "smooth": everywhere(sympy.exp(x - y)), "linear": everywhere(3 + x + y),
    "half": Piecewise([(((HALF, True),), sympy.Integer(1)), ((), sympy.Integer(0))]),
    "two": Piecewise([(((HALF, False),), 2 + x), ((), sympy.Integer(1))]),
}  # fmt: skip


@dataclass(frozen=True)
class Supported(Manufactured):
    """-div(tension grad u) + k u = load + p with the u of another scene; flux and spring replace u on sides.

    Attributes:
        base: The other scene.
        shape: Of the foundation, in `SHAPES`.
        size: It times this.
        sides: Where u is not given.
        spring: Shape of the springs there.
        stiff: They times this.
    """

    base: Manufactured
    shape: str
    size: float
    sides: tuple[str, ...]
    spring: str
    stiff: float

    name = "supported"

    def u(self) -> list[Piecewise]:
        return self.base.u()

    def tension(self) -> Piecewise:
        return self.base.tension()

    def poles(self) -> list[tuple[float, float]]:
        return self.base.poles()

    def foundation(self) -> Piecewise | None:
        return SHAPES[self.shape].map(lambda k: self.size * k) if self.size > 0 else None

    def data(self) -> dict[str, Any]:
        data = self.base.data()
        if self.size > 0:
            foundation = f"{self.size!r}*{SHAPES[self.shape].text(self.spelling)}"
            data |= {"load": f"({data.get('load', 0)}) + {foundation}*({self.value()})", "foundation": foundation}
        return data

    def support(self) -> str:
        return f"{self.stiff!r}*{SHAPES[self.spring].text(self.spelling)}" if self.stiff > 0 else ""

    def curves(self) -> list[Curve]:
        """See `Manufactured.curves`."""
        return [*super().curves(), HALF]


@st.composite
def supported(draw: st.DrawFn) -> Supported:
    """u is smooth, or touches an obstacle."""
    base = draw(st.one_of(varying(), touching()).filter(lambda one: one.mesh["shape"] == "rectangle"))
    foundation = draw(st.sampled_from([0.0, 0.0, 0.3, 7.0, 300.0, 1e5]))
    sides = draw(st.lists(st.sampled_from(sorted(SIDES)), min_size=0 if foundation else 1, max_size=3, unique=True))
    return Supported(
        base.mesh, {**base.options, "element": "P1"}, base.spelling, base, draw(st.sampled_from(sorted(SHAPES))),
        foundation, tuple(sides), draw(st.sampled_from(sorted(SHAPES))),
        draw(st.sampled_from([0.0, 0.0, 0.5, 20.0, 1e4])),
    )  # fmt: skip


@dataclass(frozen=True)
class Bearing:
    """An obstacle on one side.

    Attributes:
        side: Its name.
        middle: Of the contact set, along the side.
        width: Half of its length.
        steep: The obstacle is away from u by the squared distance from there, times this.
        pressure: In contact.
        even: Whether it is the same all over; otherwise it is 0 at the ends.
        upper: Whether the obstacle is above u.
        spring: On the whole side.
    """

    side: str
    middle: float
    width: float
    steep: float
    pressure: float
    even: bool
    upper: bool
    spring: float


@dataclass(frozen=True)
class Bearings(Manufactured):
    """-div(tension grad u) + foundation u = load, with u between obstacles on sides.

    Attributes:
        formula: Of u.
        stiff: Of the tension.
        bed: Stiffness of a foundation, a number.
        axial: Whether there is axial symmetry.
        bearings: One for each side where u is not given.
    """

    formula: str
    stiff: str
    bed: str
    axial: bool
    bearings: tuple[Bearing, ...]

    name = "bearings"

    def boundary(self) -> list[dict[str, Any]]:
        """The parts of the boundary."""
        given = [side for side in SIDES if side not in {one.side for one in self.bearings}]
        parts: list[dict[str, Any]] = [{"on": given, "value": self.formula}]
        for one in self.bearings:
            sign, along = -1 if one.upper else 1, f"abs({'y' if SIDES[one.side][0] else 'x'} - ({one.middle!r}))"
            shape = f"where({along} < {one.width!r}, 1, 0)" if one.even else f"max(1 - ({along}/{one.width!r})^2, 0)"
            spring = repr(one.spring) if one.spring > 0 else ""
            part = self.natural(one.side, spring, f" - {sign * one.pressure!r}*{shape}")
            gap = f"{sign * one.steep!r}*max({along} - {one.width!r}, 0)^2"
            parts.append({**part, "upper" if one.upper else "lower": f"({self.formula}) - {gap}"})
        return parts


@st.composite
def bearings(draw: st.DrawFn) -> Bearings:
    """One side with an obstacle, or more; the contact set ends before its ends, mostly."""
    box = draw(st.sampled_from(BOXES))
    mesh = draw(grids(4, 14, (0.0, 0.1, 0.2), x=box[0], y=box[1]))
    found = []
    for side in draw(st.lists(st.sampled_from(sorted(SIDES)), min_size=1, max_size=3, unique=True)):
        low, high = box[1] if SIDES[side][0] else box[0]
        found.append(Bearing(
            side, round(low + (high - low) * draw(place(0.3, 0.7)), 6),
            round((high - low) * draw(place(0.05, 0.35)), 6),
            draw(st.sampled_from([0.5, 20.0])), draw(st.sampled_from([0.0, 0.5, 3.0, 30.0])),
            draw(st.sampled_from([False, False, False, True])), draw(st.booleans()),
            draw(st.sampled_from([0.0, 0.0, 0.5, 20.0])),
        ))  # fmt: skip
    return Bearings(
        mesh, draw(bounds_by_all_ways("P1")), 0, draw(st.sampled_from(SMOOTH)),
        draw(st.sampled_from(["1", *TENSIONS])), draw(st.sampled_from(FOUNDATIONS)),
        box[0][0] > 0 and draw(st.booleans()), tuple(found),
    )  # fmt: skip

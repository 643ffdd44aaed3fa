"""Closed forms with concentrated loads of finite energy: at points of a string, and along a line inside a membrane.

u has a kink there. Contact is beside it, or on one side up to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import sympy
from dolfinx import mesh as dmesh
from hypothesis import assume
from hypothesis import strategies as st
from mpi4py import MPI
from sympy import Expr

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.manufactured import Line, Manufactured, Piecewise, distance, expression, x
from tests.random.families.meshes import skewed
from tests.random.families.strategies import bounds_by_all_ways, place, power
from tests.random.families.supported import SHAPES

OBSTACLES = ("0", "x**2", "x**3 - x", "sin(3*x)", "exp(-x)")
TENSIONS = ("1", "0.01", "1 + x", "exp(x)", "2 + sin(9*x)", "1/(1 + x**2)")
FOUNDATIONS = ("0", "0", "3", "300", "1 + x")
OBSTACLES_2D = ("0", "x**2 - x*y", "x**3*y - y**2", "exp(x)*sin(2*y)", "sin(3*x + y)")
TENSIONS_2D = ("1", "7.3", "exp(x - y)", "2 + sin(5*x)*cos(3*y)", "1/(1 + x**2 + y**2)")
FACTORS = ("1", "0.1", "2 + x*y", "(1 + y)**2", "exp(x)")
LINE = "line"
BORNE = 0.6  # half of the length of this part, up to a factor


@dataclass(frozen=True)
class LoadedString(Manufactured):
    """-(tension u')' + foundation u = load + sum of forces at points + p on the unit interval.

    Attributes:
        obstacle: A formula; u itself without contact and forces.
        stiff: Of the tension.
        bed: Of the foundation, a formula.
        contact: Where it ends; 0: there is none.
        size: u is above the obstacle by the squared distance from there, times this.
        pressure: In contact.
        points: Where there are kinks, beyond the contact set.
        kinks: By how much the slope rises there.
        pressed: Points in contact, where forces press.
        end: 'value', or 'force' at the right end.
        upper: Whether all is upside down.
    """

    obstacle: str
    stiff: str
    bed: str
    contact: float
    size: float
    pressure: float
    points: tuple[float, ...]
    kinks: tuple[float, ...]
    pressed: tuple[float, ...]
    end: str
    upper: bool

    name = "loaded string"

    def u(self) -> list[Piecewise]:
        parts: list[Any] = []
        for left, right in pairwise(sorted({0.0, self.contact, *self.points, 1.0})):
            u = expression(self.obstacle)
            if self.contact > 0 and left >= self.contact:
                u += self.size * (x - self.contact) ** 2
            u += sum(kink * (x - point) for point, kink in zip(self.points, self.kinks, strict=True) if left >= point)
            parts.append((((Line((1.0, 0.0), right), True),) if right < 1 else (), self.sign * u))
        return [Piecewise(parts)]

    def balance(self) -> Piecewise:
        (sides, first), *others = super().balance().map(sympy.expand).parts
        return Piecewise([(sides, first - (self.sign * self.pressure if self.contact > 0 else 0)), *others])

    def data(self) -> dict[str, Any]:
        sign, mu, data = self.sign, expression(self.stiff), super().data()
        forces = [
            (point, -kink * float(mu.subs(x, point))) for point, kink in zip(self.points, self.kinks, strict=True)
        ]
        forces += [(point, -2.5) for point in self.pressed]
        if self.end == "force":
            last = self.u()[0].parts[-1][1]
            forces.append((1.0, sign * float((mu * sympy.diff(last, x)).subs(x, 1))))
        if forces:
            data["point_load"] = [{"at": at, "force": sign * force} for at, force in forces]
        if self.contact > 0:
            data[self.side] = f"{sign}*({self.obstacle})"
        return data

    def boundary(self) -> list[dict[str, Any]]:
        """The ends where u is given."""
        parts = self.u()[0].parts
        given = [(0.0, parts[0][1], "left")] + ([] if self.end == "force" else [(1.0, parts[-1][1], "right")])
        return [{"on": name, "value": float(u.subs(x, at))} for at, u, name in given]


@st.composite
def loaded_strings(draw: st.DrawFn) -> LoadedString:
    """Points at vertices and inside cells."""
    cells, contact = draw(st.integers(4, 40)), draw(st.one_of(st.just(0.0), place(0.1, 0.6)))
    vertices = st.integers(1, cells - 1).map(lambda k: k / cells)
    anywhere = st.one_of(place(0.02, 0.98), vertices)
    drawn = draw(st.lists(anywhere, max_size=3, unique=True))
    points = tuple(sorted(one for one in drawn if one > contact))
    pressed = tuple(one for one in drawn if one < contact)
    assume(points or pressed)
    kink = power(-1, 1) if contact > 0 else st.one_of(power(-1, 1), power(-1, 1).map(lambda one: -one))
    return LoadedString(
        {"shape": "interval", "cells": cells}, draw(bounds_by_all_ways("P1", "P2")), 0,
        draw(st.sampled_from(OBSTACLES)), draw(st.sampled_from(TENSIONS)),
        draw(st.sampled_from(FOUNDATIONS)), contact, draw(st.sampled_from([1.0, 10.0])),
        draw(st.sampled_from([0.0, 1.0, 30.0])), points, tuple(draw(kink) for _ in points), pressed,
        draw(st.sampled_from(["value", "value", "force"])), draw(st.booleans()),
    )  # fmt: skip


def lined(comm: MPI.Comm, cells: int, slope: float, stretch: float, scatter: float) -> tuple[dmesh.Mesh, Any]:
    """A grid on a parallelogram with a line of edges in the middle, and the tags of these (collective).

    Args:
        comm: Communicator.
        cells: Half of those along each side.
        slope: Of the line.
        stretch: Along x.
        scatter: How far other inner vertices are moved before, in parts of a cell.
    """
    mesh = skewed(comm, 2 * cells, 2.0, slope, stretch, scatter, middle=True, lined=True)
    facets = dmesh.locate_entities(mesh, 1, lambda x: np.abs(x[0] / stretch - slope * x[1]) < 1 / (4 * cells))
    return mesh, dmesh.meshtags(mesh, 1, facets, np.ones(len(facets), dtype=np.int32))


@dataclass(frozen=True)
class LoadedLine(Manufactured):
    """u has a kink along a line of the mesh, by a load there and maybe a wire.

    Attributes:
        obstacle: A formula; of u on one side of the line without contact.
        stiff: Of the tension.
        factor: Of the kink.
        wire: Shape of the springs along the line, in `SHAPES`.
        springs: They times this.
        contact: Whether there is contact on one side of the line, where another function is negative.
        size: Of w beyond.
        pressure: In contact.
        angle: Of the direction in which w rises.
        upper: Whether all is upside down.
        borne: The largest pressure of an obstacle along a part of the line instead; 0: there is none.
    """

    obstacle: str
    stiff: str
    factor: str
    wire: str
    springs: float
    contact: bool
    size: float
    pressure: float
    angle: tuple[float, float]
    upper: bool
    borne: float

    name = "loaded line"

    @property
    def _line(self) -> Line:
        """x = stretch slope y."""
        return Line((1.0, -self.mesh["stretch"] * self.mesh["slope"]), 0.0)

    @property
    def _other(self) -> Line:
        return Line(self.angle, 0.113)

    def _parts(self, *values: Expr) -> Piecewise:
        """Below both lines; below the first; below the second; beyond."""
        one, other = (self._line, True), (self._other, True)
        return Piecewise(list(zip(((one, other), (one,), (other,), ()), values, strict=True)))

    def u(self) -> list[Piecewise]:
        psi, sign = expression(self.obstacle), self.sign
        w = self.size * distance(self._other) ** 2 if self.contact else sympy.Integer(0)
        kink = distance(self._line) * expression(self.factor)
        return [self._parts(*(sign * one for one in (psi, psi + w, psi + kink, psi + w + kink)))]

    def balance(self) -> Piecewise:
        push = self.sign * sympy.Float(self.pressure) if self.contact else sympy.Integer(0)
        return super().balance().map(lambda one, p: one - p, self._parts(push, *[sympy.Integer(0)] * 3))

    def data(self) -> dict[str, Any]:
        return super().data() | ({self.side: f"{self.sign}*({self.obstacle})"} if self.contact else {})

    def scene(self, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
        """The scene (collective)."""
        table, sign = self.mesh, self.sign
        mesh, tags = lined(comm, table["cells"], table["slope"], table["stretch"], table["scatter"])
        a, b = self._line.direction
        flux = f"{-sign * float(np.hypot(a, b))!r}*({self.stiff})*({self.factor})"
        along: dict[str, Any] = {"on": LINE}
        if self.borne > 0:
            along[self.side] = f"{self.value()} - {sign}*max(abs(y - 0.1) - {BORNE}, 0)^2"
            flux = f"{flux} - {sign * self.borne!r}*max(0, 1 - ((y - 0.1)/{BORNE})^2)"
        if self.springs > 0:
            along["spring"] = f"{self.springs!r}*{SHAPES[self.wire].text(self.spelling)}"
            flux = f"{flux} + {along['spring']}*({self.value()})"
        along["flux"] = flux
        return Scene(
            mesh=mesh, facet_tags=tags, facet_names={LINE: 1}, boundary=[{"value": self.value()}, along], **self.data()
        )


@st.composite
def loaded_lines(draw: st.DrawFn) -> LoadedLine:
    """Slanted lines, flat cells and moved vertices."""
    slope = draw(st.sampled_from([0.0, 0.0, 0.5, -1.3]))
    mesh = {"shape": "own", "cells": draw(st.integers(2, 7)), "slope": slope,
            "stretch": draw(st.sampled_from([1.0, 1.0, 0.3])) / (1 + abs(slope)),
            "scatter": draw(st.sampled_from([0.0, 0.2, 0.3]))}  # fmt: skip
    kind = draw(st.sampled_from(["none", "contact", "contact", "borne"]))
    return LoadedLine(
        mesh, draw(bounds_by_all_ways("P1")), draw(st.integers(0, 9)), draw(st.sampled_from(OBSTACLES_2D)),
        draw(st.sampled_from(TENSIONS_2D)), draw(st.sampled_from(FACTORS)), draw(st.sampled_from(sorted(SHAPES))),
        draw(st.sampled_from([0.0, 0.0, 0.5, 20.0, 200.0, 1e4])), kind == "contact", draw(st.sampled_from([1.0, 4.0])),
        draw(st.sampled_from([0.0, 1.0, 30.0])), draw(st.sampled_from([(0.0, 1.0), (1.0, 0.0), (0.6, -0.8)])),
        draw(st.booleans()), draw(st.sampled_from([1.0, 30.0])) if kind == "borne" else 0.0,
    )  # fmt: skip

"""Films of large slopes under a load, below and beyond the limit load: spherical caps and arcs of circles."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.elements import Field
from tests.random.families.family import ANSWER, EITHER, REJECTION, Family, Judgement
from tests.random.families.strategies import power

SQUARE = 2 + sqrt(np.pi)  # perimeter over area, the least of all parts of the unit square (Cheeger's constant)


@dataclass(frozen=True)
class Film(Family):
    """u = 0 at the edge of a disk (by axial symmetry), a strip or a square; load = ratio times the limit load.

    Attributes:
        kind: cap, arc (an interval), strip (a rectangle with free sides), square.
        cells: Across.
        size: Radius of the disk, length of the interval.
        tension: Surface tension.
        ratio: Load over the largest for which there is a solution.
        sign: Of the load.
        options: Of `solve`: the method, penalty or vi.
        far: Whether there is an obstacle, out of reach.
    """

    kind: str
    cells: int
    size: float
    tension: float
    ratio: float
    sign: float
    options: dict[str, Any]
    far: bool

    name = "film"

    @property
    def load(self) -> float:
        """Upwards."""
        limit = SQUARE if self.kind == "square" else 2.0
        return self.sign * self.ratio * limit * self.tension / self.size

    def scene(self) -> Scene:
        ends = [0.0, self.size]
        mesh: dict[str, Any] = {"shape": "interval", "cells": self.cells, "x": ends}
        if self.kind in ("strip", "square"):
            mesh |= {"shape": "rectangle", "y": ends}
        held = {"cap": ["right"], "strip": ["left", "right"]}.get(self.kind)
        given: dict[str, Any] = {"boundary": [{"value": 0} if held is None else {"on": held, "value": 0}]}
        if self.kind == "cap":
            given["axial_symmetry"] = True
        if self.far:
            given["lower" if self.sign < 0 else "upper"] = 1e9 * self.sign * self.size
        return Scene(mesh=mesh, large_slope=self.tension, load=self.load, **given)

    def judge(self, judgement: Judgement) -> None:
        beyond = self.ratio >= 1.05 + 4 / self.cells  # functions on a mesh bear a little more
        expected = ANSWER if self.ratio <= 0.9 else REJECTION if beyond and not self.far else EITHER
        answer = judgement.solve(self.scene, expected, **self.options)
        if answer is None:
            return
        low, high = Field(answer.u).ends()
        top = high if self.sign > 0 else -low
        if self.ratio > 1:
            # with an obstacle far away the film may hang down to it: never farther, and never anywhere
            judgement.check(not self.far or top <= 1.001e9 * self.size, f"u from {low:.6g} to {high:.6g}: nonsense")
            return
        if self.kind == "square":
            # higher than the cap of the inscribed disk, lower than the arc of the strip, if these exist
            half = self.size / 2
            least, most = self.height(half), self.height(half, arc=True)
        else:
            reach = self.size if self.kind == "cap" else self.size / 2
            least = most = self.height(reach, arc=self.kind != "cap")
        margin = 0.05 + 4 / self.cells if self.ratio <= 0.9 else 1.0
        right = least * (1 - margin) <= top <= most * (1 + margin)
        judgement.check(right, f"largest u along the load {top:.6g}; true: {least:.6g} to {most:.6g}")

    def height(self, reach: float, *, arc: bool = False) -> float:
        """Of a cap over a disk of this radius, or of an arc over an interval of twice this length."""
        radius = (1 if arc else 2) * self.tension / abs(self.load)
        return radius - sqrt(radius**2 - reach**2) if radius >= reach else float("inf")


@st.composite
def films(draw: st.DrawFn) -> Film:
    """Below the limit load, near to it, and beyond."""
    kind = draw(st.sampled_from(["cap", "cap", "arc", "strip", "square"]))
    cells = draw(st.integers(40, 120) if kind in ("cap", "arc") else st.integers(16, 24))
    percent = st.one_of(st.integers(5, 90), st.integers(91, 104), st.integers(115, 300))
    sign, method = draw(st.sampled_from([1.0, -1.0])), draw(st.sampled_from(["penalty", "vi"]))
    return Film(kind, cells, draw(power(-2, 2)), draw(power(-3, 3)), draw(percent) / 100, sign,
                {"method": method}, draw(st.booleans()))  # fmt: skip

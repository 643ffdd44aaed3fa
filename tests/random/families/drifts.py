"""Drift that carries u outwards: the operator is nearly singular, and its inverse still positive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import log

import numpy as np
from hypothesis import strategies as st
from scipy.special import expi

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.elements import Field
from tests.random.families.family import ANSWER, EITHER, Family, Judgement
from tests.random.families.strategies import power

MILD, PLAIN = 1.0, 1e4  # growth of u over that without drift up to which it must be answered: on any mesh, if resolved
POINTS = 20001  # of the quadrature
RESOLVED = 0.2  # Peclet number of a cell up to which values are compared
FLOWS: dict[str, tuple[str, Callable[[np.ndarray, float, float], np.ndarray]]] = {
    "from a point": ("{k}*(x - {c})", lambda x, k, c: k * (x - c) ** 2 / 2),
    "waves": ("{k}*sin(6*(x - {c}))", lambda x, k, c: -k * np.cos(6 * (x - c)) / 6),
    "uniform": ("{k}", lambda x, k, c: k * x),
}


@dataclass(frozen=True)
class Strip(Family):
    """-tension u'' + drift u' = 1, u = 0 at both ends, on an interval or on a square with free sides.

    Attributes:
        shape: interval or rectangle.
        cells: Along x.
        tension: The same everywhere.
        flow: Of FLOWS.
        strength: Of the drift; negative: inwards.
        centre: Where it vanishes.
    """

    shape: str
    cells: int
    tension: float
    flow: str
    strength: float
    centre: float

    name = "drift along x"

    def scene(self) -> Scene:
        drift = FLOWS[self.flow][0].format(k=repr(self.strength), c=repr(self.centre))
        return Scene(mesh={"shape": self.shape, "cells": self.cells}, tension=self.tension, load=1,
                     boundary=[{"on": ["left", "right"], "value": 0}],
                     drift=[drift] if self.shape == "interval" else [drift, 0])  # fmt: skip

    def truth(self) -> tuple[np.ndarray, np.ndarray]:
        """Places and values of u, by Green's function, whose factors are all positive."""
        x = np.linspace(0, 1, POINTS)
        phi = FLOWS[self.flow][1](x, self.strength, self.centre) / self.tension
        scale, speed = np.exp(phi - phi.max()), np.exp(phi.min() - phi)

        def summed(f: np.ndarray) -> np.ndarray:
            return np.concatenate([[0.0], np.cumsum((f[1:] + f[:-1]) / 2)]) / (POINTS - 1)

        from_left, from_right = summed(scale), summed(scale[::-1])[::-1]
        inner = from_right * summed(from_left * speed) + from_left * summed((from_right * speed)[::-1])[::-1]
        with np.errstate(over="ignore"):
            return x, inner / from_left[-1] / self.tension * np.exp(phi.max() - phi.min())

    def judge(self, judgement: Judgement) -> None:
        x, true = self.truth()
        most = float(true.max())
        phi = FLOWS[self.flow][1](x, self.strength, self.centre) / self.tension
        peclet = float(np.abs(np.gradient(phi, x)).max()) / self.cells / 2
        # the drift's potential is off by Peclet^2/3 of itself at most
        factor = np.exp(2 * float(np.ptp(phi)) * peclet**2 / 3 + 0.1)
        margin = 1e-9 if self.shape == "interval" else 0.01
        _compare(self, judgement, most * 8 * self.tension, peclet, (most, most), factor, margin)


@st.composite
def strips(draw: st.DrawFn) -> Strip:
    """Mostly outwards and strong."""
    shape = draw(st.sampled_from(["interval", "interval", "rectangle"]))
    cells = draw(st.integers(200, 1000) if shape == "interval" else st.integers(12, 32))
    tension = draw(power(-1, 2))
    sign = draw(st.sampled_from([1.0, 1.0, 1.0, -1.0]))
    most = 400.0 if shape == "interval" else 80.0
    strong = st.one_of(power(0, log(most, 10)), power(log(most / 4, 10), log(most, 10)))
    strength = round(sign * tension * draw(strong), 12)
    return Strip(shape, cells, tension, draw(st.sampled_from([*FLOWS, "from a point"])), strength,
                 draw(st.sampled_from([0.5, 0.5, 0.4, 0.31])))  # fmt: skip


@dataclass(frozen=True)
class Radial(Family):
    """Drift in the plane, proportional to the distance from a point, load 1, u = 0 on a circle or a square around it.

    Attributes:
        shape: disk or rectangle.
        cells: Across.
        tension: The same everywhere.
        strength: Drift over distance.
    """

    shape: str
    cells: int
    tension: float
    strength: float

    name = "drift from a point"

    def scene(self) -> Scene:
        k = repr(self.strength)
        centre = "0" if self.shape == "disk" else "0.5"
        mesh = {"shape": self.shape, "cells": self.cells}
        return Scene(mesh=mesh, tension=self.tension, load=1, drift=[f"{k}*(x - {centre})", f"{k}*(y - {centre})"])

    def middle(self, radius: float) -> float:
        """u in the middle of a disk."""
        phi = self.strength * radius**2 / (2 * self.tension)
        if phi > 700:
            return float("inf")
        if abs(phi) < 1e-6:
            return radius**2 / (4 * self.tension)
        return (float(expi(phi)) - log(abs(phi)) - float(np.euler_gamma)) / (2 * self.strength)

    def judge(self, judgement: Judgement) -> None:
        inner, outer = (1.0, 1.0) if self.shape == "disk" else (0.5, 0.5**0.5)
        least, most = self.middle(inner), self.middle(outer)  # a square is between two disks
        grown = most * 4 * self.tension / outer**2
        h = (2 if self.shape == "disk" else 1) / self.cells
        peclet = abs(self.strength) * outer * h / (2 * self.tension)
        # the polygon is smaller than the disk by h^2/8 of its radius or less, its sides' size being h
        phi = abs(self.strength) * outer**2 / (2 * self.tension)
        with np.errstate(over="ignore"):
            factor = np.exp(2 * phi * (RESOLVED**2 / 3 + h**2) + 0.1)
        _compare(self, judgement, grown, peclet, (least, most), factor, 0.01)


@st.composite
def radial(draw: st.DrawFn) -> Radial:
    """Outwards, mostly; in the worst case u is larger than any number."""
    tension = draw(power(-3, 1))
    sign = draw(st.sampled_from([1.0, 1.0, 1.0, -1.0]))
    return Radial(draw(st.sampled_from(["disk", "rectangle"])), 2 * draw(st.integers(6, 14)), tension,
                  round(sign * tension * draw(power(0, 4)), 12))  # fmt: skip


def _compare(
    one: Strip | Radial, judgement: Judgement, grown: float, peclet: float, true: tuple[float, float], factor: float,
    margin: float,
) -> None:  # fmt: skip
    """Solve and judge (collective).

    Growth means a small eigenvalue, whose sign is another one on a mesh that does not resolve the flow.

    Args:
        one: The scene.
        judgement: Its judgement.
        grown: The largest u over that without drift.
        peclet: Of a cell.
        true: Between what the largest u is.
        factor: How far off it may be where the flow is resolved.
        margin: How far u may be below 0, in parts of the largest.
    """
    answer = judgement.solve(one.scene, ANSWER if grown < (PLAIN if peclet <= RESOLVED else MILD) else EITHER)
    if answer is None:
        return
    (low, high), (least, most) = Field(answer.u).ends(), true
    words = f"u from {low:.6g} to {high:.6g}; true: from 0 to a value between {least:.6g} and {most:.6g}"
    judgement.check(low >= -margin * max(abs(low), high), words)
    if peclet <= RESOLVED:
        judgement.check(least / factor <= high <= most * factor, f"{words}, within a factor of {factor:.3g}")

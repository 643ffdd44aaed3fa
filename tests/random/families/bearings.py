"""Closed forms with obstacles on sides of a rectangle: u is a formula, and touches along a part of a side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from hypothesis import assume
from hypothesis import strategies as st

from tests.random.families.manufactured import SIDES, Manufactured, expression, load_of
from tests.random.families.meshes import DIAGONALS
from tests.random.families.strategies import place
from tests.random.families.varying import SMOOTH, TENSIONS

BOXES = (((0.0, 1.0), (0.0, 1.0)), ((-1.0, 1.0), (-1.0, 1.0)), ((0.5, 1.5), (-0.4, 0.6)))
FOUNDATIONS = ("0", "0", "0", "3", "300")


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

    def weight(self, px: np.ndarray) -> np.ndarray:
        return px if self.axial else np.ones_like(px)

    def data(self) -> dict[str, Any]:
        load = load_of(expression(self.formula), expression(self.stiff), expression(self.bed), axial=self.axial)
        found: dict[str, Any] = {"tension": self.stiff, "load": str(sympy.expand(load))}
        if self.axial:
            found["axial_symmetry"] = True
        if self.bed != "0":
            found["foundation"] = self.bed
        return found

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
    mesh = {"shape": "rectangle", "cells": draw(st.integers(4, 14)), "x": list(box[0]), "y": list(box[1]),
            "diagonal": draw(st.sampled_from(DIAGONALS)), "perturb": draw(st.sampled_from([0, 0.1, 0.2]))}  # fmt: skip
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
    asked = draw(st.sampled_from([{"bound": True}] * 6 + [{"tol": 0.2, "budget": "500 unknowns"}]))
    asked = asked | draw(st.sampled_from([{}, {}, {"method": "vi"}, {"eps": 1e-10}, {"eps": "h"}, {"eps": "h^2"}]))
    made = Bearings(
        mesh, {"element": "P1", **asked}, 0, draw(st.sampled_from(SMOOTH)), draw(st.sampled_from(["1", *TENSIONS])),
        draw(st.sampled_from(FOUNDATIONS)), box[0][0] > 0 and draw(st.booleans()), tuple(found),
    )  # fmt: skip
    assume(made.short)
    return made

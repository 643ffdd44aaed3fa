"""Closed forms with obstacles on sides of a rectangle: u is a formula, and touches along a part of a side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from hypothesis import assume
from hypothesis import strategies as st
from mpi4py import MPI

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.closed import ClosedForm, Piecewise, everywhere, expression, x, y
from tests.random.families.elements import Field
from tests.random.families.integrals import energy_error
from tests.random.families.meshes import DIAGONALS
from tests.random.families.strategies import place
from tests.random.families.supported import SIDES
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
class Bearings(ClosedForm):
    """-div(tension grad u) + foundation u = load, with u between obstacles on sides.

    Attributes:
        formula: Of u.
        stiff: Of the tension.
        foundation: A number.
        axial: Whether there is axial symmetry.
        bearings: One for each side where u is not given.
    """

    formula: str
    stiff: str
    foundation: str
    axial: bool
    bearings: tuple[Bearing, ...]

    name = "bearings"

    def u(self) -> list[Piecewise]:
        return [everywhere(expression(self.formula))]

    def tension(self) -> Piecewise:
        return everywhere(expression(self.stiff))

    def data(self) -> dict[str, Any]:
        u, mu = expression(self.formula), expression(self.stiff)
        load = -sum(sympy.diff(mu * sympy.diff(u, s), s) for s in (x, y)) + expression(self.foundation) * u
        if self.axial:
            load -= mu * sympy.diff(u, x) / x
        found: dict[str, Any] = {"tension": self.stiff, "load": str(sympy.expand(load))}
        if self.axial:
            found["axial_symmetry"] = True
        if self.foundation != "0":
            found["foundation"] = self.foundation
        return found

    def boundary(self) -> list[dict[str, Any]]:
        """The parts of the boundary."""
        given = [side for side in SIDES if side not in {one.side for one in self.bearings}]
        parts: list[dict[str, Any]] = [{"on": given, "value": self.formula}]
        u, mu = expression(self.formula), expression(self.stiff)
        for one in self.bearings:
            normal, sign = SIDES[one.side], -1 if one.upper else 1
            along = f"abs({'y' if normal[0] else 'x'} - ({one.middle!r}))"
            flux = mu * sum(n * sympy.diff(u, s) for n, s in zip(normal, (x, y), strict=True))
            shape = f"where({along} < {one.width!r}, 1, 0)" if one.even else f"max(1 - ({along}/{one.width!r})^2, 0)"
            text = f"({flux}) - {sign * one.pressure!r}*{shape}"
            gap = f"{sign * one.steep!r}*max({along} - {one.width!r}, 0)^2"
            part: dict[str, Any] = {"on": one.side, "upper" if one.upper else "lower": f"({self.formula}) - {gap}"}
            if one.spring > 0:
                text, part["spring"] = f"{text} + {one.spring!r}*({self.formula})", one.spring
            parts.append({**part, "flux": text})
        return parts

    def scene(self, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
        """The scene (collective)."""
        return Scene(mesh=self.mesh, boundary=self.boundary(), **self.data())

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, with the energy of the foundation but not of springs; the norm of u (collective)."""
        slopes = [self.u()[0].map(lambda value, s=s: sympy.diff(value, s)) for s in (x, y)]
        nodes, weight = self.nodes(field), (lambda x: x) if self.axial else np.ones_like

        def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return slopes[0].at(x, y), slopes[1].at(x, y)

        error, norm = energy_error(field, nodes, lambda x, y: weight(x) * self.tension().at(x, y), gradient)
        px, py = nodes.points.T
        off = field.at(nodes.cells, nodes.points[:, None])[:, 0] - self.u()[0].at(px, py)
        more = float(self.foundation) * field.comm.allreduce(float(nodes.weights @ (weight(px) * off**2)))
        return float(np.hypot(error, np.sqrt(more))), norm


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

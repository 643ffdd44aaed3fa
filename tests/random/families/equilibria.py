"""Membranes supported by an obstacle only, by weak springs, or not at all: balance of forces gives the solution."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from hypothesis import strategies as st
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.elements import Field
from tests.random.families.family import ANSWER, EITHER, REJECTION, Family, Judgement
from tests.random.families.strategies import power

SHAPES = (
    {"shape": "interval", "cells": 40}, {"shape": "rectangle", "cells": 9}, {"shape": "rectangle", "cells": 12},
    {"shape": "disk", "cells": 10}, {"shape": "l-shape", "cells": 8},
    {"shape": "rectangle", "cells": 8, "cell": "quadrilateral"}, {"shape": "box", "cells": 4},
)  # fmt: skip
BUMPS = ("0", "-x^2", "-(x - 0.3)^2", "0.2*sin(5*x)", "-abs(x - 0.4)", "where(x < 0.4, 0, -1)", "x")
OF_ROUND_OFF = 1e-6  # of forces
FEEBLE = 1e-5  # of the tension: below it round-off may decide
AT_THE_LIMIT = 5e-3  # errors of u that docs/stability.md allows where round-off nearly decides


@dataclass(frozen=True)
class Unheld(Family):
    """u is given nowhere: a load on an obstacle, and springs or foundations of next to no stiffness.

    Attributes:
        mesh: The table [mesh].
        options: Of `solve`.
        tension: The same everywhere.
        load: Its size; it points downwards on a lower obstacle.
        bump: Shape of the obstacle.
        height: Its size.
        upper: Whether all is upside down.
        pulls: Whether the load points the other way.
        feeble: Stiffness of a foundation or a spring, as an effect's key and value; empty for none.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    tension: float
    load: float
    bump: str
    height: float
    upper: bool
    pulls: bool
    feeble: dict[str, float]

    name = "obstacle alone"

    def scene(self) -> Scene:
        load = self.load if self.upper != self.pulls else -self.load
        g: dict[str, Any] = {
            "upper" if self.upper else "lower": f"{-self.height if self.upper else self.height!r}*({self.bump})"
        }
        spring = {key: value for key, value in self.feeble.items() if key == "spring"}
        effects: dict[str, Any] = {key: value for key, value in self.feeble.items() if key != "spring"}
        return Scene(mesh=self.mesh, tension=self.tension, load=load, boundary=[spring] if spring else [],
                     **g, **effects)  # fmt: skip

    def judge(self, judgement: Judgement) -> None:
        if self.pulls:
            answer = judgement.solve(self.scene, EITHER if self.feeble else REJECTION, **self.options)
            if answer is not None and "foundation" in self.feeble:
                true = (-1 if self.upper else 1) * self.load / self.feeble["foundation"]
                margin = AT_THE_LIMIT if self.feeble["foundation"] < FEEBLE * self.tension else 1e-4
                judgement.near(answer, true, true, margin * abs(true))
            return
        answer = judgement.solve(self.scene, ANSWER, **self.options)
        if answer is None:
            return
        force = answer.record["contact"]["upper" if self.upper else "lower"]["force"]
        domain = answer.u.function_space.mesh
        one = fem.Constant(domain, PETSc.ScalarType(1.0))
        area = domain.comm.allreduce(fem.assemble_scalar(releases.form(one * ufl.dx(domain))))
        # u is no higher than the obstacle at its highest, and hardly below it: so much a foundation bears at most
        borne = sum(self.feeble.values()) * 2 * self.height * 4
        wanted = self.load * area
        judgement.check(abs(abs(force) - wanted) <= OF_ROUND_OFF * wanted + borne,
                        f"contact force {force:.6g}, load {wanted:.6g}")  # fmt: skip
        low, high = Field(answer.u).ends()
        limit = 10 * (self.height + self.load / self.tension)
        judgement.check(
            max(abs(low), abs(high)) <= limit, f"u from {low:.3g} to {high:.3g}, data up to {limit / 10:.3g}"
        )


@st.composite
def unheld(draw: st.DrawFn) -> Unheld:
    """Loads that press, mostly."""
    mesh = dict(draw(st.sampled_from(SHAPES)))
    options: dict[str, Any] = {"method": draw(st.sampled_from(["penalty", "penalty", "vi", "successive"]))}
    if mesh["shape"] == "rectangle" and "cell" not in mesh and draw(st.booleans()):
        options["element"] = "P2"
    tension, load, height = draw(power(-3, 3)), draw(power(-3, 3)), draw(power(-3, 2))
    if options["method"] != "vi" and draw(st.booleans()):
        options["eps"] = draw(st.sampled_from([1e-2, 1e-4, 1e-6])) / tension
    feeble: dict[str, float] = {}
    if draw(st.booleans()):
        feeble[draw(st.sampled_from(["foundation", "spring"]))] = draw(power(-18, -9)) * load / height
    return Unheld(mesh, options, tension, load, draw(st.sampled_from(BUMPS)), height, draw(st.booleans()),
                  draw(st.integers(0, 3)) == 0, feeble)  # fmt: skip


@dataclass(frozen=True)
class Feeble(Family):
    """A load that springs or a foundation bear, stiff or not, or zero: u is known in closed form.

    Attributes:
        cells: Of the unit square or the unit interval.
        shape: One of these.
        kind: foundation, springs (on the left and the right), strip (a foundation for x < width), or zero ones.
        stiffness: Of what bears the load.
        tension: The same everywhere.
        load: The same everywhere.
        width: Of the strip.
    """

    cells: int
    shape: str
    kind: str
    stiffness: float
    tension: float
    load: float
    width: float

    name = "feeble support"

    def scene(self) -> Scene:
        k, strip = self.stiffness, f"where(x < {self.width!r}, {self.stiffness!r}, 0)"
        kinds: dict[str, dict[str, Any]] = {
            "foundation": {"boundary": [], "foundation": k},
            "springs": {"boundary": [{"on": ["left", "right"], "spring": k}]},
            "strip": {"boundary": [], "foundation": strip},
            "zero spring": {"boundary": [{"spring": 0}]},
            "zero foundation": {"boundary": [], "foundation": 0},
            "zero formula": {"boundary": [], "foundation": f"where(x < -{self.width!r}, {k!r}, 0)"},
        }
        given = kinds[self.kind]
        return Scene(mesh={"shape": self.shape, "cells": self.cells}, tension=self.tension, load=self.load, **given)

    def judge(self, judgement: Judgement) -> None:
        if self.kind.startswith("zero"):
            judgement.solve(self.scene, REJECTION)
            return
        answer = judgement.solve(self.scene, ANSWER if self.must_be_solved() else EITHER)
        if answer is None:
            return
        least, most, margin = self.truth()
        if self.kind != "strip":
            judgement.near(answer, least, most, margin * max(abs(least), abs(most)))
            return
        high = Field(answer.u).ends()[1]
        most_borne = 1 + 4 / (self.cells * self.width)  # a mesh may not see its width: whole cells may bear
        right = 1 / most_borne / 1.5 <= high / most <= 1.5 * most_borne
        judgement.check(right, f"largest u {high:.6g}; true: {most:.6g}")

    def must_be_solved(self) -> bool:
        """Whether round-off is far from deciding."""
        return self.kind != "strip" and self.stiffness >= FEEBLE * self.tension

    def truth(self) -> tuple[float, float, float]:
        """Least and largest value of u, and how far from them the discrete one may be, relative."""
        k, f, mu, c = self.stiffness, self.load, self.tension, self.width
        if self.kind == "foundation":
            return f / k, f / k, 1e-4 if self.must_be_solved() else AT_THE_LIMIT
        if self.kind == "springs":
            low, high = sorted((f / (2 * k), f / (2 * k) + f / (8 * mu)))
            return low, high, 0.02
        root = sqrt(k / mu)
        at_width = f / k + f * (1 - c) / (mu * root * np.tanh(root * c))
        ends = (f / k + f * (1 - c) / (mu * root * np.sinh(root * c)), at_width + f * (1 - c) ** 2 / (2 * mu))
        return min(ends), max(ends), 0.0


@st.composite
def feebles(draw: st.DrawFn) -> Feeble:
    """Stiffness over 20 decades."""
    kinds = ["foundation", "springs", "strip", "zero spring", "zero foundation", "zero formula"]
    tension = draw(power(-2, 2))
    return Feeble(draw(st.integers(6, 20)), draw(st.sampled_from(["interval", "rectangle"])),
                  draw(st.sampled_from(kinds)), draw(power(-18, 2)) * tension, tension, draw(power(-2, 2)),
                  draw(power(-3.5, -0.5)))  # fmt: skip


@dataclass(frozen=True)
class Soft(Family):
    """A soft obstacle alone, pressed by the load: it is penetrated by load over stiffness. No solution exists if the
    load pulls away.

    Attributes:
        mesh: The table [mesh].
        height: Of the obstacle, the same everywhere.
        stiffness: Of the obstacle.
        load: Its size.
        upper: Whether all is upside down.
        pulls: Whether the load points the other way.
    """

    mesh: dict[str, Any]
    height: float
    stiffness: float
    load: float
    upper: bool
    pulls: bool

    name = "soft obstacle alone"

    def scene(self) -> Scene:
        sign = 1 if self.upper != self.pulls else -1
        soft = {"upper" if self.upper else "lower": self.height, "stiffness": self.stiffness}
        return Scene(mesh=self.mesh, tension=1, load=sign * self.load, boundary=[], soft_obstacle=soft)

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(self.scene, REJECTION if self.pulls else ANSWER)
        if answer is None:
            return
        true = self.height + (1 if self.upper else -1) * self.load / self.stiffness
        judgement.near(answer, true, true, 1e-5 * (abs(self.height) + self.load / self.stiffness))


@st.composite
def softs(draw: st.DrawFn) -> Soft:
    """Soft obstacles with small and with large penetration."""
    return Soft(dict(draw(st.sampled_from(SHAPES))), draw(st.sampled_from([0.0, -0.3, 2.0])), draw(power(-2, 5)),
                draw(power(-2, 2)), draw(st.booleans()), draw(st.integers(0, 3)) == 0)  # fmt: skip

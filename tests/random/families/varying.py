"""Smooth u and tensions: the load of a given u is a formula. Results of polynomials are saved and read back, too."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from fenicsx_obstacle.answers.answer import Answer
from tests.random.families.elements import Field
from tests.random.families.family import EITHER, Judgement
from tests.random.families.manufactured import Manufactured, Piecewise, everywhere, expression
from tests.random.families.meshes import meshes
from tests.random.families.strategies import bounds, grids, power

POLYNOMIALS = ("x**2 - x*y", "x**3*y - y**2", "x*(1 - x)*y", "x + 2*y", "x**4 - y**3")
SMOOTH = (*POLYNOMIALS, "exp(x)*sin(2*y)", "sin(3*x + y)", "log(3 + x + y)", "sqrt(2 + x*y)", "exp(-2*(x**2 + y**2))",
          "x/(2 + y)", "cos(4*x)*exp(y)", "atan(x + 2*y)")  # fmt: skip
TENSIONS = ("1 + x**2", "exp(x - y)", "exp(2*x*y)", "2 + sin(5*x)*cos(3*y)", "1/(1 + x**2 + y**2)", "sqrt(2 + x)",
            "1.8 + atan(4*x)", "cosh(2*x) + y**2", "(1.5 + y)**3")  # fmt: skip
POSITIVE = ("1.0", "3.7", "1.0 + 2.0*y", "1.0 + 4.0*x", "0.3 + 2.0*y**2 + x + 5.0*x*y")  # on the unit square
DEGREE = 3
ELEMENTS = ("P1", "P2", "Q1", "Q2")


@dataclass(frozen=True)
class Varying(Manufactured):
    """u and the tension are smooth formulas, and the load is -div(tension grad u).

    Attributes:
        formula: Of u.
        stiff: Formula of the tension.
        scale: Of the tension.
    """

    formula: str
    stiff: str
    scale: float

    name = "smooth tension"

    def tension(self) -> Piecewise:
        return everywhere(self.scale * expression(self.stiff))


def varying() -> st.SearchStrategy[Varying]:
    """Polynomials, mostly."""
    formula = st.one_of(st.sampled_from(POLYNOMIALS), st.sampled_from(SMOOTH))
    return st.builds(Varying, meshes(), bounds(seldom=True), st.just(0), formula, st.sampled_from(TENSIONS),
                     power(-3, 3))  # fmt: skip


@dataclass(frozen=True)
class Polynomial(Varying):
    """u and the tension are polynomials, and so are load and boundary values.

    Attributes:
        saved: Whether the result is saved and read back.
    """

    saved: bool

    name = "polynomial"

    def more(self, judgement: Judgement, answer: Answer) -> None:
        """A saved result must be the one that was computed: a rejection is no answer, another element a wrong one."""
        if not self.saved:
            return
        comm = judgement.comm
        with tempfile.TemporaryDirectory(prefix="obstacle-") as own:
            folder = comm.bcast(own)
            answer.save(folder)
            read = judgement.attempt(lambda: Answer.read(folder), EITHER, "read")
            comm.Barrier()
        if read is None:
            return
        error, again = (self.error(Field(one.u))[0] for one in (answer, read))
        judgement.check(abs(again - error) <= 1e-8 * error + 1e-10,
                        f"saved with energy error {error:.6g}, read back with {again:.6g}")  # fmt: skip
        points = np.random.default_rng(1).uniform(0.01, 0.99, (20, 2))
        differ = float(np.abs(np.asarray(answer.at(points)) - np.asarray(read.at(points))).max())
        judgement.check(differ <= 1e-9 * max(1.0, float(np.abs(answer.u.x.array).max(initial=0.0))),
                        f"values of the result read back differ by {differ:.3g}")  # fmt: skip


@st.composite
def polynomials(draw: st.DrawFn) -> Polynomial:
    """Degree 3 at most."""
    size = range(DEGREE + 1)
    u = {(i, j): draw(st.integers(-3, 3)) / 2 for i in size for j in size if i + j <= DEGREE}
    u[1, 0] += 0.25  # not constant, whatever is drawn
    formula = " + ".join(f"({a!r})*x**{i}*y**{j}" for (i, j), a in u.items())
    saved = draw(st.booleans())
    mesh, options = draw(grids(3, 12)), draw(bounds())
    element = draw(st.sampled_from(ELEMENTS))
    if saved:
        options = {"element": element, **({"bound": True} if element[0] == "P" else {})}
        if element[0] == "Q":
            mesh = {"shape": "rectangle", "cells": mesh["cells"], "cell": "quadrilateral"}
    return Polynomial(mesh, options, 0, formula, draw(st.sampled_from(POSITIVE)), 1.0, saved)

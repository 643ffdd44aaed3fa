"""Polynomials: a certificate may be claimed, and must hold; results are saved and read back."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.polynomial import polynomial

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.elements import Field
from tests.random.families.family import EITHER, Family, Judgement, toml
from tests.random.families.integrals import Pieces, energy_error
from tests.random.families.strategies import bounds, grids

SIZE = 4  # of coefficients: degree 3 at most
Coefficients = tuple[tuple[float, ...], ...]
COARSE = ("P1", "P2", "Q1", "Q2")


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Coefficients of a product."""
    found = np.zeros((a.shape[0] + b.shape[0] - 1, a.shape[1] + b.shape[1] - 1))
    for i, j in product(range(a.shape[0]), range(a.shape[1])):
        found[i : i + b.shape[0], j : j + b.shape[1]] += a[i, j] * b
    return found


def written(c: np.ndarray) -> str:
    """As a formula."""
    numbers = c.tolist()  # floats of Python: NumPy 2 writes those of an array as np.float64(1.0)
    terms = [f"({a!r})*x^{i}*y^{j}" for i, row in enumerate(numbers) for j, a in enumerate(row) if a != 0]
    return " + ".join(terms).replace("*x^0", "").replace("*y^0", "") or "0"


@dataclass(frozen=True)
class Polynomial(Family):
    """u and the tension are polynomials, and so are load and boundary values.

    Attributes:
        mesh: The table [mesh].
        options: Of `solve`.
        u: Coefficients.
        tension: Coefficients; positive on the unit square.
        saved: Whether the result is saved and read back.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    u: Coefficients
    tension: Coefficients
    saved: bool

    name = "polynomial"

    def scene(self) -> Scene:
        u, mu = np.array(self.u), np.array(self.tension)
        load = np.zeros((2 * SIZE, 2 * SIZE))
        for axis in (0, 1):
            flux = polynomial.polyder(times(mu, polynomial.polyder(u, axis=axis)), axis=axis)
            load[: flux.shape[0], : flux.shape[1]] -= flux
        return Scene(mesh=self.mesh, tension=written(mu), load=written(load), boundary=[{"value": written(u)}])

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(self.scene, **self.options)
        if answer is None:
            return
        error, norm = self.error(Field(answer.u))
        if answer.bound is not None:
            judgement.certificate(answer, error, norm)
        if self.saved:
            self._read_back(judgement, answer, error)

    def _read_back(self, judgement: Judgement, answer: Answer, error: float) -> None:
        """A saved result must be the one that was computed: a rejection is no answer, another element a wrong one."""
        comm = judgement.comm
        with tempfile.TemporaryDirectory(prefix="obstacle-") as own:
            folder = comm.bcast(own)
            answer.save(folder)
            read = judgement.attempt(lambda: Answer.read(folder), EITHER, "read")
            comm.Barrier()
        if read is None:
            return
        again = self.error(Field(read.u))[0]
        judgement.check(abs(again - error) <= 1e-8 * error + 1e-10,
                        f"saved with energy error {error:.6g}, read back with {again:.6g}")  # fmt: skip
        points = np.random.default_rng(1).uniform(0.01, 0.99, (20, 2))
        differ = float(np.abs(np.asarray(answer.at(points)) - np.asarray(read.at(points))).max())
        judgement.check(differ <= 1e-9 * max(1.0, float(np.abs(answer.u.x.array).max(initial=0.0))),
                        f"values of the result read back differ by {differ:.3g}")  # fmt: skip

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, and the norm of u (collective)."""
        u, mu = np.array(self.u), np.array(self.tension)
        slopes = [polynomial.polyder(u, axis=axis) for axis in (0, 1)]

        def tension(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return polynomial.polyval2d(x, y, mu)

        def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return polynomial.polyval2d(x, y, slopes[0]), polynomial.polyval2d(x, y, slopes[1])

        return energy_error(field, Pieces.of(field), tension, gradient, count=8)

    def text(self) -> str:
        saved = ["Answer.read of its saved result"] if self.saved else []
        return toml(self.scene(), f"solve(scene, {self.options})", *saved)


@st.composite
def polynomials(draw: st.DrawFn) -> Polynomial:
    """Degree 3 at most."""
    u = [[draw(st.integers(-3, 3)) / 2 if i + j < SIZE else 0.0 for j in range(SIZE)] for i in range(SIZE)]
    u[1][0] += 0.25  # not constant, whatever is drawn
    kinds = [((1.0,),), ((3.7,),), ((1.0, 2.0),), ((1.0,), (4.0,)), ((0.3, 0.0, 2.0), (1.0, 5.0, 0.0))]
    saved = draw(st.booleans())
    mesh, options = draw(grids(3, 12)), draw(bounds())
    element = draw(st.sampled_from(COARSE))
    if saved:
        options = {"element": element, **({"bound": True} if element[0] == "P" else {})}
        if element[0] == "Q":
            mesh = {"shape": "rectangle", "cells": mesh["cells"], "cell": "quadrilateral"}
    return Polynomial(mesh, options, tuple(map(tuple, u)), draw(st.sampled_from(kinds)), saved)

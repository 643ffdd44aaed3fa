"""Stability of the pairs: (3.18) and its Examples 2 and 3, (4.7), and the dual norm of Theorem 4.2."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle import garbage
from fenicsx_obstacle.forms.pairs import pairs
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.scene import Scene
from tests.theory.constants import Stability
from tests.theory.statement import Curve, Finding, Found, Panel, check, constant, rate, slope, statement

UNEVEN = 0.25  # how far vertices of perturbed meshes are moved, in parts of h
CELLS, FEWER = (4, 8, 16, 32), (4, 8, 16)


@dataclass(frozen=True)
class Case:
    """A pair on a family of meshes of the unit square.

    Attributes:
        words: Of its rows and curves.
        pair: Its name.
        mesh: Keys of [mesh].
        cells: Numbers of cells a side.
        alpha: Limit of alpha_h/h, from the symbols on the uniform infinite mesh.
        hat: Limit of hat alpha_h/h, from the symbols too.
        most: Largest I(q,q)/||q||_0^2, by (3.21); None where it is not known.
    """

    words: str
    pair: str
    mesh: dict[str, Any] = field(default_factory=dict)
    cells: Sequence[int] = FEWER
    alpha: float | None = None
    hat: float | None = None
    most: float | None = 4

    @property
    def h(self) -> list[float]:
        return [1 / n for n in self.cells]

    @property
    def uneven(self) -> bool:
        return "perturb" in self.mesh

    def values(self, comm: MPI.Comm, of: Callable[[Stability], Any]) -> list[Any]:
        """A constant on each mesh (collective)."""
        found = []
        for n in self.cells:
            scene = Scene(mesh={"shape": "rectangle", "cells": n, **self.mesh}, tension=1)
            found.append(of(Stability(meshes.build(scene, comm).mesh, pairs()[self.pair])))
            garbage.free([comm])
        return found


CROSSED, QUADS = {"diagonal": "crossed"}, {"cell": "quadrilateral"}
CASES = (
    Case("P1, right diagonals", "P1", cells=CELLS, alpha=1 / math.sqrt(3), hat=1 / math.sqrt(12 + 8 * math.sqrt(3))),
    Case("P1, criss-cross", "P1", CROSSED, alpha=1 / math.sqrt(6), hat=1 / math.sqrt(72)),
    Case("P1, perturbed", "P1", {"perturb": UNEVEN}, cells=CELLS),
    Case("Q1, squares", "Q1", QUADS, cells=CELLS, alpha=math.sqrt(2 / 3), hat=1 / math.sqrt(24), most=9),
    Case("Q1, perturbed", "Q1", {**QUADS, "perturb": UNEVEN}, cells=CELLS, most=9),
    Case("Q2, squares", "Q2", QUADS, alpha=1 / math.sqrt(24), hat=1 / math.sqrt(120), most=6.25),
    Case("Q2, perturbed", "Q2", {**QUADS, "perturb": UNEVEN}, most=6.25),
    Case("P2, right diagonals", "P2", alpha=1 / math.sqrt(24), most=1),
    Case("P1-voronoi, criss-cross", "P1-voronoi", CROSSED, alpha=math.sqrt(3) / 4, most=None),
)
GAUSS = Case("Q1-gauss, squares", "Q1-gauss", QUADS, cells=CELLS)


@statement("3.18", "I is stable on V_h x Q_h with alpha_h ~ h, for pressures that vanish on the boundary",
           "3.19", "Example 2", "3.21", "3.28")  # fmt: skip
def inf_sup(comm: MPI.Comm) -> Found:
    """alpha_h of (3.18) for every pair, its order, and the equivalence of I and the L2 norm that it rests on."""
    where, rows, alphas, betas = "(3.18), Ex. 2, 3", [], [], []
    literal = max(float(least) for least in CASES[0].values(comm, lambda one: one.spectrum()[0]))
    rows.append(check("(3.18)", "alpha_h over all of Q_h, boundary nodes included, P1", "> 0", literal,
                      literal < 1e-14, "needs hypothesis"))  # fmt: skip
    for case in CASES:
        found = case.values(comm, lambda one: (one.alpha(), one.equivalence(), one.beta()))
        alpha, h, ends = [value[0] for value in found], case.h, found[-1][1]
        alphas.append(Curve(case.words, h, alpha, 1.0 if case is CASES[0] else None))
        betas.append(Curve(case.words, h, [value[2] for value in found]))
        if case.alpha is not None:
            rows.append(constant(where, f"alpha_h/h, {case.words}", "h/C", case.alpha, alpha[-1] / h[-1]))
        rows.append(rate(where, f"alpha_h, {case.words}", 1.0, 1.0, h, alpha))
        rows += _equivalence(case, ends)
    return Found(rows, [
        Panel("inf-sup constant, ||q||_0", "h", "alpha_h", alphas),
        Panel("inf-sup constant, ||q||_1*", "h", "beta_h", betas, ("log", "linear")),
    ])  # fmt: skip


def _equivalence(case: Case, ends: tuple[float, float]) -> list[Finding]:
    rows = []
    if ends[0] >= 1 - 1e-9:
        rows.append(constant("(3.28)", f"least I(q,q)/||q||_0^2, {case.words}", ">= 1", 1, ends[0]))
    else:
        rows.append(check("(3.28), (3.33)", f"least I(q,q)/||q||_0^2, {case.words}", ">= 1", ends[0], ends[0] < 1,
                          "needs hypothesis"))  # fmt: skip
    if case.most is None:
        return rows
    return [
        *rows,
        constant("(3.21)", f"largest I(q,q)/||q||_0^2, {case.words}", f"<= {case.most:g}", case.most, ends[1]),
    ]


@statement("4.7", "The L2 product is stable on V_h x Q_h with hat alpha_h ~ h, the constant of the inverse inequality",
           "4.7*")  # fmt: skip
def inverse(comm: MPI.Comm) -> Found:
    """hat alpha_h of (4.7), and how much of alpha_h the argument through it gives away."""
    rows, curves = [], []
    for case in CASES:
        found = case.values(comm, lambda one: (one.alpha_hat(), one.alpha()))
        hat, h = [value[0] for value in found], case.h
        curves.append(Curve(case.words, h, hat, 1.0 if case is CASES[0] else None))
        if case.hat is not None:
            rows.append(constant("(4.7)", f"hat alpha_h/h, {case.words}", "h/C", case.hat, hat[-1] / h[-1]))
        rows.append(rate("(4.7)", f"hat alpha_h, {case.words}", 1.0, 1.0, h, hat))
        margin = found[-1][1] / hat[-1]
        rows.append(check("(3.18), (4.7)", f"alpha_h/hat alpha_h, {case.words}", ">= 1", margin, margin >= 1,
                          "not sharp"))  # fmt: skip
    return Found(rows, [Panel("inf-sup constant of the L2 product", "h", "hat alpha_h", curves)])


@statement("1*", "In the dual norm pairs whose rule is exact on V_h are stable uniformly in h",
           "dual", "4.2*")  # fmt: skip
def dual(comm: MPI.Comm) -> Found:
    """beta_h with ||q||_1* over V_h and over H^1_0, and how far I(1, v) is from the integral of v."""
    rows, curves = [], []
    for case in CASES:
        found = case.values(comm, lambda one: (one.beta(), one.beta(rich=True), one.consistency()))
        h, rich, gap = case.h, [value[1] for value in found], found[-1][2]
        exact = gap < 1e-10
        for which, values in (("V_h", [value[0] for value in found]), ("H^1_0", rich)):
            if exact:
                rows.append(check("Thm 4.2, (5.8)", f"beta_h, ||q||_1* over {which}, {case.words}", "> 0", values[-1],
                                  values[-1] > 0.85, "not sharp"))  # fmt: skip
        if exact and not case.uneven:
            rows.append(rate("Thm 4.2, (5.8)", f"beta_h over H^1_0, {case.words}", 0.0, 0.0, h, rich))
        elif not exact:
            falls = slope(h[-2:], rich[-2:])
            rows.append(check("Thm 4.2, (5.8)", f"order of beta_h, |I(1,v) - (1,v)| > 0, {case.words}", "0", falls,
                              falls > 0.1, "needs hypothesis"))  # fmt: skip
        curves.append(Curve(case.words, h, rich))
    return Found(rows, [Panel("inf-sup constant, ||q||_1* over H^1_0", "h", "beta_h", curves, ("log", "linear"))])


@statement("Example 3", "One-point Gauss for Q1: the kernel of I has dimension 2n - 1 and contains the checkerboard",
           "gauss", "3.35")  # fmt: skip
def one_point(comm: MPI.Comm) -> Found:
    """The kernel of I(q, .) on n x n squares, and alpha_h on its complement."""
    found = GAUSS.values(comm, Stability.kernel)
    rows = [
        constant("Example 3", f"dimension of the kernel, {n} x {n} squares", "may be > 0", 2 * n - 1, dim, "holds")
        for n, (dim, _) in zip(GAUSS.cells, found, strict=True)
    ]
    left = [value for _, value in found]
    rows.append(check("(3.18), Ex. 3", "alpha_h, 4 x 4 squares", "need not be > 0", 0.0, found[0][0] > 0, "holds"))
    rows.append(rate("(3.18), Ex. 3", "smallest singular value that is not 0", 3.0, 3.0, GAUSS.h, left))
    return Found(rows, [Panel("one-point Gauss, without its kernel", "h", "smallest singular value > 0",
                              [Curve(GAUSS.words, GAUSS.h, left, 3.0)])])  # fmt: skip

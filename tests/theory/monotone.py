"""(2.8)-(2.13): which penalty operators are monotone. The one by the duality map of H1 is not; the one in L2 is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.forms.rules import nodal_rule
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.scene import Scene
from tests.theory.statement import Curve, Finding, Found, Panel, check, constant, statement

PAIRS, WAVES = 4, 6  # random pairs of functions, and sines of which each is made
Shape = Callable[[np.ndarray], np.ndarray]


def hat(x: np.ndarray) -> np.ndarray:
    """Of height 0.05, from 0.4 to 0.6."""
    return 0.05 * np.maximum(1 - np.abs(x - 0.5) / 0.1, 0.0)


def ramp(x: np.ndarray) -> np.ndarray:
    """Up to 1 within 0.2 of each end."""
    return np.minimum(np.minimum(x, 1 - x) / 0.2, 1.0)


@statement("2.10", "Which penalty operators are monotone",
           "2.8", "2.9", "2.11", "2.12", "2.13")  # fmt: skip
def penalties(comm: MPI.Comm) -> Found:
    """beta(u) - beta(v) on u - v for three penalty operators, with g = 0 on (0, 1) (collective)."""
    line = Line(comm)
    u = line.function(hat)
    v = line.function(lambda x: 10 * hat(x) - ramp(x))
    above = line.combined(1, u, -1, line.projected(u))
    pairs = line.random_pairs()
    panels = [
        line.panel("J((u - g)^+) is not monotone on this pair", {"u": u, "v = 10 u - ramp": v}),
        line.panel("what is beyond K", {"u^+": u, "u - P_K u": above}),
    ]
    return Found([*_duality(line, u, v), *_projection(line, u, above, pairs), *_nodal(line, [(u, v), *pairs])], panels)


class Line:
    """P1 functions on (0, 1) that vanish at its ends, with the products of H1 and of I (all methods collective)."""

    def __init__(self, comm: MPI.Comm):
        scene = Scene(mesh={"shape": "interval", "cells": 200}, tension=1, boundary=[{"value": 0}])
        self.level: Level = meshes.build(scene, comm)
        self.V, self.comm = self.level.V, comm
        self._first, self._second = fem.Function(self.V), fem.Function(self.V)
        rule = nodal_rule(releases.cell_name(self.level.mesh))
        self._products = {
            "H1": releases.form(h1(self._first, self._second)),
            "I": releases.form(self._first * self._second * rule.on(ufl.Measure("dx", domain=self.level.mesh))),
        }
        self.ends = np.flatnonzero(np.isin(self.level.points[0], (0.0, 1.0))).astype(np.int32)

    def function(self, shape: Shape) -> fem.Function:
        """The nodal interpolant."""
        made = fem.Function(self.V)
        made.x.array[:] = shape(self.level.points[0])
        return made

    def combined(self, a: float, u: fem.Function, b: float, v: fem.Function) -> fem.Function:
        """a u + b v."""
        made = fem.Function(self.V)
        made.x.array[:] = a * u.x.array + b * v.x.array
        return made

    def positive(self, u: fem.Function) -> fem.Function:
        """u^+ at the nodes."""
        made = fem.Function(self.V)
        made.x.array[:] = np.maximum(u.x.array, 0.0)
        return made

    def product(self, name: str, u: fem.Function, v: fem.Function) -> float:
        """Of H1, ((u, v)) + ((u', v')), or I(u, v)."""
        self._first.x.array[:], self._second.x.array[:] = u.x.array, v.x.array
        return total(self.comm, fem.assemble_scalar(self._products[name]))

    def projected(self, u: fem.Function) -> fem.Function:
        """P_K u, K = {v <= 0}: the nearest of K in H1, a variational inequality."""
        nearest, v = fem.Function(self.V), ufl.TestFunction(self.V)
        bc = fem.dirichletbc(fem.Function(self.V), self.ends)
        gap = nearest - u
        problem = ObstacleProblem(h1(gap, v), nearest, bcs=bc, upper=0.0, energy=0.5 * h1(gap, gap))
        problem.solve(method="vi")
        return nearest

    def panel(self, title: str, functions: dict[str, fem.Function]) -> Panel:
        """Drawn at every tenth node: those where the slopes change are among them."""
        own = self.level.owned
        columns = [self.level.points[0, :own], *(f.x.array[:own] for f in functions.values())]
        rows = np.concatenate(self.comm.allgather(np.column_stack(columns)))
        x, *u_values = rows[np.argsort(rows[:, 0])][::10].T
        curves = [Curve(name, x, y) for name, y in zip(functions, u_values, strict=True)]
        return Panel(title, "x", "height, g = 0", curves, ("linear", "linear"))

    def random_pairs(self) -> list[tuple[fem.Function, fem.Function]]:
        """The same on any number of ranks: sums of sines."""
        random = np.random.default_rng(1981)
        return [(self._random(random), self._random(random)) for _ in range(PAIRS)]

    def _random(self, random: np.random.Generator) -> fem.Function:
        sizes = random.standard_normal(WAVES)
        return self.function(lambda x: sum(size * np.sin(k * np.pi * x) / k for k, size in enumerate(sizes, start=1)))


def h1(u: ufl.core.expr.Expr, v: ufl.core.expr.Expr) -> ufl.Form:
    """The product of H1."""
    return (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx


def _duality(line: Line, u: fem.Function, v: fem.Function) -> list[Finding]:
    """J((u - g)^+) of (2.10), J the duality map: <J w, z> is the product of w and z in H1."""
    change = line.combined(1, line.positive(u), -1, line.positive(v))
    value = line.product("H1", change, line.combined(1, u, -1, v))
    # v < 0, so that it is (u, u - v) = (u, ramp) - 9 (u, u), and the ramp is 1 where u is not 0
    by_hand = 0.05 * 0.1 - 9 * (0.05**2 / 0.1 * 2 + 0.05**2 * 0.2 / 3)
    test = ufl.TestFunction(line.V)
    pressure = fem.petsc.assemble_vector(releases.form(-h1(line.positive(u), test)))
    pressure.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    highest = largest(line.comm, pressure.array_r)
    pressure.destroy()
    return [
        constant("(2.10)", "<J u^+ - J v^+, u - v>, a hat u and v = 10 u - ramp", "monotone: >= 0", by_hand, value,
                 "needs hypothesis"),
        check("(2.13)", "largest nodal value of -J u^+, a hat u", "<= 0, p_eps in N", highest, highest > 0.1,
              "needs hypothesis"),
    ]  # fmt: skip


def _projection(
    line: Line, u: fem.Function, above: fem.Function, pairs: list[tuple[fem.Function, fem.Function]]
) -> list[Finding]:
    """J(I - P_K) of (2.8): monotone, and Lipschitz with constant 1; and how far P_K is from the smaller of u and g."""
    apart = line.combined(1, above, -1, line.positive(u))
    size = np.sqrt(line.product("H1", apart, apart) / line.product("H1", u, u))
    least = min(_ratio(line, "H1", one, lambda z: line.combined(1, z, -1, line.projected(z))) for one in pairs)
    return [
        check("(2.10)", "|(u - P_K u) - u^+| / |u| in H1, a hat u", "the same operator", size, size > 0.1,
              "needs hypothesis"),
        check("(2.8)", f"least <beta u - beta v, u - v> / |beta u - beta v|^2, {PAIRS} pairs", "monotone: >= 0", least,
              least >= 1 - 1e-6),
    ]  # fmt: skip


def _nodal(line: Line, pairs: list[tuple[fem.Function, fem.Function]]) -> list[Finding]:
    """I((u - g)^+, .) of (3.2)-(3.4), the penalty that this package has."""
    least = min(_ratio(line, "I", pair, line.positive) for pair in pairs)
    most = 0.0
    for u, v in pairs:
        change, apart = line.combined(1, line.positive(u), -1, line.positive(v)), line.combined(1, u, -1, v)
        most = max(most, np.sqrt(line.product("I", change, change) / line.product("I", apart, apart)))
    return [
        check("(3.2), (3.3)", "least I(u^+ - v^+, u - v) / I(u^+ - v^+, u^+ - v^+)", "monotone: >= 0", least,
              least >= 1 - 1e-12),
        check("(3.2), (3.3)", "largest |u^+ - v^+| / |u - v| in the norm of I", "Lipschitz", most, most <= 1),
    ]  # fmt: skip


def _ratio(
    line: Line, name: str, pair: tuple[fem.Function, fem.Function], part: Callable[[fem.Function], fem.Function]
) -> float:
    """(part(u) - part(v), u - v) over the square of part(u) - part(v)."""
    u, v = pair
    change = line.combined(1, part(u), -1, part(v))
    return line.product(name, change, line.combined(1, u, -1, v)) / line.product(name, change, change)

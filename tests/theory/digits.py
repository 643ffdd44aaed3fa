"""Accuracy of the contact pressure (3.7)-(3.8) at small eps, computed from u and from u - g."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.linear_solvers import DIRECT, defaults
from fenicsx_obstacle.algebra.newton import penalty_pressure, solve_penalty
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.scenes import catalogue
from tests.theory.statement import Curve, Found, Panel, check, constant, rate, statement

WHERE = "(3.7), (3.8)"
EPS = tuple(10.0**-k for k in range(4, 17))
TIGHT = 1e-14  # unbalanced force over acting forces
LINEAR = slice(3, 11)  # 1e-7..1e-14: the active set is the one of the variational inequality
GAP, RESIDUAL, PLAIN, LINE = "-(u - g)^+/eps, unknown u - g", "(A u - f)/D in contact", "-(u - g)^+/eps, unknown u", (
    "half the last digit of g, over eps")  # fmt: skip


@statement("digits", "Digits of the contact pressure at small eps", "3.7", "3.8")
def digits(comm: MPI.Comm) -> Found:
    """Three forms of p_eps compared with p_h, and the plain one with the round-off of u (collective).

    The unknown of the package is w = u - g. In the plain form the same state is stored as u = w + g, in double
    precision, and g taken away again: what an unknown u cannot but do.
    """
    errors: dict[str, list[float]] = {GAP: [], RESIDUAL: [], PLAIN: []}
    lost = []
    scene = catalogue.scene("disk_flat", {"mesh.cells": 32})
    direct = defaults("penalty_", DIRECT), defaults("vi_", DIRECT)
    with direct[0], direct[1], closing(SolverContext(scene, comm)) as context:
        problem = context.problem
        vi = context.answer(replace(context.scene.options, method="vi")).pressure.x.array[: problem.level.owned]
        size = largest(comm, np.abs(vi))
        last_digit = largest(comm, np.spacing(np.abs(problem.obstacles()[1])))
        for eps in EPS:
            solve_penalty(problem, eps, tolerance=TIGHT)
            forms = _pressures(problem)
            for name, p in forms.items():
                errors[name].append(largest(comm, np.abs(p - vi)) / size)
            lost.append(largest(comm, np.abs(forms[PLAIN] - forms[GAP])) / size)
    line = [last_digit / 2 / eps / size for eps in EPS]
    findings = [
        rate(WHERE, f"max |p_eps - p_h|: {name}", 1, 1, EPS[LINEAR], errors[name][LINEAR]) for name in (GAP, RESIDUAL)
    ]
    findings += [
        constant(WHERE, f"the same at eps = 1e-14, over the one at 1e-7: {GAP}", "1e-7 of it", 1e-7,
                 errors[GAP][10] / errors[GAP][3]),
        rate(WHERE, f"what is lost: {PLAIN}", -1, -1, EPS, lost),
        constant(WHERE, "the same, over half the last digit of g over eps, the most", "1 at most", 1.0,
                 max(a / b for a, b in zip(lost, line, strict=True)), "sharp"),
        check(WHERE, f"relative error at eps = 1e-14: {PLAIN}", "no digits are lost", errors[PLAIN][10],
              errors[PLAIN][10] > 1e4 * errors[GAP][10], "needs hypothesis"),
    ]  # fmt: skip
    curves = [Curve(name, EPS, values) for name, values in errors.items()]
    return Found(findings, [Panel("flat ceiling, N = 32", "eps", "max |p_eps - p_h| / max |p_h|",
                                  [*curves, Curve(LINE, EPS, line)])])  # fmt: skip


def _pressures(problem: Problem) -> dict[str, np.ndarray]:
    """p_eps of the present state in three forms, at owned dofs; the last residual must be the one of this state."""
    eps = problem.eps
    p = penalty_pressure(problem)
    u, upper = problem.u, np.broadcast_to(problem.obstacles()[1], problem.owned)
    return {
        GAP: p,
        RESIDUAL: np.where(p != 0, problem.elastic.array_r / problem.weights, 0.0),
        PLAIN: np.where(problem.fixed, 0.0, -np.maximum(u - upper, 0.0) / eps),
    }

"""(3.4)*, the successive iteration: active sets shrink on M-matrices, may cycle elsewhere; what each start costs."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra.linear_solvers import defaults
from fenicsx_obstacle.algebra.newton import solve_penalty
from fenicsx_obstacle.algebra.solve_system import MatrixSystem
from fenicsx_obstacle.algebra.stopping import Step
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes import catalogue, meshes
from fenicsx_obstacle.scenes.scene import Scene
from tests.theory.statement import Curve, Finding, Found, Panel, check, constant, rate, statement

WHERE = "(3.4)*"
CELLS = (16, 32, 64, 128)
SMALL = 1e-8  # eps so small that the solution is the one of the variational inequality
COLD, NESTED, FALLING = "from no contact", "from coarser levels", "eps = 0.1 .. 1e-9, in all"
CONTINUED = tuple(10.0**-k for k in range(1, 10))
# symmetric and positive definite, but not an M-matrix; with it full steps come back to where they were
CYCLE = ((1.1125, -1.3018, -2.5507), (-1.3018, 3.4936, 6.2215), (-2.5507, 6.2215, 11.2719))
CYCLE_LOAD, CYCLE_EPS = (-1.0507, 0.0167, 1.0774), 1e-3
DENSE = {"ksp_type": "preonly", "pc_type": "lu"}


@statement("3.4*", "The successive iteration: nested active sets, a cycle, counts", "(3.4)*", "3.4")
def successive(comm: MPI.Comm) -> Found:
    """Measure (3.4)* with the package's own loop (collective)."""
    steps, panels = counts(comm)
    return Found([*linear_step(comm), *nesting(comm), *cycle(), *steps], panels)


def entered(history: Sequence[Step]) -> int:
    """Nodes that entered the active set after the first step, over all later steps."""
    return sum((step.changed + step.active - last.active) // 2 for last, step in itertools.pairwise(history[1:]))


def linear_step(comm: MPI.Comm) -> list[Finding]:
    """The second step from no contact solves (A + chi D/eps) u = f + chi D g/eps, chi where the first is beyond g."""
    with closing(SolverContext(catalogue.scene("disk_flat", {"mesh.cells": 32}), comm)) as context:
        problem = context.problem
        problem.eps = 1e-4
        x = problem.vector()
        _step(problem, x)
        beyond = _excess(problem, x) > 0
        _step(problem, x)
        after = _excess(problem, x)
        elastic = problem.elastic.array_r.copy()
        x.destroy()
        springs = beyond * problem.weights / problem.eps
        linear, printed = (
            total(comm, np.abs(elastic + springs * force)[~problem.fixed]) / problem.load
            for force in (after, np.maximum(after, 0.0))
        )
    claim = "beta linear on the last active set"
    return [
        check(WHERE, "unbalanced force of the linear problem / load, after a step", claim, linear, linear < 1e-10),
        check(WHERE, "the same with (t_u - g)^+ as printed: no linear problem", "solved by a linear step", printed,
              printed > 1e-2, "misprint"),
    ]  # fmt: skip


def _step(problem: Problem, x: PETSc.Vec) -> None:
    """One step of Newton's method from x, its system solved by a factorisation; the residual is then the new one."""
    out, change = x.duplicate(), x.duplicate()
    problem.residual(x, out)
    ksp = PETSc.KSP().create(problem.level.comm)
    ksp.setOperators(problem.jacobian(x))
    ksp.setType("preonly")
    ksp.pc.setType("lu")
    ksp.pc.setFactorSolverType("mumps")
    ksp.solve(out, change)
    x.axpy(-1.0, change)
    problem.residual(x, out)
    for owner in (ksp, out, change):
        owner.destroy()


def _excess(problem: Problem, x: PETSc.Vec) -> np.ndarray:
    """u - g at owned dofs."""
    problem.set_state(x)
    return np.where(problem.fixed, 0.0, -problem.gaps()[1])


def nesting(comm: MPI.Comm) -> list[Finding]:
    """Nodes that enter after the first step, in all runs on M-matrices; and a mesh that gives none."""
    right = catalogue.scene("disk_flat", {"mesh.cells": 32})
    crossed, string = right.change({"mesh.diagonal": "crossed"}), catalogue.scene("string_parabola", {"mesh.cells": 64})
    runs = [answer for scene in (right, crossed, string) for answer in _runs(scene, comm)]
    found = [check(
        WHERE, "nodes that enter after the first step: 3 meshes, eps = 1e-2, 1e-6, 1e-10", "sets decrease",
        sum(entered(answer.history) for answer in runs),
        all(answer.record["m_matrix"] and entered(answer.history) == 0 for answer in runs),
    )]  # fmt: skip
    most = max(answer.record["newton_iterations"] / (answer.record["free"] + 1) for answer in runs)
    found.append(check(WHERE, "steps over free nodes + 1, the most", "finite", most, most <= 1, "not sharp"))
    bent = _runs(_sheared(comm), comm)
    most = max(answer.record["newton_iterations"] for answer in bent)
    found.append(check(WHERE, "steps on obtuse triangles, no M-matrix", "finite", most,
                       not any(answer.record["m_matrix"] for answer in bent)))  # fmt: skip
    return found


def _runs(scene: Scene, comm: MPI.Comm) -> list[Answer]:
    options = replace(scene.options, method="successive")
    with closing(SolverContext(scene, comm)) as context:
        return [context.answer(replace(options, eps=eps)) for eps in (1e-2, 1e-6, 1e-10)]


def _sheared(comm: MPI.Comm) -> Scene:
    """A flat ceiling over a parallelogram, whose triangles are all obtuse, the diagonals the longest sides."""
    shape: dict[str, Any] = {"mesh": {"shape": "rectangle", "cells": 16}, "boundary": [{"value": 0}], "tension": 1}
    mesh = meshes.build(Scene(**shape), comm).mesh
    mesh.geometry.x[:, 0] += 0.8 * mesh.geometry.x[:, 1]
    return Scene(**{**shape, "mesh": mesh}, load=4, upper=0.05)


class Small(MatrixSystem):
    """A u + (u - g)^+ / eps = b of a few unknowns, with g = 0; every rank solves the whole of it.

    Attributes:
        met: The active sets for which a linear system was asked for, in their order.
    """

    def __init__(self, A: np.ndarray, b: np.ndarray):
        n, self.met = len(b), list[tuple[bool, ...]]()
        matrix = PETSc.Mat().createDense((n, n), array=A, comm=MPI.COMM_SELF).convert("aij")
        super().__init__(matrix, b, lower=None, upper=np.zeros(n), weights=np.ones(n), fixed=np.zeros(n, dtype=bool),
                         given=np.zeros(n))  # fmt: skip

    def jacobian(self, x: PETSc.Vec, *, penalised: bool = True) -> PETSc.Mat:
        A = super().jacobian(x, penalised=penalised)
        if penalised:
            self.met.append(tuple((self.w > 0).tolist()))
        return A


def cycle() -> list[Finding]:
    """Three unknowns for which full steps have period 3; the line search on the energy ends it."""
    A, b = np.array(CYCLE), np.array(CYCLE_LOAD)
    problem = Small(A, b)
    with defaults("penalty_", DENSE):
        outcome = solve_penalty(problem, CYCLE_EPS, successive=True)
    period = problem.met.index(problem.met[0], 1)
    left = np.abs(A @ problem.w + np.maximum(problem.w, 0) / CYCLE_EPS - b).max()
    return [
        constant(WHERE, "period of full steps on three unknowns, no M-matrix", "finite", 3, period,
                 "needs hypothesis"),
        check(WHERE, "steps there in all, the last by line search on the energy", "", outcome.iterations, left < 1e-9),
    ]  # fmt: skip


def counts(comm: MPI.Comm, sides: Sequence[int] = CELLS) -> tuple[list[Finding], list[Panel]]:
    """Steps from three starts, over N."""
    rows = [_counted(catalogue.scene("disk_flat", {"mesh.cells": cells}), comm) for cells in sides]
    cold, nested, continued = ([row[start, SMALL] for row in rows] for start in (COLD, NESTED, FALLING))
    findings = [
        # the last step only finds that nothing changes
        rate(WHERE, "steps from no contact, eps = 1e-8, over 1/h", 1, 1, sides, [n - 1 for n in cold]),
        check(WHERE, "eps from 0.1 to 1e-9, each from the last: steps in all, finest", "no start is named",
              continued[-1], continued[-1] <= 2 * continued[0]),
        check(WHERE, "steps on the finest level from the coarser ones, eps = 1e-8, the most", "no start is named",
              max(nested), max(nested) <= 4),
    ]  # fmt: skip
    panels = [
        Panel(f"flat ceiling, eps = {eps}", "N", "steps", [
            Curve(start, sides, [row[start, at] for row in rows]) for start, at in rows[0] if at == eps
        ], ("linear", "linear")) for eps in (SMALL, "h^2")
    ]  # fmt: skip
    return findings, panels


def _counted(scene: Scene, comm: MPI.Comm) -> dict[tuple[str, float | str], int]:
    """Steps from each start at each eps."""
    with closing(SolverContext(scene, comm)) as context:
        counts = {}
        for start, method in ((COLD, "successive"), (NESTED, "penalty")):
            for eps in (SMALL, "h^2"):
                options = scene.options_with(method=method, eps=eps)
                counts[start, eps] = context.answer(options).record["newton_iterations"]
        problem = context.problem
        problem.set_reference(problem.cold_start())
        counts[FALLING, SMALL] = sum(solve_penalty(problem, eps).iterations for eps in CONTINUED)
    return counts

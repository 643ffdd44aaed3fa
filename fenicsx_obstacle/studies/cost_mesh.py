"""One mesh of `cost` with its measurements, and the test whether the next mesh exceeds the budget."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.newton import smallest_eps
from fenicsx_obstacle.algebra.penalty_parameter import penalty_parameter
from fenicsx_obstacle.algebra.stopping import TOLERANCE
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.budget import Budget
from fenicsx_obstacle.answers.poisson_baseline import poisson_seconds
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.memory import fits
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.estimation.norms import Distance
from fenicsx_obstacle.parallel import forget_peak_memory, largest, total
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.studies.reference_solution import Truth, sizes_of

EPSILON = float(np.finfo(float).eps)


class CostMesh:
    """A solver context, the solution of the inequality on its mesh, and the time of a Poisson solve there."""

    def __init__(self, scene: Scene, comm: MPI.Comm):
        self.before = forget_peak_memory(comm)
        self.work = SolverContext(scene, comm)
        self._reference: Answer | None = None
        self.distance = Distance(self.work.problem)
        self.poisson = comm.bcast(poisson_seconds(self.work.problem.level))

    def close(self) -> None:
        """Free what it holds (collective)."""
        self._reference = None
        del self.distance
        self.work.close()

    def parts(self, answer: Answer) -> dict[str, dict[str, float]]:
        """The part of eps: distance to the solution of the inequality on the same mesh (collective)."""
        if answer.record["method"] == "vi":
            self._reference = answer
        if answer.record["eps"] is None:
            return {}
        if self._reference is None:
            with suppress(NotConverged):
                self._reference = self.work.answer(replace(self.work.options, method="vi"))
        if self._reference is None:
            return {}
        e, comm = answer.u.x.array - self._reference.u.x.array, answer.level.comm
        return {"eps": {"energy": self.distance.energy(e), "l2": self.distance.l2(e), "max": largest(comm, np.abs(e))}}


def floor_of(context: SolverContext, answer: Answer) -> float:
    """An estimate of the relative error of u by unbalanced forces and round-off (collective).

    Systems are solved until unbalanced forces are 1e-10 of the acting ones. Values of u are rounded, which causes
    forces of machine epsilon times the stiffness of each node and u there, with random signs.
    """
    problem, comm = context.problem, answer.level.comm
    step = answer.history[-1]
    if step.forces <= 0:
        return EPSILON
    rounded = 0.0
    if problem.affine and problem.level.pair.nodal:
        u = answer.u.x.array[: problem.level.owned]
        rounded = EPSILON * math.sqrt(total(comm, (problem.matrices.diagonal * u * ~problem.fixed) ** 2))
    return min(step.unbalanced / step.forces, TOLERANCE) + rounded / step.forces


def ending(
    rows: Sequence[Mapping[str, Any]], growth: float, dim: int, budget: Budget, comm: MPI.Comm, *, adaptive: bool
) -> str:
    """The reason why there is no row after these, or "" (collective).

    Args:
        rows: Of one choice.
        growth: Of unknowns from one mesh to the next.
        dim: Of the mesh.
        budget: Of a row.
        comm: Communicator.
        adaptive: Whether seconds are those of all meshes so far.
    """
    if not rows:
        return ""
    last = rows[-1]
    if last.get("reason"):
        return str(last["reason"])
    times = [row["seconds"] for row in rows]
    if adaptive:
        next_ = times[-1] + growth * (times[-1] - (times[-2] if len(times) > 1 else 0.0))
    else:
        next_ = times[-1] * max([growth, *(b / a for a, b in list(pairwise(times))[-1:])])
    if next_ > budget.seconds:
        return f"the next mesh would take about {next_:.2g} s; the budget is {budget.seconds:g} s"
    if growth * last["dofs"] > budget.unknowns and not adaptive:
        return too_many(budget)
    if growth * last["memory_mb"] > budget.megabytes:
        return f"the next mesh would take more than the budget of {budget.megabytes:g} MB"
    if not fits(growth * last["dofs"], dim, comm):
        return "the next mesh would not fit into the memory of this machine"
    return ""


def too_many(budget: Budget) -> str:
    """The message that a mesh exceeds a budget."""
    return f"the next mesh would have more than the {budget.unknowns:g} unknowns of the budget"


def place(context: CostMesh, scene: Scene, truth: Truth, k: int) -> dict[str, Any]:
    """One place of the map over h and eps: k powers of ten below 1/mu L^2 (collective)."""
    problem = context.work.problem
    h = problem.level.h
    unit = penalty_parameter(problem, scene.options) / h**2  # 1/mu
    eps = unit * problem.data.extent**2 * 10.0**-k
    row: dict[str, Any] = {"choice": "map", "h": h, "eps": eps, "paper": unit * h**2, "auto": unit * h**2 / 100,
                "floor": smallest_eps(problem)}  # fmt: skip
    try:
        answer = context.work.answer(replace(scene.options, eps=eps))
    except (NotConverged, InputError) as error:
        return {**row, "reason": without_name(error, scene)}
    row |= {"errors": truth.errors(context.work, answer), "sizes": sizes_of(context.distance, answer)}
    return {**row, "line": answer.record.get("round_off", {}).get("line")}


def without_name(error: Exception, scene: Scene) -> str:
    """A message without the name of the scene, which all rows share."""
    return str(error).removeprefix(f"{scene.source}: ")

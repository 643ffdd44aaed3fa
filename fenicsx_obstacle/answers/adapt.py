"""From a tolerance to a solution: solve, bound the error, refine, until the bound is below the tolerance."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.newton import smallest_eps
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.budget import Budget
from fenicsx_obstacle.answers.guaranteed_outputs import with_guaranteed_outputs
from fenicsx_obstacle.answers.solver_context import SolverContext, close
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.memory import fits
from fenicsx_obstacle.parallel import largest, peak_memory_mb, total
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.scene import Scene

if TYPE_CHECKING:
    from fenicsx_obstacle.estimation.bound import Bound

_log = logging.getLogger(__name__)
BULK = {1: 0.5, 2: 0.85}  # share of the bound in the cells that are refined (Doerfler); with P2 they are few
MIN_BULK = 0.1
FIRST = {1: 0, 2: 2000}  # unknowns of the first mesh for a tolerance, by degree: fewer take as long
SAFETY_OF_BULK = 1.1  # times the share of the bound that should do: cut into four, cells keep 4^-degree of its square
BALANCED = 0.2  # ratio of the parts of penalty and mesh above which eps is reduced
PENALTY_SHARE_AHEAD = (
    0.04  # times this ratio: eps is reduced further than necessary, so that the next meshes need no smaller one
)
MAX_EPS_REDUCTION = 0.02
UP_TO_TOLERANCE = 0.125  # times the error that is left at the tolerance: then one reduction of eps is enough
GROWTH = 3.0  # unknowns, time and memory of the next mesh over this one's, about
FALLS = 0.9  # an error below so much of that on the mesh before falls; otherwise it is bounded, not estimated
ABOVE_ESTIMATE = 1.05  # a bound over its estimate from samples, at most about
STALLED = 8  # meshes without a smaller error: round-off
HARDLY = {"dofs": 1.1, "total": 0.98}  # by these factors


@dataclass(frozen=True, eq=False)
class Estimate:
    """The estimated error of a quantity on one mesh.

    Attributes:
        value: The quantity there.
        discretisation: Part of the mesh, >= 0.
        penalty: Part of the penalty, >= 0.
        indicator: Contribution of each owned cell.
        dofs: Unknowns of the finest mesh that it took.
        unknowns: Of all meshes that it took together.
    """

    value: float
    discretisation: float
    penalty: float
    indicator: np.ndarray
    dofs: int
    unknowns: int

    @property
    def total(self) -> float:
        """The estimate."""
        return self.discretisation + self.penalty

    @property
    def relative(self) -> float | None:
        """The error over the absolute value; None where that is 0."""
        return self.total / abs(self.value) if self.value != 0 else None


@dataclass(frozen=True)
class Work:
    """The work for one mesh of an adaptive refinement.

    Attributes:
        unknowns: Of the mesh, and of the finer meshes that its estimate took.
        solves: How often it was solved, each time with a smaller eps.
        seconds: Processor time of the main thread, the largest of all ranks: elapsed time, if nothing else runs.
        elapsed: Elapsed time.
        memory_mb: Peak of the process after it.
    """

    unknowns: int
    solves: int
    seconds: float
    elapsed: float
    memory_mb: float

    @property
    def rate(self) -> float:
        """Seconds for each unknown of each solve."""
        return self.seconds / (self.unknowns * self.solves)


class Adaptation:
    """Solutions on adaptively refined meshes, with eps so small that the error of the mesh dominates; until a tolerance
    is reached, or a budget is spent.

    Attributes:
        scene: What is solved.
        options: How, with the present eps.
        error: The bound or estimate on the last mesh.
        path: Unknowns, bound, eps, seconds and memory of each mesh so far.
        work: Of each mesh so far.
        full: Whether the next mesh would have too many unknowns.
        tolerance: Of the error in the energy norm; 0 for meshes without end.
        relative: Whether it is relative to the energy norm of u.
        budget: Its limits.
        goal: The quantity that has the tolerance; None for the energy norm.
        power: The error of smooth solutions is of this power of the energy error.
        steady: Whether the error falls steadily, and the last mesh has no more cells refined than the tolerance needs.
        estimates: Whether the error is only estimated on meshes that are far from the tolerance, where that is faster.
            With a budget it is not, as the bound of the last mesh is then in the budget.
    """

    power, steady = 1, True
    goal: str | None = None
    error: Bound | Estimate

    def __init__(
        self,
        scene: Scene,
        comm: MPI.Comm = MPI.COMM_WORLD,
        tolerance: tuple[float, bool] = (0.0, False),
        budget: Budget | None = None,
    ):
        self.scene, self.options, self.full = scene, scene.options, False
        (self.tolerance, self.relative), self.budget = tolerance, budget or Budget()
        endless = math.isinf(self.budget.seconds) and math.isinf(self.budget.megabytes)
        self.estimates = endless and self.tolerance > 0
        self.given = scene.options.eps != "auto"  # eps is the user's
        self.comm = scene.mesh.comm if scene.mesh is not None else comm
        self.path: list[dict[str, Any]] = []
        self.work: list[Work] = []
        self._solves = 0  # on the present mesh
        self._since = _now()  # the work for the present mesh began
        self._everywhere = False  # the mesh before was refined

    def meshes(self, unknowns: float = np.inf) -> Generator[tuple[SolverContext, Answer], None, None]:
        """Each solver context and its answer, from the coarsest mesh of the scene on; the last comes twice if `full`.

        Errors are left to those who want them: `SolverContext.measured`.

        Every step is collective. They are freed when the iterator is closed; time that others take between two meshes
        is not counted.

        Args:
            unknowns: No mesh has more.
        """
        least = FIRST[self.scene.pair.degree] if self.tolerance > 0 else 0
        context = SolverContext(self.scene, self.comm, meshes.build(self.scene, self.comm, least))
        benches = [context]
        try:
            while True:
                answer = self.assessed(context)
                yield context, answer
                self._since = _now()
                assert self.error.indicator is not None
                finer = context.refined(self._marked(self.error.indicator))
                benches.append(finer)
                if finer.problem.level.dofs > unknowns:
                    self.full = True
                    yield context, answer
                    return
                context.forget_estimator()
                context = finer
        finally:
            close(benches)

    def _marked(self, indicator: np.ndarray) -> np.ndarray:
        """The owned cells to refine (collective): all where the part of the penalty is the larger one, and eps is a
        formula in h of the user, which is that of the largest cells."""
        share, formula = self.share(), self.given and not isinstance(self.options.eps, float)
        self._everywhere = formula and self.tolerance > 0 and self.error.penalty > self.error.discretisation
        return np.ones(len(indicator), dtype=bool) if self._everywhere else marked(indicator, share, self.comm)

    def work_of(self, context: SolverContext, cells: np.ndarray) -> Work:
        """The work for the mesh with these owned cells refined, which does not belong to the path (collective)."""
        options, path, work = self.options, list(self.path), list(self.work)
        context.forget_estimator()
        self._since = _now()
        with closing(context.refined(cells)) as finer:
            self.assessed(finer)
        found = self.work[-1]
        self.options, self.path, self.work = options, path, work
        return found

    def balanced(self, context: SolverContext) -> Answer:
        """The answer on one mesh, with eps so small that the error of the mesh dominates (collective)."""

        def bounded() -> tuple[Answer, Bound]:
            first = not self.path and self._solves == 0  # a wrong exact solution is reported on the first mesh
            answer = context.answer(self.options, bound=True, errors=first)
            assert answer.bound is not None
            return answer, answer.bound

        return self.with_eps(context, bounded)

    def with_eps(self, context: SolverContext, solve: Callable[[], tuple[Answer, Bound | Estimate]]) -> Answer:
        """Solve, and again with a smaller eps as long as the part of the penalty dominates (collective).

        Args:
            context: Of the mesh.
            solve: Returns an answer and its error.
        """
        self._solves = 0
        answer, self.error = solve()
        self._solves = 1
        chosen = answer.record["eps"] is not None and not self.given  # a number of the user is kept
        while chosen and (before := self.error.penalty) > BALANCED * self.error.discretisation:
            least, ahead = self.ahead()
            eps = answer.record["eps"] * max(least, ahead * BALANCED * self.error.discretisation / before)
            if (eps := max(eps, smallest_eps(context.problem))) >= answer.record["eps"]:
                break
            self.options = replace(self.options, eps=eps)
            answer, self.error = solve()
            self._solves += 1
            if self.error.penalty > 0.9 * before:  # round-off, or an obstacle that nodes do not see
                break
        return answer

    def ahead(self) -> tuple[float, float]:
        """By which factor eps is reduced at most, and how small the part of the penalty is to become then, over what is
        necessary; P2 has few meshes, on which one reduction of eps is enough for the tolerance."""
        limit = 0.0 if self.scene.pair.degree == 1 else self.limit()
        if limit == 0 or self.error.total <= limit:
            return MAX_EPS_REDUCTION, PENALTY_SHARE_AHEAD
        return 0.1 * MAX_EPS_REDUCTION, min(PENALTY_SHARE_AHEAD, UP_TO_TOLERANCE * limit / self.error.total)

    def note(self, answer: Answer, unknowns: int, *, sampled: bool = False) -> None:
        """Append a mesh to the path (collective).

        Args:
            answer: On this mesh.
            unknowns: Of this mesh, and of the finer meshes that the estimate took.
            sampled: Whether it is an estimate from samples of the obstacles.
        """
        record, before, self._since = answer.record, self._since, _now()
        elapsed, seconds = (largest(self.comm, end - start) for start, end in zip(before, self._since, strict=True))
        self.work.append(Work(unknowns, self._solves, seconds, elapsed, record["memory_mb"]))
        self.path.append({"dofs": record["dofs"], "total": self.error.total, "relative": self.error.relative,
                          "eps": record["eps"], "seconds": sum(work.elapsed for work in self.work),
                          "memory_mb": record["memory_mb"], "sampled": sampled})  # fmt: skip
        _log.info("%d unknowns: error %.3g", record["dofs"], self.error.total)

    def answer(self, *, yardstick: bool) -> Answer:
        """The first answer whose error is below the tolerance, or the best that the budget allows (collective)."""
        why, least = None, np.inf
        with closing(self.meshes(self.budget.unknowns)) as meshes:
            for finest, latest in meshes:
                why = "the budget of unknowns" if self.full else self.finished(latest)
                if self.path[-1]["sampled"]:
                    context, answer = finest, latest
                    if why is not None:
                        answer = self._proved(context, answer)
                # with round-off, finer meshes may be worse
                elif why == "" or not self.steady or self.comm.bcast(self.path[-1]["total"] <= least):
                    context, answer, least = finest, latest, self.path[-1]["total"]
                if why is not None:
                    break
            if yardstick:
                bound = answer.bound is not None
                answer = context.answer(self.options, yardstick=True, bound=bound, errors=False)
            if answer.bound is not None:
                answer = with_guaranteed_outputs(answer, context)
            answer = context.measured(answer)
        adaptive = {"tolerance": self.tolerance, "relative": self.relative, "reached": why == "", "stopped": why,
                    "path": self.path}  # fmt: skip
        seconds = {**answer.record["seconds"], "total": self.path[-1]["seconds"]}
        # the mesh is not the scene's any more; clocks differ between ranks: rank 0 speaks for all
        here = {"cells": None, "refine": None, "seconds": seconds, "adaptive": adaptive}
        return replace(answer, record=self.comm.bcast({**answer.record, **here}))

    def assessed(self, context: SolverContext) -> Answer:
        """The answer on one mesh, whose error is then `error` (collective).

        The error is bounded where the tolerance may be reached, and where errors do not fall any more.
        """
        path, degree = self.path, self.scene.pair.degree
        falls = len(path) < 2 or path[-1]["total"] < FALLS * path[-2]["total"]
        last = len(path) > 0 and self._share < BULK[degree]
        estimator = context.estimator
        estimator.sampled = self.estimates and self.comm.bcast(falls and not last)
        answer = self.balanced(context)
        if estimator.sampled and self.error.total <= self.limit():
            answer = self._proved(context, answer)
        self.note(answer, answer.dofs, sampled=estimator.sampled)
        return answer

    def _proved(self, context: SolverContext, answer: Answer) -> Answer:
        """An answer with an error bound in place of an estimate, the last one of a solver context (collective)."""
        context.estimator.sampled = False
        self.error = bound = context.estimator.bound()
        if self.path and self.path[-1]["sampled"] and self.path[-1]["dofs"] == answer.record["dofs"]:
            self.path[-1] |= {"total": bound.total, "relative": bound.relative, "sampled": False}
        record = {**answer.record, "bound": {**bound.record, "effectivity": None}}
        return replace(answer, bound=bound, record=record)

    def share(self) -> float:
        """The share of the bound whose cells are refined next, smaller before the last mesh."""
        above = ABOVE_ESTIMATE if self.path[-1]["sampled"] else 1.0
        beyond = 1 - (self.limit() / (above * self.error.total)) ** 2 if self.error.total > 0 else 1.0
        degree = self.scene.pair.degree
        self._share = min(BULK[degree], max(MIN_BULK, SAFETY_OF_BULK * beyond / (1 - 0.25**degree)))
        return self._share

    def limit(self) -> float:
        """The tolerance in the unit of the error."""
        total, relative = self.error.total, self.error.relative
        if not self.relative:
            return self.tolerance
        if relative is None and total > 0:
            raise InputError("--tol: the energy norm of u is 0; give --tol-absolute")
        return self.tolerance * total / relative if relative else 0.0

    def finished(self, answer: Answer) -> str | None:
        """None to continue, "" at the tolerance, otherwise the reason to stop (collective)."""
        limit, penalty = self.limit(), self.error.penalty
        if self.error.total <= limit:
            return ""
        number = self._everywhere and self.path[-1]["eps"] >= self.path[-2]["eps"]  # or a formula without h
        if self.given and penalty > limit and (number or isinstance(self.options.eps, float)):
            return f"eps = {answer.record['eps']:.3g} alone contributes {penalty:.3g}; omit eps, so that it is chosen"
        before = self.path[-2]["seconds"] if len(self.path) > 1 else 0.0
        now = self.path[-1]["seconds"]
        stop = None
        if now + GROWTH * (now - before) > self.budget.seconds:
            stop = f"the budget of {self.budget.seconds:g} s"
        if GROWTH * peak_memory_mb(self.comm) > self.budget.megabytes:
            stop = f"the budget of {self.budget.megabytes:g} MB"
        finest = self.error.dofs if isinstance(self.error, Estimate) else answer.dofs
        if not fits(GROWTH * finest, answer.level.mesh.topology.dim, self.comm):
            stop = "the memory of this machine"
        if self._stalls():
            stop = f"round-off: the last {STALLED} meshes have no smaller error"
        return self.comm.bcast(stop)

    def _stalls(self) -> bool:
        """Whether refinement has no effect any more: no smaller error, and no larger mesh where errors fluctuate."""
        if len(self.path) <= STALLED:
            return False
        before, last = self.path[:-STALLED], self.path[-STALLED:]
        least, now = (min(mesh["total"] for mesh in meshes) for meshes in (before, last))
        grown = last[-1]["dofs"] > HARDLY["dofs"] * before[-1]["dofs"]
        return now > HARDLY["total"] * least and (self.steady or not grown)


def _now() -> tuple[float, float]:
    """Elapsed time, and processor time of this thread."""
    return time.perf_counter(), time.thread_time()


def marked(indicator: np.ndarray, share: float, comm: MPI.Comm) -> np.ndarray:
    """The fewest owned cells that together have a given share of the sum over all ranks (collective)."""
    everything = total(comm, indicator)
    low, high = 0.0, largest(comm, indicator)
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        enough = total(comm, indicator[indicator >= middle]) >= share * everything
        low, high = (middle, high) if enough else (low, middle)
    # cells that are equal by symmetry are marked together, whatever their last digit
    return indicator >= low * (1 - 1e-6)

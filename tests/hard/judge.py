"""One scene on one mesh, solved by several methods: a row with a verdict for each result."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.data_scales import NEGLIGIBLE_FORCE
from fenicsx_obstacle.algebra.newton import penalty_pressure, solve_penalty
from fenicsx_obstacle.algebra.plausibility import NO_SOLUTION
from fenicsx_obstacle.algebra.vi import residual_pressure, solve_vi
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.check.finding import Finding
from fenicsx_obstacle.check.verification import EPSILON
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.scenes.scene import Scene
from tests.hard.invariants import beside_inequality, falling, of_one, same
from tests.hard.row import FAILED, Row, asked, judged_row, refused, row_of
from tests.hard.solved import ReferenceProblem, Solved
from tests.hard.units import Units, all_units

EPS: tuple[float | str, ...] = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, "auto")
METHODS = ("penalty", "successive")
TRIAL = 1e-6  # eps of what is tried once: other starts, units and ranks


class Trial(NamedTuple):
    """An answer, and its Newton steps."""

    solved: Solved
    iterations: int


def judge(
    scene: Scene,
    comm: MPI.Comm = MPI.COMM_WORLD,
    epsilons: Sequence[float | str] = EPS,
    methods: Sequence[str] = METHODS,
    refuse: str = "",
    *,
    known: Mapping[str, float] | None = None,
    starts: bool = False,
    units: bool = False,
) -> Iterator[Row]:
    """Solve a scene by SNES VI, and by each method for each eps; a row for each answer (collective).

    Args:
        scene: What to solve.
        comm: Communicator.
        epsilons: From large to small.
        methods: penalty, successive.
        refuse: Part of the message with which the scene must be rejected; empty where it has a solution.
        known: Of elastic bodies, as `judge_body` takes it.
        starts: Solve from other starting guesses as well.
        units: Solve in other units as well.
    """
    if scene.time is not None:
        from tests.hard.moving import judge_moving  # only where a scene has time

        yield from judge_moving(scene, comm, epsilons, methods)
        return
    if scene.model.vector_valued:
        from tests.hard.bodies import judge_body  # only where a scene has an elastic body

        yield from judge_body(scene, comm, epsilons, refuse, known or {}, units=units)
        return
    start = time.perf_counter()
    try:
        context = SolverContext(scene, comm)
    except InputError as error:
        yield refused(scene, "", None, start, error, refuse)
        return
    with closing(context), closing(ReferenceProblem(context.problem)) as ground:
        court = _Verifier(scene, context, ground, refuse)
        yield from court.sweep(epsilons, methods)
        if starts:
            yield from court.other_starts()
        if units:
            yield from court.other_units(comm)


class _Verifier:
    """Judges the answers of one problem (all methods collective)."""

    def __init__(self, scene: Scene, context: SolverContext, ground: ReferenceProblem, refuse: str):
        self.scene, self.context, self.ground, self.refuse = scene, context, ground, refuse
        self.known: dict[tuple[str, float | str | None], Trial] = {}

    def sweep(self, epsilons: Sequence[float | str], methods: Sequence[str]) -> Iterator[Row]:
        """The inequality, then each method for each eps, compared with those before."""
        yield from self._judged("vi", None, [])
        last: dict[str, Trial] = {}
        for eps in epsilons:
            for method in methods:
                before = [] if eps == "auto" or method not in last else [last[method]]
                yield from self._judged(method, eps, before)
                if eps != "auto" and (method, eps) in self.known:
                    last[method] = self.known[method, eps]

    def other_starts(self) -> Iterator[Row]:
        """The same from another start: cold, and from random values far away."""
        for method, eps in (("vi", None), ("penalty", TRIAL)):
            if (method, eps) not in self.known:
                continue
            for words in ("cold start", "scattered start"):
                start = time.perf_counter()
                problem = self.context.problem
                u_values = problem.cold_start()
                if words == "scattered start":
                    noise = _scatter(problem.level.points[:, : problem.owned])
                    u_values = u_values + 10 * self.known[method, eps].solved.range * noise
                problem.set_reference(u_values)
                try:
                    outcome = solve_vi(problem) if eps is None else solve_penalty(problem, TRIAL)
                except NotConverged as error:
                    yield row_of(self.scene, method, eps, FAILED, start, message=f"{words}: {error}", trial=words)
                    continue
                solved = take(self.context, self.ground, eps)
                findings = [*of_one(solved), *same(self.known[method, eps].solved, solved, words)]
                record = {"newton_iterations": outcome.iterations}
                yield self._verdict(method, eps, start, findings, record, words)

    def other_units(self, comm: MPI.Comm) -> Iterator[Row]:
        """The same in other units: within one step as many, and the same answer."""
        size = max((trial.solved.range for trial in self.known.values()), default=1.0)
        gaps = [
            gap[np.isfinite(gap)] for trial in self.known.values() for gap in (trial.solved.below, trial.solved.above)
        ]
        far = max((largest(comm, np.abs(gap)) for gap in gaps), default=0.0)
        size = size if size > NEGLIGIBLE_FORCE**0.5 * far else far  # a u of round-off has no size
        for units in all_units(self.scene, size):
            start = time.perf_counter()
            scene = units.of(self.scene)
            with closing(SolverContext(scene, comm)) as context, closing(ReferenceProblem(context.problem)) as ground:
                for method, eps in (("vi", None), ("penalty", TRIAL)):
                    if (method, eps) not in self.known:
                        continue
                    options = asked(scene, method, None if eps is None else eps * units.eps)
                    try:
                        answer = context.answer(options)
                    except (InputError, NotConverged) as error:
                        yield row_of(self.scene, method, eps, FAILED, start, message=str(error), trial=units.name)
                        continue
                    record = dict(answer.record)
                    solved = take(context, ground, record["eps"])
                    more = record["newton_iterations"] - self.known[method, eps].iterations
                    findings = [*of_one(solved), *_in_units(units, self.known[method, eps].solved, solved, more)]
                    yield self._verdict(method, eps, start, findings, record, units.name)
                    start = time.perf_counter()

    def _judged(self, method: str, eps: float | str | None, before: Sequence[Trial]) -> Iterator[Row]:
        start = time.perf_counter()
        try:
            answer = self.context.answer(asked(self.scene, method, eps))
        except (InputError, NotConverged) as error:
            # without a maximum principle for A an error of the size of the solution is the mesh's, and no answer
            coarse = NO_SOLUTION in str(error) and not self.ground.monotone
            yield refused(self.scene, method, eps, start, error, right=coarse)
            return
        record = dict(answer.record)
        number = record["eps"]
        solved = take(self.context, self.ground, number)
        findings = of_one(solved)
        vi = self.known.get(("vi", None))
        if number is not None and vi is not None:
            findings += beside_inequality(solved, vi.solved)
            off = largest(self.ground.comm, np.abs(solved.p - vi.solved.p))
            record["digits"] = {"from_heights": record.get("round_off", {}).get("from_heights"),
                                "off": off / max(largest(self.ground.comm, np.abs(vi.solved.p)), 1e-300)}  # fmt: skip
        for trial in before:
            findings += falling(trial.solved, solved)
        other = self.known.get((METHODS[0], eps))
        if method != METHODS[0] and other is not None:
            findings += same(other.solved, solved, f"{METHODS[0]} and {method}")
        self.known[method, eps] = Trial(solved, record["newton_iterations"])
        yield self._verdict(method, eps, start, findings, record)

    def _verdict(
        self, method: str, eps: float | str | None, start: float, findings: Sequence[Finding], record: dict[str, Any],
        trial: str = "",
    ) -> Row:  # fmt: skip
        record = {**record, "monotone": self.ground.monotone}
        return judged_row(self.scene, method, eps, start, record, findings, trial, self.refuse)


def take(context: SolverContext, ground: ReferenceProblem, eps: float | None) -> Solved:
    """The state that a solver context has just solved for, with its contact pressure."""
    p = residual_pressure(context.problem) if eps is None else penalty_pressure(context.problem)
    return ground.take(p, eps)


def _scatter(points: np.ndarray) -> np.ndarray:
    """Numbers between -1 and 1 by place, the same on all ranks."""
    mixed = np.sin(np.array([12.9898, 78.233, 37.719]) @ points) * 437.585453
    return 2 * (mixed - np.floor(mixed)) - 1


def _in_units(units: Units, old: Solved, solved: Solved, more: int) -> list[Finding]:
    """u and p in old units, node by node, and how many more steps there were."""
    g = old.ground
    scale = total(g.comm, solved.stiffness) / total(g.comm, old.stiffness)  # of a(u, u) over u^2
    # the data too are rounded where they are shifted: obstacles and boundary values bound what that does to u
    rounded, force = 2 * EPSILON * abs(units.shift), scale * units.height
    stiff = np.where(g.touchable, old.stiffness / np.maximum(g.D, 1e-300), 0.0)
    new = replace(
        solved, ground=g, w=solved.w / units.height, r=(solved.r - units.shift) / units.height,
        p=solved.p / units.pressure, elastic=solved.elastic / force, noise=solved.noise / force,
        z=solved.z / units.height + rounded, q=solved.q / units.pressure + 4 * stiff * rounded,
        R=solved.R / (units.height * np.sqrt(scale)) + rounded * np.sqrt(total(g.comm, old.stiffness)),
    )  # fmt: skip
    # a shift rounds heights to 1e-10 of their size: nodes nearer than that to an obstacle touch it from the start, and
    # may save steps
    steps = Finding("other units: steps", "equations scale", more if units.shift else abs(more), 1,
                    units.exact(g.problem.model))  # fmt: skip
    return [steps, *same(old, new, "other units", "equations scale")]

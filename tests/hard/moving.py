"""Scenes with [time] on one mesh: each step is checked as a stationary problem, and invariants over all steps."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import closing

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.stopping import TOLERANCE
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.check.finding import Finding
from fenicsx_obstacle.data.time_discretization import INERTIA
from fenicsx_obstacle.effects.field import fields_in
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.scenes.scene import Scene
from tests.hard.invariants import of_one
from tests.hard.judge import take
from tests.hard.row import Row, asked, judged_row, refused
from tests.hard.solved import ReferenceProblem, Solved


def judge_moving(
    scene: Scene, comm: MPI.Comm, epsilons: Sequence[float | str], methods: Sequence[str]
) -> Iterator[Row]:
    """Solve a scene with time by SNES VI, and by each method for each eps; a row for each answer (collective)."""
    known: tuple[Answer, Solved] | None = None
    ways = [("vi", None), *((method, eps) for eps in epsilons for method in methods)]
    with closing(SolverContext(scene, comm)) as context:
        for method, eps in ways:
            start = time.perf_counter()
            try:
                answer = context.answer(asked(scene, method, eps))
            except (InputError, NotConverged) as error:
                yield refused(scene, method, eps, start, error)
                continue
            problem = context.problem
            with closing(ReferenceProblem(problem)) as ground:  # of the last step
                number = None if eps is None else problem.eps
                solved = take(context, ground, number)
                findings = [*of_one(solved), *_energies(answer)]
                if known is not None and number is not None:
                    findings += _beside_inequality(answer, solved, *known)
                if eps is None:
                    known = answer, solved
                record = {**answer.record, "monotone": ground.monotone}
            yield judged_row(scene, method, eps, start, record, findings)


def _energies(answer: Answer) -> list[Finding]:
    """Of a conservative scene whose data rest: energy, with that of motion and of the penalty, never grows.

    Implicit Euler's step minimises energy plus a distance to the state before; with inertia elastic forces do no work
    over a step, and contact only against the motion.
    """
    scene, time_history = answer.scene, answer.time_history
    assert time_history is not None and scene.time is not None
    energy = time_history.column("energy")
    model = scene.model
    given = [model.lower, model.upper, *(part.value for part in model.boundary)]
    rests = not any(field.moves for field in fields_in([*map(vars, model.effects), *given]))
    falls = rests and np.isfinite(energy).all() and scene.time.scheme in ("euler", "midpoint")
    if not falls:
        return []
    # a step leaves forces unbalanced up to the solvers' tolerance, which do work
    margin = TOLERANCE * len(energy) * float(np.ptp(energy) + np.abs(energy).max())
    return [Finding("energy never grows", "each step minimises", float(np.diff(energy).max()), margin)]


def _beside_inequality(answer: Answer, solved: Solved, exact: Answer, vi: Solved) -> list[Finding]:
    """The penalised course is within its largest penetration so far of the inequality's, at every node.

    Where the maximum principle holds, steps of implicit Euler are monotone and never spread what their starts differ
    by: u_eps moved out by its largest penetration is a supersolution of the inequality's steps, whose u is one of the
    penalised steps. So for one obstacle 0 <= u_h - u_eps <= penetration, mirrored for an upper one.
    """
    assert answer.time_history is not None and answer.scene.time is not None
    g = vi.ground
    deepest = float(np.nanmax(answer.time_history.column("penetration")))
    off = answer.u.x.array - exact.u.x.array
    steps = len(answer.time_history.rows)
    margin = steps * max(largest(g.comm, solved.z + vi.z), 0.0)
    claimed = solved.ground.monotone and answer.scene.time.scheme in ("euler", "equilibria")
    return [
        Finding("all steps: no farther from the inequality's u than the penetration", "maximum principle",
                largest(g.comm, np.abs(off)), deepest + margin, claimed and answer.scene.time.order < INERTIA),
    ]  # fmt: skip

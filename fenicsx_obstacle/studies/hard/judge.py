"""One scene on one mesh, solved in many ways: a row with a verdict for each answer."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.accuracy.invariants import Finding, beside_inequality, falling, of_one, same, violated
from fenicsx_obstacle.accuracy.solved import Ground, Solved
from fenicsx_obstacle.answers.compute import Workbench
from fenicsx_obstacle.errors import InputError, ObstacleError
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.solvers.newton import penalty_pressure
from fenicsx_obstacle.solvers.vi import residual_pressure

EPS: tuple[float | str, ...] = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, "auto")
METHODS = ("penalty", "successive")
RIGHT, REFUSED, FAILED = "right", "refused", "FAILED"
Row = dict[str, Any]


def judge(
    scene: Scene,
    comm: MPI.Comm = MPI.COMM_WORLD,
    epsilons: Sequence[float | str] = EPS,
    methods: Sequence[str] = METHODS,
    refuse: str = "",
) -> Iterator[Row]:
    """Solve a scene by SNES VI once, then by each method for each eps; a row for each (collective).

    Args:
        scene: What to solve.
        comm: Communicator.
        epsilons: From large to small.
        methods: penalty, successive.
        refuse: Part of the message with which the scene must be refused; empty where it has a solution.
    """
    start = time.perf_counter()
    try:
        bench = Workbench(scene, comm)
    except InputError as error:
        yield _refused(scene, error, refuse, time.perf_counter() - start)
        return
    with closing(bench), closing(Ground(bench.problem)) as ground:
        vi: Solved | None = None
        last: dict[str, Solved] = {}
        tried: list[tuple[str, float | str | None]] = [("vi", None)]
        tried += [(method, eps) for eps in epsilons for method in methods]
        for method, eps in tried:
            asked = scene.change({"solve.method": method, **({} if eps is None else {"solve.eps": eps})})
            start = time.perf_counter()
            try:
                answer = bench.answer(asked)
            except ObstacleError as error:
                yield _row(scene, method, eps, FAILED, start, message=str(error))
                continue
            number = answer.record["eps"]
            p = residual_pressure(bench.problem) if number is None else penalty_pressure(bench.problem)
            solved = ground.take(p, number)
            findings = of_one(solved)
            if number is None:
                vi = solved
            elif vi is not None:
                findings += beside_inequality(solved, vi)
            before = last.get(method)
            if number is not None and before is not None and before.eps is not None and eps != "auto":
                findings += falling(before, solved)
            other = last.get(methods[0])
            if method != methods[0] and other is not None and other.eps == number:
                findings += same(other, solved, f"{methods[0]} and {method}")
            last[method] = solved
            verdict = FAILED if refuse or violated(findings) else RIGHT
            message = "; ".join(map(str, violated(findings)))
            if refuse:
                message = f"should be refused: {refuse}"
            yield _row(scene, method, eps, verdict, start, answer.record, findings, message)


def _refused(scene: Scene, error: InputError, refuse: str, seconds: float) -> Row:
    expected = bool(refuse) and refuse in str(error)
    return {"scene": scene.name, "verdict": REFUSED if expected else FAILED, "message": str(error), "seconds": seconds}


def _row(
    scene: Scene, method: str, eps: float | str | None, verdict: str, start: float, record: Any = None,
    findings: Sequence[Finding] = (), message: str = "",
) -> Row:  # fmt: skip
    figures = {} if record is None else {
        "eps": record["eps"], "dofs": record["dofs"], "newton_iterations": record["newton_iterations"],
        "newton_total": record["newton_total"], "energy": record["energy"], "contact": record["contact"],
        "penetration": record["penetration"], "u_range": record["u_range"],
    }  # fmt: skip
    return {
        "scene": scene.name, "method": method, "asked": eps, "verdict": verdict, "message": message,
        "seconds": time.perf_counter() - start, **figures, "findings": [finding.record for finding in findings],
    }  # fmt: skip

"""A row: one answer of a hard scene with its verdict."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.check.finding import Finding, violated
from fenicsx_obstacle.errors import ObstacleError
from fenicsx_obstacle.scenes.scene import Scene

RIGHT, REJECTED, FAILED = "right", "rejected", "FAILED"
FLOOR = "limit of round-off"  # words of the refusal
Row = dict[str, Any]


def asked(scene: Scene, method: str, eps: float | str | None) -> SolverOptions:
    """The options that a row asks for; None is for no eps, a text for a formula in h."""
    return scene.options_with(method=method, **({} if eps is None else {"eps": eps}))


def judged_row(
    scene: Scene, method: str, eps: float | str | None, start: float, record: Any, findings: Sequence[Finding],
    trial: str = "", refuse: str = "",
) -> Row:  # fmt: skip
    """The row of an answer: FAILED where a finding is violated, or the scene should have been refused."""
    message = f"should be rejected: {refuse}" if refuse else "; ".join(map(str, violated(findings)))
    return row_of(scene, method, eps, FAILED if message else RIGHT, start, record, findings, message, trial)


def refused(
    scene: Scene, method: str, eps: float | str | None, start: float, error: ObstacleError, refuse: str = "", *,
    right: bool = False,
) -> Row:  # fmt: skip
    """The row of an error: rejected if eps is below the floor, if the scene must be refused, or if that is right."""
    expected = right or FLOOR in str(error) or (bool(refuse) and refuse in str(error))
    return row_of(scene, method, eps, REJECTED if expected else FAILED, start, message=str(error))


def row_of(
    scene: Scene, method: str, eps: float | str | None, verdict: str, start: float, record: Any = None,
    findings: Sequence[Finding] = (), message: str = "", trial: str = "",
) -> Row:  # fmt: skip
    """The row of an answer, or of what there is in its place."""
    keys = ("eps", "dofs", "newton_iterations", "newton_total", "energy", "contact", "penetration", "u_range",
            "digits", "monotone", "report", "errors")  # fmt: skip
    figures = {} if record is None else {key: record[key] for key in keys if key in record}
    return {
        "scene": scene.name, "method": method, "asked": eps, "trial": trial, "verdict": verdict, "message": message,
        "seconds": time.perf_counter() - start, **figures, "findings": [finding.record for finding in findings],
    }  # fmt: skip

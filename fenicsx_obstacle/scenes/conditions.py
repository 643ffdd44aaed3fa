"""Conditions in a formula as margins: continuous functions whose signs decide the conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fenicsx_obstacle.scenes.formulas import NUMPY, Formula
from fenicsx_obstacle.scenes.vocabulary import Vocabulary


def margins(scene: Vocabulary, formula: Formula, x: np.ndarray, values: Mapping[str, Any]) -> list[np.ndarray]:
    """For each condition in a formula and in its definitions a value that is positive only where the condition holds.

    `a < b` has b - a, `and` the smaller of two. `abs`, `sign`, `min` and `max` have such a value too: there they bend.

    Args:
        scene: Whose formula it is.
        formula: From `scene.formula()`.
        x: Points, shape (3, n).
        values: Further names, as for `Vocabulary.at_points`.

    Returns:
        Arrays of n values, as many at all points.
    """
    found: list[np.ndarray] = []

    def record(margin: Any, value: Any) -> Any:
        found.append(np.broadcast_to(margin, x.shape[1:]))
        return value

    more: dict[str, Callable[..., Any]] = {
        "<": lambda a, b: b - a, "<=": lambda a, b: b - a, ">": lambda a, b: a - b, ">=": lambda a, b: a - b,
        "==": lambda a, b: -np.abs(a - b), "!=": lambda a, b: np.abs(a - b),
        "and": np.minimum, "or": np.maximum, "not": np.negative,
        "where": lambda test, yes, no: record(test, np.where(test > 0, yes, no)),
        "abs": lambda a: record(a, np.abs(a)), "sign": lambda a: record(a, np.sign(a)),
        "min": lambda a, b: record(b - a, np.minimum(a, b)), "max": lambda a, b: record(b - a, np.maximum(a, b)),
    }  # fmt: skip
    scene.at_points(formula, x, values, {**NUMPY, **more})
    return found

"""Bounds of a formula over intervals of t at fixed points, by the interval arithmetic that bounds it over cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fenicsx_obstacle.effects.field import TimeBounds
from fenicsx_obstacle.scenes import derivative_bounds, intervals
from fenicsx_obstacle.scenes.cells import Cells
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.tree_walk import TreeWalk
from fenicsx_obstacle.scenes.vocabulary import TIME

if TYPE_CHECKING:
    from fenicsx_obstacle.scenes.vocabulary import Vocabulary


def over_time(
    vocabulary: Vocabulary,
    formula: Formula,
    x: np.ndarray,
    distance: np.ndarray | None,
    start: np.ndarray,
    end: np.ndarray,
) -> TimeBounds:
    """Bounds of a formula at points, each over an interval of t.

    Args:
        vocabulary: The names that the formula may use.
        formula: The formula.
        x: Points, shape (3, n).
        distance: Their distances to the boundary, or None if no formula needs them.
        start: Start of the interval of each point, shape (n,).
        end: Its end.
    """
    # a "cell" is an interval of t: the coordinates are numbers in it, and derivatives are those by t
    walk = TreeWalk(Cells(vocabulary, np.empty((x.shape[1], 0, 0))))
    fixed = dict(zip("xyz", x, strict=True))
    fixed |= {"r": np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2), "theta": np.arctan2(x[1], x[0])}
    if distance is not None:
        fixed["distance"] = distance
    walk.known.update({name: intervals.of_bounds(values, values, 0) for name, values in fixed.items()})
    walk.known[TIME] = intervals.of_bounds(start, end, 1, derivative_bounds.COORDINATE)
    with np.errstate(all="ignore"):
        found = walk.number(formula, formula.tree)
        smooth = found.whole & found.finite
        first, second = (np.where(smooth, found.derivative(k), np.inf) for k in (1, 2))
        lower, upper = np.where(found.defined, found.lower, -np.inf), np.where(found.defined, found.upper, np.inf)
    return TimeBounds(*(np.broadcast_to(part, x.shape[1:]) for part in (lower, upper, first, 2 * second)))

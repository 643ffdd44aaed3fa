"""Enclosures of a formula in cells, and over intervals of t: bounds, polynomial degree, conditions that change inside.

See `tree_walk` for how.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fenicsx_obstacle.effects.field import Enclosed, TimeBounds, Truth
from fenicsx_obstacle.scenes import derivative_bounds, intervals
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.intervals import Enclosure
from fenicsx_obstacle.scenes.mean_value_forms import among, linear, lines, nearest_on
from fenicsx_obstacle.scenes.tree_walk import Cells, TreeWalk
from fenicsx_obstacle.scenes.vocabulary import TIME, Vocabulary


class OnCells(Enclosed):
    """One formula on cells."""

    def __init__(self, cells: Cells, formula: Formula):
        self.cells, self.formula = cells, formula

    @cached_property
    def _walk(self) -> TreeWalk:
        """It is kept, with all it finds."""
        return TreeWalk(self.cells, nearest_on)

    def once(self) -> Enclosure:
        with np.errstate(all="ignore"):
            found = self._walk.number(self.formula, self.formula.tree)
        lower, upper, degree, whole, defined = (np.broadcast_to(part, self.cells.count) for part in found.parts)
        return Enclosure(lower, upper, degree, whole, defined, found.slopes)

    def some(self, cells: np.ndarray) -> OnCells:
        return OnCells(self.cells.of(cells), self.formula)

    def truth(self) -> Truth:
        with np.errstate(all="ignore"):
            return self._walk.condition(self.formula, self.formula.tree)

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        walk, places = among(self._walk, cells)
        at_corners, rest, steep = linear(walk, self.formula)
        return at_corners[places], rest[places], steep[places]

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        walk, places = among(self._walk, cells)
        values, rest = lines(walk, self.formula)
        return values[places], rest[places]

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        return self.cells.values(self.formula, degree, cells)


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

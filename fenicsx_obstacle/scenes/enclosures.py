"""Enclosures of a formula in cells: bounds, polynomial degree, conditions that change inside a cell.

See `tree_walk` for how.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fenicsx_obstacle.effects.field import Enclosed, Truth
from fenicsx_obstacle.scenes.cells import Cells
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.intervals import Enclosure
from fenicsx_obstacle.scenes.mean_value_forms import among, linear, lines, nearest_on
from fenicsx_obstacle.scenes.tree_walk import TreeWalk


class OnCells(Enclosed):
    """One formula on cells."""

    def __init__(self, cells: Cells, formula: Formula):
        self.cells, self.formula = cells, formula

    def _walk(self) -> TreeWalk:
        return TreeWalk(self.cells, nearest_on)

    @cached_property
    def _kept(self) -> TreeWalk:
        """One that is kept, with all it finds: for few cells."""
        return self._walk()

    def once(self) -> Enclosure:
        return self._enclosed(self._kept if self.cells.kept else self._walk())

    def by_intervals(self) -> tuple[Enclosure, np.ndarray]:
        walk = TreeWalk(self.cells)
        return self._enclosed(walk), walk.blurred

    def _enclosed(self, walk: TreeWalk) -> Enclosure:
        with np.errstate(all="ignore"):
            found = walk.number(self.formula, self.formula.tree)
        lower, upper, degree, whole, defined = (np.broadcast_to(part, self.cells.count) for part in found.parts)
        return Enclosure(lower, upper, degree, whole, defined, found.slopes)

    def some(self, cells: np.ndarray) -> OnCells:
        return OnCells(self.cells.of(cells), self.formula)

    def truth(self) -> Truth:
        with np.errstate(all="ignore"):
            return self._walk().condition(self.formula, self.formula.tree)

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        walk, places = among(self._kept, cells)
        at_corners, rest, steep = linear(walk, self.formula)
        return at_corners[places], rest[places], steep[places]

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        walk, places = among(self._kept, cells)
        values, rest = lines(walk, self.formula)
        return values[places], rest[places]

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        return self.cells.values(self.formula, degree, cells)

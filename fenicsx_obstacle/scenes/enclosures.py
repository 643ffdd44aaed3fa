"""Enclosures of a formula in cells: bounds, polynomial degree, conditions that change inside a cell.

See `tree_walk` for how.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Enclosed, Truth
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.intervals import Enclosure
from fenicsx_obstacle.scenes.tree_walk import TreeWalk

if TYPE_CHECKING:
    from fenicsx_obstacle.scenes.vocabulary import Vocabulary

FEW = 2000  # cells, for which walking through a formula costs more than arithmetic
POINTS = 30_000  # in which a formula is evaluated together: what is made of them fits into the cache of a core
KEPT = 30_000  # cells: all that is found on so many of them is kept
Distance = Callable[[np.ndarray], np.ndarray]


class Cells:
    """Simplices on which formulas are enclosed."""

    def __init__(self, vocabulary: Vocabulary, corners: np.ndarray, distance: Distance | None = None):
        """Take their bounding boxes.

        Args:
            vocabulary: The names that formulas may use.
            corners: Shape (cells, corners, coordinates).
            distance: Distance to the boundary of points, shape (n, 3), for formulas that name it.
        """
        self.vocabulary, self.corners, self.distance = vocabulary, corners, distance
        self.count = len(corners)

    def of(self, cells: np.ndarray) -> Cells:
        """A selection of the cells."""
        return Cells(self.vocabulary, self.corners[cells], self.distance)

    @cached_property
    def walk(self) -> TreeWalk:
        """One that is kept, with all it finds: for few cells."""
        return TreeWalk(self)

    def among(self, cells: np.ndarray) -> tuple[Cells, np.ndarray | slice]:
        """Cells in which to look closely at some of these, and the places of those there: these, of which much is known
        already, unless they are many more."""
        return (self, cells) if self.count <= min(KEPT, FEW + 4 * len(cells)) else (self.of(cells), slice(None))

    def truth(self, formula: Formula) -> Truth:
        """Whether a condition may be true and may be false on each cell."""
        with np.errstate(all="ignore"):
            return TreeWalk(self).condition(formula, formula.tree)

    def once(self, formula: Formula) -> Enclosure:
        """Bounds over each cell as it is."""
        return self._enclosed(self.walk if self.count <= KEPT else TreeWalk(self), formula)

    def by_intervals(self, formula: Formula) -> tuple[Enclosure, np.ndarray]:
        """Bounds by interval arithmetic alone, and the cells where `once` does more."""
        walk = TreeWalk(self, sharp=False)
        return self._enclosed(walk, formula), walk.blurred

    def _enclosed(self, walk: TreeWalk, formula: Formula) -> Enclosure:
        with np.errstate(all="ignore"):
            found = walk.number(formula, formula.tree)
        lower, upper, degree, whole, defined = (np.broadcast_to(part, self.count) for part in found.parts)
        return Enclosure(lower, upper, degree, whole, defined, found.slopes)

    def values(self, formula: Formula, degree: int, cells: np.ndarray) -> np.ndarray:
        """Values at the inner points for a degree, shape (cells, points)."""
        points = polynomials.inner_points(self.corners.shape[1], degree)
        found, at_once = np.empty((len(cells), len(points))), max(POINTS // len(points), 1)
        for start in range(0, len(cells), at_once):
            corners, own = self.corners[cells[start : start + at_once]], found[start : start + at_once]
            x = np.zeros((3, own.size))
            for axis in range(corners.shape[2]):
                np.matmul(corners[..., axis], points.T, out=x[axis].reshape(own.shape))
            known = {} if self.distance is None else {"distance": self.distance(x.T)}
            own[:] = self.vocabulary.at_points(formula, x, known).reshape(own.shape)
        return found


class OnCells(Enclosed):
    """One formula on cells."""

    def __init__(self, cells: Cells, formula: Formula):
        self.cells, self.formula = cells, formula

    def once(self) -> Enclosure:
        return self.cells.once(self.formula)

    def by_intervals(self) -> tuple[Enclosure, np.ndarray]:
        return self.cells.by_intervals(self.formula)

    def some(self, cells: np.ndarray) -> OnCells:
        return OnCells(self.cells.of(cells), self.formula)

    def truth(self) -> Truth:
        return self.cells.truth(self.formula)

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        from fenicsx_obstacle.scenes.mean_value_forms import linear  # only where conditions cut cells

        among, places = self.cells.among(cells)
        at_corners, rest, steep = linear(among, self.formula)
        return at_corners[places], rest[places], steep[places]

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from fenicsx_obstacle.scenes.mean_value_forms import lines  # only where it is needed

        among, places = self.cells.among(cells)
        values, rest = lines(among, self.formula)
        return values[places], rest[places]

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        return self.cells.values(self.formula, degree, cells)

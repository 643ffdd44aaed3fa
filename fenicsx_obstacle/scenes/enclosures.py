"""What is known of a formula on whole cells, without sampling: bounds, polynomial degree, conditions that cut a cell.

See `tree_walk` for how; here cells where no finite bound is found are divided.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from fenicsx_obstacle.estimation import polynomials
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.intervals import Enclosure
from fenicsx_obstacle.scenes.tree_walk import TreeWalk, Truth

if TYPE_CHECKING:
    from fenicsx_obstacle.scenes.vocabulary import Vocabulary

SPLITS = 8  # how often a cell is halved where no finite bound is found
LARGE = 1e7  # times the usual value: such a bound may come from a pole nearby
MAX_PIECES = 50_000

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

    def enclosure(self, formula: Formula) -> Enclosure:
        """Bounds over each cell; where they are infinite, or nearly so, of the parts of a divided cell."""
        found = self.once(formula)
        largest = np.inf
        if np.any(found.degree > 0):
            values = np.abs(self.values(formula, 0, np.arange(self.count)))
            largest = LARGE * float(np.median(values[np.isfinite(values)])) if np.isfinite(values).any() else np.inf
        cells = np.flatnonzero(_open(found, largest))
        if not len(cells) or self.corners.shape[1] > 3:
            return found
        lower, upper, defined = found.lower.copy(), found.upper.copy(), found.defined.copy()
        lower[cells], upper[cells], defined[cells] = np.inf, -np.inf, True
        owners, corners = cells, self.corners[cells]
        for split in range(1, SPLITS + 1):
            pieces = Cells(self.vocabulary, halved(corners), self.distance)
            owners = np.repeat(owners, pieces.count // len(owners))
            parts = pieces.once(formula)
            open_ = _open(parts, largest)
            done = ~open_ | (split == SPLITS or np.count_nonzero(open_) > MAX_PIECES)
            np.minimum.at(lower, owners[done], parts.lower[done])
            np.maximum.at(upper, owners[done], parts.upper[done])
            np.logical_and.at(defined, owners[done], parts.defined[done])
            owners, corners = owners[~done], pieces.corners[~done]
            if not len(owners):
                break
        return Enclosure(lower, upper, found.degree, found.whole, defined)

    def truth(self, formula: Formula) -> Truth:
        """What a condition, or a number as one, may be on each cell."""
        with np.errstate(all="ignore"):
            return TreeWalk(self).condition(formula, formula.tree)

    def once(self, formula: Formula) -> Enclosure:
        """Bounds over each cell as it is."""
        with np.errstate(all="ignore"):
            found = TreeWalk(self).number(formula, formula.tree)
        return Enclosure(*(np.broadcast_to(part, self.count) for part in found.parts))

    def values(self, formula: Formula, degree: int, cells: np.ndarray) -> np.ndarray:
        """Values at the inner points for a degree, shape (cells, points)."""
        points = polynomials.inner_points(self.corners.shape[1], degree)
        x = np.zeros((3, len(cells) * len(points)))
        inside = points @ self.corners[cells]
        x[: inside.shape[2]] = inside.reshape(-1, inside.shape[2]).T
        known = {} if self.distance is None else {"distance": self.distance(x.T)}
        return self.vocabulary.at_points(formula, x, known).reshape(len(cells), len(points))


def _open(found: Enclosure, largest: float) -> np.ndarray:
    """Cells that are worth dividing."""
    huge = np.maximum(np.abs(found.lower), np.abs(found.upper)) > largest
    return ~found.finite | (huge & ~(found.whole & (found.degree == 0)))


def halved(corners: np.ndarray) -> np.ndarray:
    """Segments in two, triangles in four: the parts of one follow each other."""
    a, b = corners[:, 0], corners[:, 1]
    parts: list[tuple[np.ndarray, ...]]
    if corners.shape[1] == 2:
        m = (a + b) / 2
        parts = [(a, m), (m, b)]
    else:
        c = corners[:, 2]
        d, e, f = (b + c) / 2, (c + a) / 2, (a + b) / 2
        parts = [(a, f, e), (f, b, d), (e, d, c), (d, e, f)]
    stacked = np.stack([np.stack(part, axis=1) for part in parts], axis=1)
    return stacked.reshape(-1, *corners.shape[1:])


class OnCells:
    """One formula on cells, as `effects.field.Enclosed` has it."""

    def __init__(self, cells: Cells, formula: Formula):
        self.cells, self.formula = cells, formula

    def enclosure(self) -> Enclosure:
        return self.cells.enclosure(self.formula)

    def once(self) -> Enclosure:
        return self.cells.once(self.formula)

    def truth(self) -> Truth:
        return self.cells.truth(self.formula)

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        return self.cells.values(self.formula, degree, cells)

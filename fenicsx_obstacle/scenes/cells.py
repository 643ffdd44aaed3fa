"""Simplices on which formulas are enclosed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.vocabulary import Vocabulary

POINTS = 30_000  # in which a formula is evaluated together: what is made of them fits into the cache of a core
KEPT = 30_000  # cells: all that is found on so many of them is kept
Distance = Callable[[np.ndarray], np.ndarray]


class Cells:
    """Simplices, and the names that formulas on them may use.

    Attributes:
        vocabulary: The names.
        corners: Shape (cells, corners, coordinates).
        distance: Distance to the boundary of points, shape (n, 3), for formulas that name it.
        count: How many there are.
    """

    def __init__(self, vocabulary: Vocabulary, corners: np.ndarray, distance: Distance | None = None):
        """Take them; see the attributes."""
        self.vocabulary, self.corners, self.distance = vocabulary, corners, distance
        self.count = len(corners)

    @property
    def kept(self) -> bool:
        """Whether all that is found on them is kept."""
        return self.count <= KEPT

    def of(self, cells: np.ndarray) -> Cells:
        """A selection of the cells."""
        return Cells(self.vocabulary, self.corners[cells], self.distance)

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

"""A foundation in the cells: k u as the solver has it, and as it is.

The equilibrated flux is in balance with the solver's forces k_T u |T|/(d + 1) at the corners of each cell, whose sum is
that of a constant k. What k u is beyond its mean in a cell has mean zero; what k is beyond the solver's value has not.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.cell_data import TENSION, in_cells, of_solver
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.estimation.simplices import Simplices, sums


class Reaction:
    """The foundation k of a problem.

    Attributes:
        given: Whether there is one; otherwise k = 0.
        least: A lower bound of k in each cell, 0 at least.
        most: An upper bound.
        pieces: What is known of it; None of a number, or of a number for each material.
    """

    def __init__(self, simplices: Simplices, value: Field | None):
        """Enclose it (collective)."""
        self._simplices, corners, self.given = simplices, simplices.dim + 1, value is not None
        self.least = self.most = self._of_solver = np.zeros(len(simplices.area))
        self.pieces: Pieces | None = None
        if value is None:
            return
        middle = np.full((1, corners), 1 / corners)
        self.least = self.most = self._of_solver = of_solver(simplices, simplices.data, value, middle)[:, 0]
        parts = [value] if value.parts is None else list(value.parts.values())
        if simplices.radius is None and all(part.uniform for part in parts):
            return
        self.pieces = in_cells(simplices, value, TENSION)
        self.least = np.where(np.isfinite(self.pieces.lower), np.maximum(self.pieces.lower, 0.0), 0.0)
        self.most = np.where(np.isfinite(self.pieces.upper), self.pieces.upper, self._of_solver)

    def forces(self, u: np.ndarray) -> np.ndarray:
        """The solver's forces at the corners of cells, shape (cells, d + 1) (local)."""
        simplices = self._simplices
        return (self._of_solver * simplices.size / (simplices.dim + 1))[:, None] * u[simplices.dofs]

    def beyond(self, u: np.ndarray, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Norms over each cell of what k u is beyond the solver's, u a P1 function by its values at local dofs, (E26)
        (local).

        Args:
            u: It.
            linear: Of a linear function in each cell that has mean zero, the values at its vertices.

        Returns:
            ||k u - mean - linear||_T, and a bound of what is besides, of any mean.
        """
        simplices, k = self._simplices, self._of_solver
        corner, area, dim = u[simplices.dofs], simplices.area, simplices.dim
        mean = sums(corner) / (dim + 1)
        if self.pieces is None:
            return np.sqrt(squared_norm(k[:, None] * (corner - mean[:, None]) - linear, area)), np.zeros(len(area))
        radius, root, ratio = simplices.radius, np.sqrt(area), simplices.size / area
        means = self.pieces.mean(corner, radius)
        known, rests = self.pieces.distance(linear + means[:, None], radius, corner)
        return root * known, root * (np.sqrt(ratio) * np.abs(means - k * mean) + rests)

    def energy(self, e: np.ndarray) -> np.ndarray:
        """A bound of the integral of k e^2 over each cell, e a P1 function by its values at local dofs (local)."""
        simplices = self._simplices
        return self.most * simplices.most_weight * squared_norm(e[simplices.dofs], simplices.area)


def squared_norm(corner: np.ndarray, size: np.ndarray) -> np.ndarray:
    """||.||^2 of linear functions from their values at the corners of simplices, shape (simplices, corners)."""
    count = corner.shape[1]
    return size / (count * (count + 1)) * ((corner**2).sum(axis=1) + corner.sum(axis=1) ** 2)

"""An obstacle that is replaced by a limit where the solution cannot reach it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenicsx_obstacle.effects.field import NO_POLYNOMIAL, Bounds, Enclosed, Field, Names
from fenicsx_obstacle.estimation.simplex_geometry import gradients


class Clipped(Field):
    """max(obstacle, limit) of a lower obstacle, min(obstacle, limit) of an upper one."""

    def __init__(self, obstacle: Field, sign: float, limit: float):
        """Cut it off.

        Args:
            obstacle: The obstacle.
            sign: 1 for a lower obstacle, -1 for an upper one.
            limit: A value that is nowhere beyond the solution.
        """
        self.obstacle, self.sign, self.limit = obstacle, sign, limit
        self.source, self.text, self.uniform = obstacle.source, obstacle.text, obstacle.uniform
        self.needs_distance, self.continuous = obstacle.needs_distance, obstacle.continuous

    @property
    def pointwise(self) -> bool:
        return self.obstacle.pointwise

    def on(self, level: Any) -> Field:
        return Clipped(self.obstacle.on(level), self.sign, self.limit)

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        return self.clip(self.obstacle.at(x, names, cells))

    def over(self, corners: np.ndarray, names: Names, cells: np.ndarray) -> Enclosed | None:
        known = self.obstacle.over(corners, names, cells)
        return None if known is None else _ClippedCells(known, self, corners)

    def clip(self, values: np.ndarray) -> np.ndarray:
        """Values of the obstacle, cut off."""
        return np.maximum(values, self.limit) if self.sign > 0 else np.minimum(values, self.limit)


@dataclass(frozen=True, eq=False)
class _ClippedCells(Enclosed):
    known: Enclosed
    by: Clipped
    corners: np.ndarray

    def once(self) -> Bounds:
        bounds = self.known.once()
        limit = self.by.limit
        near, far = (bounds.lower, bounds.upper) if self.by.sign > 0 else (bounds.upper, bounds.lower)
        beyond = self.by.sign * (far - limit) <= 0  # all of it is cut off
        cut = ~beyond & ~(self.by.sign * (near - limit) >= 0)
        return Bounds(
            self.by.clip(bounds.lower), self.by.clip(bounds.upper),
            np.where(beyond, 0, np.where(cut, NO_POLYNOMIAL, bounds.degree)), beyond | (bounds.whole & ~cut),
            bounds.defined, lambda k: np.where(beyond, 0.0, bounds.derivative(k)),
        )  # fmt: skip

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A linear function that is not cut off is no farther from what is left of the obstacle."""
        at_corners, rest, steep = self.known.linear(cells)
        kept = np.all(self.by.sign * (at_corners - self.by.limit) >= 0, axis=1)
        # where the obstacle is cut off the difference has the slope of the linear function
        own = np.linalg.norm(gradients(self.corners[cells], at_corners), axis=0)
        none = np.full(len(cells), np.inf)
        return at_corners, np.where(kept, rest, none), np.where(kept, np.maximum(steep, own), none)

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.known.cuts(cells)

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        return self.by.clip(self.known.values(degree, cells))

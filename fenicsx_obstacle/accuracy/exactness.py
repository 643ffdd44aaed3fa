"""What is known of the data of a scene on whole cells and edges, without sampling."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenicsx_obstacle.accuracy.quadrature import blocks
from fenicsx_obstacle.accuracy.triangles import Triangles
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.scenes import polynomials
from fenicsx_obstacle.scenes.enclosures import Cells
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.intervals import NO_POLYNOMIAL
from fenicsx_obstacle.scenes.materials import Materials, Value


@dataclass(frozen=True)
class Known:
    """Bounds of a datum over simplices, and where it is a polynomial.

    Attributes:
        lower: Lower bound over each simplex; infinite where none is known.
        upper: Upper bound.
        degree: Where it is a polynomial of degree `polynomials.MAX_DEGREE` at most; `NO_POLYNOMIAL` elsewhere.
    """

    lower: np.ndarray
    upper: np.ndarray
    degree: np.ndarray

    @property
    def exact(self) -> np.ndarray:
        """Whether a few values determine it."""
        return self.degree <= polynomials.MAX_DEGREE

    @property
    def finite(self) -> np.ndarray:
        return np.isfinite(self.lower) & np.isfinite(self.upper)

    def degrees(self, least: int = 0) -> Iterator[tuple[int, np.ndarray]]:
        """Each degree >= least that occurs, and the simplices where it does."""
        for degree in np.unique(self.degree[self.exact & (self.degree >= least)]):
            yield int(degree), np.flatnonzero(self.degree == degree)


def number(count: int) -> Known:
    """Of a number: it needs no bounds."""
    return Known(np.zeros(count), np.zeros(count), np.zeros(count, dtype=int))


def in_cells(triangles: Triangles, value: Value) -> Known:
    """Of a value on the owned cells (collective where it is the first to need the distance)."""
    count = len(triangles.area)
    found = Known(np.zeros(count), np.zeros(count), np.full(count, NO_POLYNOMIAL))
    parts: list[tuple[Formula, Any]] = [(value, np.arange(count))] if isinstance(value, Formula) else []
    if isinstance(value, Materials):
        parts = [(formula, triangles.data.level.groups[name]) for name, formula in value.parts.items()]
    for formula, cells in parts:
        for name, values in vars(on_simplices(triangles.data, formula, triangles.x[cells])).items():
            getattr(found, name)[cells] = values
    return found


def on_simplices(data: Data, formula: Formula, corners: np.ndarray) -> Known:
    """Of a formula on triangles or edges in the plane (collective where it is the first to need the distance).

    Args:
        data: Of the scene.
        formula: In the scene's names.
        corners: Shape (simplices, corners, 2).
    """
    count, scene = len(corners), data.scene
    if data.uniform(formula):
        value = np.full(count, scene.at_points(formula, np.zeros((3, 1)))[0])
        return Known(value, value, np.zeros(count, dtype=int))
    distance = data.boundary_distance if "distance" in scene.needs(formula) else None
    found = Known(np.empty(count), np.empty(count), np.empty(count, dtype=int))
    for block in blocks(count):
        cells = Cells(scene, corners[block], distance)
        bounds = cells.enclosure(formula)
        lower, upper = np.where(bounds.defined, bounds.lower, -np.inf), np.where(bounds.defined, bounds.upper, np.inf)
        degree = np.where(bounds.whole & bounds.finite, bounds.degree, NO_POLYNOMIAL)
        degree = np.where(degree > polynomials.MAX_DEGREE, NO_POLYNOMIAL, degree)
        for d in np.unique(degree[degree < NO_POLYNOMIAL]):
            inside = np.flatnonzero(degree == d)
            low, high = polynomials.bounds(cells.values(formula, int(d), inside), corners.shape[1], int(d))
            lower[inside], upper[inside] = np.maximum(lower[inside], low), np.minimum(upper[inside], high)
        found.lower[block], found.upper[block], found.degree[block] = lower, upper, degree
    return found

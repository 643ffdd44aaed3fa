"""What is known of data on whole cells and edges, without sampling."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.effects.field import NO_POLYNOMIAL, Field
from fenicsx_obstacle.estimation import polynomials
from fenicsx_obstacle.estimation.quadrature import blocks
from fenicsx_obstacle.estimation.triangles import Triangles


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


def in_cells(triangles: Triangles, value: Field) -> Known:
    """Of a value on the owned cells (collective where it is the first to need the distance)."""
    count = len(triangles.area)
    found = Known(np.zeros(count), np.zeros(count), np.full(count, NO_POLYNOMIAL))
    parts: list[tuple[Field, Any]] = [(value, np.arange(count))]
    if value.parts is not None:
        parts = [(field, triangles.data.level.groups[name]) for name, field in value.parts.items()]
    for field, cells in parts:
        for name, values in vars(on_simplices(triangles.data, field, triangles.x[cells], cells)).items():
            getattr(found, name)[cells] = values
    return found


def on_simplices(data: Data, field: Field, corners: np.ndarray, cells: np.ndarray) -> Known:
    """Of a datum on triangles or edges in the plane (collective where it is the first to need the distance).

    Args:
        data: Of the problem.
        field: The datum. Of one that knows no bounds a value in the middle stands for them: it is sampled.
        corners: Shape (simplices, corners, 2).
        cells: The owned cell that each is, or is an edge of.
    """
    count, names = len(corners), data.names(field)
    if field.uniform:
        value = np.full(count, field.at(np.zeros((3, 1)), names)[0])
        return Known(value, value, np.zeros(count, dtype=int))
    here = data.here(field)
    found = Known(np.empty(count), np.empty(count), np.empty(count, dtype=int))
    for block in blocks(count):
        known = here.over(corners[block], names)
        if known is None:
            x = np.zeros((3, block.stop - block.start))
            x[:2] = corners[block].mean(axis=1).T
            found.lower[block] = found.upper[block] = here.at(x, names, cells[block])
            found.degree[block] = NO_POLYNOMIAL
            continue
        bounds = known.enclosure()
        lower, upper = np.where(bounds.defined, bounds.lower, -np.inf), np.where(bounds.defined, bounds.upper, np.inf)
        degree = np.where(bounds.whole & bounds.finite, bounds.degree, NO_POLYNOMIAL)
        degree = np.where(degree > polynomials.MAX_DEGREE, NO_POLYNOMIAL, degree)
        for d in np.unique(degree[degree < NO_POLYNOMIAL]):
            inside = np.flatnonzero(degree == d)
            low, high = polynomials.bounds(known.values(int(d), inside), corners.shape[1], int(d))
            lower[inside], upper[inside] = np.maximum(lower[inside], low), np.minimum(upper[inside], high)
        found.lower[block], found.upper[block], found.degree[block] = lower, upper, degree
    return found

"""Surfaces of measured data: heights at points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

EDGE = 1e-9  # of its size: how far outside the data a point may lie
AT_ONCE = 2_000_000  # values of a table that are looked at together


class Surface(ABC):
    """Piecewise polynomial values over a part of the plane or the line.

    Attributes:
        low: Least coordinates that it covers, shape (2,).
        high: Largest coordinates.
        spacing: Distance of neighbouring data, the median of all.
    """

    low: np.ndarray
    high: np.ndarray
    spacing: float

    @abstractmethod
    def at(self, points: np.ndarray) -> np.ndarray:
        """Heights at points, shape (n, 2); not-a-number outside."""


def runs(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Items counted row by row: the row of each item, its number within the row, and where rows start."""
    starts = np.cumsum(counts) - counts
    rows = np.repeat(np.arange(len(counts)), counts)
    return rows, np.arange(len(rows)) - starts[rows], starts


def parts(counts: np.ndarray) -> Iterator[slice]:
    """Slices of rows that have `AT_ONCE` items at most, or one row."""
    ends, start = np.cumsum(counts), 0
    while start < len(counts):
        before = ends[start - 1] if start else 0
        end = max(start + 1, int(np.searchsorted(ends, before + AT_ONCE, "right")))
        yield slice(start, end)
        start = end

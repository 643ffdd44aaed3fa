"""The contact nodes of an elastic body: forces, moments, ends of the contact set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenicsx_obstacle.errors import InputError


@dataclass(frozen=True, eq=False)
class ContactTable:
    """The contact nodes of all ranks, in the order of their coordinates; the same arrays on every rank.

    Attributes:
        points: Coordinates, shape (n, gdim).
        normals: Unit normals N_i, shape (n, gdim).
        areas: D_i, the area (in the plane the length) that belongs to a node, with the factor of the measure.
        pressure: Contact pressure p_i: >= 0 at the lower obstacle, <= 0 at the upper obstacle.
        gap: Distance to the nearest obstacle along N_i. In contact it is -eps |p_i|.
    """

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    pressure: np.ndarray
    gap: np.ndarray

    @property
    def forces(self) -> np.ndarray:
        """Forces p_i D_i N_i of the obstacles on the body, shape (n, gdim)."""
        return (self.pressure * self.areas)[:, None] * self.normals

    @property
    def resultant(self) -> np.ndarray:
        """Sum of the forces, shape (gdim,)."""
        return self.forces.sum(axis=0)

    def moment(self, about: Any = None) -> np.ndarray | float:
        """Moment of the forces about a point, in the plane a number.

        Args:
            about: Point, shape (gdim,); by default the origin.
        """
        arms = self.points if about is None else self.points - np.asarray(about, dtype=float)
        if arms.shape[1] == 3:
            return np.cross(arms, self.forces).sum(axis=0)
        return float(np.sum(arms[:, 0] * self.forces[:, 1] - arms[:, 1] * self.forces[:, 0]))

    def radius_of_gyration(self, about: Any = None) -> float:
        """The square root of sum |p_i| D_i |x_i - c|^2 / sum |p_i| D_i, a length; not-a-number without contact.

        The half-width of a Hertzian contact is this length times 2 for a cylinder, and times sqrt(5/2) for a ball. The
        error of this half-width is O(h^2); a half-width from counting nodes in contact has an error of O(h).

        Args:
            about: The middle c, shape (gdim,); by default the mean of the contact points, weighted by their forces.
        """
        size = np.abs(self.pressure * self.areas)
        if size.sum() == 0:
            return np.nan
        middle = size @ self.points / size.sum() if about is None else np.asarray(about, dtype=float)
        return float(np.sqrt(size @ ((self.points - middle) ** 2).sum(axis=1) / size.sum()))

    def ends(self) -> np.ndarray:
        """The two ends of each piece of the contact set, for plane and axially symmetric bodies; shape (pieces, 2, 2).

        Near the contact of smooth surfaces the gap grows like d^(3/2) with the distance d from the contact. Therefore
        gap^(2/3) is linear. It is extrapolated to 0 from the second to the fourth node without contact. The error is
        much smaller than the distance between nodes. If contact reaches the last node of the boundary, the end is this
        node. If one of the three nodes does not exist or is in contact, the end is not-a-number.

        Raises:
            InputError: If the body is not plane.
        """
        if self.points.shape[1] != 2:
            raise InputError("ends() is for plane and axially symmetric bodies; radius_of_gyration() also for others")
        along = np.linalg.svd(self.points - self.points.mean(axis=0), full_matrices=False)[2][0]
        along = along * np.sign(along[np.argmax(np.abs(along))])
        s = self.points @ along
        order = np.argsort(s)
        s, points, gap, closed = s[order], self.points[order], self.gap[order], self.pressure[order] != 0
        steps = np.diff(np.concatenate([[False], closed, [False]]).astype(int))
        found = []
        for first, last in zip(np.flatnonzero(steps == 1), np.flatnonzero(steps == -1) - 1, strict=True):
            end = [_zero(s, gap, closed, first, -1), _zero(s, gap, closed, last, 1)]
            found.append(np.column_stack([np.interp(end, s, column) for column in points.T]))
        return np.array(found).reshape(-1, 2, 2)


def _zero(s: np.ndarray, gap: np.ndarray, closed: np.ndarray, last: int, step: int) -> float:
    """Where the gap vanishes beyond the last closed node, in the direction of a step."""
    if not 0 <= last + step < len(s):
        return float(s[last])
    rows = last + step * np.array([2, 3, 4])
    rows = rows[(rows >= 0) & (rows < len(s))]
    if len(rows) < 3 or closed[rows].any() or not (np.isfinite(gap[rows]) & (gap[rows] > 0)).all():
        return float("nan")
    slope, value = np.polyfit(s[rows], gap[rows] ** (2 / 3), 1)
    return float(-value / slope)

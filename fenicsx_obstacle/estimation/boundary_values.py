"""Facets where u is given, and the nodes of interpolants of boundary values on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Field

ROUNDED = 4e-15  # relative to the values of u: of a difference of two of them,
ROUND_OFF = 1e-14  # and of a datum and what interpolates it

DEGREE = 4  # of interpolants of boundary values
# barycentric coordinates of the nodes, times DEGREE, in the order of Bernstein coefficients
NODES = {corners: polynomials.exponents(corners, DEGREE).astype(int) for corners in (1, 2, 3, 4)}
# Bernstein coefficients from values at these nodes
TO_BERNSTEIN = {
    corners: np.linalg.inv(polynomials.evaluate(np.eye(len(nodes)), nodes / DEGREE, DEGREE).T)
    for corners, nodes in NODES.items()
}


def places(corners: int) -> dict[tuple[int, ...], int]:
    """Where each node stands."""
    return {tuple(node): n for n, node in enumerate(NODES[corners].tolist())}


@dataclass(frozen=True, eq=False)
class Facets:
    """Facets of owned cells where one part of the boundary gives u.

    Attributes:
        cells: Owned cell beside each.
        opposite: Vertex of the cell opposite to it.
        members: Its vertices in the cell, shape (facets, d).
        x: Their coordinates, shape (facets, d, d).
        ends: The nodal boundary values there, shape (facets, d).
        value: What is given.
        height: Of each cell over its facet.
        foot: Of this height, shape (facets, d).
    """

    cells: np.ndarray
    opposite: np.ndarray
    members: np.ndarray
    x: np.ndarray
    ends: np.ndarray
    value: Field
    height: np.ndarray
    foot: np.ndarray

    @property
    def arm(self) -> np.ndarray:
        """The largest distance of a facet's points from the foot of the height."""
        return np.linalg.norm(self.x - self.foot[:, None], axis=2).max(axis=1, initial=0.0)

    def of_cone(self, value: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Bounds of the gradient of cones over the facets from those of functions on these and of their slopes."""
        return np.hypot(slope, (value + self.arm * slope) / self.height)

"""The normal flux where u is given: tension du/dn, which is also the force per length by which u is held there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import cell_facets, corners, facet_vertices, sides, volumes
from fenicsx_obstacle.discrete.data import Data

Tension = Callable[[np.ndarray], np.ndarray | float]


class NormalFlux:
    """tension du/dn on both sides of a facet, outward from the cell beside it; 0 where u is free, as the equation says.

    It is the flux of the gradient there, which alone would miss the balance by O(h), and a P1 function beside it by
    which I(tension du/dn, phi_i) = a(u, phi_i) - f(phi_i) at every vertex i where u is given: all of it together is
    minus the integral of load + p, to the accuracy of the solver.
    """

    def __init__(self, data: Data, tension: Tension, u: fem.Function, support: np.ndarray):
        """Measure it (collective).

        Args:
            data: Of the solved problem.
            tension: Its values in given local cells, or one for all.
            u: Solution.
            support: a(u, phi_i) - f(phi_i) at owned dofs.
        """
        self.level, self.tension, self.u = data.level, tension, u
        level = self.level
        self._corners, self._dofs = corners(level.mesh), releases.cell_dofs(level.V)
        self._facets = cell_facets(level.mesh)
        self._given = np.zeros(len(u.x.array), dtype=bool)
        self._given[data.fixed[0]] = True
        names = {name for part in data.model.boundary if part.value is not None for name in part.on or ()}
        self._held = np.zeros(self._facets.max(initial=-1) + 1, dtype=bool)
        for facets in (level.boundary_facets, *(level.facets[name] for name in names)):
            self._held[facets] = True
        missing, lengths = fem.Function(level.V), fem.Function(level.V)
        cells, numbers, shares = sides(level.mesh, np.flatnonzero(self._held))
        members = self._members(numbers)
        dofs = np.take_along_axis(self._dofs[cells], members, axis=1)
        held = self._is_held(cells, numbers)[:, None]
        size = volumes(self._corners[cells[:, None], members])[:, None] / members.shape[1] * held
        np.add.at(missing.x.array, dofs, -size * self._outward(cells, numbers)[:, None])
        np.add.at(lengths.x.array, dofs, size * shares[:, None])
        for function in (missing, lengths):
            releases.vec(function).ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        own = level.owned
        found = lengths.x.array[:own] > 0
        self.correction = fem.Function(level.V)
        self.correction.x.array[:own][found] = (support + missing.x.array[:own])[found] / lengths.x.array[:own][found]
        self.correction.x.scatter_forward()

    def values(self, cells: np.ndarray, numbers: np.ndarray, shares: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Values on sides of facets; those of a facet inside the domain add up to what leaves it on both (local).

        Args:
            cells: Cell of each side.
            numbers: Number of the facet in it.
            shares: Share of the side in the facet, as in the integral that will be taken.
            where: Barycentric coordinates in the cells, shape (sides, points, vertices).

        Returns:
            Shape (sides, points).
        """
        correction = (where @ self.correction.x.array[self._dofs[cells]][:, :, None])[:, :, 0]
        flux = (self._outward(cells, numbers) / shares)[:, None] + correction
        return np.where(self._is_held(cells, numbers)[:, None], flux, 0.0)

    def _outward(self, cells: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """tension du/dn of the gradient in each cell, n along the surface for surfaces."""
        vertices, u = self._corners[cells], self.u.x.array[self._dofs[cells]]
        edges, rises = vertices[:, 1:] - vertices[:, :1], u[:, 1:] - u[:, :1]
        slopes = np.linalg.solve(edges @ edges.transpose(0, 2, 1), edges)  # gradients of barycentric coordinates
        slopes = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
        members = self._members(numbers)
        opposite = (np.arange(slopes.shape[1]).sum() - members.sum(axis=1))[:, None, None]
        inward = np.take_along_axis(slopes, opposite, axis=1)[:, 0]
        gradient = np.einsum("ci,cix->cx", rises, slopes[:, 1:])
        return -self.tension(cells) * np.einsum("cx,cx->c", gradient, inward) / np.linalg.norm(inward, axis=1)

    def _members(self, numbers: np.ndarray) -> np.ndarray:
        """Vertices of facets by their numbers in a cell."""
        return np.array(facet_vertices(self.level.mesh.topology.dim))[numbers]

    def _is_held(self, cells: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        given = np.take_along_axis(self._given[self._dofs[cells]], self._members(numbers), axis=1)
        return self._held[self._facets[cells, numbers]] & given.all(axis=1)

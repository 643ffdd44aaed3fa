"""The normal flux tension du/dn where u is given, which is the reaction force per length."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import cell_facets, sides
from fenicsx_obstacle.mesh.reference_cell import Reference

Tension = Callable[[np.ndarray, np.ndarray], np.ndarray | float]
Rule = tuple[np.ndarray, np.ndarray]  # weights of the vertices of a facet at points, weights of sum 1


class NormalFlux:
    """tension du/dn on both sides of a facet, outward from the cell beside it; 0 where u is free, as the equation says.

    It is the flux of the gradient there, which alone would miss the balance by O(h), and a function of V_h beside it by
    which I(tension du/dn, phi_i) = a(u, phi_i) - f(phi_i) at every node i where u is given: all of it together is
    minus the integral of load + p, to the accuracy of the solver.

    Attributes:
        correction: That function of V_h.
        lengths: int phi_i over the parts of the boundary where u is given, at owned dofs.
    """

    def __init__(
        self, data: Data, reference: Reference, rule: Rule, tension: Tension, u: fem.Function, support: np.ndarray
    ):
        """Measure it (collective).

        Args:
            data: Of the solved problem.
            reference: Of its mesh.
            rule: Of quadrature on facets.
            tension: Its values at places in local cells, or one for all.
            u: Solution.
            support: a(u, phi_i) - f(phi_i) at owned dofs.
        """
        self.level, self.reference, self.tension, self.u = data.level, reference, tension, u
        level = self.level
        self._facets = cell_facets(level.mesh)
        self._held = np.zeros(self._facets.max(initial=-1) + 1, dtype=bool)
        for facets in data.held:
            self._held[facets] = True
        cells, numbers, shares = sides(level.mesh, np.flatnonzero(self._held))
        where = reference.on_facets(numbers, rule[0])
        phi = reference.basis(level.V, where)
        sizes = reference.facet_measures(cells, numbers, rule[0]) * rule[1]
        around, own = AroundNodes(level.V, releases.cell_dofs(level.V)[cells]), level.owned
        missing = -around.sums(np.einsum("fp,fp,fpn->fn", sizes, self.outward(cells, numbers, where), phi))[:own]
        self.lengths = length = around.sums(np.einsum("fp,fpn->fn", sizes, phi) * shares[:, None])[:own]
        found = length > 1e-9 * length.max(initial=0.0)  # nodes off the facet have none, up to round-off
        self.correction = fem.Function(level.V)
        self.correction.x.array[:own][found] = (support + missing)[found] / length[found]
        self.correction.x.scatter_forward()

    def values(self, cells: np.ndarray, numbers: np.ndarray, shares: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Values on sides of facets; those of a facet inside the domain add up to what leaves it on both (local).

        Args:
            cells: Cell of each side.
            numbers: Number of the facet in it.
            shares: Share of the side in the facet, as in the integral that will be taken.
            where: Weights of the vertices of the cells, shape (sides, points, vertices).

        Returns:
            Shape (sides, points).
        """
        correction = self.reference.values(self.correction, cells, where)
        flux = self.outward(cells, numbers, where) / shares[:, None] + correction
        return np.where(self._held[self._facets[cells, numbers]][:, None], flux, 0.0)

    def outward(self, cells: np.ndarray, numbers: np.ndarray, where: np.ndarray) -> np.ndarray:
        """tension du/dn of the gradient in each cell, n along the surface for surfaces."""
        return outward_flux(self.reference, self.tension, self.u, cells, numbers, where)


def outward_flux(
    reference: Reference, tension: Tension, u: fem.Function, cells: np.ndarray, numbers: np.ndarray, where: np.ndarray
) -> np.ndarray:
    """tension du/dn of the gradient in cells, outward on their facets, shape (facets, points)."""
    slope = np.sum(reference.gradients(u, cells, where) * reference.normals(cells, numbers, where), axis=2)
    return tension(cells, where) * slope

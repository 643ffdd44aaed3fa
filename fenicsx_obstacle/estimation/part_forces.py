"""Fluxes and springs on parts of the boundary, and along curves and surfaces inside.

On a facet E of a cell T the equilibrated flux has a force like the solver's as its normal part. What r = g - k u_h is
beyond that, by Poincare's and the trace inequalities in T,

    (r - mean r, e)_E <= C ||r - mean r||_E ||grad e||_T,   C^2 = |E|/|T| P (P + 2 H/d),
    (r, e)_E <= (|E|/|T|)^(1/2) ||r||_E (||e||_T + H/d ||grad e||_T),

P being Poincare's constant of T and H the longest edge from the vertex x_E opposite to E: the integral of
div((x - x_E) e^2) over T gives ||e||_E^2 = |E|/|T| (||e||_T^2 + 2/d int e (x - x_E) . grad e). Where there is a spring,
(r, e)_E <= k^(-1/2) ||r||_E ||k^(1/2) e||_E may be less. With the weight x of axial symmetry, of which (x - x_E) . grad
is at most itself, ||e||_T^2 has the factor q = (d + 1)/d there, and H/d is H/(d q^(1/2)) in the second inequality.

The force along a facet inside is divided between its two cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenicsx_obstacle.effects.effect import Effect, OnPart
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of
from fenicsx_obstacle.estimation.oscillation import poincare
from fenicsx_obstacle.estimation.pieces import Pieces, joined
from fenicsx_obstacle.estimation.point_forces import PointForces
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.reactions import squared_norm
from fenicsx_obstacle.estimation.simplex_geometry import sizes
from fenicsx_obstacle.estimation.simplices import Simplices, integrals, reciprocals

# of facets by the dimension of the cells; a jump inside an edge is found to the length whose root counts
DIVISION = {2: Division(24, 1e-2, 1e-7), 3: Division(5, 1e-2, 1e-3)}


@dataclass(frozen=True, eq=False)
class PartForces:
    """All fluxes and springs, on the facets of owned cells; facets with obstacles are among them.

    Attributes:
        cells: The cell of each facet.
        sides: The vertex opposite to it.
        share: Of the force that the cell has: 1/2 inside.
        size: |E|.
        corners: The vertices of the facet in the cell, shape (facets, d).
        nodal: The solver's flux g and spring constant k at these, shape (2, facets, d).
        pieces: What is known of g and k; empty in one dimension, where the nodal values are all there is.
        free: Whether u is not given on the facet.
        radius: The weight of integrals at the vertices, shape (facets, d); None where they have none.
    """

    simplices: Simplices
    cells: np.ndarray
    sides: np.ndarray
    share: np.ndarray
    size: np.ndarray
    corners: np.ndarray
    nodal: np.ndarray
    pieces: tuple[Pieces, ...]
    free: np.ndarray
    radius: np.ndarray | None

    @property
    def ratio(self) -> np.ndarray:
        """The mean weight of integrals on each facet, 1 where they have none."""
        return np.ones(len(self.cells)) if self.radius is None else self.radius.mean(axis=1)

    @property
    def dofs(self) -> np.ndarray:
        """Local dofs of the vertices, shape (facets, d)."""
        return self.simplices.dofs[self.cells[:, None], self.corners]

    @property
    def springs(self) -> tuple[np.ndarray, np.ndarray]:
        """A lower bound of k on each facet, 0 at least, and an upper one."""
        nodal = self.nodal[1]
        if not self.pieces:
            return nodal[:, 0], nodal[:, 0]
        lower, upper = self.pieces[1].lower, self.pieces[1].upper
        return np.where(np.isfinite(lower), np.maximum(lower, 0.0), 0.0), np.where(np.isfinite(upper), upper, 0.0)

    def forces(self, u: np.ndarray) -> np.ndarray:
        """The solver's forces g - k u at the vertices of the cell of each facet, by the nodal rule, shape (facets, d +
        1) (local)."""
        (g, k), size = self.nodal, self.share * self.size
        weight = 1.0 if self.radius is None else self.radius
        return self._at_vertices(size[:, None] / self.simplices.dim * weight * (g - k * u[self.dofs]))

    def _at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Values at the vertices of the facets as those of their cells, 0 opposite to the facet."""
        found = np.zeros((len(self.cells), self.simplices.dim + 1))
        np.put_along_axis(found, self.corners, values, axis=1)
        return found

    def beyond(self, u: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the force of a P1 state: how far it is from its mean, and a bound of how far from another one this is
        besides; norms over each facet, shape (facets,) (local).

        Args:
            u: Its values at local dofs.
            force: The other one, as `forces` gives it.
        """
        count, dim = len(self.cells), self.simplices.dim
        if not self.pieces or not count:
            return np.zeros(count), np.zeros(count)
        corner, root = u[self.dofs], np.sqrt(self.size)
        ratio, radius = self.ratio, self.radius
        inverse = reciprocals(ratio)
        one, other = np.ones((count, dim)), force.sum(axis=1) / (self.share * self.size) * inverse
        of_flux, of_spring = self.pieces
        means = of_flux.mean(one, radius), of_spring.mean(corner, radius)
        mean = means[0] - means[1]
        (flux, flux_rest), (spring, spring_rest) = (
            pieces.distance(np.repeat(own[:, None], dim, axis=1), radius, factor)
            for pieces, own, factor in zip(self.pieces, means, (one, corner), strict=True)
        )
        # both at the same points where neither is divided
        groups = [*of_flux.groups, *of_spring.groups]
        divided = np.zeros(count, dtype=bool)
        for group in groups:
            if group.corners is not None:
                divided[group.rows] = True
        degree = max((group.degree for group in groups), default=0) + 1
        points, weights = rule(dim - 1, 2 * degree + (radius is not None))
        if radius is not None:
            weights = weights * (radius @ points.T)
        there = _undivided(of_flux, points, count) - _undivided(of_spring, points, count) * (corner @ points.T)
        together = np.sqrt(integrals((there - mean[:, None]) ** 2, weights))
        apart = np.where(divided, flux + spring, together)
        return root * apart, root * (np.sqrt(ratio) * np.abs(mean - other) + flux_rest + spring_rest)

    def lacking(
        self, u: np.ndarray, force: np.ndarray, least_tension: np.ndarray, friedrichs: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the flux lacks of the forces of a P1 state, in each owned cell, (E6) (local).

        Args:
            u: Its values at local dofs.
            force: What the flux has, as `forces` gives it.
            least_tension: A lower bound in each cell.
            friedrichs: c with ||e|| <= c times the energy norm of e.

        Returns:
            A bound of the force against functions of energy norm 1 in the cell; and one of the force per area that is
            to be weighed by `friedrichs` besides, in the norm of the cell.
        """
        simplices, dim = self.simplices, self.simplices.dim
        apart, rest = self.beyond(u, force)
        x, area = simplices.x[self.cells], simplices.area[self.cells]
        tip = x[np.arange(len(x)), self.sides]
        reach = np.linalg.norm(x - tip[:, None], axis=2).max(axis=1, initial=0.0)
        slender, constant = np.sqrt(self.size / area), poincare(x, area, weighted=self.radius is not None)
        q = 1.0 if self.radius is None else (dim + 1) / dim
        trace = slender * np.sqrt(constant * (q * constant + 2 * reach / dim))
        inside = trace * apart + reach / (dim * np.sqrt(q)) * slender * rest
        inside *= self.share / np.sqrt(least_tension[self.cells])
        outside = self.share * slender * np.sqrt(q) * rest
        with np.errstate(divide="ignore", invalid="ignore"):
            by_spring = np.sqrt(self.share) * (apart + rest) / np.sqrt(self.springs[0])
        better = by_spring < inside + friedrichs * outside
        inside, outside = np.where(better, by_spring, inside), np.where(better, 0.0, outside)
        inside, outside = np.where(self.free, inside, 0.0), np.where(self.free, outside, 0.0)
        return self._in_cells(inside), self._in_cells(outside)

    def energy(self, e: np.ndarray) -> np.ndarray:
        """A bound of the integral of k e^2 over the facets of each owned cell, e a P1 function (local)."""
        most = 1.0 if self.radius is None else self.radius.max(axis=1, initial=0.0)
        found = self.share * self.springs[1] * most * squared_norm(e[self.dofs], self.size)
        return self._in_cells(found)

    def energy_of(self, height: np.ndarray) -> np.ndarray:
        """The same for functions with bounds of their absolute values in the owned cells (local)."""
        found = self.share * self.springs[1] * self.size * self.ratio * height[self.cells] ** 2
        return self._in_cells(found)

    def _in_cells(self, values: np.ndarray) -> np.ndarray:
        """Sums over the facets of each owned cell."""
        found = np.zeros(len(self.simplices.area))
        np.add.at(found, self.cells, values)
        return found


def part_forces(
    simplices: Simplices, effects: list[Effect], points: PointForces, bearing: list[np.ndarray]
) -> PartForces:
    """The fluxes and springs among some effects, and forces at vertices (collective).

    Args:
        simplices: The owned cells.
        effects: Of facets with two data of the same kind the later one counts.
        points: Forces at points.
        bearing: Obstacles, as numbers of fields on the side opposite to each vertex, -1 where there is none: these
            sides are among the facets.
    """
    data, dim = simplices.data, simplices.dim
    shape = simplices.facets.shape
    given: list[list[tuple[Field, int, float | None]]] = [[], []]
    for effect in effects:
        if isinstance(effect, OnPart) and effect.role == "part load":
            given[0].append((effect.value, effect.part, None))
        if isinstance(effect, OnPart) and effect.role == "part reaction":
            given[1].append((effect.value, effect.part, 0.0))
    which = np.full((2, *shape), -1)
    for kind, fields in enumerate(given):
        for number, (_, part, _) in enumerate(fields):
            which[kind][simplices.on_sides(data.facets[part])] = number
    at_vertices = np.zeros(shape)
    np.add.at(at_vertices, points.at_vertices[:2], points.at_vertices[2])
    at_vertices[simplices.held] = 0.0
    cells, sides = np.nonzero((np.stack([*which, *bearing]) >= 0).any(axis=0) | (at_vertices != 0))
    corners = (sides[:, None] + np.arange(1, dim + 1)) % (dim + 1)
    x = simplices.x[cells[:, None], corners]
    outer = simplices.on_sides(data.level.boundary_facets)[cells, sides]
    nodal, pieces = np.zeros((2, len(cells), dim)), []
    for kind, fields in enumerate(given):
        found: list[tuple[np.ndarray, Pieces]] = []
        for number, (field, part, least) in enumerate(fields):
            rows = np.flatnonzero(which[kind, cells, sides] == number)
            values = data.on_part(field, part, least=least).x.array
            nodal[kind, rows] = values[simplices.dofs[cells[rows, None], corners[rows]]]
            if dim > 1:
                found.append((rows, pieces_of(data, field, x[rows], cells[rows], DIVISION[dim])))
        if dim > 1:
            pieces.append(joined(found, len(cells)))
    share = np.where(outer, 1.0, 0.5)
    nodal[0] += (at_vertices[cells, sides] / share)[:, None]
    return PartForces(
        simplices, cells, sides, share, sizes(x), corners, nodal, tuple(pieces), ~simplices.held[cells, sides],
        None if simplices.radius is None else simplices.radius[cells[:, None], corners],
    )  # fmt: skip


def _undivided(pieces: Pieces, points: np.ndarray, count: int) -> np.ndarray:
    """Values at points of facets that are no parts, 0 elsewhere, shape (facets, points)."""
    found = np.zeros((count, len(points)))
    for group in pieces.groups:
        if group.corners is None:
            found[group.rows] = group.values(points)
    return found

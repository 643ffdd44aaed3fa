"""The error bound for P1: v_h is the nodal maximum of u_h and the obstacle, plus a bound of the obstacle's excess."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, reduce
from math import sqrt

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.estimation.axial_flux import AxialFlux
from fenicsx_obstacle.estimation.cell_data import other_effects, proved, tension_of_state
from fenicsx_obstacle.estimation.certification import CellDatum, Obstacle
from fenicsx_obstacle.estimation.covered_obstacle import UNDERFLOW
from fenicsx_obstacle.estimation.element import Element, Terms
from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1, FluxP1
from fenicsx_obstacle.estimation.obstacle_excess import ObstacleExcess
from fenicsx_obstacle.estimation.quadrature import blocks
from fenicsx_obstacle.estimation.simplices import Simplices, sums
from fenicsx_obstacle.parallel import largest, smallest, total

NEGATIVE = 1e-9  # of the least foundation that holds as the tension does: it changes the energy by no more


class ElementP1(Element):
    """P1 on one mesh: what depends on mesh and data alone is made once."""

    equilibration: EquilibrationP1
    obstacles: list[ObstacleExcess]
    _degree = 1  # see `Tension.integrate_distances`

    def __init__(self, problem: Problem):
        """Sample the data, sort the corners around the vertices (collective)."""
        super().__init__(self._equilibrated(problem))
        simplices = self.simplices
        dim, cells = simplices.dim, len(simplices.area)
        self.obstacles = [ObstacleExcess(simplices, self.dirichlet, *obstacle) for obstacle in self.given_obstacles]
        if simplices.radius is not None:
            self._ring = AxialFlux(simplices)
            return
        self._spread = np.empty(cells)  # the mean of |x - middle|^2
        for block in blocks(cells):
            squares = sum(sums(part**2) for part in self._from_middle(block))
            self._spread[block] = squares / ((dim + 1) * (dim + 2))

    @staticmethod
    def _equilibrated(problem: Problem) -> EquilibrationP1:
        """Cells and flux (collective)."""
        simplices = Simplices(problem.data)
        return EquilibrationP1(simplices, tension_of_state(problem, simplices))

    def _bends(self, points: np.ndarray, cells: np.ndarray) -> np.ndarray | float:
        """Gradients of what u has in cells beside its interpolant of P1, at barycentric points (P2 on intervals)."""
        return 0.0

    def _bent(self, cells: slice) -> np.ndarray | float:
        """What mu times that gradient lets flow into cells through the facets opposite to their vertices."""
        return 0.0

    def _from_middle(self, cells: slice) -> list[np.ndarray]:
        """Coordinates of the corners less those of the middle: they are cheaper to compute than to keep."""
        x, middle = self.simplices.x[cells], self.simplices.middle[cells]
        return [x[..., k] - middle[:, k : k + 1] for k in range(self.simplices.dim)]

    def _friedrichs(self) -> float:
        """That of the tension, or that of foundations, which needs no boundary (collective)."""
        least = smallest(self.simplices.data.level.comm, self.equilibration.reaction.least)
        return min(super()._friedrichs(), 1 / sqrt(least) if least > 0 else np.inf)

    def terms(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> Terms:
        """See `Element.terms` (collective)."""
        nodal, v, beyond = self._admissible(u)
        gaps = {excess.sign: self._gap(v, excess) for excess in self.obstacles}
        mean = {sign: gap / self.simplices.area for sign, gap in gaps.items()}
        simplices = self.simplices
        flux = self.equilibration.flux(u, touches_lower, touches_upper, (mean.get(1.0), mean.get(-1.0)))
        contact = np.zeros(len(self.simplices.area))
        for sign, gap in gaps.items():
            contact += sums(flux.lower if sign > 0 else flux.upper) / (self.simplices.dim + 1) * gap
        cover = sum((excess.cover_energy for excess in self.obstacles), np.zeros(len(self.simplices.area)))
        # continued boundary values are 0 on the other edges of a triangle, but not on other facets of a tetrahedron
        continued = self.dirichlet.deviation if simplices.dim == 3 else np.zeros(len(contact))
        for side, force in zip(self.equilibration.sides, flux.contact, strict=True):
            distances, above = side.gaps(side.sign * v, continued)
            beyond.append(largest(simplices.data.level.comm, np.array([above])))
            np.add.at(contact, self.equilibration.parts.cells[side.rows], force[side.rows].sum(axis=1) * distances)
        distance, balanced = self._distance(u, flux)
        inside, outside, with_load = self._lacking(u, flux)
        moved, of_v = self._reaction_energy(v - u), self._distance(v, flux)
        height = sum((peaks.cover_height for peaks in self.obstacles), np.zeros(len(cover)))
        return Terms(
            flux=flux, distance=distance,
            balanced=np.minimum(np.sqrt(balanced) + inside, np.sqrt(distance) + with_load) ** 2,
            admissible_balanced=np.minimum(
                np.sqrt(of_v[1] + moved) + inside, np.sqrt(of_v[0] + moved) + with_load) ** 2,
            oscillation=np.minimum(self._far + inside, with_load),
            contact=contact,
            moved=self._energy(v - u) + moved,
            cover=self.tension.most * simplices.most_weight * cover + self._reaction_energy_of(height),
            raised=self._energy(v - nodal),
            penetration=self._energy(nodal - u),
            rest=self._means_squared(flux.rest), solver_rest=self._means_squared(flux.solver_rest),
            energy=self._least_energy(u), admissible=v,
            crossing=self.crossing(beyond, v), lacking=outside**2,
        )  # fmt: skip

    def energy_of(self, v: np.ndarray) -> tuple[float, float] | None:
        """See `Element.energy_of`; with tension and load, (E16) (collective)."""
        data = self.simplices.data
        if other_effects(data) or not proved(data) or data.axial:
            return None
        comm, area, load = self.simplices.data.level.comm, self.simplices.area, self.equilibration.load
        values = v[self.simplices.dofs]
        work = total(comm, sums(load.moments * values))
        rest = total(comm, load.rest * area * np.abs(values).max(axis=1, initial=0.0))
        gradient = self.simplices.gradient(v)
        bounds = self.tension.energy_below(gradient), self.tension.energy_above(gradient)
        least, most = (total(comm, energy) / 2 for energy in bounds)
        return least - work - rest, most - work + rest

    @property
    def every_obstacle(self) -> Sequence[Obstacle]:
        """See `Element.every_obstacle`."""
        return [*self.obstacles, *self.equilibration.sides]

    def data_in_cells(self) -> list[CellDatum]:
        """See `Element.data_in_cells`."""
        pieces, parts = self.equilibration.reaction.pieces, self.equilibration.parts
        round_off = -NEGATIVE / self.friedrichs**2 - UNDERFLOW
        found = [CellDatum("foundation", pieces, "foundation may be negative, infinite or undefined", least=round_off)]
        if parts.pieces:
            flux, springs = parts.pieces
            found.append(CellDatum("flux", flux, "flux may be infinite or undefined", parts.cells))
            # the mean of e^2 over a facet E of a cell T is about that over T
            slender = largest(self.simplices.data.level.comm, parts.size / self.simplices.area[parts.cells])
            least, wrong = round_off / max(slender, 1e-300), "spring may be negative, infinite or undefined"
            found.append(CellDatum("spring", springs, wrong, parts.cells, least=least))
        return [*super().data_in_cells(), *found]

    def rim_energy(self) -> np.ndarray:
        """See `Element.rim_energy`."""
        return super().rim_energy() * self.simplices.most_weight + self._reaction_energy_of(self.dirichlet.deviation)

    def _lacking(self, u: np.ndarray, flux: FluxP1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the flux lacks of the forces of foundations, fluxes and springs, (E5).

        A force in a cell is weighed by k^(-1/2), as (r, e) <= k^(-1/2) ||r|| ||k^(1/2) e||, or if its mean is 0 by
        Poincare's constant, otherwise by Friedrichs', whichever is less.

        Returns:
            A bound of it against functions of energy norm 1 in each cell; of what Friedrichs' constant weighs besides,
            in the norm of each cell; and the first again with what it lacks of the load, the two being summed before
            norms are taken: they may nearly cancel.
        """
        equilibration, least, friedrichs = self.equilibration, self.tension.least, self.friedrichs
        reaction, load = equilibration.reaction, self.oscillation
        simplices = self.simplices
        inside, outside = equilibration.parts.lacking(u, flux.force, least, friedrichs)
        if simplices.radius is not None:
            inside += load.poincare / np.sqrt(least) * self._ring.beyond(flux.normal)
        inside += equilibration.points.moved / np.sqrt(least)
        if not reaction.given:
            return inside, outside, inside + self._far
        k = reaction.least
        by_reaction = np.divide(1, np.sqrt(k), out=np.full(len(k), np.inf), where=k > 0)
        weight, local = np.minimum(load.poincare / np.sqrt(least), by_reaction), by_reaction <= friedrichs
        alone, rest = reaction.beyond(u, np.zeros(self.simplices.dofs.shape))
        together = reaction.beyond(u, load.linear(slice(None)))[0] + load.beyond
        rest += simplices.area / np.sqrt(simplices.size) * np.abs(flux.averaged)
        inside[local] += by_reaction[local] * rest[local]
        outside += np.where(local, 0.0, rest)
        together = weight * together + equilibration.points.norm / np.sqrt(least)
        return inside + weight * alone, outside, inside + together

    @cached_property
    def _far(self) -> np.ndarray:
        """Bound of ||mu^(-1/2) tau||_T, tau in balance with what load and forces at points are beyond their mean in the
        cell."""
        found = self.oscillation.norm / np.sqrt(self.tension.least)
        points = self.equilibration.points.norm / np.sqrt(self.tension.least)
        if self.tension.poincare is None:
            return found + points
        known = np.isfinite(self.tension.poincare)
        local = self.tension.poincare[known] * self.equilibration.load.oscillation[known]
        found[known] = np.minimum(found[known], local)
        return found + points

    def _reaction_energy(self, e: np.ndarray) -> np.ndarray:
        """A bound of the energy of foundations and springs, twice, in each cell, of a P1 function."""
        return self.equilibration.reaction.energy(e) + self.equilibration.parts.energy(e)

    def _reaction_energy_of(self, height: np.ndarray) -> np.ndarray:
        """The same of functions whose absolute values are bounded in each cell."""
        most = self.equilibration.reaction.most
        return most * self.simplices.size * height**2 + self.equilibration.parts.energy_of(height)

    def _admissible(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[float]]:
        """The nodal maximum of u and the obstacles, the same of the obstacles raised, and by how much each obstacle in
        the domain may be beyond the latter (collective)."""
        data, nodal, v = self.simplices.data, u.copy(), u.copy()
        given = data.fixed[0]
        for side in self.equilibration.sides:
            for state, obstacle in ((nodal, side.nodal), (v, side.lifted)):
                inside = side.sign * np.maximum(side.sign * state, obstacle)
                inside[given] = state[given]
                state[:] = inside
        for excess in self.obstacles:
            inside = excess.sign * np.maximum(excess.sign * nodal, excess.floor)
            inside[given] = nodal[given]
            nodal[:], v = inside, excess.sign * excess.lift(excess.sign * v)
        # of two obstacles the second one may have moved the state beyond the first
        return nodal, v, [excess.beyond(excess.sign * v) for excess in self.obstacles]

    def _gap(self, v: np.ndarray, excess: ObstacleExcess) -> np.ndarray:
        """The integral of the distance of v to an obstacle over each cell; with a weight |T| times the mean."""
        corners, radius = self.simplices.dim + 1, self.simplices.radius
        nodal = (excess.sign * v - excess.nodal)[self.simplices.dofs]
        if radius is not None:
            # of the vertices, with the weight divided by its mean
            share = (radius + sums(radius)[:, None]) / ((corners + 1) * (sums(radius) / corners)[:, None])
            most = self.simplices.most_weight * self.simplices.area / self.simplices.size * excess.cover_volume
            gap = (sums(nodal * share) / corners - excess.mean + self.dirichlet.deviation) * self.simplices.area + most
            return np.maximum(gap, 0.0)
        gap = sums(nodal) / corners - excess.mean
        gap = (
            gap * self.simplices.area
            + excess.sign * self.dirichlet.volume
            + self.dirichlet.volume_rest
            + excess.cover_volume
        )
        return np.maximum(gap, 0.0)

    def _distance(self, v: np.ndarray, flux: FluxP1) -> tuple[np.ndarray, np.ndarray]:
        """||mu^(1/2) grad v - mu^(-1/2) sigma||_T^2, and with a flux in balance with the load itself.

        mu grad v is in RT0 too, of normal fluxes -mu grad v . normal: with a constant tension mu grad v - sigma is the
        gradient of Q = a . y + b |y|^2/2, y = x - middle, and its product with tau (see `oscillation`) is (f - f_0, Q).
        """
        simplices, mu, dim = self.simplices, self.equilibration.mu, self.simplices.dim
        gradient = simplices.gradient(v)
        if simplices.radius is not None:
            squares = self._ring.distances(gradient, flux.normal, self.tension)
            return squares, (np.sqrt(squares) + self._far) ** 2
        pulled = self.equilibration.pulled(gradient)
        across, gathered, squares = np.empty(gradient.shape), np.empty(len(mu)), np.empty(len(mu))
        for block in blocks(len(mu)):
            outward = flux.normal[block] + simplices.along_normals(pulled[:, block], block) + self._bent(block)
            gathered[block] = sums(outward)
            found = gathered[block] ** 2 * self._spread[block]
            for along, part in zip(across, self._from_middle(block), strict=True):
                np.einsum("ci,ci->c", outward, part, out=along[block])
                found += along[block] ** 2
            np.divide(found, dim**2 * simplices.area[block] * mu[block], out=squares[block])

        def fields(cells: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            sigma = simplices.flux_fields(flux.normal[cells], points, cells)
            return np.broadcast_to(gradient[:, cells].T[:, None], sigma.shape) + self._bends(points, cells), sigma

        self.tension.integrate_distances(squares, fields, self._degree)
        load, points = self.oscillation, self.equilibration.points
        if self.equilibration.load.pieces is None and not points.given:
            return squares, squares
        product = np.einsum("xc,xc->c", across, load.first + points.first)
        product -= gathered * (load.second + points.second) / 2
        near, far = np.sqrt(squares), self._far
        balanced = squares - 2 * product / (dim * simplices.area * mu) + 2 * near * load.rest / np.sqrt(mu) + far**2
        return squares, np.where(self.tension.varies, (near + far) ** 2, np.maximum(balanced, 0.0))

    def _energy(self, e: np.ndarray) -> np.ndarray:
        """Upper bound of ||mu^(1/2) grad e||_T^2."""
        simplices, squares = self.simplices, np.zeros(len(self.simplices.area))
        cells = np.flatnonzero(reduce(np.logical_or, (e != 0)[simplices.dofs].T))
        squares[cells] = self.tension.energy_above(simplices.gradient(e, cells), cells)
        return squares

    def _least_energy(self, u: np.ndarray) -> np.ndarray:
        """A lower bound of ||mu^(1/2) grad u||_T^2."""
        return self.tension.energy_below(self.simplices.gradient(u))

    def _means_squared(self, rest: np.ndarray) -> np.ndarray:
        """||.||_T^2 of the means in cells of nodal values."""
        means = sums(rest[self.simplices.dofs]) / (self.simplices.dim + 1)
        return self.simplices.area * (self.simplices.area / self.simplices.size) * means**2

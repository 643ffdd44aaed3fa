"""P2 with contact at the middles of edges.

The multiplier, linear in each cell, may be negative near the free boundary: lambda_+ is what of it is left when its
slope is reduced there, and the difference, of mean zero, counts like the oscillation of the load. And v is u_h with,
where the obstacle is higher, the difference added, on a lattice of each cell: at vertices nothing holds u_h, so that it
is below the obstacle however small eps is.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.cell_data import obstacles_of
from fenicsx_obstacle.estimation.element import Element, Terms
from fenicsx_obstacle.estimation.exactness import in_cells
from fenicsx_obstacle.estimation.flux_p2 import EquilibrationP2, FluxP2
from fenicsx_obstacle.estimation.peaks import DENSE
from fenicsx_obstacle.estimation.polynomials import coefficients, inner_points, round_off
from fenicsx_obstacle.estimation.rim import Rim
from fenicsx_obstacle.estimation.rt1 import GRAMS, MASS, metric, quadratics, reference_fields
from fenicsx_obstacle.estimation.triangles import Triangles, lattice, lattice_cells, with_ghosts
from fenicsx_obstacle.parallel import total

SPARSE = 4  # parts of an edge where obstacles are looked at first
NEAR = 0.25  # of the range of a gap over a cell: where it comes so near to 0 the cell is sampled densely
POINTS, SMALL = lattice(DENSE), np.array(lattice_cells(DENSE))


def _slopes() -> np.ndarray:
    """Derivatives along the reference axes in each small triangle from values on the lattice, (small, 2, points)."""
    found = np.zeros((len(SMALL), 2, len(POINTS)))
    for number, corner in enumerate(SMALL):
        x = POINTS[corner, 1:]
        J = np.array([x[1] - x[0], x[2] - x[0]])
        to = np.array([[-1.0, 1, 0], [-1, 0, 1]])
        found[number][:, corner] = np.linalg.solve(J, to)
    return found


def _means() -> np.ndarray:
    """Means of the functions of RT1 over the small triangles, shape (small, 2, 8)."""
    corner = POINTS[SMALL]
    middles = (corner + corner[:, [1, 2, 0]]) / 2  # the rule there is exact for degree 2
    fields = reference_fields(middles.reshape(-1, 3)).reshape(8, len(SMALL), 3, 2)
    return np.moveaxis(fields.mean(axis=2), 0, 2)


def _number(x: float, y: float) -> int:
    """Place in the lattice of the point with these reference coordinates."""
    return int(np.argmin(np.abs(POINTS[:, 1:] - (x, y)).sum(axis=1)))


SLOPES, MEANS = _slopes(), _means()
NODES = [_number(*x) for x in ((0, 0), (1, 0), (0, 1), (0.5, 0.5), (0, 0.5), (0.5, 0))]  # those of P2 in the lattice
SHARES = np.bincount(SMALL.ravel(), minlength=len(POINTS)) / (3 * len(SMALL))  # weights on the lattice


class LatticeObstacle:
    """One obstacle on a lattice of the cells that u may touch; heights count away from it: times -1 for an upper one.

    Attributes:
        sign: 1 for a lower obstacle, -1 for an upper one.
        surprise: 0: it is compared with u on a lattice wherever they may touch.
        sampled: Whether they were compared so anywhere, on any rank.
        unbounded: Whether it may be infinite in each cell, on the side of the state.
    """

    def __init__(self, triangles: Triangles, sign: float, field: Field):
        """See what is known of it in the cells (collective)."""
        self.triangles, self.sign, self._field = triangles, sign, field
        self.surprise = 0.0
        self._known = in_cells(triangles, field)
        self.unbounded = ~np.isfinite(self._known.upper if sign > 0 else self._known.lower)
        self.sampled = False

    def above(self, u: np.ndarray, pressing: np.ndarray, rim: Rim) -> tuple[np.ndarray, np.ndarray]:
        """Cells where u may be below it or is pressed against it, and there u minus obstacle on the lattice.

        Args:
            u: Values of P2 at the nodes of cells, shape (cells, 6).
            pressing: Whether a cell has a multiplier.
            rim: What boundary values add to u (collective).
        """
        near = pressing | ~self._known.exact
        sampled = np.flatnonzero(~self._known.exact & ~pressing)
        gap = self._gap(u, lattice(SPARSE), sampled)
        least = gap.min(axis=1, initial=np.inf)
        near[sampled] = (least <= NEAR * np.ptp(gap, axis=1)) | (least - rim.dip[sampled] <= 0)
        for degree, cells in self._known.degrees():
            degree = max(degree, 2)
            gap = self._gap(u, inner_points(3, degree), cells)
            room = round_off(np.abs(u[cells]).max(axis=1, initial=0.0)[:, None] + np.abs(gap), 3, degree)
            near[cells] |= coefficients(gap, 3, degree).min(axis=1) - rim.dip[cells] < -room
        cells = np.flatnonzero(near)
        self.sampled = total(self.triangles.data.level.comm, len(cells) + len(sampled)) > 0
        return cells, self._gap(u, POINTS, cells) + self.sign * rim.cones(cells, POINTS)

    def _gap(self, u: np.ndarray, where: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """How far u is from the obstacle at barycentric points, without what boundary values add."""
        return self.sign * (u[cells] @ quadratics(where) - self.triangles.values(self._field, where, cells))


class ElementP2(Element):
    """P2 on one mesh: what depends on mesh and data alone is made once."""

    equilibration: EquilibrationP2
    obstacles: list[LatticeObstacle]

    def __init__(self, problem: Problem):
        """Sample the data, sort the corners around the vertices (collective)."""
        assert problem.level.coarse is not None
        triangles = Triangles(problem.data.on(problem.level.coarse))
        equilibration = EquilibrationP2(triangles, problem.data)
        super().__init__(equilibration, problem.data.fixed[1].x.array[equilibration.nodes[:, 3:]])
        self.problem = problem
        self.obstacles = [LatticeObstacle(triangles, *obstacle) for obstacle in obstacles_of(problem.data)]
        self._metric = metric(triangles.x[:, 1] - triangles.x[:, 0], triangles.x[:, 2] - triangles.x[:, 0],
                              triangles.area, np.ones(len(triangles.area)))  # fmt: skip

    def terms(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> Terms:
        """See `Element.terms` (collective)."""
        equilibration, area = self.equilibration, self.triangles.area
        flux = equilibration.flux(u, touches_lower, touches_upper)
        added, contact, reduced = self._lifted(u[equilibration.nodes], flux)
        lifted = np.flatnonzero(added.any(axis=1))
        slopes = np.einsum("sxp,cp->csx", SLOPES, added[lifted])
        moved, product = np.zeros(len(area)), np.zeros(len(area))
        moved[lifted] = self._energy_on_lattice(slopes, lifted)
        difference = flux.moments - equilibration.membrane(u)
        means = np.einsum("sxi,ci->csx", MEANS, difference[lifted])
        product[lifted] = np.einsum("csx,csx->c", slopes, means) / (2 * len(SMALL))
        distance = self._distance(u, flux, difference)
        of_v = np.where(self.tension.varies, (np.sqrt(distance) + np.sqrt(moved)) ** 2, distance - 2 * product + moved)
        v = u.copy()
        v[equilibration.nodes] += added[:, NODES]
        rest = area * np.einsum("cj,jk,ck->c", flux.rest, MASS, flux.rest)
        none = np.zeros(len(area))
        return Terms(
            flux=flux, distance=distance, admissible_distance=np.maximum(of_v, 0.0),
            oscillation=equilibration.load.oscillation + reduced, contact=contact,
            moved=moved, cover=none, raised=none, penetration=self._energy(self._penetration()),
            rest=rest, solver_rest=rest, energy=self._energy(u), admissible=v, crossing=0.0,
        )  # fmt: skip

    def _lifted(self, nodal: np.ndarray, flux: FluxP2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What is added to u on the lattice so that it is above the obstacles (collective).

        Args:
            nodal: Values of u at the nodes of cells.
            flux: With the multipliers.

        Returns:
            It; int lambda_+ (v - obstacle); and ||lambda - lambda_+||_T.
        """
        area, count = self.triangles.area, len(self.triangles.area)
        added, contact, reduced = np.zeros((count, len(POINTS))), np.zeros(count), np.zeros(count)
        for side in self.obstacles:
            pressure = flux.lower if side.sign > 0 else flux.upper
            mean = pressure.mean(axis=1)
            at_vertices = pressure.sum(axis=1)[:, None] - 2 * pressure
            least = at_vertices.min(axis=1)
            kept = np.where(least < 0, mean / np.maximum(mean - least, 1e-300), 1.0)
            reduced += (1 - kept) * np.sqrt(area / 3 * ((pressure - mean[:, None]) ** 2).sum(axis=1))
            cells, gap = side.above(nodal, pressure.any(axis=1), self.rim)
            added[cells] += side.sign * np.maximum(-gap, 0.0)
            positive = mean[:, None] + kept[:, None] * (at_vertices - mean[:, None])
            weight = np.maximum(positive[cells] @ POINTS.T, 0.0) * np.maximum(gap, 0.0)
            contact[cells] += area[cells] * (weight @ SHARES)
        return added, contact, reduced

    def _energy_on_lattice(self, slopes: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad||_T^2, mu being the largest tension, from derivatives along the reference axes."""
        area = self.triangles.area[cells]
        g = self._metric[:, cells] * 2 * area  # J^T J / det J, times det J
        squares = (g[2] * (slopes[..., 0] ** 2).sum(1) - 2 * g[1] * (slopes[..., 0] * slopes[..., 1]).sum(1)
                   + g[0] * (slopes[..., 1] ** 2).sum(1)) / (2 * area) ** 2  # fmt: skip
        return self.tension.most[cells] * squares * area / len(SMALL)

    def _distance(self, u: np.ndarray, flux: FluxP2, difference: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad u_h - mu^(-1/2) sigma||_T^2, from the moments of the difference with the mean tension."""
        triangles, mu = self.triangles, self.equilibration.mu
        squares = np.einsum("kc,kij,ci,cj->c", self._metric / mu, GRAMS, difference, difference, optimize=True)
        gradient = self.equilibration.gradients(u)

        def fields(cells: np.ndarray | slice, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            x = triangles.x[cells]
            J = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=2)
            reference = np.einsum("ipx,ci->cpx", reference_fields(points), flux.moments[cells])
            sigma = np.einsum("cyx,cpx->cpy", J, reference) / (2 * triangles.area[cells])[:, None, None]
            return np.einsum("xck,pk->cpx", gradient[:, cells], points), sigma

        self.tension.integrate_distances(squares, fields)
        return squares

    def _energy(self, e: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad e||_T^2."""
        gradient = self.equilibration.gradients(e)
        products = np.einsum("xcj,jk,xck->c", gradient, MASS, gradient, optimize=True)
        return self.tension.mean * self.triangles.area * products

    def _penetration(self) -> np.ndarray:
        """How far u is beyond an obstacle at the middles, between them its mean: what a smaller eps makes smaller."""
        gaps, equilibration = self.problem.gaps(), self.equilibration
        below, above = (np.maximum(-np.where(np.isfinite(gap), gap, 0.0), 0.0) for gap in gaps)
        beyond = with_ghosts(self.problem.level.V, below - above)
        middles = beyond[equilibration.nodes[:, 3:]]
        around = np.zeros((len(middles), 6))
        around[:, :3] = (middles.sum(axis=1, keepdims=True) - middles) / 2
        flags = np.zeros_like(around)
        flags[:, :3] = 1.0
        sums, counts = equilibration.summed(around), equilibration.summed(flags)
        found = np.where(counts > 0, sums / np.maximum(counts, 1.0), beyond)
        found[self.problem.data.fixed[0]] = 0.0
        return found

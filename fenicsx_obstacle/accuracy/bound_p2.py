"""The error bound of `bound` for P2 with contact at the middles of edges.

    ||e||^2 <= (sigma - mu grad v, grad e) + int lambda_+ (v - lower) + int nu_+ (upper - v)
             + (f - Pi_1 f + lambda - lambda_+ - nu + nu_+, e) - (rho, e),

e = u - v, with the flux of `flux_p2`. Two things are new. The multiplier, linear in each cell, may be negative near the
free boundary: lambda_+ is what of it is left when its slope is reduced there, and the difference, of mean zero, counts
like the oscillation of the load. And v is u_h with, where the obstacle is higher, the difference added, on a lattice of
each cell: at vertices nothing holds u_h, so that it is below the obstacle however small eps is.
"""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, pi, sqrt

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.accuracy.bound import Bound, Estimator
from fenicsx_obstacle.accuracy.contact import TOUCHES
from fenicsx_obstacle.accuracy.exactness import in_cells
from fenicsx_obstacle.accuracy.flux_p2 import Equilibration2, Flux2
from fenicsx_obstacle.accuracy.friedrichs import friedrichs
from fenicsx_obstacle.accuracy.peaks import DENSE
from fenicsx_obstacle.accuracy.polynomials import coefficients, inner_points, round_off
from fenicsx_obstacle.accuracy.rim import Rim
from fenicsx_obstacle.accuracy.rt1 import GRAMS, MASS, metric, quadratics, reference_fields
from fenicsx_obstacle.accuracy.scope import refuse_no_bound
from fenicsx_obstacle.accuracy.triangles import Triangles, lattice, lattice_cells
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total

SPARSE = 4  # parts of an edge where obstacles are looked at first
NEAR = 0.25  # of the range of a gap over a cell: where it comes so near to 0 the cell is sampled densely
POINTS, SMALL = lattice(DENSE), np.array(lattice_cells(DENSE))
_SAME = DENSE * (DENSE + 1) // 2  # of the small triangles; the others are turned round


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


SLOPES, MEANS = _slopes(), _means()
SHARES = np.bincount(SMALL.ravel(), minlength=len(POINTS)) / (3 * len(SMALL))  # weights on the lattice


class _Side:
    """One obstacle: its samples; heights count away from it (times -1 for an upper one)."""

    def __init__(self, triangles: Triangles, field: Field, sign: float):
        self.sign, self.field, self.triangles = sign, field, triangles
        self.surprise = 0.0
        self._known = in_cells(triangles, field)
        self.unbounded = ~np.isfinite(self._known.upper if sign > 0 else self._known.lower)
        self.sampled = False  # on a lattice u_h and obstacle are compared wherever they may touch

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
        return self.sign * (u[cells] @ quadratics(where) - self.triangles.values(self.field, where, cells))


class Estimator2(Estimator):
    """Bounds on one problem of P2: what depends on mesh and data alone is made once."""

    def __init__(self, problem: Problem):
        """Sample the data, sort the corners around the vertices (collective).

        Raises:
            InputError: If the scene has other effects than tension and load, or is not plane.
        """
        self.problem, level, model = problem, problem.level, problem.model
        refuse_no_bound(problem)
        others = [effect.key for effect in model.effects if effect.key not in ("tension", "load")]
        if others:
            raise InputError(f"{model.source}: with P2 the error bound is for tension and load, not for {others[0]}")
        assert level.coarse is not None
        self.triangles = triangles = Triangles(Data(model, level.coarse))
        self.equilibration2 = Equilibration2(triangles, problem.data)
        self._sample_tension_of(self.equilibration2.mu)
        values = problem.data.fixed[1].x.array
        self.rim = Rim(triangles, values[self.equilibration2.nodes[:, 3:]])
        self._rim_energy = self.rim.energy(self._mu_max)
        self.sides = [
            _Side(triangles, obstacle, sign)
            for obstacle, sign in ((model.lower, 1.0), (model.upper, -1.0))
            if obstacle is not None
        ]
        self.peaks = []
        self._metric = metric(triangles.x[:, 1] - triangles.x[:, 0], triangles.x[:, 2] - triangles.x[:, 0],
                              triangles.area, np.ones(len(triangles.area)))  # fmt: skip
        self._held = self.equilibration2.held
        self._friedrichs, self._exact_constant = friedrichs(self.triangles, self._held)
        self._least_tension = smallest(level.comm, self._mu_min)
        self._hypotheses = self._checked(self.equilibration2.load_known)

    def lend_load(self) -> None:
        """Let the problem have the load by the quadrature used here (collective)."""
        self.problem.nodal.add_forces(self.equilibration2.missing)
        self.equilibration2.missing = np.zeros_like(self.equilibration2.missing)

    def bound(self) -> Bound:
        """Of the problem's present state (collective)."""
        problem, equilibration, triangles = self.problem, self.equilibration2, self.triangles
        comm, u = problem.level.comm, problem.w.x.array + problem.reference.x.array
        flux = equilibration.flux(u, *self._touching())
        nodal = u[equilibration.nodes]
        lift, moved, crossed, contact, loose = self._lifted(nodal, flux)
        distance = flux.moments - equilibration.membrane(u)
        of_u = self._distance2(u, flux, distance)
        of_v = np.where(self._varies, (np.sqrt(of_u) + np.sqrt(moved)) ** 2, of_u - 2 * crossed(distance) + moved)
        of_v = np.maximum(of_v, 0.0)

        def norm(squares: np.ndarray) -> float:
            return sqrt(max(total(comm, squares), 0.0))

        scale = triangles.diameter / pi / np.sqrt(self._mu_min)
        oscillation = scale * (equilibration.oscillation + loose)
        rest = triangles.area * np.einsum("cj,jk,ck->c", flux.rest, MASS, flux.rest)
        algebraic = self._friedrichs / sqrt(self._least_tension) * norm(rest)
        eta_g, eta_C, W = norm(self._rim_energy), max(total(comm, contact), 0.0), norm(moved)
        squares = (np.sqrt(of_v) + oscillation) ** 2
        S = norm(squares) + algebraic + eta_g
        Su = norm((np.sqrt(of_u) + oscillation) ** 2) + algebraic + eta_g
        root = sqrt(S**2 / 4 + eta_C)
        B = S / 2 + root + eta_g
        B2 = (Su + W) / 2 + sqrt((Su + W) ** 2 / 4 + eta_C + Su * W) + eta_g
        bound, height = min(B + W, B2), norm(self._energy2(u))
        slope, each = (0.5 + S / (4 * root), 1 / root) if root > 0 else (1.0, 0.0)
        indicator = each * contact
        for times, part in ((slope, squares), (1.0, moved), (1 + slope, self._rim_energy)):
            indicator += times * part / max(norm(part), 1e-300)
        doubts = self._doubts(flux, algebraic, bound, 0.0)
        standing = self._hypotheses.standing(doubts, self.sides, bound)
        admissible = fem.Function(problem.level.V, name="admissible")
        admissible.x.array[:] = u
        admissible.x.array[equilibration.nodes] += lift
        return Bound(
            total=bound, admissible_total=B, relative=bound / height if height > 0 else None,
            discretisation=norm(of_u), penalty=norm(self._energy2(self._penetration(u))), algebraic=algebraic,
            data=hypot(norm(oscillation**2), eta_g), guaranteed=standing.guaranteed, words=standing.words,
            indicator=indicator, admissible=admissible,
        )  # fmt: skip

    def _touching(self) -> tuple[np.ndarray, np.ndarray]:
        """Whether u is at each obstacle or beyond it, at local nodes (collective)."""
        gaps, level = self.problem.gaps(), self.problem.level
        finite = [np.abs(gap[np.isfinite(gap)]) for gap in gaps]
        near = TOUCHES * max(largest(level.comm, np.concatenate(finite)), 0.0)
        found = []
        for gap in gaps:
            flags = fem.Function(level.V)
            flags.x.array[: level.owned] = gap <= near
            flags.x.scatter_forward()
            found.append(flags.x.array > 0.5)
        return found[0], found[1]

    def _lifted(
        self, nodal: np.ndarray, flux: Flux2
    ) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray], np.ndarray, np.ndarray]:
        """What is added to u so that it is above the obstacle (collective).

        Returns:
            It at the nodes of cells; ||mu^(1/2) grad||^2 in each cell; a function that gives its product with a flux of
            RT1; int lambda_+ (v - obstacle); and ||lambda - lambda_+||_T.
        """
        area, count = self.triangles.area, len(self.triangles.area)
        added, contact, loose = np.zeros((count, len(POINTS))), np.zeros(count), np.zeros(count)
        for side in self.sides:
            pressure = flux.lower if side.sign > 0 else flux.upper
            mean = pressure.mean(axis=1)
            at_vertices = pressure.sum(axis=1)[:, None] - 2 * pressure
            least = at_vertices.min(axis=1)
            kept = np.where(least < 0, mean / np.maximum(mean - least, 1e-300), 1.0)
            loose += (1 - kept) * np.sqrt(area / 3 * ((pressure - mean[:, None]) ** 2).sum(axis=1))
            cells, gap = side.above(nodal, pressure.any(axis=1), self.rim)
            added[cells] += side.sign * np.maximum(-gap, 0.0)
            positive = mean[:, None] + kept[:, None] * (at_vertices - mean[:, None])
            weight = np.maximum(positive[cells] @ POINTS.T, 0.0) * np.maximum(gap, 0.0)
            contact[cells] += area[cells] * (weight @ SHARES)
        where = np.flatnonzero(added.any(axis=1))
        slopes = np.einsum("sxp,cp->csx", SLOPES, added[where])
        moved = np.zeros(count)
        g = self._metric[:, where] * 2 * area[where]  # J^T J / det J, times det J
        det2 = (2 * area[where]) ** 2
        squares = (g[2] * (slopes[..., 0] ** 2).sum(1) - 2 * g[1] * (slopes[..., 0] * slopes[..., 1]).sum(1)
                   + g[0] * (slopes[..., 1] ** 2).sum(1)) / det2  # fmt: skip
        moved[where] = self._mu_max[where] * squares * area[where] / len(SMALL)

        def crossed(moments: np.ndarray) -> np.ndarray:
            found = np.zeros(count)
            means = np.einsum("sxi,ci->csx", MEANS, moments[where])
            found[where] = np.einsum("csx,csx->c", slopes, means) / (2 * len(SMALL))
            return found

        corners = [_number(1.0, 0.0), _number(0.0, 1.0), _number(0.0, 0.0)]
        nodes = [corners[2], *corners[:2], _number(0.5, 0.5), _number(0.0, 0.5), _number(0.5, 0.0)]
        return added[:, nodes], moved, crossed, contact, loose

    def _distance2(self, u: np.ndarray, flux: Flux2, moments: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad u_h - mu^(-1/2) sigma||_T^2."""
        triangles, mu = self.triangles, self.equilibration2.mu
        squares = np.einsum("kc,kij,ci,cj->c", self._metric / mu, GRAMS, moments, moments, optimize=True)
        gradient = self.equilibration2.gradients(u)
        for cells, points, weights, tension, divisor in self._varying:
            x = triangles.x[cells]
            J = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=2)
            fields = np.einsum("ipx,ci->cpx", reference_fields(points), flux.moments[cells])
            sigma = np.einsum("cyx,cpx->cpy", J, fields) / (2 * triangles.area[cells])[:, None, None]
            slopes = np.einsum("xck,pk->cpx", gradient[:, cells], points)
            difference = tension[..., None] * slopes - sigma
            squares[cells] = triangles.area[cells] * (
                np.einsum("cpx,cpx->cp", difference, difference) / divisor @ weights
            )
        return squares

    def _energy2(self, e: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad e||_T^2 of a function of P2."""
        gradient = self.equilibration2.gradients(e)
        products = np.einsum("xcj,jk,xck->c", gradient, MASS, gradient, optimize=True)
        return self._mu_mean * self.triangles.area * products

    def _penetration(self, u: np.ndarray) -> np.ndarray:
        """How far u is beyond an obstacle at the middles, between them its mean: what a smaller eps makes smaller."""
        gaps, level = self.problem.gaps(), self.problem.level
        beyond = fem.Function(level.V)
        for gap, sign in zip(gaps, (1.0, -1.0), strict=True):
            beyond.x.array[: level.owned] += sign * np.maximum(-np.where(np.isfinite(gap), gap, 0.0), 0.0)
        beyond.x.scatter_forward()
        middles = beyond.x.array[self.equilibration2.nodes[:, 3:]]
        around = np.zeros((len(middles), 6))
        around[:, :3] = (middles.sum(axis=1, keepdims=True) - middles) / 2
        flags = np.zeros_like(around)
        flags[:, :3] = 1.0
        sums, counts = self.equilibration2.summed(around), self.equilibration2.summed(flags)
        found = np.where(counts > 0, sums / np.maximum(counts, 1.0), beyond.x.array)
        found[self.problem.data.fixed[0]] = 0.0
        return found


def _number(x: float, y: float) -> int:
    """Place in the lattice of the point with these reference coordinates."""
    return int(np.argmin(np.abs(POINTS[:, 1:] - (x, y)).sum(axis=1)))

"""A guaranteed bound of the energy error, without constants, for the computed state and an admissible one beside it.

    ||mu^(1/2) grad(u - u_h)|| <= total,   ||mu^(1/2) grad(u - v_h)|| <= admissible_total,

u the solution of the variational inequality, u_h any P1 function with the boundary values, and v_h the nodal
maximum of u_h and the obstacle (raised by what nodes do not see), which the obstacle allows. With e = u - v_h, tested
in the inequality and with the equilibrated flux sigma and multiplier of `flux`,

    ||e||^2 <= (sigma - mu grad v_h, grad e) + int lambda (v_h - lower) + int nu (upper - v_h)
             + (f - f_0, e) - (rho, e).

It holds for any eps, any mesh, converged or not; nothing is assumed of angles, contact set or regularity.

`words` says what the bound rests on (`standing`). It is certified where nothing rests on sampling: data that are
numbers or polynomials on the cells, on a domain that is the polygon of the mesh. Other data are sampled, obstacles and
boundary values between the nodes, tension and load by quadrature: 'certified for the sampled load'. An indicator is
what does not bound the error for other reasons: effects other than tension and load, data that may be infinite, u given
nowhere, forces out of balance where Friedrichs' constant is not known.

Sources: Braess and Schoeberl (2008) for the flux; Prager and Synge's identity with a multiplier, as in Ainsworth, Oden
and Lee (1993) and Veeser (2001).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.accuracy.contact import TOUCHES
from fenicsx_obstacle.accuracy.exactness import Known, in_cells
from fenicsx_obstacle.accuracy.flux import KNOWN, SHARP, Equilibration, Flux
from fenicsx_obstacle.accuracy.friedrichs import friedrichs
from fenicsx_obstacle.accuracy.peaks import Peaks
from fenicsx_obstacle.accuracy.quadrature import rule
from fenicsx_obstacle.accuracy.rim import Rim
from fenicsx_obstacle.accuracy.scope import refuse_no_bound
from fenicsx_obstacle.accuracy.standing import Hypotheses
from fenicsx_obstacle.accuracy.triangles import Triangles, halved_rule
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total

if TYPE_CHECKING:
    from fenicsx_obstacle.accuracy.flux_p2 import Flux2

ROUND_OFF = 1e-9  # of the heights
NEGLIGIBLE = 1e-6  # of the bound: an unbalanced force so small needs no exact constant


@dataclass(frozen=True, eq=False)
class Bound:
    """A bound of the energy error ||mu^(1/2) grad(u - u_h)||, in the unit of the square root of the energy.

    Attributes:
        total: Of u_h.
        admissible_total: Of v_h.
        relative: total over the energy norm of u_h; None where that is 0.
        discretisation: What a finer mesh makes smaller: ||mu^(1/2) grad u_h - mu^(-1/2) sigma||.
        penalty: What a smaller eps makes smaller: ||mu^(1/2) grad(max(u_h, lower) - u_h)||, nodal maximum.
        algebraic: What further iterations make smaller: Friedrichs' constant times the unbalanced force.
        data: Load, obstacle and boundary values between nodes.
        guaranteed: Whether all hypotheses hold: the words are 'certified' alone.
        words: What it rests on.
        indicator: What of the bound goes with each owned cell, to first order; their sum over all ranks is about total.
        admissible: v_h.
    """

    total: float
    admissible_total: float
    relative: float | None
    discretisation: float
    penalty: float
    algebraic: float
    data: float
    guaranteed: bool
    words: str
    indicator: np.ndarray = field(repr=False)
    admissible: fem.Function = field(repr=False)

    @property
    def record(self) -> dict[str, float | bool | str | None]:
        """Its figures, as in answer.json."""
        return {key: value for key, value in vars(self).items() if key not in ("indicator", "admissible")}


class Estimator:
    """Bounds on one problem: what depends on mesh and data alone is made once."""

    def __init__(self, problem: Problem):
        """Sample the data, sort the corners around the vertices (collective).

        Raises:
            InputError: If the elements are not P1 on triangles in the plane, or there is no tension.
        """
        self.problem, level = problem, problem.level
        refuse_no_bound(problem)
        self.triangles = Triangles(problem.data)
        self.equilibration = Equilibration(self.triangles)
        self._sample_tension_of(self.equilibration.mu)
        self._held = self.equilibration.held
        self.rim = Rim(self.triangles)
        self._rim_energy = self.rim.energy(self._mu_max)
        sides = [side for side in ("lower", "upper") if getattr(problem.data, side) is not None]
        self.peaks = [Peaks(self.triangles, self.equilibration.fans, self.rim, side) for side in sides]
        x = self.triangles.x
        self._from_middle = np.ascontiguousarray(np.moveaxis(x - x.mean(axis=1, keepdims=True), 2, 0))
        self._spread = np.einsum("xci,xci->c", self._from_middle, self._from_middle) / 12
        self._oscillation = self.triangles.diameter / pi * self.equilibration.oscillation / np.sqrt(self._mu_min)
        self._friedrichs, self._exact_constant = friedrichs(self.triangles, self._held)
        self._least_tension = smallest(level.comm, self._mu_min)
        self._hypotheses = self._checked(self.equilibration.load_known)

    def lend_load(self) -> None:
        """Let the problem have the load by the quadrature used here, which sees where formulas jump (collective)."""
        self.problem.nodal.add_forces(self.equilibration.missing)
        self.equilibration.missing = np.zeros_like(self.equilibration.missing)

    def bound(self) -> Bound:
        """Of the problem's present state (collective)."""
        problem, equilibration = self.problem, self.equilibration
        comm, u = problem.level.comm, problem.w.x.array + problem.reference.x.array
        gaps = problem.gaps()
        finite = [np.abs(gap[np.isfinite(gap)]) for gap in gaps]
        near = TOUCHES * max(largest(comm, np.concatenate(finite)), 0.0)
        flux = equilibration.flux(u, gaps[0] <= near, gaps[1] <= near)
        nodal, v, crossing = self._admissible(u)
        of_u, of_v = self._distance(u, flux), self._distance(v, flux)
        contact = self._contact(v, flux)
        moved, penetrated = self._energy(v - u), self._energy(nodal - u)
        scale = self._friedrichs / sqrt(self._least_tension)
        unbalanced, algebraic = (scale * self._norm(rest) for rest in (flux.rest, flux.solver_rest))

        def norm(squares: np.ndarray) -> float:
            return sqrt(max(total(comm, squares), 0.0))

        covered = self._mu_max * sum((peaks.cover_energy for peaks in self.peaks), np.zeros(len(moved)))
        eta_g, eta_p, eta_C = norm(self._rim_energy), norm(covered), max(total(comm, contact), 0.0)
        W = norm(moved) + eta_p
        squares = (np.sqrt(of_v) + self._oscillation) ** 2
        S = norm(squares) + unbalanced + eta_g + eta_p
        Su = norm((np.sqrt(of_u) + self._oscillation) ** 2) + unbalanced + eta_g
        root = sqrt(S**2 / 4 + eta_C)
        B = S / 2 + root + eta_g + eta_p
        B2 = (Su + W) / 2 + sqrt((Su + W) ** 2 / 4 + eta_C + Su * W) + eta_g
        bound, height = min(B + norm(moved), B2), norm(self._energy(u))
        # how much of B + ||moved|| goes with a cell: its derivative, term by term
        slope, each = (0.5 + S / (4 * root), 1 / root) if root > 0 else (1.0, 0.0)
        indicator = each * contact
        for times, part in ((slope, squares), (1.0, moved), (1 + slope, covered), (1 + slope, self._rim_energy)):
            indicator += times * part / max(norm(part), 1e-300)
        doubts = self._doubts(flux, unbalanced, bound, crossing)
        standing = self._hypotheses.standing(doubts, self.peaks, bound)
        admissible = fem.Function(problem.level.V, name="admissible")
        admissible.x.array[:] = v
        between = norm(self._energy(v - nodal)) + eta_p
        data = hypot(norm(self._oscillation**2), eta_g, between, max(unbalanced - algebraic, 0.0))
        return Bound(
            total=bound, admissible_total=B, relative=bound / height if height > 0 else None,
            discretisation=norm(of_u), penalty=norm(penetrated), algebraic=algebraic, data=data,
            guaranteed=standing.guaranteed, words=standing.words,
            indicator=indicator,
            admissible=admissible,
        )  # fmt: skip

    def _admissible(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """The nodal maximum of u and the obstacles, the same of the obstacles raised, and by how much these then cross
        each other or what is given (collective)."""
        nodal, v = u.copy(), u.copy()
        given = self.problem.data.fixed[0]
        lifted = []
        for peaks in self.peaks:
            lifted.append(peaks.lift(peaks.sign * v))
            for state, obstacle in ((nodal, peaks.nodal), (v, lifted[-1])):
                inside = peaks.sign * np.maximum(peaks.sign * state, obstacle)
                inside[given] = state[given]
                state[:] = inside
        comm, crossing = self.problem.level.comm, 0.0
        for peaks, lift in zip(self.peaks, lifted, strict=True):
            beyond = largest(comm, lift - peaks.sign * v)
            if beyond > ROUND_OFF * largest(comm, np.abs(lift)):
                crossing = max(crossing, beyond)
        return nodal, v, crossing

    def _contact(self, v: np.ndarray, flux: Flux) -> np.ndarray:
        """int lambda (v - lower) + int nu (upper - v), lambda and nu being their means in each cell."""
        triangles, found = self.triangles, np.zeros(len(self.triangles.area))
        for peaks in self.peaks:
            pressure = (flux.lower if peaks.sign > 0 else flux.upper)[triangles.dofs].mean(axis=1)
            gap = (peaks.sign * v - peaks.nodal)[triangles.dofs].mean(axis=1) - peaks.mean
            gap = gap * triangles.area + peaks.sign * self.rim.volume + peaks.cover_volume
            found += pressure * np.maximum(gap, 0.0)
        return found

    def _distance(self, v: np.ndarray, flux: Flux) -> np.ndarray:
        """||mu^(1/2) grad v - mu^(-1/2) sigma||_T^2: mu grad v is in RT0 too, of normal fluxes -mu grad v . normal."""
        triangles, mu = self.triangles, self.equilibration.mu
        gradient = triangles.gradient(v)
        outward = flux.normal + triangles.along_normals(gradient * mu)
        across = np.einsum("ci,xci->xc", outward, self._from_middle)
        squares = outward.sum(axis=1) ** 2 * self._spread + across[0] ** 2 + across[1] ** 2
        squares /= 4 * triangles.area * mu
        for cells, points, weights, tension, divisor in self._varying:
            area, x = triangles.area[cells], triangles.x[cells]
            place = points @ x
            sigma = (
                np.einsum("ci,cpx->cpx", flux.normal[cells], place)
                - (np.einsum("ci,cix->cx", flux.normal[cells], x)[:, None])
            )
            difference = tension[..., None] * gradient[:, cells].T[:, None] - sigma / (2 * area)[:, None, None]
            squares[cells] = area * (np.einsum("cpx,cpx->cp", difference, difference) / divisor @ weights)
        return squares

    def _energy(self, e: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad e||_T^2."""
        triangles, squares = self.triangles, np.zeros(len(self.triangles.area))
        cells = np.flatnonzero((e != 0)[triangles.dofs].any(axis=1))
        gradient = triangles.gradient(e, cells)
        squares[cells] = (self._mu_mean * triangles.area)[cells] * (gradient[0] ** 2 + gradient[1] ** 2)
        return squares

    def _norm(self, rest: np.ndarray) -> float:
        """||.||_0 of means in cells of nodal values (collective)."""
        means = rest[self.triangles.dofs].mean(axis=1)
        return sqrt(total(self.problem.level.comm, self.triangles.area * means**2))

    def _sample_tension_of(self, mu: np.ndarray) -> None:
        """Where the tension varies within cells: points and values there, and its least, mean and largest value."""
        triangles = self.triangles
        self._mu_min = self._mu_mean = self._mu_max = mu
        self._varies = np.zeros(len(mu), dtype=bool)
        self._varying: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
        self._tension_known = Known(mu, mu, np.zeros(len(mu), dtype=int))
        value = self.problem.model.elastic.value
        parts = [value] if value.parts is None else list(value.parts.values())
        if all(part.uniform for part in parts):
            return
        known = self._tension_known = in_cells(triangles, value)
        self._mu_min, self._mu_mean, self._mu_max = mu.copy(), mu.copy(), mu.copy()
        points, weights = rule(2)
        tension = triangles.values(value, points)
        spread = np.ptp(tension, axis=1)
        sharp = spread > SHARP * np.abs(tension).max(axis=1, initial=0.0)
        sampled = ~known.exact | (known.lower <= 0)
        smooth = np.flatnonzero((spread > 0) & ~sharp & sampled)
        self._varying.append((smooth, points, weights, tension[smooth], tension[smooth]))
        points, weights = halved_rule(2)
        cells = np.flatnonzero(sharp & sampled)
        tension = triangles.values(value, points, cells)
        self._varying.append((cells, points, weights, tension, tension))
        for cells, _, weights, tension, _ in self._varying:
            self._mu_min[cells], self._mu_max[cells] = tension.min(axis=1), tension.max(axis=1)
            self._mu_mean[cells] = tension @ weights
        for degree, cells in known.degrees(1):
            cells = cells[known.lower[cells] > 0]
            # with the least tension in place of 1/tension all is polynomial, of fluxes of degree 2 at most
            points, weights = rule(2, 2 * max(degree + 1, 2))
            tension = triangles.values(value, points, cells)
            self._mu_min[cells], self._mu_max[cells] = known.lower[cells], known.upper[cells]
            self._mu_mean[cells] = tension @ weights
            self._varying.append((cells, points, weights, tension, known.lower[cells, None]))
        for cells, *_ in self._varying:
            self._varies[cells] = True
        if smallest(self.problem.level.comm, self._mu_min) <= 0:
            raise InputError(f"{value}: must be positive everywhere, not at midpoints of cells only")

    def _checked(self, load: Known) -> Hypotheses:
        """What is known of the data without sampling (collective)."""
        scale = self.triangles.diameter / pi * np.sqrt(self.triangles.area / self._mu_min)
        unseen = scale * np.where(load.exact, 0.0, load.upper - load.lower) / 2
        return Hypotheses(self.triangles, self._tension_known, load, unseen, self.rim)

    def _doubts(self, flux: Flux | Flux2, unbalanced: float, bound: float, crossing: float) -> list[str]:
        """Why the bound is an indicator, as far as it depends on the state and on effects (collective)."""
        level = self.problem.level
        effects = [effect.key for effect in self.problem.model.effects]
        doubts = [f"it knows tension and load, not {key}" for key in effects if key not in KNOWN]
        if total(level.comm, np.count_nonzero(self._held)) == 0:
            doubts.append("u is given nowhere")
        if unbalanced > NEGLIGIBLE * bound and not self._exact_constant:
            doubts.append("Friedrichs' constant is not known for such a boundary, and the load is not quite in balance")
        scale = largest(level.comm, np.abs(flux.normal))
        if flux.incompatible > 1e-8 * scale:
            doubts.append("cells overlap, or meet at a vertex alone")
        if crossing > 0:
            doubts.append(f"between the nodes the obstacles cross, by {crossing:.2g} at most")
        return doubts

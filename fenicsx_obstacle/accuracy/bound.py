"""A guaranteed bound of the energy error, without constants, for the computed state and an admissible one beside it.

    ||mu^(1/2) grad(u - u_h)|| <= total,   ||mu^(1/2) grad(u - v_h)|| <= admissible_total,

u the solution of the variational inequality, u_h any P1 function with the boundary values, and v_h the nodal
maximum of u_h and the obstacle (raised by what nodes do not see), which the obstacle allows. With e = u - v_h, tested
in the inequality and with the equilibrated flux sigma and multiplier of `flux`,

    ||e||^2 <= (sigma - mu grad v_h, grad e) + int lambda (v_h - lower) + int nu (upper - v_h)
             + (f - f_0, e) - (rho, e).

It holds for any eps, any mesh, converged or not; nothing is assumed of angles, contact set or regularity.

What is taken care of: tension and load that vary within cells, obstacles and boundary values between the nodes (all by
sampling their formulas). What is not, and makes the number an indicator that says so: effects other than tension and
load (drift, nonlinear tension), the difference between a curved domain and the polygon of the mesh, boundary values
that jump, u given nowhere, forces out of balance where Friedrichs' constant is not known. Not seen at all are peaks
narrower than the samples; tension and load are integrated by quadrature.

Sources: Braess and Schoeberl (2008) for the flux; Prager and Synge's identity with a multiplier, as in Ainsworth, Oden
and Lee (1993) and Veeser (2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.accuracy.contact import TOUCHES
from fenicsx_obstacle.accuracy.flux import KNOWN, SHARP, Equilibration, Flux
from fenicsx_obstacle.accuracy.friedrichs import friedrichs
from fenicsx_obstacle.accuracy.peaks import Peaks, Rim
from fenicsx_obstacle.accuracy.quadrature import rule
from fenicsx_obstacle.accuracy.scope import in_words, refuse_no_bound
from fenicsx_obstacle.accuracy.triangles import Triangles, halved_rule
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes.materials import Materials

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
        guaranteed: Whether all hypotheses hold.
        words: What is guaranteed, and why not more.
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
        doubts, sampled_only = self._doubts(flux, unbalanced, bound, crossing)
        admissible = fem.Function(problem.level.V, name="admissible")
        admissible.x.array[:] = v
        between = norm(self._energy(v - nodal)) + eta_p
        data = hypot(norm(self._oscillation**2), eta_g, between, max(unbalanced - algebraic, 0.0))
        return Bound(
            total=bound, admissible_total=B, relative=bound / height if height > 0 else None,
            discretisation=norm(of_u), penalty=norm(penetrated), algebraic=algebraic, data=data,
            guaranteed=not doubts, words=in_words(doubts, sampled_only),
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
        for cells, points, weights, tension in self._varying:
            area, x = triangles.area[cells], triangles.x[cells]
            place = points @ x
            sigma = (
                np.einsum("ci,cpx->cpx", flux.normal[cells], place)
                - (np.einsum("ci,cix->cx", flux.normal[cells], x)[:, None])
            )
            difference = tension[..., None] * gradient[:, cells].T[:, None] - sigma / (2 * area)[:, None, None]
            squares[cells] = area * (np.einsum("cpx,cpx->cp", difference, difference) / tension @ weights)
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
        self._varying: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
        value = next(effect.value for effect in self.problem.scene.effects if effect.key == "tension")
        parts: Sequence = list(value.parts.values()) if isinstance(value, Materials) else [value]
        if all(triangles.data.uniform(part) for part in parts):
            return
        self._mu_min, self._mu_mean, self._mu_max = mu.copy(), mu.copy(), mu.copy()
        points, weights = rule(2)
        tension = triangles.values(value, points)
        spread = np.ptp(tension, axis=1)
        sharp = spread > SHARP * np.abs(tension).max(axis=1, initial=0.0)
        smooth = np.flatnonzero((spread > 0) & ~sharp)
        self._varying.append((smooth, points, weights, tension[smooth]))
        points, weights = halved_rule(2)
        cells = np.flatnonzero(sharp)
        self._varying.append((cells, points, weights, triangles.values(value, points, cells)))
        for cells, _, weights, tension in self._varying:
            self._varies[cells] = True
            self._mu_min[cells], self._mu_max[cells] = tension.min(axis=1), tension.max(axis=1)
            self._mu_mean[cells] = tension @ weights
        if smallest(self.problem.level.comm, self._mu_min) <= 0:
            raise InputError(
                f"{value.place} = {value.text}: must be positive everywhere, not at midpoints of cells only"
            )

    def _doubts(self, flux: Flux | Flux2, unbalanced: float, bound: float, crossing: float) -> tuple[list[str], bool]:
        """What the bound does not cover (collective); whether it is the obstacle between the nodes alone."""
        level = self.problem.level
        effects = [effect.key for effect in self.problem.scene.effects]
        doubts = [f"it knows tension and load, not {key}" for key in effects if key not in KNOWN]
        if level.shape is not None and level.shape.project is not None:
            doubts.append("it is for the polygon of the mesh, not for the curved domain")
        if total(level.comm, np.count_nonzero(self._held)) == 0:
            doubts.append("u is given nowhere")
        if self.rim.torn > 0:
            doubts.append(f"boundary values jump by {self.rim.torn:.2g}, so that no u has a finite energy")
        if unbalanced > NEGLIGIBLE * bound and not self._exact_constant:
            doubts.append("Friedrichs' constant is not known for such a boundary, and the load is not quite in balance")
        scale = largest(level.comm, np.abs(flux.normal))
        if flux.incompatible > 1e-8 * scale:
            doubts.append("cells overlap, or meet at a vertex alone")
        if crossing > 0:
            doubts.append(f"between the nodes the obstacles cross, by {crossing:.2g} at most")
        others = len(doubts)
        surprise = max((peaks.surprise for peaks in self.peaks), default=0.0)
        if surprise > 0:
            doubts.append(f"its peaks within cells differ by {surprise:.2g} from sample to sample")
        return doubts, others == 0

"""A guaranteed bound of the energy error without unknown constants, for u_h and for an admissible function v_h.

    ||mu^(1/2) grad(u - u_h)|| <= total,   ||mu^(1/2) grad(u - v_h)|| <= admissible_total,

where u is the solution of the variational inequality, u_h any function of P1 or P2 with the boundary values, and v_h a
function near u_h that satisfies the constraints. With e = u - v_h as test function in the inequality, an equilibrated
flux sigma, and multipliers lambda, nu of the right sign,

    ||e||^2 <= (sigma - mu grad v_h, grad e) + int lambda (v_h - lower) + int nu (upper - v_h) + (r, e) - (rho, e),

where r has mean zero in each cell and rho is the unbalanced force. The bound holds for any eps and any mesh, whether
the iteration has converged or not; it assumes nothing of angles, contact set or regularity. The element gives sigma,
the multipliers, v_h and r: `element_p1`, `element_p2`.

Statements (E1) to (E27) of docs/bound_proofs.md prove the bound; the functions that compute them name them.

`words` says how far the bound is guaranteed (`certification`). It is 'certified' if it uses no samples: numbers,
formulas and Functions of the mesh are enclosed in each cell (`pieces`), and the domain is the polygon of the mesh. A
callable is known at its samples only: 'certified for the sampled load'. It is 'an indicator' where the error may be
larger for other reasons: effects that the proof does not cover (`flux_p1.unknown_effects`), data that may be infinite,
u given nowhere, or a boundary for which no bound of Friedrichs' constant is known.

Sources: Braess and Schoeberl (2008) for the flux; Prager and Synge's identity with a multiplier, as in Ainsworth, Oden
and Lee (1993) and Veeser (2001).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import hypot, sqrt
from typing import Any

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.discrete.contact_set import touching
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.estimation.applicability import check_bound_exists
from fenicsx_obstacle.estimation.certification import Hypotheses
from fenicsx_obstacle.estimation.element import Element, Terms
from fenicsx_obstacle.estimation.element_p1 import ElementP1
from fenicsx_obstacle.estimation.element_p2 import ElementP2
from fenicsx_obstacle.estimation.element_p2_on_intervals import ElementP2OnIntervals
from fenicsx_obstacle.estimation.flux_p1 import unknown_effects
from fenicsx_obstacle.parallel import smallest, total


@dataclass(frozen=True, eq=False)
class Bound:
    """An upper bound of the energy error ||mu^(1/2) grad(u - u_h)||, in the unit of the square root of the energy.

    u is the exact solution and u_h the computed one. With foundations and springs the bound is for
    a(u - u_h, u - u_h)^(1/2), which contains their energy.

    Attributes:
        total: The bound for u_h.
        admissible_total: The bound for the admissible function v_h.
        relative: total divided by a lower bound of the energy norm of u_h; None if this lower bound is 0.
        discretisation: Part due to the mesh: ||mu^(1/2) grad u_h - mu^(-1/2) sigma||, sigma the equilibrated flux.
        penalty: Part due to eps: ||mu^(1/2) grad(max(u_h, lower) - u_h)||, with the maximum at the contact nodes.
        algebraic: Part due to the iterations: Friedrichs' constant times the unbalanced force.
        data: Part due to load, obstacle and boundary values between the nodes.
        energy: Lower and upper bound of the energy J(u), under the assumptions that `words` states. None with effects
            other than tension and load, with P2, and if boundary values or obstacles at the boundary are not P1.
        guaranteed: Whether `words` is 'certified', so that the bound needs no further assumption.
        words: The assumptions of the bound.
        indicator: Contribution of each owned cell to the bound, to first order. Their sum over all ranks is about
            total. None for a solution that was read from files.
        admissible: v_h, a function near u_h that satisfies the constraint; None for a solution read from files.
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
    energy: tuple[float, float] | None = None
    indicator: np.ndarray | None = field(default=None, repr=False)
    admissible: fem.Function | None = field(default=None, repr=False)

    @classmethod
    def read(cls, record: Mapping[str, Any]) -> Bound:
        """The bound of a saved solution.

        Args:
            record: What answer.json has of it.
        """
        known = {one.name: record[one.name] for one in fields(cls) if one.name in record}
        if known.get("energy") is not None:
            known["energy"] = tuple(known["energy"])
        return cls(**known)

    @property
    def certified(self) -> bool:
        """Whether it is proved, as far as `words` says: for sampled data, on the polygon of the mesh."""
        return self.words.startswith("certified")

    @property
    def record(self) -> dict[str, Any]:
        """Its values, as in answer.json."""
        return {key: value for key, value in vars(self).items() if key not in ("indicator", "admissible")}


class Estimator:
    """Error bounds for one problem; parts that depend on mesh and data only are computed once."""

    def __init__(self, problem: Problem):
        """Sample the data, sort the corners around the vertices (collective).

        Raises:
            InputError: If there is no bound for the elements, the effects or the tension.
        """
        check_bound_exists(problem)
        self.problem = problem
        self._before: np.ndarray | None = None  # the forces of the problem without those of `set_load`
        self._added: np.ndarray | None = None
        if problem.model.elastic.affine:  # otherwise the tension is that of the state
            self._prepare()

    def _prepare(self) -> None:
        """Everything that depends on mesh and data (collective)."""
        problem, comm = self.problem, self.problem.level.comm
        quadratic, dim = problem.level.pair.has_p1_coarse_space, problem.level.mesh.topology.dim
        kind = ElementP1 if not quadratic else ElementP2OnIntervals if dim == 1 else ElementP2
        self.element: Element = kind(problem)
        simplices, load = self.element.simplices, self.element.equilibration.load
        held = self.element.simplices.held
        self._held_somewhere = total(comm, np.count_nonzero(held)) > 0
        self._friedrichs = self.element.friedrichs
        self._rim_energy = self.element.rim_energy()
        # the mean of what the load is beyond its polynomials is in no balance
        self._load_rest = self._friedrichs * sqrt(total(comm, simplices.size * load.rest**2))
        self._hypotheses = Hypotheses(simplices, self.element.data_in_cells(), self.element.dirichlet)

    def set_load(self, *, resolved: bool) -> None:
        """Give an affine problem the load of the quadrature used here, which resolves jumps, or its own one again
        (collective)."""
        if not self.problem.affine or resolved == (self._added is not None):
            return
        equilibration, forms, added = self.element.equilibration, self.problem.nodal_forms, self._added
        if added is None:
            self._before, self._added = forms.forces, equilibration.missing
            forms.add_forces(equilibration.missing)
            equilibration.missing = np.zeros_like(equilibration.missing)
        else:
            forms.add_forces(-added)
            forms.forces, equilibration.missing, self._added = self._before, added, None

    @property
    def sampled(self) -> bool:
        """Whether `bound` is an estimate from samples of the obstacles, an indicator; for elements that have none it
        stays a bound."""
        return self.problem.model.elastic.affine and self.element.sampled

    @sampled.setter
    def sampled(self, wanted: bool) -> None:
        if self.problem.model.elastic.affine:
            self.element.sampled = wanted and self.element.has_samples

    def bound(self) -> Bound:
        """The error bound of the problem's present state, the lesser one of (E1) with ||v_h - u_h|| and (E2)
        (collective)."""
        problem, comm = self.problem, self.problem.level.comm
        if not problem.model.elastic.affine:
            self._prepare()
        terms = self.element.terms(problem.solution().x.array, *touching(problem, self.element.reach))

        def norm(squares: np.ndarray) -> float:
            return sqrt(max(total(comm, squares), 0.0))

        unbalanced, algebraic = (self._friedrichs * norm(rest) for rest in (terms.rest, terms.solver_rest))
        lacking = self._friedrichs**2 * terms.lacking
        unbalanced += self._load_rest + norm(lacking)
        eta_g, eta_p, eta_C = norm(self._rim_energy), norm(terms.cover), max(total(comm, terms.contact), 0.0)
        moved = norm(terms.moved)
        W = moved + eta_p
        squares = terms.admissible_balanced
        S = norm(squares) + unbalanced + eta_g + eta_p
        Su = norm(terms.balanced) + unbalanced + eta_g
        error = largest_error(S, eta_C)
        B, B2 = error + eta_g + eta_p, largest_error(Su + W, eta_C + Su * W) + eta_g
        root = error - S / 2
        bound, energy_norm = min(B + moved, B2), norm(terms.energy)
        # how much of B + ||moved|| goes with a cell: its derivative, term by term
        slope, each = (0.5 + S / (4 * root), 1 / root) if root > 0 else (1.0, 0.0)
        parts = (
            (slope, squares),
            (1.0, terms.moved),
            (1 + slope, terms.cover),
            (1 + slope, self._rim_energy),
            (slope, lacking),
        )
        indicator = each * terms.contact
        for times, part in parts:
            indicator += times * part / max(norm(part), 1e-300)
        violated = self._violated(terms)
        if not np.isfinite(bound):
            violated.append("data may be undefined somewhere")
        words = self._hypotheses.words(violated, self.element.every_obstacle)
        admissible = fem.Function(problem.level.V, name="admissible")
        admissible.x.array[:] = terms.admissible
        between = norm(terms.raised) + eta_p
        energy = self.element.energy_of(terms.admissible) if eta_g == eta_p == 0.0 else None
        if energy is not None:
            energy = energy[0] - S**2 / 2 - eta_C, energy[1]
        return Bound(
            total=bound, admissible_total=B, relative=bound / energy_norm if energy_norm > 0 else None,
            discretisation=norm(terms.distance), penalty=norm(terms.penetration), algebraic=algebraic,
            data=hypot(norm(terms.oscillation**2), eta_g, between, max(unbalanced - algebraic, 0.0)),
            guaranteed=words == "certified", words=words, energy=energy, indicator=indicator, admissible=admissible,
        )  # fmt: skip

    def _violated(self, terms: Terms) -> list[str]:
        """The violated hypotheses that depend on the state and on effects (collective)."""
        known = "tension, load, foundation, flux and spring"
        elastic, comm = self.problem.model.elastic, self.problem.level.comm
        unknown = unknown_effects(self.problem.data)
        reasons = ["estimated from samples of the obstacles"] if self.sampled else []
        reasons += [f"estimated, no bound, as its proof covers {known}, not {effect.key}" for effect in unknown]
        simplices = self.element.simplices
        if simplices.radius is not None:
            on_axis = simplices.radius.sum(axis=1, keepdims=True) == simplices.radius
            held = on_axis & self.element.simplices.held
            if total(comm, np.count_nonzero(held)) > 0:
                reasons.append("u is given on the axis, where no state of finite energy keeps to a value")
            if smallest(comm, simplices.radius) < 0:
                reasons.append("cells reach across the axis")
        if not elastic.affine:
            reasons.append(f"estimated with the tension of the solution, no bound, as {elastic.key} is not linear")
        if not self.element.friedrichs_known:
            unknown_constant = "no bound of Friedrichs' constant is known for such a boundary"
            reasons.append(unknown_constant if self._held_somewhere else "u is given nowhere")
        if self.element.equilibration.apart:
            reasons.append("cells overlap, or meet in a vertex only")
        if terms.crossing > 0:
            reasons.append(
                f"no function between the obstacles is known: between the nodes they may cross each other or what is "
                f"given, by {terms.crossing:.2g} at most"
            )
        return reasons


def largest_error(S: float, eta_C: float) -> float:
    """The largest number e with e^2 <= S e + eta_C, (E1)."""
    return S / 2 + sqrt(S**2 / 4 + eta_C)

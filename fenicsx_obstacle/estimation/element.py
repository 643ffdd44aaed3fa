"""Base class of elements in the error bound: flux, admissible function, and the terms of each cell."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt

import numpy as np

from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.boundary_data import BoundaryData
from fenicsx_obstacle.estimation.cell_data import Tension, load_of, matrix_of, obstacles_of, other_effects, proved
from fenicsx_obstacle.estimation.certification import CellDatum, Obstacle
from fenicsx_obstacle.estimation.clipped import Clipped
from fenicsx_obstacle.estimation.covered_obstacle import CoveredObstacle, negligible
from fenicsx_obstacle.estimation.dirichlet_boundary import dirichlet_boundary
from fenicsx_obstacle.estimation.enclosed_data import range_of
from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1, FluxP1
from fenicsx_obstacle.estimation.flux_p2 import EquilibrationP2, FluxP2
from fenicsx_obstacle.estimation.friedrichs import friedrichs
from fenicsx_obstacle.estimation.matrix_tension import MatrixTension
from fenicsx_obstacle.estimation.oscillation import Oscillation
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.parallel import largest, smallest

MARGIN = 0.1  # of the range of u: obstacles are replaced by a limit that is so much farther away than the bound of u


@dataclass(frozen=True, eq=False)
class Terms:
    """The terms of the bound for one state u_h, mostly one value for each owned cell T. Squares of norms of functions
    contain those of foundations and springs, but for `penetration`, `raised` and `energy`.

    Attributes:
        flux: sigma, and the multipliers lambda (lower obstacle) and nu (upper).
        distance: ||mu^(1/2) grad u_h - mu^(-1/2) sigma||_T^2.
        balanced: The same with a flux that is in balance with load and multipliers themselves, not with what of them
            sigma is in balance with.
        admissible_balanced: ||mu^(1/2) grad v_h - mu^(-1/2) ..||_T^2 with that flux.
        oscillation: Bound of ||mu^(-1/2) ..||_T of the difference of the two fluxes.
        contact: int lambda_+ (v - lower) + int nu_+ (upper - v).
        moved: ||mu^(1/2) grad(v_h - u_h)||_T^2.
        cover: ||mu^(1/2) grad(v - v_h)||_T^2, v being v_h with what it lacks beside nodes where u is given.
        raised: ||mu^(1/2) grad||_T^2 of what v_h is above the nodal maximum of u_h and the obstacles.
        penetration: ||mu^(1/2) grad||_T^2 of how far u_h is beyond the obstacles at the points of contact.
        rest: ||rho||_T^2 of the force that is out of balance.
        solver_rest: ||rho||_T^2 with the data as the solver has them.
        energy: ||mu^(1/2) grad u_h||_T^2.
        admissible: v_h at local dofs.
        crossing: By how much obstacles cross each other, or what is given, between the nodes.
        lacking: As `rest`, of what foundations, fluxes and springs are beyond what the solver makes of them.
    """

    flux: FluxP1 | FluxP2
    distance: np.ndarray
    balanced: np.ndarray
    admissible_balanced: np.ndarray
    oscillation: np.ndarray
    contact: np.ndarray
    moved: np.ndarray
    cover: np.ndarray
    raised: np.ndarray
    penetration: np.ndarray
    rest: np.ndarray
    solver_rest: np.ndarray
    energy: np.ndarray
    admissible: np.ndarray = field(repr=False)
    crossing: float
    lacking: np.ndarray


class Element(ABC):
    """One finite element on one mesh: what depends on mesh and data alone is made once.

    Attributes:
        simplices: The owned cells.
        equilibration: Makes flux and multipliers.
        tension: In the cells.
        dirichlet: Boundary values between the nodes.
        oscillation: Of the load.
        held: Where u is given.
        friedrichs: c with ||e|| <= c times the energy norm of e, if e is 0 where u is given.
        friedrichs_known: Whether it is; otherwise a guess stands for it, and nothing is guaranteed.
        reach: Numbers that the solution is between, infinite where there is no obstacle or no such number is known.
        obstacles: The excess of an obstacle over its nodal interpolant.
        has_samples: Whether terms are found faster from samples of the obstacles.
        sampled: Whether that is what `terms` does: its terms are an estimate then.
    """

    equilibration: EquilibrationP1 | EquilibrationP2
    obstacles: Sequence[CoveredObstacle]
    has_samples, sampled = False, False

    def __init__(self, equilibration: EquilibrationP1 | EquilibrationP2, middles: np.ndarray | None = None):
        """Sample tension and boundary values (collective).

        Args:
            equilibration: Of this element.
            middles: See `BoundaryData`.
        """
        self.equilibration, self.simplices = equilibration, equilibration.simplices
        self.tension = tension_in_cells(equilibration)
        self.dirichlet = BoundaryData(self.simplices, middles)
        load, degree = load_of(self.simplices.data), 0 if middles is None else 1
        self.oscillation = Oscillation(self.simplices, equilibration.load, load, degree)
        equilibration.load.forget_polynomials()
        self.held = dirichlet_boundary(self.simplices)
        constant = self._friedrichs()
        self.friedrichs_known = bool(np.isfinite(constant))
        least = smallest(self.simplices.data.level.comm, self.tension.least)
        self.friedrichs = constant if self.friedrichs_known else 2 * float(self.held.sides.max()) / sqrt(least)
        self._ranges = {sign: self._range(obstacle) for sign, obstacle in obstacles_of(self.simplices.data)}
        self.reach = self._reach()
        comm, obstacles = self.simplices.data.level.comm, obstacles_of(self.simplices.data)
        self._below = max(
            (largest(comm, np.array([self.dirichlet.below(one, s)])) for s, one in obstacles), default=0.0
        )

    def _friedrichs(self) -> float:
        """The constant, infinite where none is known (collective)."""
        level = self.simplices.data.level
        least = smallest(level.comm, self.tension.least)
        return friedrichs(level, self.held, self.simplices.held) / sqrt(least)

    def _range(self, obstacle: Field) -> Pieces:
        """Bounds of an obstacle in the cells."""
        simplices = self.simplices
        return range_of(simplices.data, obstacle, simplices.x, np.arange(len(simplices.area)))

    def _reach(self) -> tuple[float, float]:
        """Bounds of the solution by comparison (collective).

        Let m be a number that no boundary value and no upper obstacle is below, w = 0 where u is given and
        a(w, v) = (f^-, v) with f^- = max(-f, 0). Then u >= m - w: as m - w <= m, max(u, m - w) satisfies the
        constraints, and with z = max(m - w - u, 0) in the inequality a(u, z) >= (f, z), so that
        a(z, z) = a(m - w - u, z) <= -(f^- + f, z) <= 0. Nor does it matter for u, if the lower obstacle is replaced by
        its maximum with such a bound: u satisfies that constraint too, and the inequality for fewer functions. With
        foundations and springs this holds for m <= 0: where z > 0 there is u < 0, so that k u z <= 0.
        """
        data, equilibration = self.simplices.data, self.equilibration
        comm, load = data.level.comm, equilibration.load
        limits = {1.0: -np.inf, -1.0: np.inf}
        others = other_effects(data)
        if not proved(data) or data.axial or any(effect.role not in ("reaction", "part reaction") for effect in others):
            return limits[1], limits[-1]
        push, pull = largest(comm, load.upper), smallest(comm, load.lower)
        least_tension = smallest(comm, self.tension.least)
        up, down = (self.held.reach(max(force, 0.0), least_tension) for force in (push, -pull))
        top = max(self.dirichlet.most, -np.inf if data.lower is None else largest(comm, data.lower.x.array))
        bottom = min(self.dirichlet.least, np.inf if data.upper is None else smallest(comm, data.upper.x.array))
        for sign in self._ranges:
            given, way = (self.dirichlet.least, down) if sign > 0 else (self.dirichlet.most, up)
            if -sign in self._ranges:
                other = self._ranges[-sign]
                given = min(given, smallest(comm, other.lower)) if sign > 0 else max(given, largest(comm, other.upper))
            if others:
                given = min(given, 0.0) if sign > 0 else max(given, 0.0)
            if np.isfinite(given) and np.isfinite(way):
                # a little farther, so that u does not touch there
                limits[sign] = given - sign * (way + MARGIN * (way + top - bottom))
        return limits[1], limits[-1]

    @property
    def given_obstacles(self) -> list[tuple[float, Field, Pieces]]:
        """The obstacles as `obstacles_of` has them, cut off beyond the reach of u, and their bounds in the cells."""
        found: list[tuple[float, Field, Pieces]] = []
        for sign, obstacle in obstacles_of(self.simplices.data):
            limit, known = self.reach[0] if sign > 0 else self.reach[1], self._ranges[sign]
            if np.isfinite(limit):
                cut = Clipped(obstacle, sign, limit)
                found.append((sign, cut, Pieces([], cut.clip(known.lower), cut.clip(known.upper), known.sampled)))
            else:
                found.append((sign, obstacle, known))
        return found

    @property
    def every_obstacle(self) -> Sequence[Obstacle]:
        """The obstacles in the domain, and those on facets."""
        return self.obstacles

    def data_in_cells(self) -> list[CellDatum]:
        """What is known of the data in the cells, those in facets among them."""
        return [
            self.tension.known(),
            CellDatum("load", self.equilibration.load.pieces, "load may be infinite or undefined"),
        ]

    def rim_energy(self) -> np.ndarray:
        """Bound of the energy, twice, of what boundary values are between the nodes, in each cell."""
        return self.dirichlet.energy(self.tension.most)

    def crossing(self, beyond: Sequence[float], v: np.ndarray) -> float:
        """By how much obstacles may be beyond the final v, or are beyond what is given, 0 if that may be round-off:
        then v is in K, (E14) (collective).

        Args:
            beyond: The same of each obstacle, but where it is covered: of two only one may be.
            v: Values of v.
        """
        comm, covers = self.simplices.data.level.comm, [obstacle.cover_height for obstacle in self.obstacles]
        most = max([*beyond, self._below], default=0.0)
        if len(covers) == 2:
            most = max(most, largest(comm, np.minimum(*covers)))
        return most if most > negligible(comm, v)[1] else 0.0

    def energy_of(self, v: np.ndarray) -> tuple[float, float] | None:
        """Bounds of the energy of a function, a(v, v)/2 - f(v) with the true data; None where there are none
        (collective).

        Args:
            v: Values at local dofs.
        """
        return None

    @abstractmethod
    def terms(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> Terms:
        """The terms of a state (collective).

        Args:
            u: Values at local dofs.
            touches_lower: Whether u is at the lower obstacle or beyond it, at owned dofs.
            touches_upper: Whether it is at the upper one or beyond it.
        """


def tension_in_cells(equilibration: EquilibrationP1 | EquilibrationP2) -> Tension:
    """The tension of a problem (collective)."""
    simplices = equilibration.simplices
    rows = matrix_of(simplices.data)
    if rows is None:
        return Tension(simplices, equilibration.mu)
    assert isinstance(equilibration, EquilibrationP1) and equilibration.matrix is not None
    return MatrixTension(simplices, rows, equilibration.matrix)

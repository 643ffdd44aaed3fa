"""What the error bound takes from a finite element: the flux, the admissible state, and the terms of each cell."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fenicsx_obstacle.estimation.cell_data import Tension
from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1, FluxP1
from fenicsx_obstacle.estimation.flux_p2 import EquilibrationP2, FluxP2
from fenicsx_obstacle.estimation.rim import Rim
from fenicsx_obstacle.estimation.standing import Obstacle


@dataclass(frozen=True, eq=False)
class Terms:
    """The terms of the bound for one state u_h, mostly one value for each owned cell T.

    Attributes:
        flux: sigma, and the multipliers lambda (lower obstacle) and nu (upper).
        distance: ||mu^(1/2) grad u_h - mu^(-1/2) sigma||_T^2.
        admissible_distance: ||mu^(1/2) grad v_h - mu^(-1/2) sigma||_T^2.
        oscillation: ||f - Pi f||_T + ||lambda - lambda_+||_T + ||nu - nu_+||_T, Pi f being what of the load sigma is in
            balance with, lambda_+ and nu_+ the parts of the multipliers that have the right sign.
        contact: int lambda_+ (v - lower) + int nu_+ (upper - v).
        moved: ||mu^(1/2) grad(v_h - u_h)||_T^2.
        cover: ||mu^(1/2) grad(v - v_h)||_T^2, v being v_h with what it lacks beside nodes where u is given.
        raised: ||mu^(1/2) grad||_T^2 of what v_h is above the nodal maximum of u_h and the obstacles.
        penetration: ||mu^(1/2) grad||_T^2 of how far u_h is beyond the obstacles at the points of contact.
        rest: ||rho||_T^2 of the force that is out of balance.
        solver_rest: The same with the load as the solver has it.
        energy: ||mu^(1/2) grad u_h||_T^2.
        admissible: v_h at local dofs.
        crossing: By how much obstacles cross each other, or what is given, between the nodes.
    """

    flux: FluxP1 | FluxP2
    distance: np.ndarray
    admissible_distance: np.ndarray
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


class Element(ABC):
    """One finite element on one mesh: what depends on mesh and data alone is made once.

    Attributes:
        triangles: The owned cells.
        equilibration: Makes flux and multipliers.
        tension: In the cells.
        rim: Boundary values between the nodes.
        obstacles: Obstacles between the nodes.
    """

    equilibration: EquilibrationP1 | EquilibrationP2
    obstacles: Sequence[Obstacle]

    def __init__(self, equilibration: EquilibrationP1 | EquilibrationP2, middles: np.ndarray | None = None):
        """Sample tension and boundary values (collective).

        Args:
            equilibration: Of this element.
            middles: See `Rim`.
        """
        self.equilibration, self.triangles = equilibration, equilibration.triangles
        self.tension = Tension(self.triangles, equilibration.mu)
        self.rim = Rim(self.triangles, middles)

    @abstractmethod
    def terms(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> Terms:
        """The terms of a state (collective).

        Args:
            u: Values at local dofs.
            touches_lower: Whether u is at the lower obstacle or beyond it, at owned dofs.
            touches_upper: Whether it is at the upper one or beyond it.
        """

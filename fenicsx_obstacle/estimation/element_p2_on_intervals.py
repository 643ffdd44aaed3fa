"""The error bound for P2 on intervals.

In a cell [x_0, x_1] of length h, u_h = u_1 + b B, where u_1 is in P1 and B = 4 psi_0 psi_1. The bound of P1 holds with
these changes: sigma is linear in each cell, as mu u_h' is, and in balance with the means of all forces, as with P1; the
forces against the hat functions are those of u_h; contact forces at middles are known in their cells; and v_h is u_h
plus what raises u_1 above the obstacle less b B (`curved_obstacle`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.cell_data import Load, obstacles_of, of_solver, tension_of
from fenicsx_obstacle.estimation.curved_obstacle import CurvedExcess
from fenicsx_obstacle.estimation.element import Terms
from fenicsx_obstacle.estimation.element_p1 import ElementP1
from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1, FluxP1
from fenicsx_obstacle.estimation.multipliers import pushes
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.reactions import Reaction
from fenicsx_obstacle.estimation.rt1 import quadratics
from fenicsx_obstacle.estimation.simplices import Simplices, sums
from fenicsx_obstacle.mesh.around_nodes import AroundNodes, with_ghosts

POINTS, WEIGHTS = rule(1, 6)  # exact for data of P2 times two functions of P2
NODAL = quadratics(POINTS)
SLOPE = 4 * (POINTS[:, 0] - POINTS[:, 1])  # h B'
SQUARE, VARIANCE = 8 / 15, 4 / 45  # mean of B^2, and of (B - mean B)^2; the mean of B is 2/3


class QuadraticReaction(Reaction):
    """A foundation under P2."""

    def __init__(self, simplices: Simplices, value: Field | None, data: Data):
        """Enclose it (collective)."""
        super().__init__(simplices, value)
        self._at_points = None if value is None else of_solver(simplices, data, value, POINTS)

    def at_nodes(self, nodal: np.ndarray) -> np.ndarray:
        """The solver's forces at the nodes of cells from u there, shape (cells, 3), and keep u (local)."""
        self._nodal = nodal
        self._forces = self._simplices.area[:, None] * ((self._at_points * (nodal @ NODAL) * WEIGHTS) @ NODAL.T)
        return self._forces

    def beyond(self, u: np.ndarray, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Reaction.beyond`; u is that of `at_nodes`."""
        root, b = np.sqrt(self._simplices.area), _bubble(self._nodal)
        corner = self._nodal[:, :2]
        if self.pieces is None:
            known, rest = super().beyond(u, linear)
            return known + root * self.most * np.abs(b) * np.sqrt(VARIANCE), rest
        means = self.pieces.mean(corner)
        known, rests = self.pieces.distance(linear + means[:, None], None, corner)
        off = means + b * (self.least + self.most) / 3 - sums(self._forces) / self._simplices.area
        rests += np.abs(off) + (self.most - self.least) / 3 * np.abs(b)
        return root * (known + self.most * np.abs(b) * np.sqrt(SQUARE)), root * rests


class EquilibrationP2OnIntervals(EquilibrationP1):
    """Equilibrated flux and multipliers of P2; `take` gives the state for what else it does."""

    def __init__(self, simplices: Simplices, data: Data):
        """Sample the load, sort the corners (collective).

        Args:
            simplices: Of P1 on the same mesh.
            data: Of P2.
        """
        self._data, self.space = data, data.level.V
        self.nodes = simplices.turned_nodes(releases.cell_dofs(self.space)[: len(simplices.area)])
        super().__init__(simplices, None)
        obstacles = data.model.lower, data.model.upper
        self._continuous = [one is not None and (one.uniform or one.continuous) for one in obstacles]
        tension = tension_of(data)
        assert tension is not None  # by `check_bound_exists`
        mu = np.broadcast_to(of_solver(simplices, data, tension, POINTS, positive=True), (len(self.mu), len(POINTS)))
        self.mu = self.pull = mu @ WEIGHTS
        self._tilt, self._stiffness = mu @ (WEIGHTS * SLOPE), mu @ (WEIGHTS * SLOPE**2)

    def take(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> np.ndarray:
        """Keep a state, values at local dofs, and return b in each cell (local)."""
        self._nodal = u[self.nodes]
        self._touches = tuple(there[self.nodes[:, 2]] > 0.5 for there in (touches_lower, touches_upper))
        return _bubble(self._nodal)

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Values at local dofs of P1 from those of P2 (local)."""
        found = np.zeros(len(self.simplices.given), dtype=values.dtype)
        found[releases.cell_dofs(self.level.V)] = values[releases.cell_dofs(self.space)[:, :2]]
        return found

    def flux(
        self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray,
        gaps: tuple[np.ndarray | None, np.ndarray | None] = (None, None),
    ) -> FluxP1:  # fmt: skip
        """See `EquilibrationP1.flux`; where mu u_h' jumps at a contact node, sigma jumps too, (E27) (collective)."""
        flux, simplices = super().flux(u, touches_lower, touches_upper, gaps), self.simplices
        outward = -simplices.along_normals(self.pulled(simplices.gradient(u)))[:, ::-1]  # at the vertices
        outward -= (4 * self.mu * _bubble(self._nodal) / simplices.area)[:, None]
        jump, half = simplices.around.sums(outward), simplices.area[:, None] / 2
        normal, spread, self.at_points = flux.normal.copy(), [], []
        for sign, multiplier, continuous in zip((1.0, -1.0), (flux.lower, flux.upper), self._continuous, strict=True):
            whole = simplices.around.sums(half * multiplier)
            share = np.clip(sign * jump, 0.0, whole) / np.where(whole > 0, whole, 1.0)
            share[simplices.given if continuous else slice(None)] = 0.0
            force = half * multiplier * share[simplices.dofs]
            normal += sign * force[:, ::-1]
            spread.append(multiplier - force / half)
            self.at_points.append(force)
        return replace(flux, lower=spread[0], upper=spread[1], normal=normal)

    def _reaction(self, foundation: Field | None) -> Reaction:
        return QuadraticReaction(self.simplices, foundation, self._data)

    def _sample_load(self) -> None:
        self.load = load = Load(self.simplices, self._data, tests=lambda points: quadratics(points).T)
        self._against_nodes = load.moments
        owned = self.space.dofmap.index_map.size_local
        self.missing = AroundNodes(self.space, self.nodes).sums(load.missing)[:owned]
        load.moments, load.missing = _hats(load.moments), _hats(load.missing)

    def _missing_at_vertices(self) -> np.ndarray:
        missing = with_ghosts(self.space, self.missing)
        middle = np.repeat(missing[self.nodes[:, 2:]] / 2, 2, axis=1)
        return self.at_vertices(missing) + self.simplices.around.sums(middle)

    def _mean_forces(self, u: np.ndarray) -> np.ndarray:
        return super()._mean_forces(u) + self._tilt * _bubble(self._nodal) / self.simplices.area

    def _all_moments(self, u: np.ndarray) -> np.ndarray:
        forces = self._against_nodes.copy()
        forces[:, :2] += self.points.moments - self.points.middle[:, None] / 2
        forces[:, 2] += self.points.middle
        if isinstance(self.reaction, QuadraticReaction) and self.reaction.given:
            forces -= self.reaction.at_nodes(self._nodal)
        self._at_middles = forces[:, 2]
        return _hats(forces)

    def _inside_cells(self) -> tuple[np.ndarray, np.ndarray]:
        slope, b = self._nodal[:, 1] - self._nodal[:, 0], _bubble(self._nodal)
        force = (self._tilt * slope + self._stiffness * b) / self.simplices.area - self._at_middles
        return pushes(force / self.simplices.area, *self._touches)


class ElementP2OnIntervals(ElementP1):
    """P2 on one mesh of intervals."""

    equilibration: EquilibrationP2OnIntervals
    _degree = 2  # mu u_h' is of higher degree than sigma where mu varies

    @staticmethod
    def _equilibrated(problem: Problem) -> EquilibrationP1:
        assert problem.level.coarse is not None
        return EquilibrationP2OnIntervals(Simplices(problem.data.on(problem.level.coarse)), problem.data)

    def terms(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> Terms:
        """See `Element.terms` (collective)."""
        own, simplices = self.equilibration, self.simplices
        touches = [with_ghosts(own.space, owned) for owned in (touches_lower, touches_upper)]
        self._bubble = own.take(u, *touches)
        linear, owned = own.at_vertices(u), simplices.data.level.owned
        self.obstacles = [
            CurvedExcess(simplices, self.dirichlet, *obstacle, linear, self._bubble)
            for obstacle in self.given_obstacles
        ]
        terms = super().terms(linear, *(own.at_vertices(there)[:owned] for there in touches))
        contact = terms.contact.copy()
        for sign, _ in obstacles_of(simplices.data):
            gap = np.maximum(sign * (terms.admissible - simplices.data.heights(sign)), 0.0)
            contact += sums(own.at_points[0 if sign > 0 else 1] * gap[simplices.dofs])
        v, dofs = u.copy(), releases.cell_dofs(own.space)
        raised = (terms.admissible - linear)[releases.cell_dofs(simplices.data.level.V)]
        v[dofs] = u[dofs] + np.column_stack([raised, raised.mean(axis=1)])
        return replace(terms, admissible=v, contact=contact)

    def energy_of(self, v: np.ndarray) -> None:
        """There are no bounds of the energy."""
        return None

    def _bends(self, points: np.ndarray, cells: np.ndarray) -> np.ndarray:
        slopes = 4 * (points[..., 0] - points[..., 1])
        return (slopes * (self._bubble / self.simplices.area)[cells, None])[..., None]

    def _bent(self, cells: slice) -> np.ndarray:
        return (4 * self.equilibration.mu * self._bubble / self.simplices.area)[cells, None]

    def _least_energy(self, u: np.ndarray) -> np.ndarray:
        gradient, area = self.simplices.gradient(u), self.simplices.area
        squares = self.tension.energy_below(gradient) + self.equilibration.mu * self._bubble**2 * 16 / (3 * area)
        linear = gradient.T[:, None]
        self.tension.least_energy(squares, lambda cells, points: linear[cells] + self._bends(points, cells))
        return squares


def _bubble(nodal: np.ndarray) -> np.ndarray:
    """b from values at the nodes of cells, shape (cells, 3)."""
    return nodal[:, 2] - (nodal[:, 0] + nodal[:, 1]) / 2


def _hats(nodal: np.ndarray) -> np.ndarray:
    """Forces against the hat functions from those against the functions of P2, shape (cells, 3)."""
    return nodal[:, :2] + nodal[:, 2:] / 2

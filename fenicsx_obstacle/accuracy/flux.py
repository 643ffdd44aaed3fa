"""Multiplier and equilibrated flux of a P1 state: what proves how far it is from the solution.

For any P1 function u_h, converged or not, nodal multipliers lambda >= 0 (lower obstacle), nu >= 0 (upper) and a rest
rho come from its residual alone, eps-free, and a flux sigma in RT0 with continuous normal parts and

    div sigma = -(f_0 + mean lambda - mean nu + mean rho)   in each cell, f_0 the mean of the load,

is found vertex by vertex as a sum of fluxes on the patches, each the nearest (in the norm of mu^(-1/2)) to the broken
RT0 interpolant of phi_i mu grad u_h. (Braess and Schoeberl 2008 for equations; the interpolant in place of phi_i mu
grad u_h itself keeps the flux near on irregular meshes.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.accuracy.exactness import in_cells, number
from fenicsx_obstacle.accuracy.fans import Fans
from fenicsx_obstacle.accuracy.quadrature import DEGREE, rule
from fenicsx_obstacle.accuracy.triangles import Triangles, halved_rule, next_, previous
from fenicsx_obstacle.discrete.data import array_of
from fenicsx_obstacle.effects.effect import Effect, residual
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.parallel import largest, total

KNOWN = ("tension", "load")
SWEEPS = 2  # along the boundary, to find a pressure where u is given and touches
SHARP = 0.1  # of the largest load: what varies so much in a cell may jump there


@dataclass(frozen=True)
class Flux:
    """Multipliers and flux; arrays of local dofs, ghosts included, or of owned cells.

    Attributes:
        lower: lambda >= 0, in the unit of the load.
        upper: nu >= 0.
        rest: rho, what no obstacle carries.
        solver_rest: The same of the solver's own load, one value per cell: 0 where it has converged.
        normal: s: sigma = sum of s_j (x - x_j)/(2 |T|) in a cell; s_j is the flux out of it opposite to vertex j.
        incompatible: Largest flux that a fan of a free vertex leaves over, 0 up to round-off.
    """

    lower: np.ndarray
    upper: np.ndarray
    rest: np.ndarray
    solver_rest: np.ndarray
    normal: np.ndarray
    incompatible: float


class Equilibration:
    """Everything about flux and multipliers that depends on mesh and data alone.

    Attributes:
        triangles: The owned cells.
        fans: Their corners around the vertices.
        mu: Tension of each cell, as the solver has it.
        others: Names of effects besides tension and load, whose terms at u_h count as a load.
        moments: int_T f phi_l, shape (cells, 3).
        oscillation: ||f - f_0||_T, shape (cells,).
        mass: int phi_i at owned vertices.
        free: Whether u is not given at an owned vertex.
        load_known: What is known of the load in the cells.
        missing: Force at owned vertices that the load's formula gives more than what the solver makes of it.
    """

    def __init__(self, triangles: Triangles):
        """Sample the load, sort the corners (collective)."""
        self.triangles, data = triangles, triangles.data
        self.level = level = data.level
        is_held = np.zeros(triangles.facets.max(initial=-1) + 1, dtype=bool)
        for facets in data.held:
            is_held[facets[facets < len(is_held)]] = True
        self.held = is_held[triangles.facets]
        self.fans = Fans(level, triangles.dofs, self.held)
        self.free = np.ones(level.owned, dtype=bool)
        fixed = data.fixed[0]
        self.free[fixed[fixed < level.owned]] = False
        tension = data.model.elastic
        self.mu = self._per_cell(array_of(data.cellwise(tension.value, positive=True)))
        self._prepare_others([effect for effect in data.model.effects if effect.key not in KNOWN])
        loads = [effect.value for effect in data.model.effects if effect.key == "load"]
        self._sample_load(loads)
        self._area = self.fans.gather(np.repeat(triangles.area[:, None] / 3, 3, axis=1))[0]
        self.mass = self.fans.at_vertices(self._area)
        less = self.moments - (self._solver_load * triangles.area / 3)[:, None]
        self.missing = self.fans.at_vertices(self.fans.gather(less)[0]) if loads else np.zeros(len(self.mass))
        x, y = triangles.x[..., 0], triangles.x[..., 1]
        scale = 1 / (4 * triangles.area * self.mu)[:, None]
        # the edge opposite to a vertex, and from each vertex to the middle of the cell
        to_x, to_y = x.mean(axis=1, keepdims=True) - x, y.mean(axis=1, keepdims=True) - y
        edge_x, edge_y = triangles.normal[1] * scale, -triangles.normal[0] * scale
        self._A = edge_x * next_(to_x) + edge_y * next_(to_y)
        self._B = edge_x * previous(to_x) + edge_y * previous(to_y)
        G = scale * (triangles.normal[0] ** 2 + triangles.normal[1] ** 2)
        self._fan_A, self._fan_B, fan_G = self.fans.gather(self._A, self._B, G)
        self._fan_G = self._over_fans(fan_G)

    def _prepare_others(self, effects: list[Effect]) -> None:
        """Their terms against the discontinuous P1 functions of single cells (collective)."""
        self.others = [effect.key for effect in effects]
        self._terms: Any = None
        if not any(effect.integrals for effect in effects):
            return
        broken = releases.functionspace(self.level.mesh, "DG", 1)
        self._u, v = fem.Function(self.level.V), ufl.TestFunction(broken)
        self._terms = releases.form(residual(effects, self._u, v, self.triangles.data))
        self._moments_of_others = fem.Function(broken)

    def _all_moments(self, u: np.ndarray) -> np.ndarray:
        """Moments of the load less those of other effects at u (collective)."""
        if self._terms is None:
            return self.moments
        self._u.x.array[:] = u
        vector = releases.vec(self._moments_of_others)
        with vector.localForm() as local:
            local.set(0.0)
        fem.petsc.assemble_vector(vector, self._terms)
        dofs = releases.cell_dofs(self._moments_of_others.function_space)[: len(self.moments)]
        return self.moments - self._moments_of_others.x.array[self.triangles.turned(dofs)]

    def _per_cell(self, values: np.ndarray) -> np.ndarray:
        """Values at local dofs of W, or the one there is, at owned cells."""
        count = len(self.triangles.area)
        if len(values) == 1 and self.level.W.dofmap.index_map.size_global != 1:
            return np.full(count, values[0])
        return values[releases.cell_dofs(self.level.W)[:count, 0]]

    def _sample_load(self, loads: list[Field]) -> None:
        """Moments, means and oscillation of the load's formula, and the moments that the solver takes."""
        triangles = self.triangles
        area = triangles.area
        self.moments, self.oscillation = np.zeros((len(area), 3)), np.zeros(len(area))
        self._solver_load = np.zeros(len(area))
        self.load_known = number(len(area))
        for value in loads:
            self._solver_load = self._per_cell(array_of(triangles.data.cellwise(value)))
            if value.uniform:
                self.moments = np.repeat((self._solver_load * area / 3)[:, None], 3, axis=1)
                continue
            known = self.load_known = in_cells(triangles, value)
            points, weights = rule(2)
            values = triangles.values(value, points)
            self._integrate(values, points, weights, slice(None))
            sizes = np.abs(values).max(axis=1, initial=0.0)
            wide = np.ptp(values, axis=1) > SHARP * largest(self.level.comm, sizes)
            sharp = np.flatnonzero(wide & ~known.exact)
            points, weights = halved_rule(2)
            self._integrate(triangles.values(value, points, sharp), points, weights, sharp)
            for degree, cells in known.degrees(DEGREE // 2 + 1):
                points, weights = rule(2, 2 * degree)
                self._integrate(triangles.values(value, points, cells), points, weights, cells)

    def _integrate(
        self, values: np.ndarray, points: np.ndarray, weights: np.ndarray, cells: np.ndarray | slice
    ) -> None:
        area = self.triangles.area[cells]
        self.moments[cells] = area[:, None] * (values @ (weights[:, None] * points))
        mean = values @ weights
        self.oscillation[cells] = np.sqrt(area * ((values - mean[:, None]) ** 2 @ weights))

    def _over_fans(self, values: np.ndarray) -> np.ndarray:
        """Sum along each fan."""
        sums = np.zeros(len(self.fans.vertex))
        for step in self.fans.steps:
            sums[: step.stop - step.start] += values[step]
        return sums

    def flux(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> Flux:
        """Multipliers and flux of a state (collective).

        Args:
            u: Values at local dofs.
            touches_lower: Whether u is at the lower obstacle or beyond it, at owned dofs.
            touches_upper: Likewise of the upper one.
        """
        triangles, fans = self.triangles, self.fans
        beta = triangles.along_normals(triangles.gradient(u) * (-self.mu / 2))
        correction = next_(beta) * self._A + previous(beta) * self._B
        drops, correction = fans.gather(beta + self._all_moments(u), correction)
        residual = np.where(self.free, -fans.at_vertices(drops) / self.mass, 0.0)
        lower, upper, rest = self._multipliers(residual, touches_lower, touches_upper)
        of_solver = np.where(self.free, residual + self.missing / self.mass, 0.0)
        solver_rest = self._multipliers(of_solver, touches_lower, touches_upper)[2]
        lower, upper = (
            self._along_the_boundary(values, touches)
            for values, touches in ((lower, touches_lower), (upper, touches_upper))
        )
        own = self.level.owned
        pressure = (lower[:own] - upper[:own] + rest)[fans.vertex]
        before, after = fans.walk(drops + fans.along(pressure) * self._area)
        shift = -(self._over_fans(after * self._fan_A - before * self._fan_B - correction)) / self._fan_G
        # nothing leaves through the free boundary
        open_ = ~fans.closed
        shift[open_ & ~fans.exit_held] = -after[fans.last[open_ & ~fans.exit_held]]
        shift[open_ & ~fans.entry_held] = 0.0
        left = np.abs(after[fans.last])[fans.closed | ~(fans.entry_held | fans.exit_held)]
        shift = fans.along(shift)
        to_b, to_c = fans.scatter(after + shift, before + shift)
        return Flux(
            lower, upper, self._with_ghosts(rest), self._with_ghosts(solver_rest),
            previous(to_b) - next_(to_c), max(largest(self.level.comm, left), 0.0),
        )  # fmt: skip

    def _multipliers(
        self, residual: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The residual as lambda - nu + rho: what pushes away from an obstacle that is touched, and the rest."""
        lower = np.where(touches_lower, np.maximum(residual, 0.0), 0.0)
        upper = np.where(touches_upper, np.maximum(-residual, 0.0), 0.0)
        return lower, upper, residual - lower + upper

    def _along_the_boundary(self, values: np.ndarray, touches: np.ndarray) -> np.ndarray:
        """Where u is given and touches, the mean of the neighbours: any value >= 0 will do, 0 is far off in contact."""
        function, level, dofs = fem.Function(self.level.V), self.level, self.triangles.dofs
        function.x.array[: level.owned] = values
        function.x.scatter_forward()
        wanted = touches & ~self.free
        if total(level.comm, np.count_nonzero(wanted)) == 0:
            return function.x.array
        for _ in range(SWEEPS):
            corner = function.x.array[dofs]
            others = self.fans.gather(corner.sum(axis=1, keepdims=True) - corner, np.full(corner.shape, 2.0))
            sums, counts = (self.fans.at_vertices(part) for part in others)
            function.x.array[: level.owned][wanted] = (sums / counts)[wanted]
            function.x.scatter_forward()
        return function.x.array

    def _with_ghosts(self, owned: np.ndarray) -> np.ndarray:
        function = fem.Function(self.level.V)
        function.x.array[: len(owned)] = owned
        function.x.scatter_forward()
        return function.x.array

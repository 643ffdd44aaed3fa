"""Multipliers and equilibrated flux of a P1 solution, for the error bound.

For any P1 function u_h, converged or not, nodal multipliers lambda >= 0 (lower obstacle), nu >= 0 (upper) and a rest
rho come from its residual alone, eps-free, and a flux sigma in RT0 with continuous normal parts and

    div sigma = -(f_0 + mean lambda - mean nu + mean rho)   in each cell, f_0 the mean of the load,

is found vertex by vertex as a sum of fluxes on the patches, each the nearest (in the norm of mu^(-1/2)) to the broken
RT0 interpolant of phi_i mu grad u_h (`patch_flux`; Braess and Schoeberl 2008 for equations; the interpolant in place of
phi_i mu grad u_h itself keeps the flux near on irregular meshes).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.effects.effect import Effect, residual
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.axial_flux import AxialPatchFlux
from fenicsx_obstacle.estimation.boundary_obstacles import BoundaryObstacle, boundary_obstacles
from fenicsx_obstacle.estimation.cell_data import (
    Load,
    matrix_of,
    matrix_of_solver,
    of_solver,
    other_effects,
    tension_of,
)
from fenicsx_obstacle.estimation.multipliers import Multipliers, pushes
from fenicsx_obstacle.estimation.part_forces import part_forces
from fenicsx_obstacle.estimation.patch_flux import PatchFlux
from fenicsx_obstacle.estimation.point_forces import PointForces
from fenicsx_obstacle.estimation.reactions import Reaction
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.mesh.around_nodes import with_ghosts
from fenicsx_obstacle.parallel import total

STIFF = 5.0  # k |T|^(2/d)/tension, from which forces are averaged around vertices
SWEEPS = 2  # along the boundary, to find a pressure where u is given and touches


@dataclass(frozen=True)
class FluxP1:
    """Multipliers and flux; arrays of owned cells, or of local dofs, ghosts included.

    Attributes:
        lower: lambda >= 0 at the vertices of each cell, in the unit of the load, shape (cells, d + 1).
        upper: nu >= 0.
        rest: rho, what no obstacle carries, at local dofs.
        solver_rest: The same of the solver's own load, one value per cell: 0 where it has converged.
        normal: s: sigma = sum of s_j (x - x_j)/(d |T|) in a cell; s_j is the flux out of it opposite to vertex j.
        averaged: Force per area in each cell that sigma is in balance with besides, because forces are averaged around
            vertices where foundations are stiff.
        force: Of fluxes and springs on the facets of `EquilibrationP1.parts`, by vertices of the cell.
        contact: The same of each of the obstacles on facets.
    """

    lower: np.ndarray
    upper: np.ndarray
    rest: np.ndarray
    solver_rest: np.ndarray
    normal: np.ndarray
    averaged: np.ndarray
    force: np.ndarray
    contact: tuple[np.ndarray, ...] = ()


class EquilibrationP1:
    """Equilibrated flux and multipliers; parts that depend on mesh and data only are computed once.

    Attributes:
        simplices: The owned cells.
        multipliers: Makes those of contact forces at the vertices.
        mu: Tension of each cell, as the solver has it; of a matrix the geometric mean of its eigenvalues.
        pull: The same times the mean weight of integrals in the cell.
        matrix: The tension of each cell, where it is a matrix, shape (cells, d, d).
        load: Its moments are int_T f phi_l, shape (cells, d + 1), its oscillation ||f - f_0||_T.
        sides: The lower and the upper obstacle on facets, if they are there.
        missing: Force at owned vertices that the load gives more than what the solver makes of it.
        reaction: Foundation.
        parts: Fluxes and springs, and forces at vertices.
        points: Forces at points inside cells, on intervals.
        apart: Of the patches.
    """

    def __init__(self, simplices: Simplices, of_state: np.ndarray | None):
        """Sample the load, sort the corners (collective).

        Args:
            simplices: The owned cells.
            of_state: Tension in each cell where it depends on u.
        """
        self.simplices, data = simplices, simplices.data
        self.level, corners = data.level, simplices.dim + 1
        middle = np.full((1, corners), 1 / corners)
        rows, tension = matrix_of(data), tension_of(data)
        self.matrix = None if rows is None else matrix_of_solver(simplices, rows)
        if of_state is not None:
            self.mu = of_state
        elif tension is not None:
            self.mu = of_solver(simplices, data, tension, middle, positive=True)[:, 0]
        elif self.matrix is not None:
            self.mu = np.linalg.det(self.matrix) ** (1 / simplices.dim)
            self._inverse = np.linalg.inv(self.matrix)
        self.pull = self.mu * (simplices.size / simplices.area)
        self.multipliers = Multipliers(simplices.around, simplices.area, self.pull, simplices.given, SWEEPS)
        others, unknown = other_effects(data), unknown_effects(data)
        # with an effect that the bound does not know all but tension and load are taken from their forms
        self._prepare_others(others if unknown else [])
        known = [] if unknown else others
        foundation = next((effect.value for effect in known if effect.role == "reaction"), None)
        self.points = PointForces(simplices, others)
        self.reaction = self._reaction(foundation)
        obstacles = boundary_obstacles(simplices)
        self.parts = part_forces(simplices, known, self.points, [which for _, which, _ in obstacles])
        self.sides = [BoundaryObstacle(sign, self.parts, which, fields) for sign, which, fields in obstacles]
        stiff = self.reaction.least * simplices.area ** (2 / simplices.dim) / self.mu > STIFF
        self._stiff: np.ndarray | None = None  # whether all cells around a vertex are, at the corners
        if total(self.level.comm, np.count_nonzero(stiff)) > 0:
            everywhere = simplices.around.smallest(np.repeat(stiff[:, None].astype(float), corners, axis=1))
            self._stiff = everywhere[simplices.dofs] > 0
        if simplices.radius is not None and simplices.dim == 2:
            self._patch_flux: PatchFlux = AxialPatchFlux(simplices, self.parts, self.mu)
        else:
            self._patch_flux = PatchFlux(simplices, self.parts, self.weighted)
        self.apart = self._patch_flux.apart
        self._sample_load()

    def _reaction(self, foundation: Field | None) -> Reaction:
        """The foundation (collective)."""
        return Reaction(self.simplices, foundation)

    def _sample_load(self) -> None:
        """Enclose the load (collective)."""
        self.load = Load(self.simplices, self.simplices.data, tests=lambda points: points)
        self.missing = self.simplices.around.sums(self.load.missing)[: self.level.owned]

    def _missing_at_vertices(self) -> np.ndarray:
        """`missing` against the hat functions, at local vertices (collective)."""
        return with_ghosts(self.level.V, self.missing)

    def _mean_forces(self, u: np.ndarray) -> np.ndarray:
        """The mean of mu grad u in each cell, as the solver has it, times the weight of integrals, shape (d, cells)."""
        return self.pulled(self.simplices.gradient(u))

    def _inside_cells(self) -> tuple[np.ndarray, np.ndarray]:
        """lambda and nu of contact nodes inside cells, each half of its force at both ends of the cell (P2 on
        intervals)."""
        return np.zeros(len(self.mu)), np.zeros(len(self.mu))

    def _prepare_others(self, effects: list[Effect]) -> None:
        """Their terms against the discontinuous P1 functions of single cells (collective)."""
        self._terms: Any = None
        if not effects:
            return
        broken = releases.functionspace(self.level.mesh, "DG", 1)
        self._u, v = fem.Function(self.level.V), ufl.TestFunction(broken)
        self._terms = releases.form(residual(effects, self._u, v, self.simplices.data))
        self._moments_of_others = fem.Function(broken)
        self._vector_of_others = releases.vec(self._moments_of_others)

    def _all_moments(self, u: np.ndarray) -> np.ndarray:
        """Moments of the load less those of other effects at u (collective)."""
        load = self.load.moments + self.points.moments if self.points.given else self.load.moments
        if self._terms is None:
            return load - self.reaction.forces(u) if self.reaction.given else load
        self._u.x.array[:] = u
        self._moments_of_others.x.array[:] = 0.0
        fem.petsc.assemble_vector(self._vector_of_others, self._terms)
        dofs = releases.cell_dofs(self._moments_of_others.function_space)[: len(self.mu)]
        return load - self._moments_of_others.x.array[self.simplices.turned(dofs)]

    def pulled(self, gradient: np.ndarray) -> np.ndarray:
        """The solver's tension times one vector per cell, shape (d, cells)."""
        return gradient * self.pull if self.matrix is None else _times(self.matrix, gradient)

    def weighted(self, vectors: np.ndarray) -> np.ndarray:
        """One vector per cell, shape (d, cells), divided by the tension: in this norm fluxes are near their targets."""
        return vectors / self.pull if self.matrix is None else _times(self._inverse, vectors)

    def flux(
        self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray,
        gaps: tuple[np.ndarray | None, np.ndarray | None] = (None, None),
    ) -> FluxP1:  # fmt: skip
        """Multipliers and flux of a state (collective).

        Args:
            u: Values at local dofs.
            touches_lower: Whether u is at the lower obstacle or beyond it, at owned dofs.
            touches_upper: Whether it is at the upper one or beyond it.
            gaps: Mean distance to the lower obstacle in each cell, and to the upper one.
        """
        simplices, nodes, level = self.simplices, self.multipliers, self.level
        touches = [with_ghosts(level.V, owned) > 0.5 for owned in (touches_lower, touches_upper)]
        beta = simplices.along_normals(self._mean_forces(u) / -simplices.dim)
        given_force = force = self.parts.forces(u)
        outside = beta.copy()
        np.add.at(outside, self.parts.cells, force)
        moments = self._all_moments(u)
        drops, averaged = self._drops(outside, moments)
        inside = self._inside_cells()
        drops = drops + nodes.share * (inside[0] - inside[1])[:, None]
        residual = np.where(nodes.given, 0.0, -simplices.around.sums(drops) / nodes.weights)
        lower, upper = pushes(residual, *touches)
        rest = residual - lower + upper
        of_solver = residual + np.where(nodes.given, 0.0, self._missing_at_vertices() / nodes.weights)
        pushed, pulled = pushes(of_solver, *touches)
        borne = tuple(side.forces((lower if side.sign > 0 else upper) * nodes.weights) for side in self.sides)
        if self.sides:
            for side, one in zip(self.sides, borne, strict=True):
                force = force + side.sign * one
                np.add.at(drops, self.parts.cells, side.sign * one)
            lower, upper = np.zeros_like(lower), np.zeros_like(upper)
        lower, upper = (
            nodes.in_cells(values, there, gap) for values, there, gap in zip((lower, upper), touches, gaps, strict=True)
        )
        drops += nodes.share * (lower - upper + rest[simplices.dofs])
        lower, upper = (values + more[:, None] for values, more in zip((lower, upper), inside, strict=True))
        return FluxP1(
            lower=lower, upper=upper, rest=rest, solver_rest=of_solver - pushed + pulled,
            normal=self._patch_flux.nearest(drops, beta, force), averaged=averaged, force=given_force, contact=borne,
        )  # fmt: skip

    def _drops(self, outside: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is to leave each corner, with the sign changed, and forces per area because of averages (collective).

        Where foundations are stiff, a difference of forces costs more as a flux from cell to cell than as a force:
        around such vertices forces are spread evenly, so that the sum remains.

        Args:
            outside: Flux of the state out of the corners, and forces on facets, shape (cells, d + 1).
            inside: Forces in the corners.
        """
        if self._stiff is None:
            return outside + inside, np.zeros(len(self.mu))
        nodes, dofs, around = self.multipliers, self.simplices.dofs, self.simplices.around
        sums = np.where(nodes.given, -around.sums(outside), around.sums(inside))
        spread = np.where(self._stiff, (sums / nodes.weights)[dofs] * nodes.share, inside)
        return outside + spread, (spread - inside).sum(axis=1) / self.simplices.area


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Matrices of cells, shape (cells, d, d), times vectors of shape (d, cells, ...)."""
    return np.einsum("cxy,yc...->xc...", matrices, vectors)


def unknown_effects(data: Data) -> list[Effect]:
    """The effects of which error bounds know nothing; of several foundations all but the first."""
    others = other_effects(data)
    foundation = next((effect for effect in others if effect.role == "reaction"), None)
    known = [effect for effect in others if effect.role in ("part load", "part reaction", "point forces")]
    return [effect for effect in others if effect is not foundation and effect not in known]

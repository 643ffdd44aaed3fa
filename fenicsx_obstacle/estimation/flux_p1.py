"""Multipliers and equilibrated flux of a P1 solution, for the error bound.

For any P1 function u_h, converged or not, nodal multipliers lambda >= 0 (lower obstacle), nu >= 0 (upper) and a rest
rho come from its residual alone, eps-free, and a flux sigma in RT0 with continuous normal parts and

    div sigma = -(f_0 + mean lambda - mean nu + mean rho)   in each cell, f_0 the mean of the load,

is found vertex by vertex as a sum of fluxes on the patches, each the nearest (in the norm of mu^(-1/2)) to the broken
RT0 interpolant of phi_i mu grad u_h (`patch_flux`; Braess and Schoeberl 2008 for equations; the interpolant in place of
phi_i mu grad u_h itself keeps the flux near on irregular meshes).

Of the contact force at a vertex only its sum over the patch is needed. Where the obstacle falls off steeply the force
is put into those cells of the patch in which u is near it: the error bound has force times distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.effects.effect import Effect, residual
from fenicsx_obstacle.estimation.axial_flux import AxialPatchFlux
from fenicsx_obstacle.estimation.boundary_obstacles import BoundaryObstacle, BoundaryObstacles
from fenicsx_obstacle.estimation.cell_data import (
    Load,
    matrix_of,
    matrix_of_solver,
    of_solver,
    other_effects,
    tension_of,
)
from fenicsx_obstacle.estimation.part_forces import part_forces
from fenicsx_obstacle.estimation.patch_flux import PatchFlux
from fenicsx_obstacle.estimation.patches import Patches
from fenicsx_obstacle.estimation.point_forces import PointForces
from fenicsx_obstacle.estimation.reactions import Reaction
from fenicsx_obstacle.estimation.simplices import Simplices, with_ghosts
from fenicsx_obstacle.parallel import largest, total

NEAR = 0.5  # of force/tension: a larger distance costs more than what moving the force to other cells does to the flux
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
        incompatible: Largest flux that a patch of a free vertex leaves over, 0 up to round-off.
        forces: Largest force in a corner of a cell, whose round-off this is.
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
    incompatible: float
    forces: float
    averaged: np.ndarray
    force: np.ndarray
    contact: tuple[np.ndarray, ...] = ()


class EquilibrationP1:
    """Equilibrated flux and multipliers; parts that depend on mesh and data only are computed once.

    Attributes:
        simplices: The owned cells.
        patches: Their corners around the vertices.
        mu: Tension of each cell, as the solver has it; of a matrix the geometric mean of its eigenvalues.
        pull: The same times the mean weight of integrals in the cell.
        matrix: The tension of each cell, where it is a matrix, shape (cells, d, d).
        load: Its moments are int_T f phi_l, shape (cells, d + 1), its oscillation ||f - f_0||_T.
        sides: The lower and the upper obstacle on facets, if they are there.
        missing: Force at owned vertices that the load gives more than what the solver makes of it.
        reaction: Foundation.
        parts: Fluxes and springs, and forces at vertices.
        points: Forces at points inside cells, on intervals.
        unknown: Effects that the bound does not know; with them all but tension and load are taken from their forms.
    """

    def __init__(self, simplices: Simplices, of_state: np.ndarray | None):
        """Sample the load, sort the corners (collective).

        Args:
            simplices: The owned cells.
            of_state: Tension in each cell where it depends on u.
        """
        data, patches = simplices.data, Patches(simplices)
        self.simplices, self.patches = simplices, patches
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
        share = simplices.area / (corners * self.pull)
        area = self.patches.gather(np.repeat(share[:, None], corners, axis=1))[0]
        self._softness = self.patches.at_vertices(area)  # int phi_i/mu
        others = other_effects(data)
        self.unknown = unknown_effects(data)
        self._prepare_others(others if self.unknown else [])
        known = [] if self.unknown else others
        foundation = next((effect.reaction for effect in known if effect.reaction is not None), None)
        self.points = PointForces(simplices, others)
        self.reaction = Reaction(simplices, foundation)
        bearing = BoundaryObstacles(simplices)
        self.parts = part_forces(simplices, known, patches.held, self.points, bearing.on(simplices.facets.shape))
        self.sides = [
            BoundaryObstacle(sign, self.parts, patches, which, fields) for sign, which, fields in bearing.given
        ]
        stiff = self.reaction.least * simplices.area ** (2 / simplices.dim) / self.mu > STIFF
        self._stiff: np.ndarray | None = None  # whether all cells around each patch's vertex are
        if total(self.level.comm, np.count_nonzero(stiff)) > 0:
            around = patches.gather(np.repeat(stiff[:, None].astype(float), corners, axis=1))[0]
            self._stiff = patches.along(patches.smallest(around)[patches.vertex] > 0)
        if simplices.radius is not None and simplices.dim == 2:
            self._patch_flux: PatchFlux = AxialPatchFlux(simplices, patches, self.parts, self.mu)
        else:
            self._patch_flux = PatchFlux(simplices, patches, self.parts, self.weighted)
        self.load = Load(simplices, data, tests=lambda points: points, basis=lambda points: np.ones((len(points), 1)))
        self.missing = np.zeros(patches.owned)
        if self.load.pieces is not None:
            self.missing = patches.at_vertices(patches.gather(self.load.missing)[0])

    def _prepare_others(self, effects: list[Effect]) -> None:
        """Their terms against the discontinuous P1 functions of single cells (collective)."""
        self._terms: Any = None
        if not any(effect.integrals for effect in effects):
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

    def pulled(self, gradient: np.ndarray, cells: slice = slice(None)) -> np.ndarray:
        """The solver's tension times one vector per cell, shape (d, cells)."""
        return gradient * self.pull[cells] if self.matrix is None else _times(self.matrix[cells], gradient)

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
        simplices, patches, V = self.simplices, self.patches, self.level.V
        beta = simplices.along_normals(self.pulled(simplices.gradient(u)) / -simplices.dim)
        given_force = force = self.parts.forces(u)
        outside = beta.copy()
        np.add.at(outside, self.parts.cells, force)
        moments = self._all_moments(u)
        forces_at_most = largest(self.level.comm, np.maximum(np.abs(outside), np.abs(moments)))
        drops, averaged = self._drops(outside, moments)
        residual = np.where(patches.free, -patches.at_vertices(drops) / patches.mass, 0.0)
        lower, upper, rest = self._multipliers(residual, touches_lower, touches_upper)
        with_solver_load = np.where(patches.free, residual + self.missing / patches.mass, 0.0)
        solver_rest = self._multipliers(with_solver_load, touches_lower, touches_upper)[2]
        borne: tuple[np.ndarray, ...] = ()
        if self.sides:
            borne = tuple(side.forces(lower if side.sign > 0 else upper) for side in self.sides)
            at_corners = np.zeros(simplices.dofs.shape)
            for side, one in zip(self.sides, borne, strict=True):
                force = force + side.sign * one
                np.add.at(at_corners, self.parts.cells, side.sign * one)
            drops += patches.gather(at_corners)[0]
            lower, upper = np.zeros(patches.owned), np.zeros(patches.owned)
        (lower, push), (upper, pull) = (
            self._in_cells(self._along_the_boundary(values, touches), gap)
            for values, touches, gap in ((lower, touches_lower, gaps[0]), (upper, touches_upper, gaps[1]))
        )
        forces = patches.along(rest[patches.vertex])
        forces += push
        forces -= pull
        forces *= patches.area
        drops += forces
        normal, incompatible = self._patch_flux.nearest(drops, beta, force)
        return FluxP1(
            lower=lower, upper=upper, rest=with_ghosts(V, rest), solver_rest=with_ghosts(V, solver_rest),
            normal=normal, incompatible=incompatible, forces=forces_at_most, averaged=averaged, force=given_force,
            contact=borne,
        )  # fmt: skip

    def _drops(self, outside: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is to leave each corner, with the sign changed, and forces per area because of averages (collective).

        Where foundations are stiff, a difference of forces costs more as a flux from cell to cell than as a force:
        around such vertices forces are spread evenly, so that the sum remains.

        Args:
            outside: Flux of the state out of the corners, and forces on facets, shape (cells, d + 1); overwritten.
            inside: Forces in the corners.
        """
        patches = self.patches
        if self._stiff is None:
            outside += inside
            return patches.gather(outside)[0], np.zeros(len(self.mu))
        around, forces = patches.gather(outside, inside)
        sums = np.where(patches.free, patches.at_vertices(forces), -patches.at_vertices(around))
        even = patches.along((sums / patches.mass)[patches.vertex]) * patches.area
        spread = np.where(self._stiff, even, forces)
        changed = patches.scatter(spread - forces)[0]
        return around + spread, changed.sum(axis=1) / self.simplices.area

    def _multipliers(
        self, residual: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Split the residual into lambda - nu + rho: contact forces of the right sign, and the rest."""
        lower = np.where(touches_lower, np.maximum(residual, 0.0), 0.0)
        upper = np.where(touches_upper, np.maximum(-residual, 0.0), 0.0)
        return lower, upper, residual - lower + upper

    def _along_the_boundary(self, values: np.ndarray, touches: np.ndarray) -> np.ndarray:
        """At contact nodes where u is given: the mean of the neighbours; any value >= 0 is admissible."""
        level, dofs, values = self.level, self.simplices.dofs, with_ghosts(self.level.V, values)
        wanted = touches & ~self.patches.free
        if total(level.comm, np.count_nonzero(wanted)) == 0:
            return values
        for _ in range(SWEEPS):
            corner = values[dofs]
            dim = float(self.simplices.dim)
            others = self.patches.gather(corner.sum(axis=1, keepdims=True) - corner, np.full(corner.shape, dim))
            sums, counts = (self.patches.at_vertices(part) for part in others)
            values = with_ghosts(level.V, np.where(wanted, sums / counts, values[: level.owned]))
        return values

    def _in_cells(self, values: np.ndarray, gap: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Nodal multipliers at the corners of cells with the same sum over each patch, and these patch by patch
        (collective).

        Args:
            values: At local dofs, >= 0.
            gap: Mean distance to the obstacle in each cell; None: it plays no part.
        """
        patches, own = self.patches, values[: self.level.owned]
        if total(self.level.comm, np.count_nonzero(own)) == 0:
            return np.broadcast_to(0.0, self.simplices.dofs.shape), np.broadcast_to(0.0, len(patches.area))
        along, dofs = patches.along(own[patches.vertex]), self.simplices.dofs
        if gap is None:
            return values[dofs], along
        gaps = patches.gather(np.broadcast_to(gap[:, None], dofs.shape))[0]
        most = patches.smallest(gaps) + NEAR * own * self._softness
        far = (gaps > patches.along(most[patches.vertex])) & (along > 0)
        if total(self.level.comm, np.count_nonzero(far)) == 0:
            return values[dofs], along
        share = patches.mass / patches.at_vertices(np.where(far, 0.0, patches.area))
        along *= patches.along(share[patches.vertex])
        along[far] = 0.0
        return patches.scatter(along)[0], along


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Matrices of cells, shape (cells, d, d), times vectors of shape (d, cells, ...)."""
    return np.einsum("cxy,yc...->xc...", matrices, vectors)


def unknown_effects(data: Data) -> list[Effect]:
    """The effects of which error bounds know nothing; of several foundations all but the first."""
    others = other_effects(data)
    foundation = next((effect for effect in others if effect.reaction is not None), None)
    known = [
        effect
        for effect in others
        if effect.part_load is not None or effect.part_reaction is not None or effect.point_forces
    ]
    return [effect for effect in others if effect is not foundation and effect not in known]

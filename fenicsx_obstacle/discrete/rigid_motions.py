"""Rigid body motions: near-null space of multigrid for elasticity, and a check that supports hold a body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.data_scales import EPSILON, ROUNDOFF_MARGIN, stiffness_of
from fenicsx_obstacle.algebra.products import product
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.discrete.contact_nodes import VectorData
from fenicsx_obstacle.discrete.mesh_system import MeshSystem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.validation import place
from fenicsx_obstacle.parallel import largest, total

INDEPENDENT = 1e-8  # of the largest eigenvalue of a Gram matrix: vectors that are others' combinations
LOOSE = 1e-11  # relative energy of a motion that nothing resists
BALANCED = 1e-6  # of the load: what contact leaves of a force on a loose body
ROUND_OFF = 1e-12  # of the sum of its parts: what cancels
SAME = 1e-6  # of a motion: what its components and those of another one differ by through round-off
_REMEDY = (
    "prescribe components of u that exclude this, such as u_x = 0 on the plane of symmetry of a half model, or at one "
    "node of a side"
)
FORCELESS = 1e-8  # of the forces, or of the size of the body: what is none


def rigid_motions(x: np.ndarray, components: int) -> np.ndarray:
    """Translations and rotations at points, not normalised.

    Args:
        x: Shape (3, nodes), about their centre and in units of the size of the body.
        components: Of u, as many as the points have coordinates.

    Returns:
        Shape (motions, nodes, components).
    """
    turns = [(i, j) for i in range(components) for j in range(i)]
    found = np.zeros((components + len(turns), x.shape[1], components))
    for k in range(components):
        found[k, :, k] = 1.0
    for k, (i, j) in enumerate(turns, components):
        found[k, :, i], found[k, :, j] = x[j], -x[i]
    return found


def _box(level: Level) -> tuple[np.ndarray, float]:
    """Centre of the box around all nodes, shape (3,), and its longest side (collective)."""
    low, high = level.box
    return (low + high) / 2, max(np.max(high - low), 1e-300)


class RigidMotions(System, ABC):
    """A system whose matrix has rigid body motions as near-null space of algebraic multigrid."""

    preconditioner: Mapping[str, str] = {
        "pc_type": "gamg",
        "mg_levels_pc_type": "jacobi",
        "mg_coarse_ksp_type": "preonly",
        # PETSc's default for the coarsest level keeps the size of the first active set
        "mg_coarse_pc_type": "lu",
        "mg_coarse_pc_factor_mat_solver_type": "mumps",
        # an aggregate of few nodes has fewer independent motions than there are: a pivot that is 0
        "mg_coarse_mat_mumps_icntl_24": "1",
    }

    extent: float  # of the body

    @property
    @abstractmethod
    def motions(self) -> np.ndarray:
        """Rigid body motions at owned dofs, in the components of w, shape (motions, dofs) (first use is collective)."""

    def jacobian(self, x: PETSc.Vec, *, penalised: bool = True) -> PETSc.Mat:
        super().jacobian(x, penalised=penalised)
        self._set_near_null_space(self.matrices.penalty_diagonal() if penalised else np.zeros(self.owned))
        return self.A

    def hold(self, penalty_diagonal: np.ndarray) -> None:
        super().hold(penalty_diagonal)
        self._set_near_null_space(penalty_diagonal)

    def _set_near_null_space(self, penalty_diagonal: np.ndarray) -> None:
        """Give A the motions, orthonormal, with zeros at dofs that are held (collective).

        Zeros at the normal components of closed nodes keep coarse corrections from moving them, so that counts of
        linear steps do not depend on eps.
        """
        struck = self.motions * ((penalty_diagonal == 0) & ~self.fixed)
        values, vectors = np.linalg.eigh(self.comm.allreduce(struck @ struck.T))
        kept = values > INDEPENDENT * max(values[-1], 1e-300)
        found = []
        for row in (vectors[:, kept] / np.sqrt(values[kept])).T @ struck:
            vector = self.A.createVecRight()
            vector.array[:] = row
            found.append(vector)
        if found:
            space = PETSc.NullSpace().create(vectors=found, comm=self.comm)
            self.A.setNearNullSpace(space)
            for owner in (*found, space):
                owner.destroy()


class BodySystem(RigidMotions, MeshSystem):
    """The system of an elastic body on a mesh."""

    data: VectorData
    vector_valued = True
    loose: np.ndarray | None  # motions that only contact resists

    @cached_property
    def motions(self) -> np.ndarray:
        level, (centre, size) = self.level, _box(self.level)
        x = level.nodes[:, : level.V.dofmap.index_map.size_local]
        motions = rigid_motions((x - centre[:, None]) / size, level.components)
        return np.array([self.data.contact.rotated(motion.ravel()) for motion in motions])

    def bounded_sides(self) -> list[tuple[np.ndarray, float]]:
        """Bounds at owned dofs on each side that has an obstacle, and where it is along N_i: 1 above, -1 below."""
        sides = ((self.lower, -1.0), (self.upper, 1.0))
        return [(bound, sign) for bound, sign in sides if bound is not None]


def check_held(problem: BodySystem) -> np.ndarray | None:
    """Check that supports or contact hold the body (collective).

    A motion without elastic energy that supports allow does work against no force but contact's. So contact forces,
    which only push, must balance the load on all such motions: there are p_i >= 0 with sum p_i D_i N_i . z = f . z.

    Args:
        problem: With the residual of u = 0 in `elastic`.

    Returns:
        The motions that only contact resists, orthonormal at owned dofs; None if there are none.

    Raises:
        InputError: If a motion is resisted by nothing, or the load pulls the body from the obstacles; or if the
            derivative of F is not finite.
    """
    comm, source = problem.level.comm, problem.model.source
    motions, fixed = problem.motions, problem.fixed
    gram = comm.allreduce(motions @ motions.T)
    values, vectors = np.linalg.eigh(gram)
    orthonormal = (vectors / np.sqrt(values)).T
    basis = orthonormal @ motions
    resisted = comm.allreduce(basis[:, fixed] @ basis[:, fixed].T + _energies(problem, basis))
    if not np.isfinite(resisted).all():
        raise InputError(
            f"{source}: the derivative of F is not finite at the start: is a logarithm or a root taken of a number "
            "that is not positive there, as of det(I + grad(u)) in a cell turned inside out? start from another u"
        )
    values, vectors = np.linalg.eigh(resisted)
    shares = vectors[:, values < LOOSE].T @ orthonormal  # of the motions, in each that nothing resists
    loose = shares @ motions
    if not len(loose):
        return None
    load = -comm.allreduce((loose * ~fixed) @ problem.elastic.array_r)
    at, D = problem.touchable, problem.weights
    pushes = [(basis * D * sign)[:, at & np.isfinite(bound[: len(D)])] for bound, sign in problem.bounded_sides()]
    of_all = np.concatenate(comm.allgather(np.concatenate(pushes, axis=1)), axis=1)
    everywhere = vectors[:, values < LOOSE].T @ of_all
    enough = np.pad(everywhere, ((0, 0), (0, max(len(loose) - everywhere.shape[1], 0))))
    directions, strength, _ = np.linalg.svd(enough, full_matrices=False)
    free = directions[:, strength <= INDEPENDENT * np.linalg.norm(of_all)].T
    if len(free):
        raise InputError(
            f"{source}: the body is not supported: {len(free)} rigid body motion{'s are' if len(free) > 1 else ' is'} "
            "free that neither supports nor contact resist: "
            f"{_named(problem, free @ shares)}; {_REMEDY}"
        )
    from scipy.optimize import nnls  # only where contact alone holds a body

    forces, left = nnls(everywhere, load, maxiter=100 * everywhere.shape[1])
    size = total(comm, np.abs(problem.elastic.array_r[~fixed]))
    if left > max(BALANCED * np.linalg.norm(load), ROUND_OFF * size):
        raise InputError(
            f"{source}: only contact supports the body, and the load does not press it against the obstacles, so that "
            f"no solution exists: the load moves it: {_named(problem, (load - everywhere @ forces)[None] @ shares)}; "
            f"{_REMEDY}"
        )
    return loose


def moves_freely(problem: System, active: np.ndarray) -> str | None:
    """The reason why a body that only contact holds is not held; None if it is (collective).

    A rigid motion is free if no contact force resists it. A node that two equal obstacles hold resists motions without
    a force.

    Args:
        problem: A `VectorProblem` that holds its solution.
        active: Which obstacle holds each owned dof: -1 lower, 1 upper, 0 none.
    """
    loose = problem.loose
    if loose is None:
        return None
    assert isinstance(problem, RigidMotions)
    stiffness = stiffness_of(problem, exact_bounds=True)
    round_off = total(problem.comm, ROUNDOFF_MARGIN * EPSILON * stiffness * np.abs(problem.u))
    problem.law.elastic(problem.elastic)
    forces = np.where(active != 0, np.abs(problem.elastic.array_r), 0.0)
    resists = forces > max(FORCELESS * max(problem.load, largest(problem.comm, forces)), round_off)
    resists |= np.sum(problem.gaps(), axis=0) <= FORCELESS * problem.extent
    there = loose[:, resists & problem.touchable]
    values = np.linalg.eigvalsh(problem.comm.allreduce(there @ there.T))
    # of a motion with displacements of one size everywhere
    usual = total(problem.comm, np.count_nonzero(resists & problem.touchable)) / problem.dofs
    if values[0] > INDEPENDENT * max(values[-1], usual):
        return None
    return (
        "only contact supports the body, and a rigid body motion is resisted by no contact force, so that u is "
        "determined only up to this motion; prescribe more components of u"
    )


def _energies(problem: BodySystem, basis: np.ndarray) -> np.ndarray:
    """This rank's part of z . A z over the mean diagonal of A, for pairs of motions (collective)."""
    A = problem.matrices.stiffness
    diagonal = A.getDiagonal()
    mean = total(problem.level.comm, np.abs(diagonal.array_r)) / problem.level.dofs
    diagonal.destroy()
    found = basis @ np.array([product(A, row) for row in basis]).T / (mean or 1.0)
    return (found + found.T) / 2


def _named(problem: BodySystem, shares: np.ndarray) -> str:
    """Motions in words: translations with their direction, rotations with their axis or point (collective).

    Args:
        problem: Of the body.
        shares: Of the motions of `rigid_motions` in each, shape (found, motions).
    """
    dim, (centre, size) = problem.level.components, _box(problem.level)
    words = list[str]()
    for motion in _aligned(np.roll(shares, -dim, axis=1)):  # rotations before translations
        spin, shift = motion[:-dim], np.pad(motion[-dim:], (0, 3 - dim))
        if np.abs(spin).max() <= SAME * np.abs(shift).max():
            words.append(f"translation along {_direction(shift[:dim])}")
            continue
        axis = np.pad(spin, (0, 3 - len(spin)))[::-1] * [1, -1, 1]  # of the pairs (1, 0), (2, 0), (2, 1)
        point = place(np.round(centre + size * np.cross(axis, shift) / (axis @ axis), 9)[:dim] + 0.0)
        words.append(f"rotation about {point if dim == 2 else f'the axis along {_direction(axis)} through {point}'}")
    return ", ".join(sorted(words, key=lambda one: one.startswith("rotation")))


def _aligned(rows: np.ndarray) -> np.ndarray:
    """Other combinations of independent rows, in which each has a column of its own (local)."""
    columns, least = list[int](), SAME * np.abs(rows).max(initial=0.0)
    for column in range(rows.shape[1]):
        if np.linalg.matrix_rank(rows[:, [*columns, column]], tol=least) > len(columns):
            columns.append(column)
    return np.linalg.pinv(rows[:, columns]) @ rows


def _direction(vector: np.ndarray) -> str:
    """x, y or z, or the unit vector."""
    unit = vector / np.linalg.norm(vector)
    axis = int(np.argmax(np.abs(unit)))
    if 1 - abs(unit[axis]) < SAME:
        return "xyz"[axis]
    return place(np.round(unit * np.sign(unit[axis]), 9) + 0.0)

"""The discrete problem on a coarse level: Galerkin products, and the data of the finer level injected."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.assembly import Nodal
from fenicsx_obstacle.discrete.cells import corners
from fenicsx_obstacle.discrete.coarsening import BOUNDARY, FIXED, FREE, Nodes, coarsen, first_keys
from fenicsx_obstacle.discrete.kernels import kernels
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.transfer import Transfer, downward
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.parallel import total

# unknowns, by dimension, below which a direct solver is fast, and a cold start takes few steps
COARSEST = {1: 30, 2: 600, 3: 600}
SMALLEST = 1500  # unknowns of a mesh from which coarse levels reduce the time
SLOWEST = 0.7  # of the unknowns may be left by a coarsening


class Values:
    """Owned nodal values with the interface of a Function; there are no ghosts."""

    def __init__(self, P: PETSc.Mat):
        """Zero at the columns of a matrix (collective)."""
        self.vector = P.createVecRight()
        self.x = SimpleNamespace(array=self.vector.array, scatter_forward=lambda: None)


@dataclass(frozen=True, eq=False)
class GalerkinLevel:
    """The attributes of a level that solvers use, without a mesh.

    Attributes:
        comm: Communicator.
        owned: Number of owned nodes.
        dofs: On all ranks.
        h: Of the finest level, for messages.
        pair: Of the finest level.
    """

    comm: MPI.Comm
    owned: int
    dofs: int
    h: float
    pair: Pair


class GalerkinForms(Nodal):
    """(3.4) with P^T A P, P^T f and weights of coarse nodes (all methods collective)."""

    def __init__(self, finer: Nodal, transfer: Transfer, data: Any):
        self._finer, self._transfer, self.data = finer, transfer, data
        self.stiffness = finer.stiffness.ptap(transfer.P)
        self._state = finer.stiffness.stateGet()
        self.w, self.reference, self.eps = Values(self.stiffness), Values(self.stiffness), SimpleNamespace(value=1.0)
        self._vectors = self.w.vector, self.reference.vector
        self.below = None if data.lower is None else Values(self.stiffness)
        self.above = None if data.upper is None else Values(self.stiffness)
        self.thickness, self.multiplier = finer.thickness, None
        self.fixed = data.fixed[0]
        self._constant, self._minus_load = self.vector(), self.vector()
        self._load()
        self._D = _weights(finer.weights(), transfer, thin=data.thin)

    def vector(self) -> PETSc.Vec:
        return self.stiffness.createVecLeft()

    def _load(self) -> None:
        self._minus_load.array[:] = self._transfer.restrict(self._finer._minus_load.array_r)

    def renew(self, A: PETSc.Mat, *, stiffness: bool) -> bool:
        self._load()
        state = self._finer.stiffness.stateGet()
        changed = state != self._state
        if changed:
            self._finer.stiffness.ptap(self._transfer.P, result=self.stiffness)
            self._state = state
            self.stiffness.copy(A, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            self._hold_fixed(A)
        return changed

    def energy(self, *, penalised: bool, moving: bool = True) -> float:
        return self._work() + (self._penalty_energy() if penalised else 0.0)


def _weights(fine: np.ndarray, transfer: Transfer, *, thin: bool) -> np.ndarray:
    """D of coarse nodes (collective): each fine weight goes, in positive shares, to those that it is interpolated from.

    Args:
        fine: D of owned nodes of the finer level.
        transfer: From the coarse level.
        thin: Whether contact is on a part of the boundary or a curve: then coarse nodes beside it get nothing.
    """
    if transfer.of_means and not thin:
        return transfer.restrict(fine)
    starts, columns, values = transfer.P.getValuesCSR()
    size = transfer.P.getSizes()
    shares = PETSc.Mat().createAIJ(size, csr=(starts, columns, np.maximum(values, 0.0)), comm=transfer.P.comm)
    there, sums = shares.createVecs()
    if thin:
        there.array[:] = transfer.inject(fine) > 0
        shares.diagonalScale(R=there)
    there.set(1.0)
    shares.mult(there, sums)
    sums.array[:] = np.divide(fine, sums.array_r, out=np.zeros(len(fine)), where=sums.array_r > 0)
    shares.multTranspose(sums, there)
    D = there.array.copy()
    for owner in (shares, there, sums):
        owner.destroy()
    return D


class GalerkinProblem(Problem):
    """A problem on coarse nodes of a finer one; its states are starts and corrections for that.

    Attributes:
        finer: The next finer problem.
    """

    def __init__(self, finer: Problem, transfer: Transfer, fixed: np.ndarray, pair: Pair):
        """Multiply matrices, and inject the data of the finer problem (collective).

        Args:
            finer: With affine effects and contact at nodes.
            transfer: To it.
            fixed: Whether u is given at the owned coarse nodes.
            pair: With contact at the coarse nodes.
        """
        self.finer, self._up = finer, transfer
        self.prefix, self.model, comm = finer.prefix, finer.model, finer.level.comm
        owned = len(fixed)
        level: Any = GalerkinLevel(comm, owned, int(total(comm, owned)), finer.level.h, pair)
        self.level = level
        self.affine, self.constrained, self.thickness = True, finer.constrained, finer.thickness
        self.fixed = fixed
        sides = {side: None if getattr(finer.data, side) is None else Values(transfer.P) for side in ("lower", "upper")}
        data: Any = SimpleNamespace(
            model=self.model, level=level, moment=finer.data.moment, thin=finer.data.thin,
            fixed=(np.flatnonzero(self.fixed), Values(transfer.P)), **sides,
        )  # fmt: skip
        self.data = data
        self.forms = forms = GalerkinForms(finer.nodal, transfer, data)
        self.w, self.reference, self.eps = forms.w, forms.reference, forms.eps
        self.below, self.above = forms.below, forms.above
        self.A = forms.create_matrix()
        self.elastic, self.reaction = forms.vector(), forms.vector()
        self.weights = forms.weights()
        self.touchable = (self.weights > 0) & ~self.fixed
        self._inject_data()
        self.set_reference(self.cold_start())

    def _inject_data(self) -> None:
        """Take the obstacles, boundary values and start of the finer problem at the coarse nodes (collective)."""
        finer, own, inject = self.finer, self.finer.level.owned, self._up.inject
        pairs = [(getattr(self.data, side), getattr(finer.data, side)) for side in ("lower", "upper")]
        for ours, theirs in (*pairs, (self.data.fixed[1], finer.data.fixed[1])):
            if ours is not None:
                ours.x.array[:] = inject(theirs.x.array[:own])
        self._start = None if finer._start is None else inject(finer._start[:own])
        self.floating, self.borne, self.balanced = finer.floating, None, None
        self.load = self._load_sum()

    def _take_data(self, *, stiffness: bool) -> bool:
        changed = self.forms.renew(self.A, stiffness=stiffness)
        self._inject_data()
        return changed

    def move(self, u_values: np.ndarray) -> bool:
        changed = self._take_data(stiffness=False)
        self.set_reference(u_values)
        return changed

    def renew(self, *, stiffness: bool) -> None:
        self._take_data(stiffness=stiffness)
        self.set_reference(self.cold_start())

    @property
    def has_energy(self) -> bool:
        return self.finer.has_energy


def coarse_problems(problem: Problem, *, algebraic: bool = True) -> list[Problem]:
    """The levels below a problem with affine effects, the coarsest first (collective).

    Those of the meshes that its mesh was refined from, and below them algebraic ones. There are none for few unknowns,
    or where contact is neither at the vertices nor that of P2, which is above P1.

    Args:
        problem: The problem.
        algebraic: Whether to construct algebraic ones.
    """
    level, found = problem.level, list[Problem]()
    if level.pair.has_p1_coarse_space:
        assert level.coarse is not None
        level = level.coarse
    if not level.pair.at_vertices:
        return []
    loops = kernels(level.comm) if algebraic and level.downward[-1].dofs >= SMALLEST else None
    if level is not problem.level:
        if level.coarse is None and loops is None:
            return []
        problem = _below(problem, problem.transfer, level.pair)
        found.append(problem)
    for transfer in downward(level):
        problem.transfer = transfer
        problem = _below(problem, transfer, level.pair)
        found.insert(0, problem)
    if loops is None:
        return found
    nodes = _nodes(problem, level.downward[-1])
    while problem.level.dofs > COARSEST[nodes.dim]:
        transfer, nodes = coarsen(problem.nodal.stiffness, nodes, loops, level.comm)
        if total(level.comm, len(nodes.key)) > SLOWEST * problem.level.dofs:
            break
        problem.transfer = transfer
        problem = GalerkinProblem(problem, transfer, nodes.kind == FIXED, level.pair)
        found.insert(0, problem)
    return found


def _below(problem: Problem, transfer: Transfer, pair: Pair) -> GalerkinProblem:
    """The problem on the nodes that coincide with coarse ones (collective)."""
    return GalerkinProblem(problem, transfer, transfer.inject(problem.fixed) > 0, pair)


def _nodes(problem: Problem, level: Level) -> Nodes:
    """The nodes of a problem that are the vertices of a mesh (collective)."""
    own, dim, gdim = level.owned, level.mesh.topology.dim, level.mesh.geometry.dim
    x = np.ascontiguousarray(level.points.T[:own])
    kind = np.full(own, FREE, dtype=np.int8)
    boundary = fem.locate_dofs_topological(level.V, dim - 1, level.boundary_facets)
    kind[boundary[boundary < own]] = BOUNDARY
    if problem.data.thin:
        kind[problem.weights > 0] = BOUNDARY
    kind[problem.fixed] = FIXED
    tangents = None if dim == gdim else _tangents(level)
    return Nodes(x, kind, first_keys(problem.nodal.stiffness, x), tangents, dim)


def _tangents(level: Level) -> np.ndarray:
    """Orthonormal bases of tangent spaces at owned nodes, by the cells around, shape (nodes, dim, 3) (collective)."""
    V, vertices, dim = level.V, corners(level.mesh), level.mesh.topology.dim
    own = level.mesh.topology.index_map(dim).size_local
    dofs, edges = releases.cell_dofs(V)[:own], vertices[:own, 1:] - vertices[:own, :1]
    spread = np.einsum("cei,cej->cij", edges, edges)
    moments = np.empty((level.owned, 3, 3))
    part = fem.Function(V)
    for i in range(3):
        for j in range(i + 1):
            values = np.repeat(spread[:, i, j], dofs.shape[1])
            part.x.array[:] = np.bincount(dofs.ravel(), values, len(part.x.array))
            releases.add_ghosts(part)
            moments[:, i, j] = moments[:, j, i] = part.x.array[: level.owned]
    return np.ascontiguousarray(np.linalg.eigh(moments)[1].transpose(0, 2, 1)[:, 3 - dim :])

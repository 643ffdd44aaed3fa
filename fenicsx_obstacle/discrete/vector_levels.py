"""Algebraic coarse levels of vector-valued problems: those of the nodes, for each Cartesian component.

Interpolation is exact for linear functions, and so for rigid body motions. As on the finest level the unknowns are
normal and tangential components at contact nodes: with H the reflections of the fine and H_c those of the coarse
nodes, which are some of the fine ones, the interpolation is H (P x I) H_c. The levels give nested iteration its
starts; linear systems keep algebraic multigrid with rigid body motions.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle.algebra.coarse import COARSEST, SLOWEST, SMALLEST, CoarseSystem
from fenicsx_obstacle.algebra.coarsening import BOUNDARY, FIXED, FREE, Nodes, coarsen, first_keys
from fenicsx_obstacle.algebra.kernels import kernels
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.discrete.rigid_motions import RigidMotions
from fenicsx_obstacle.discrete.vector_problem import VectorProblem
from fenicsx_obstacle.parallel import total


class VectorTransfer(Transfer):
    """Interpolation of the unknowns of a vector-valued problem, one row for each owned dof.

    Attributes:
        nodal: Interpolation between the nodes.
    """

    def __init__(self, nodal: Transfer, normal: np.ndarray, components: int, reflections: tuple[PETSc.Mat, ...]):
        """Multiply matrices (collective).

        Args:
            nodal: Interpolation between the nodes.
            normal: Whether an owned fine dof is a normal component at a contact node.
            components: Of u at a node.
            reflections: H and H_c; none if all normals are along coordinate axes.
        """
        self.nodal, self._normal, self._components = nodal, normal, components
        P = _for_each_component(nodal.P, components)
        super().__init__(P if not reflections else reflections[0].matMatMult(P, reflections[1]), self._of_nodes)

    def _of_nodes(self, fine: np.ndarray) -> np.ndarray:
        return self.nodal.inject(fine.reshape(-1, self._components)).ravel()

    def all_of(self, coarse: np.ndarray) -> np.ndarray:
        """For normal components: whether a condition holds at the normal components of all coarse nodes that a fine
        node is interpolated from (collective)."""
        somewhere = coarse.reshape(-1, self._components).any(axis=1)
        return np.repeat(self.nodal.all_of(somewhere), self._components) & self._normal


def _for_each_component(P: PETSc.Mat, components: int) -> PETSc.Mat:
    """P x I (collective)."""
    starts, columns, values = P.getValuesCSR()
    (own, rows), (own_columns, all_columns) = P.getSizes()
    local = scipy.sparse.csr_matrix((values, columns, starts), shape=(own, all_columns))
    blocks = scipy.sparse.kron(local, scipy.sparse.eye(components), format="csr")
    csr = blocks.indptr.astype(PETSc.IntType), blocks.indices.astype(PETSc.IntType), blocks.data
    size = tuple((components * a, components * b) for a, b in ((own, rows), (own_columns, all_columns)))
    return PETSc.Mat().createAIJ(size, bsize=components, csr=csr, comm=P.comm)


class CoarseVectorSystem(RigidMotions, CoarseSystem):
    """A vector-valued system on coarse nodes of a finer one."""

    def __init__(self, finer: VectorProblem | CoarseVectorSystem, transfer: VectorTransfer):
        """Multiply matrices, and inject the data of the finer problem (collective)."""
        self._fine_motions = finer.motions
        super().__init__(finer, transfer, transfer.inject(finer.fixed), all_points=finer.all_points)

    @cached_property
    def motions(self) -> np.ndarray:
        return np.array([self._up.inject(motion) for motion in self._fine_motions])

    def cold_start(self) -> np.ndarray:
        return self.between(np.where(self.fixed, self.given, 0.0))


def coarse_vector_problems(problem: System) -> list[System]:
    """Algebraic levels below a vector-valued problem with affine effects, the coarsest first (collective).

    There are none for few unknowns, or where contact alone holds the body.
    """
    assert isinstance(problem, VectorProblem)
    level, found = problem.level, list[System]()
    bs, comm = level.components, level.comm
    if not problem.affine or problem.floating or level.dofs < SMALLEST or (loops := kernels(comm)) is None:
        return []
    finer: VectorProblem | CoarseVectorSystem = problem
    nodes = _nodes(problem)
    contact, own = problem.data.contact, level.owned
    normal = np.zeros(own, dtype=bool)
    normal[contact.dofs[contact.dofs < own]] = True
    turned = total(comm, len(contact.turned)) > 0
    reflection = contact.rotation(problem.matrices.stiffness) if turned else None
    while finer.dofs > bs * COARSEST[nodes.dim]:
        graph = _graph(finer.matrices.stiffness, bs)
        nodal, nodes = coarsen(graph, nodes, loops, comm)
        graph.destroy()
        if bs * total(comm, len(nodes.key)) > SLOWEST * finer.dofs:
            break
        reflections: tuple[PETSc.Mat, ...] = ()
        if reflection is not None:
            first, last = reflection.getOwnershipRange()
            kept = nodal.inject(np.arange(first, last).reshape(-1, bs)).ravel().astype(PETSc.IntType)
            rows = PETSc.IS().createGeneral(kept, comm=comm)
            reflections = reflection, reflection.createSubMatrix(rows, rows)
            reflection = reflections[1]
        transfer = VectorTransfer(nodal, normal, bs, reflections)
        normal = transfer.inject(normal)
        finer.transfer = transfer
        finer = CoarseVectorSystem(finer, transfer)
        found.insert(0, finer)
    return found


def _nodes(problem: VectorProblem) -> Nodes:
    """The nodes of a problem (collective)."""
    level = problem.level
    bs, dim = level.components, level.mesh.topology.dim
    own = level.owned // bs
    x = np.empty((len(level.nodes.T), 3))
    x[level.node_of] = level.scalar.points.T  # the same on all ranks to the last digit
    x = x[:own].copy()
    kind = np.full(own, FREE, dtype=np.int8)
    boundary = fem.locate_dofs_topological(level.V, dim - 1, level.boundary_facets)
    kind[boundary[boundary < own]] = BOUNDARY
    kind[problem.fixed.reshape(own, bs).all(axis=1)] = FIXED
    graph = _graph(problem.matrices.stiffness, bs)
    keys = first_keys(graph, x)
    graph.destroy()
    return Nodes(x, kind, keys, None, dim)


def _graph(A: PETSc.Mat, components: int) -> PETSc.Mat:
    """The first components at the nodes in a matrix, which couple where the nodes do (collective)."""
    first, last = A.getOwnershipRange()
    nodes = PETSc.IS().createStride((last - first) // components, first, components, comm=A.comm)
    return A.createSubMatrix(nodes, nodes)

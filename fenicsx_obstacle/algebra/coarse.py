"""Coarse levels of a system: Galerkin products, the data of the finer level injected, and algebraic coarsening."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.affine import Affine
from fenicsx_obstacle.algebra.coarsening import FIXED, Nodes, coarsen
from fenicsx_obstacle.algebra.kernels import Kernels
from fenicsx_obstacle.algebra.state import State
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.parallel import total

# unknowns, by dimension, below which a direct solver is fast, and a cold start takes few steps
COARSEST = {1: 30, 2: 600, 3: 600}
SMALLEST = 1500  # unknowns of a mesh from which coarse levels reduce the time
SLOWEST = 0.7  # of the unknowns may be left by a coarsening


class CoarseSystem(System):
    """A system on coarse nodes of a finer one: P^T A P, P^T f; its states are starts and corrections for that.

    Attributes:
        finer: The next finer system.
    """

    def __init__(self, finer: System, transfer: Transfer, fixed: np.ndarray, *, all_points: bool = True):
        """Multiply matrices, and inject the data of the finer system (collective).

        Args:
            finer: Affine, with contact at dofs.
            transfer: To it.
            fixed: Whether u is given at the owned coarse nodes.
            all_points: Whether every coarse node counts as a point of I.
        """
        self.finer, self._up = finer, transfer
        self.comm, self.prefix, self.source, self.h = finer.comm, finer.prefix, finer.source, finer.h
        self.symmetric, self.has_energy, self.share = finer.symmetric, finer.has_energy, finer.share
        self.all_points, self.weights_are_sparse = all_points, finer.weights_are_sparse
        self.fixed, self.given = fixed, np.zeros(len(fixed))
        self.lower = None if finer.lower is None else np.zeros(len(fixed))
        self.upper = None if finer.upper is None else np.zeros(len(fixed))
        fine = finer.matrices
        stiffness = fine.stiffness.ptap(transfer.P)
        self._seen = fine.stiffness.stateGet()
        vectors = [stiffness.createVecRight() for _ in range(2)]
        state = State(*vectors, lower=self.lower is not None, upper=self.upper is not None)
        D = _weights(fine.D, transfer, thin=finer.weights_are_sparse)
        law = Affine(self.comm, state, stiffness, stiffness.createVecLeft(), D, np.flatnonzero(fixed))
        law.thickness = fine.thickness
        self._set_law(law)
        self._inject()
        self.set_reference(self.cold_start())

    def _inject(self) -> None:
        """Take the obstacles, given values, start and load of the finer system at the coarse nodes."""
        finer, inject = self.finer, self._up.inject
        for ours, theirs in ((self.lower, finer.lower), (self.upper, finer.upper), (self.given, finer.given)):
            if ours is not None and theirs is not None:
                ours[:] = inject(theirs)
        self.start = None if finer.start is None else inject(finer.start)
        self.floating = finer.floating
        self.matrices.minus_load.array[:] = self._up.restrict(finer.matrices.minus_load.array_r)
        self.load = total(self.comm, np.abs(self.matrices.minus_load.array_r[~self.fixed]))

    def _follow(self) -> bool:
        """Take the data of the finer system; returns whether the stiffness has changed."""
        stiffness = self.finer.matrices.stiffness
        changed = stiffness.stateGet() != self._seen
        if changed:
            stiffness.ptap(self._up.P, result=self.matrices.stiffness)
            self._seen = stiffness.stateGet()
            self.matrices.take_stiffness(self.A)
        self._inject()
        return changed

    def move(self, u_values: np.ndarray) -> bool:
        changed = self._follow()
        self.set_reference(u_values)
        return changed

    def renew(self, *, stiffness: bool) -> None:
        self._follow()
        self.set_reference(self.cold_start())


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


def algebraic_levels(system: System, nodes: Nodes, loops: Kernels) -> list[System]:
    """The levels below a system by algebraic coarsening, the coarsest first (collective).

    Args:
        system: Affine, with contact at dofs that are all points.
        nodes: Of its dofs.
        loops: Compiled.
    """
    found: list[System] = []
    while system.dofs > COARSEST[nodes.dim]:
        transfer, nodes = coarsen(system.matrices.stiffness, nodes, loops, system.comm)
        if total(system.comm, len(nodes.key)) > SLOWEST * system.dofs:
            break
        system.transfer = transfer
        system = CoarseSystem(system, transfer, nodes.kind == FIXED)
        found.insert(0, system)
    return found


def below(system: System, transfer: Transfer, *, all_points: bool = True) -> CoarseSystem:
    """The system on the nodes that coincide with coarse ones (collective)."""
    system.transfer = transfer
    return CoarseSystem(system, transfer, transfer.inject(system.fixed.astype(float)) > 0, all_points=all_points)

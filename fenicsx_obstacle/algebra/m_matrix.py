"""Checks of a stiffness matrix: whether it is symmetric, and an M-matrix, so that the maximum principle holds."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle.algebra.products import product
from fenicsx_obstacle.parallel import largest, total

ROUND_OFF = 1e-12  # of the diagonal: the legs of a right angle give zero up to this


def is_symmetric(A: PETSc.Mat) -> bool:
    """Whether A x = A^T x up to round-off for a random x, row by row: one part may be much stiffer than the others
    (collective)."""
    x, random = A.createVecRight(), PETSc.Random().create(A.comm)
    random.setInterval((-1.0, 1.0))
    x.setRandom(random)
    direct, transposed = (product(A, x.array_r, transposed=way) for way in (False, True))
    A.getDiagonal(x)
    size = np.abs(x.array_r) + np.abs(direct) + np.abs(transposed)
    apart = total(A.comm.tompi4py(), ~(np.abs(direct - transposed) <= ROUND_OFF * size))
    for owner in (x, random):
        owner.destroy()
    return apart == 0


def is_m_matrix(A: PETSc.Mat, diagonal: np.ndarray, comm: MPI.Comm) -> bool:
    """Whether a symmetric positive definite matrix has no positive off-diagonal entry: its inverse has none negative.

    Of P1 triangles with one tension: wherever the two angles opposite to an edge sum to 180 degrees at most.

    Args:
        A: The matrix; rows of fixed dofs and their columns are those of the identity.
        diagonal: Of its owned rows, without the penalty diagonal: the scale of round-off.
        comm: Of the matrix (collective).
    """
    starts, columns, values = A.getValuesCSR()
    rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    beside = columns != rows + A.getOwnershipRange()[0]
    return largest(comm, (values / diagonal[rows])[beside]) <= ROUND_OFF


def sums_nowhere_negative(A: PETSc.Mat, diagonal: np.ndarray, comm: MPI.Comm) -> bool:
    """Whether no row sum of the stiffness at free nodes is negative (collective).

    A shifted solution is then a super- or subsolution, as maximum principles for the height of u need it beside
    `is_m_matrix`: the angles at edges to fixed nodes count as well.

    Args:
        A: The matrix; rows of fixed dofs and their columns are those of the identity.
        diagonal: Of its owned rows.
        comm: Of the matrix.
    """
    return largest(comm, -product(A, 1.0) / diagonal) <= ROUND_OFF

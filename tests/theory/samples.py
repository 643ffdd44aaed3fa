"""Problems on which the statements are measured: scenes of demos/, and problems with a few unknowns."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike
from petsc4py import PETSc

from fenicsx_obstacle.algebra.solve_system import MatrixSystem
from fenicsx_obstacle.checkout import DEMOS
from fenicsx_obstacle.scenes.scene import Scene


def sample(name: str, cells: int) -> Scene:
    """A scene of demos/ with so many cells a side."""
    return Scene.read(DEMOS / f"{name}.toml").change({"mesh.cells": cells})


class Small(MatrixSystem):
    """A u + D (u - g)^+ / eps = b of a few unknowns, with g = 0 and D = 1; every rank solves the whole of it.

    Attributes:
        matrix: A.
        b: b.
        met: The active sets for which a linear system was asked for, in their order.
    """

    def __init__(self, A: ArrayLike, b: ArrayLike):
        self.matrix, self.b = np.array(A, dtype=float), np.array(b, dtype=float)
        n = len(self.b)
        dense = PETSc.Mat().createAIJ((n, n), csr=_full(self.matrix), comm=MPI.COMM_SELF)
        super().__init__(dense, self.b, lower=None, upper=np.zeros(n), weights=np.ones(n),
                         fixed=np.zeros(n, dtype=bool), given=np.zeros(n))  # fmt: skip
        self.met: list[tuple[bool, ...]] = []

    def jacobian(self, x: PETSc.Vec, *, penalised: bool = True) -> PETSc.Mat:
        A = super().jacobian(x, penalised=penalised)
        self.met.append(tuple((self.w > 0).tolist()))
        return A


def _full(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All entries of a matrix, those that are 0 too."""
    n = len(matrix)
    starts, columns = np.arange(0, n * n + 1, n, dtype=PETSc.IntType), np.tile(np.arange(n, dtype=PETSc.IntType), n)
    return starts, columns, matrix.ravel()

"""Products of PETSc matrices with owned values."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc


def product(A: PETSc.Mat, values: np.ndarray | float, *, transposed: bool = False) -> np.ndarray:
    """A times owned values, or its transpose (collective)."""
    right, left = A.createVecs()
    x, y = (left, right) if transposed else (right, left)
    x.array[:] = values
    (A.multTranspose if transposed else A.mult)(x, y)
    found = y.array.copy()
    for vector in (x, y):
        vector.destroy()
    return found


def absolute_product(A: PETSc.Mat, values: np.ndarray) -> np.ndarray:
    """|A| times owned values (collective)."""
    starts, columns, entries = A.getValuesCSR()
    absolute = PETSc.Mat().createAIJ(A.getSizes(), csr=(starts, columns, np.abs(entries)), comm=A.comm)
    found = product(absolute, values)
    absolute.destroy()
    return found

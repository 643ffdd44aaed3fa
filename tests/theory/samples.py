"""Problems on which the statements are measured: scenes of demos/, and problems with a few unknowns."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike
from petsc4py import PETSc

from fenicsx_obstacle.checkout import DEMOS
from fenicsx_obstacle.forms.pairs import P1
from fenicsx_obstacle.scenes.scene import Scene


def sample(name: str, cells: int) -> Scene:
    """A scene of demos/ with so many cells a side."""
    return Scene.read(DEMOS / f"{name}.toml").change({"mesh.cells": cells})


class Small:
    """A u + D (u - g)^+ / eps = b of a few unknowns, with g = 0 and D = 1: what the solvers ask of a `Problem`.

    No mesh lies behind it, and every rank solves the whole of it.

    Attributes:
        met: The active sets for which a linear system was asked for, in their order.
        active_sets_shrink: Whether the matrix has no positive off-diagonal entry, so that active sets must shrink.
    """

    def __init__(self, A: ArrayLike, b: ArrayLike):
        self.matrix, self.b = np.array(A, dtype=float), np.array(b, dtype=float)
        n = len(self.b)
        self.level = SimpleNamespace(comm=MPI.COMM_SELF, owned=n, h=1.0, pair=P1)
        self.w, self.reference, values = (SimpleNamespace(x=SimpleNamespace(array=np.zeros(n))) for _ in range(3))
        self.model = SimpleNamespace(effects=(), time=None)
        self.data = SimpleNamespace(fixed=(np.empty(0, dtype=np.int32), values))
        self.eps = SimpleNamespace(value=1.0)
        self.fixed, self.weights = np.zeros(n, dtype=bool), np.ones(n)
        self.touchable = ~self.fixed
        self.below, self.above = None, np.zeros(n)
        self.preconditioner: dict[str, Any] = {}
        self.keeps_solver, self.borne, self.balanced, self.loose, self.drift = False, None, None, None, None
        self.constrained = self.affine = self.has_energy = self.symmetric = True
        self.active_sets_shrink = bool(np.all(self.matrix - np.diag(np.diag(self.matrix)) <= 0))
        self.A = PETSc.Mat().createDense(n, comm=MPI.COMM_SELF)
        self.A.setUp()
        self.elastic, self.reaction = self.A.createVecs()
        self.load = float(np.abs(self.b).sum())
        self.met: list[tuple[bool, ...]] = []

    def options_of(self, solver: str) -> str:
        return f"{solver}_"

    def cold_start(self) -> np.ndarray:
        return np.zeros(len(self.b))

    def obstacles(self) -> tuple[float, np.ndarray]:
        return -np.inf, np.zeros(len(self.b))

    def set_reference(self, u_values: np.ndarray) -> None:
        self.w.x.array[:] = u_values

    def update_reference(self, *, roundoff_limited: bool = False) -> bool:
        return False

    def state(self) -> PETSc.Vec:
        x = self.A.createVecLeft()
        x.array[:] = self.w.x.array
        return x

    def set_state(self, x: PETSc.Vec) -> None:
        self.w.x.array[:] = x.array_r

    def gaps(self) -> tuple[np.ndarray, np.ndarray]:
        return np.full(len(self.b), np.inf), -self.w.x.array

    pressed_gaps = gaps

    def active_dofs(self, active: np.ndarray) -> np.ndarray:
        return active

    def residual(self, x: PETSc.Vec, out: PETSc.Vec, *, penalised: bool = True) -> None:
        self.set_state(x)
        w = self.w.x.array
        self.elastic.array[:] = self.matrix @ w - self.b
        self.reaction.array[:] = np.maximum(w, 0) / self.eps.value
        out.array[:] = self.elastic.array_r + self.reaction.array_r

    def jacobian(self, x: PETSc.Vec, *, penalised: bool = True) -> PETSc.Mat:
        self.set_state(x)
        n, active = range(len(self.b)), self.w.x.array > 0
        self.met.append(tuple(active.tolist()))
        self.A.setValues(n, n, (self.matrix + np.diag(active / self.eps.value)).ravel())
        self.A.assemble()
        return self.A

    def energy(self, x: PETSc.Vec, *, penalised: bool = True) -> float:
        w: Any = x.array_r
        return float(w @ self.matrix @ w / 2 - self.b @ w + (np.maximum(w, 0) ** 2).sum() / (2 * self.eps.value))

"""Residuals of the caller that only an obstacle supports: balance of forces gives the contact force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from hypothesis import strategies as st
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem
from fenicsx_obstacle.problems.solution import Solution
from tests.random.families.family import ANSWER, REJECTION, Family, Judgement


@dataclass(frozen=True)
class Form(Family):
    """A residual of the caller's own that nothing holds but an obstacle, and perhaps a foundation.

    Attributes:
        cells: Of the unit square.
        eps: None for SNES VI.
        bump: Height of the obstacle's middle over its edge.
        load: Downwards; negative: it pulls away.
        foundation: Its stiffness.
        energy: Whether the energy is given, too.
    """

    cells: int
    eps: float | None
    bump: float
    load: float
    foundation: float
    energy: bool

    name = "residual of one's own"

    def judge(self, judgement: Judgement) -> None:
        expected = ANSWER if self.load > 0 else REJECTION
        found = judgement.attempt(lambda: self._solved(judgement), expected, "ObstacleProblem")
        if found is None:
            return
        force = found.force.lower
        assert force is not None
        borne = self.foundation * 2 * abs(self.bump)
        judgement.check(abs(force - self.load) <= 1e-6 * self.load + borne,
                        f"contact force {force:.6g}, load {self.load:.6g}")  # fmt: skip

    def _solved(self, judgement: Judgement) -> Solution:
        mesh = releases.settle(
            dmesh.create_unit_square(judgement.comm, self.cells, self.cells, ghost_mode=releases.FACET_GHOSTS)
        )
        V = releases.functionspace(mesh, "Lagrange", 1)
        u, v, x = fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
        load, k = (fem.Constant(mesh, PETSc.ScalarType(value)) for value in (self.load, self.foundation))
        F = (ufl.inner(ufl.grad(u), ufl.grad(v)) + load * v) * ufl.dx
        J = (0.5 * ufl.inner(ufl.grad(u), ufl.grad(u)) + load * u) * ufl.dx
        if self.foundation:
            F, J = F + k * u * v * ufl.dx, J + 0.5 * k * u**2 * ufl.dx
        lower = -self.bump * ((x[0] - 0.4) ** 2 + (x[1] - 0.5) ** 2) if self.bump else 0.0
        return ObstacleProblem(F, u, lower=lower, energy=J if self.energy else None).solve(**self._how)

    @property
    def _how(self) -> dict[str, Any]:
        """Arguments of `solve`."""
        return {"method": "vi"} if self.eps is None else {"eps": self.eps}

    def text(self) -> str:
        how = ", ".join(f"{key}={value!r}" for key, value in self._how.items())
        return (
            f"unit square, {self.cells} cells a side, P1: F = inner(grad(u), grad(v))*dx + {self.load}*v*dx"
            f" + {self.foundation}*u*v*dx; lower = {-self.bump}*((x - 0.4)^2 + (y - 0.5)^2);"
            f" ObstacleProblem(F, u, lower=lower{', energy=J' if self.energy else ''}).solve({how})"
        )


@st.composite
def forms(draw: st.DrawFn) -> Form:
    """Few values, so that few forms are compiled."""
    load = draw(st.sampled_from([1.0, 0.2, 1.0, 0.2, -1.0]))
    foundation = draw(st.sampled_from([0.0, 0.0, 1e-14])) if load > 0 else 0.0
    return Form(draw(st.integers(4, 16)), draw(st.sampled_from([None, 1e-2, 1e-4, 1e-6])),
                draw(st.sampled_from([0.0, 0.5, -0.5])), load, foundation, draw(st.booleans()))  # fmt: skip

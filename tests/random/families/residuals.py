"""Residuals of the caller that only an obstacle supports: balance of forces gives the contact force."""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from hypothesis import strategies as st
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.problems.solve_form import FormAnswer, solve_form
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
        found = judgement.attempt(lambda: self._solved(judgement), ANSWER if self.load > 0 else REJECTION, "solve_form")
        if found is None:
            return
        force = found.contact.lower_force
        borne = self.foundation * 2 * abs(self.bump)
        judgement.check(abs(force - self.load) <= 1e-6 * self.load + borne,
                        f"contact force {force:.6g}, load {self.load:.6g}")  # fmt: skip

    def _solved(self, judgement: Judgement) -> FormAnswer:
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
        return solve_form(F, u, lower=lower, eps=self.eps, energy=J if self.energy else None)

    def text(self) -> str:
        return (
            f"unit square, {self.cells} cells a side, P1: F = inner(grad(u), grad(v))*dx + {self.load}*v*dx"
            f" + {self.foundation}*u*v*dx; lower = {-self.bump}*((x - 0.4)^2 + (y - 0.5)^2);"
            f" solve_form(F, u, lower=lower, eps={self.eps}{', energy=J' if self.energy else ''})"
        )


@st.composite
def forms(draw: st.DrawFn) -> Form:
    """Few values, so that few forms are compiled."""
    load = draw(st.sampled_from([1.0, 0.2, 1.0, 0.2, -1.0]))
    foundation = draw(st.sampled_from([0.0, 0.0, 1e-14])) if load > 0 else 0.0
    return Form(draw(st.integers(4, 16)), draw(st.sampled_from([None, 1e-2, 1e-4, 1e-6])),
                draw(st.sampled_from([0.0, 0.5, -0.5])), load, foundation, draw(st.booleans()))  # fmt: skip

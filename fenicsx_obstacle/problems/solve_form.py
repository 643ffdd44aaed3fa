"""`solve_form`: solves an ObstacleProblem once, with the arguments of version 0.1."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import ufl
from dolfinx import fem

from fenicsx_obstacle.algebra.stopping import TOLERANCE, Step
from fenicsx_obstacle.estimation.contact import Contact
from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem


@dataclass(frozen=True, eq=False)
class FormAnswer:
    """A converged solution of a form.

    Attributes:
        u: The caller's Function, holding the solution.
        pressure: Contact pressure at the nodes.
        contact: Contact set, area and forces.
        iterations: Newton steps.
        history: The steps of the iteration.
        eps: Penalty parameter, in units of u/p; None for the variational inequality.
    """

    u: fem.Function = field(repr=False)
    pressure: fem.Function = field(repr=False)
    contact: Contact
    iterations: int
    history: tuple[Step, ...] = field(repr=False)
    eps: float | None = None


class _OneSolve(ObstacleProblem):
    name = "solve_form"

    def answer(self, eps: Any) -> FormAnswer:
        method = "vi" if eps is None else "penalty"
        found = self._solved("auto" if eps is None else eps, method, TOLERANCE, None)
        outcome, state = found.outcome, found.state
        return FormAnswer(self.u, state.pressure, state.contact, outcome.iterations, outcome.history, outcome.eps)


def solve_form(
    F: ufl.Form,
    u: fem.Function,
    *,
    bcs: Any = (),
    lower: Any = None,
    upper: Any = None,
    eps: float | str | fem.Constant | None = None,
    energy: ufl.Form | None = None,
) -> FormAnswer:
    """Solve an `ObstacleProblem` once (collective); deprecated, use that class: this function will be removed in
    version 0.3.

    Args:
        F: As for `ObstacleProblem`.
        u: As for `ObstacleProblem`.
        bcs: As for `ObstacleProblem`.
        lower: As for `ObstacleProblem`.
        upper: As for `ObstacleProblem`.
        eps: As for `ObstacleProblem.solve`; None for the variational inequality, by SNES VI.
        energy: As for `ObstacleProblem`.

    Raises:
        InputError: If an argument is of another kind, or no u can satisfy the data.
        NotConverged: With PETSc's reason.
    """
    return _OneSolve(F, u, bcs=bcs, lower=lower, upper=upper, energy=energy).answer(eps)

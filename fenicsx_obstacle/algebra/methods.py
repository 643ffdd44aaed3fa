"""The methods: the solver, eps and the pressure that belong to each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from fenicsx_obstacle.algebra.augmented import solve_augmented
from fenicsx_obstacle.algebra.newton import penalty_pressure, solve_penalty
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.penalty_parameter import PenaltySolve, penalty_parameter
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.vi import residual_pressure, solve_vi
from fenicsx_obstacle.errors import NotConverged

METHODS = {
    "penalty": "semismooth Newton on (3.4) by PETSc SNES: full steps; a line search on the energy if sets repeat",
    "successive": "the paper's (3.4)*: the same Newton loop, started without contact, until the active set repeats",
    "vi": "PETSc SNES VI (vinewtonrsls) on the discrete variational inequality (3.19), no penalty",
}
# residuals that are not linear in u begin with the line search
NONLINEAR_WORDS = (
    "full steps; a line search on the energy if sets repeat",
    "a line search on the energy, full steps where round-off hides descent; continuation in eps if both fail",
)


@dataclass(frozen=True)
class Method:
    """A method: the solver, eps, and the pressure of its solution.

    Attributes:
        solve: From its present state; takes `multigrid`.
        penalty: The penalty solve, or None.
    """

    solve: Callable[..., Outcome]
    penalty: PenaltySolve | None
    _force: Callable[[System], np.ndarray]

    @property
    def eps(self) -> float | None:
        """Penalty parameter that a solve begins with, in units of u/p, or None."""
        return None if self.penalty is None else self.penalty.eps

    def pressure(self, problem: System) -> np.ndarray:
        """Contact pressure at owned points of I of the problem just solved (collective)."""
        return self._force(problem) * problem.share


def method_of(problem: System, options: SolverOptions, *, known: float | None = None) -> Method:
    """The method that options ask for (collective).

    Args:
        problem: To be solved.
        options: Method and eps.
        known: An eps that a solution of the same problem was found to need, instead of "auto".

    Raises:
        InputError: For a bad eps.
    """
    asked = options.method
    if asked == "vi":
        by_bounds = problem.nodal
        force = residual_pressure if by_bounds else penalty_pressure
        return Method(_named(solve_vi if by_bounds else solve_augmented, asked), None, force)
    automatic = options.eps == "auto"
    eps = known if automatic and known is not None else penalty_parameter(problem, options)
    if not problem.constrained:
        return Method(partial(solve_penalty, eps=1.0), None, penalty_pressure)
    penalty = PenaltySolve(eps, automatic=automatic, successive=asked == "successive", source=options.source)
    return Method(_named(penalty, asked), penalty, penalty_pressure)


def _named(solve: Callable[..., Outcome], asked: str) -> Callable[..., Outcome]:
    """The solver, with errors that name the requested method."""

    def solve_as_asked(*given: Any, **options: Any) -> Outcome:
        try:
            return solve(*given, **options)
        except NotConverged as error:
            if asked == "vi" and error.solver != asked:
                raise error.changed(
                    solver=asked, eps=None, reason=f"{error.reason}, in a penalty solve for it"
                ) from None
            raise error.changed(solver=asked) from None

    return solve_as_asked

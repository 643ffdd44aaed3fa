"""Choice of eps and of the solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.galerkin import coarse_problems
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.solvers.augmented import solve_augmented
from fenicsx_obstacle.solvers.linear import LARGEST
from fenicsx_obstacle.solvers.newton import penalty_pressure, solve_penalty
from fenicsx_obstacle.solvers.options import SolverOptions
from fenicsx_obstacle.solvers.penalty_parameter import PenaltySolve, penalty_parameter
from fenicsx_obstacle.solvers.snes import Outcome
from fenicsx_obstacle.solvers.vi import residual_pressure, solve_vi

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
NESTED = "conjugate gradients with truncated multigrid; each level starts from the next coarser one"
ALGEBRAIC = "where the mesh has no coarser one levels are algebraic, with interpolation exact for linear functions"
WITHOUT_HYPRE = f"GAMG, and up to {LARGEST} unknowns MUMPS in its place, because this PETSc has no hypre"
AMG = "hypre BoomerAMG" if releases.AMG == "hypre" else WITHOUT_HYPRE
LINEAR_SOLVER = f"conjugate gradients with algebraic multigrid ({AMG})"
GENERAL_SOLVER = f"GMRES with algebraic multigrid ({AMG}), because the equation is not symmetric"
DIRECT_SOLVER = "a direct solver (MUMPS), because contact couples the nodes of a cell"
AUGMENTED = "penalty solves with augmented obstacles g + eps p: the quadratic program with u <= g at the points of I"


def nested(effects: Sequence[Effect], pair: Pair, options: SolverOptions) -> bool:
    """Whether a problem is solved from the coarsest level on: that of its mesh, or an algebraic one below it.

    Truncated multigrid needs stiffness matrices that hold still (affine effects), symmetric and definite, and contact
    at the vertices, or that of P2, which begins with P1 on the same mesh. (3.4)* is the paper's own
    iteration, which starts without contact; `start = "cold"` asks for the same of the other methods. Whatever is not
    nested is solved with `LINEAR_SOLVER`, `GENERAL_SOLVER` or, where the pair is not nodal, `DIRECT_SOLVER`.
    """
    simple = all(effect.affine and effect.symmetric and effect.convex for effect in effects)
    serves = pair.at_vertices or pair.has_p1_coarse_space
    return simple and serves and options.start == "nested" and options.method != "successive"


def stepwise(effects: Sequence[Effect], pair: Pair, options: SolverOptions) -> bool:
    """Whether nested iteration is used although truncated multigrid is not possible, for better initial values.

    Newton's method then has the region of convergence of the coarsest mesh, and few steps on the finest.
    """
    starts = options.start == "nested" and options.method != "successive"
    return starts and pair.nested_hierarchy and not nested(effects, pair, options)


def chain(problem: Problem) -> list[Problem]:
    """The problems from the coarsest mesh to this one; only this one without nested iteration (collective)."""
    problem.__dict__.pop("transfer", None)  # from a coarse problem without a mesh
    problems = [problem]
    for level in problem.level.on_meshes.downward[1:]:
        try:
            data = Data(problem.model, level, problem.data.moment)  # one clock for all levels
            problems.insert(0, Problem(data))
        except InputError:  # data that only the fine levels resolve
            break
    return problems


def hierarchy(problem: Problem, *, on_meshes: bool = False) -> list[Problem]:
    """The problems of all levels, the coarsest first, with algebraic ones below the coarsest mesh (collective).

    Without obstacles BoomerAMG is as good as algebraic levels, where there is hypre.

    Args:
        problem: That truncated multigrid serves.
        on_meshes: Whether the coarse problems are to have meshes and data of their own, to be looked at, instead of
            Galerkin products.
    """
    algebraic = problem.constrained or releases.AMG != "hypre"
    if on_meshes:
        problems = chain(problem)
        return [*(coarse_problems(problems[0]) if algebraic else []), *problems]
    problems, level = [problem], problem.level
    if level.pair.has_p1_coarse_space:
        assert level.coarse is not None
        with suppress(InputError):  # data that only P2 resolves
            problems.insert(0, Problem(Data(problem.model, level.coarse, problem.data.moment)))
    return [*coarse_problems(problems[0], algebraic=algebraic), *problems]


@dataclass(frozen=True)
class Method:
    """A method: the solver, eps, and the pressure of its solution.

    Attributes:
        solve: From its present state; takes `multigrid`.
        eps: Penalty parameter that it begins with, in units of u/p, or None.
        share: Of the force that balances a step in time, the part that is the contact force: 1, or 1/2 with inertia.
    """

    solve: Callable[..., Outcome]
    eps: float | None
    share: float
    _force: Callable[[Problem], np.ndarray]

    def pressure(self, problem: Problem) -> np.ndarray:
        """Contact pressure at owned points of I of the problem just solved (collective)."""
        return self._force(problem) * self.share


def method_of(problem: Problem, options: SolverOptions, *, known: float | None = None) -> Method:
    """The method that options ask for (collective).

    Args:
        problem: To be solved.
        options: Method and eps.
        known: An eps that a solution of the same problem was found to need, instead of "auto".

    Raises:
        InputError: For a bad eps.
    """
    moments = problem.model.time
    asked, share = options.method, 1.0 if moments is None else moments.share
    if asked == "vi":
        by_bounds = problem.level.pair.nodal
        force = residual_pressure if by_bounds else penalty_pressure
        return Method(_named(solve_vi if by_bounds else solve_augmented, asked), None, share, force)
    automatic = options.eps == "auto"
    eps = known if automatic and known is not None else penalty_parameter(problem, options)
    if not problem.constrained:
        return Method(partial(solve_penalty, eps=1.0), None, share, penalty_pressure)
    penalty = PenaltySolve(
        eps, share, automatic=automatic, successive=asked == "successive", source=options.source
    )  # fmt: skip
    return Method(_named(penalty, asked), eps, share, penalty_pressure)


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

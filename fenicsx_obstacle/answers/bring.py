"""Bring your own residual: the solvers of this package on a form that somebody else has written."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from fenicsx_obstacle.answers.given import check_form, conditions, obstacle, penalty_parameter
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.levels import of_space
from fenicsx_obstacle.discrete.model import Model
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.contact import Contact, contact_of
from fenicsx_obstacle.parallel import smallest
from fenicsx_obstacle.solvers.newton import penalty_pressure, solve_penalty
from fenicsx_obstacle.solvers.stopping import Step
from fenicsx_obstacle.solvers.vi import residual_pressure, solve_vi
from fenicsx_obstacle.words import shown

SHARE = 0.01  # of the median of D_i/A_ii: eps = "auto"


@dataclass(frozen=True, eq=False)
class FormAnswer:
    """A converged solution of a residual of the caller's own.

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
    """Solve F(u; v) + (1/eps) I((u - g)^+, v) = 0 for u between obstacles (collective).

    F is the residual without contact: the penalty is added here. Linear or not, in any UFL; PETSc options with the
    prefix `penalty_` or `vi_` choose the linear solver (default: conjugate gradients with BoomerAMG where an energy is
    given, GMRES with BoomerAMG otherwise).

    Args:
        F: Residual, a linear form in one test function.
        u: Unknown of F, a continuous P1 Function: start and solution. Where nothing but contact holds it the start is
            in contact instead.
        bcs: Dirichlet conditions, a list or a single one.
        lower: Obstacle below, taken at the nodes: a number; a Function, also of another space, or on another mesh that
            covers this one; UFL without u; or a callable of x, shape (3, n), as Function.interpolate takes it.
        upper: Obstacle above, in the same way.
        eps: Penalty parameter: a number or a Constant; "auto", a hundredth of the median of D_i/A_ii over the nodes
            where u is free, for A the derivative of F at the start and D the weights of the vertex rule; None for the
            variational inequality, by SNES VI.
        energy: The functional whose derivative F is; with it a line search safeguards the iteration.

    Raises:
        InputError: If the space is not P1 on simplices, no obstacle is given, or an argument is of another kind or not
            admissible.
        NotConverged: With PETSc's reason.
    """
    if lower is None and upper is None:
        raise InputError("solve_form: give an obstacle, lower= or upper=")
    if not isinstance(u, fem.Function):
        raise InputError(f"solve_form: u = {shown(u)}: expected the Function that F is to be solved for")
    level, eps = of_space(u.function_space), penalty_parameter(eps)
    check_form(F, u, "F", arguments=1)
    if energy is not None:
        check_form(energy, u, "energy", arguments=0)
    bcs = conditions(bcs, u.function_space)
    lower, upper = (None if g is None else obstacle(g, u, name) for g, name in ((lower, "lower"), (upper, "upper")))
    model = Model((OfForm(F=F, u=u, functional=energy),), lower, upper, source="solve_form")
    data = Data(model, level, bcs=bcs)
    problem = Problem(data)
    data.refuse_infinite(u, words="solve_form: u, the start,")
    start = u.x.array.copy()
    dofs, values = data.fixed
    start[dofs] = values.x.array[dofs]
    low, high = problem.obstacles()
    start = problem.cold_start() if problem.floating else np.clip(start, low, high)
    problem.refer(start)
    if energy is not None:
        _refuse_no_minimum(problem)
    if isinstance(eps, str):
        eps = _automatic(problem)
    if eps is None:
        outcome = solve_vi(problem)
        p = residual_pressure(problem)
    else:
        outcome = solve_penalty(problem, eps)
        p = penalty_pressure(problem)
    contact = contact_of(problem, p)
    u.x.array[:] = problem.heights().x.array
    pressure = fem.Function(u.function_space, name="p")
    pressure.x.array[: len(p)] = p
    pressure.x.scatter_forward()
    return FormAnswer(u, pressure, contact, outcome.iterations, outcome.history, eps)


def _diagonal(problem: Problem) -> np.ndarray:
    """A_ii at owned nodes where u is free, for A the derivative of F at the present state (collective)."""
    state = problem.state()
    diagonal = problem.jacobian(state, penalised=False).getDiagonal()
    found = diagonal.array_r[~problem.fixed]
    for owner in (state, diagonal):
        owner.destroy()
    return found


def _automatic(problem: Problem) -> float:
    """eps = "auto" (collective).

    Raises:
        InputError: If A has no positive diagonal entry there.
    """
    diagonal = _diagonal(problem)
    ratios = problem.weights[~problem.fixed][diagonal > 0] / diagonal[diagonal > 0]
    everywhere = np.concatenate(problem.level.comm.allgather(ratios))
    if not len(everywhere):
        raise InputError("solve_form: eps = 'auto': the derivative of F has no positive diagonal entry; give a number")
    return SHARE * float(np.median(everywhere))


def _refuse_no_minimum(problem: Problem) -> None:
    """A convex energy gives the derivative of F a positive diagonal (collective)."""
    least = smallest(problem.level.comm, _diagonal(problem))
    if least <= 0:
        raise InputError(
            f"solve_form: the energy has no minimum: the derivative of F has {least:.3g} on its diagonal; "
            "is a sign wrong? without energy= any solution of the equation is taken"
        )


@dataclass(frozen=True, eq=False)
class OfForm(Effect):
    """The caller's residual as an effect: what a problem is made of.

    Attributes:
        F: Residual.
        u: Its unknown.
        functional: Whose derivative F is, or None.
    """

    value: Any = None
    F: ufl.Form = None
    u: fem.Function = None
    functional: ufl.Form | None = None

    key = "solve_form"
    elastic = True
    affine = False

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        return self.functional is not None

    @property
    def convex(self) -> bool:  # type: ignore[override]
        return self.functional is not None

    def terms(self, u: Any, v: Any, data: Any) -> ufl.Form:
        return ufl.replace(self.F, {self.u: u, self.F.arguments()[0]: v})

    def heights(self, data: Any) -> list[Any]:
        return [0.0]

    def energy(self, u: Any, data: Any) -> ufl.Form | None:
        return None if self.functional is None else ufl.replace(self.functional, {self.u: u})

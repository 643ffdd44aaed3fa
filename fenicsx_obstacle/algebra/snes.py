"""A PETSc SNES for a problem: callbacks that never raise on one rank, defaults that options override."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra.data_scales import determined, stiffness_of
from fenicsx_obstacle.algebra.inexact_newton import Inexact
from fenicsx_obstacle.algebra.linear_solvers import (
    COARSEST,
    DIRECT,
    GENERAL,
    INEXACT,
    LARGEST,
    LINEAR,
    SADDLE,
    attempt,
    check_diagonal,
    defaults,
    direct_first,
    user_has_set,
)
from fenicsx_obstacle.algebra.plausibility import violation
from fenicsx_obstacle.algebra.reduced_systems import OnInactive, Reduced
from fenicsx_obstacle.algebra.stopping import MEANINGLESS, ON_THE_WAY, Step, Stopping, in_words
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.truncated_multigrid import HeldRows, KeptLevels, Multigrid
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.parallel import total

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a solver; the state is in the problem.

    Attributes:
        solver: Its name.
        iterations: Newton steps.
        krylov: Linear iterations in all steps.
        history: One step per line.
        seconds: Time of the iteration.
        reason: PETSc's reason.
        roundoff_limited: Balance was only reached up to the round-off of w.
        from_afar: The round-off of w exceeds the tolerance, and hardly any of it is that of u.
        active: Which obstacle holds each owned node, as in `Stopping.before`.
        eps: Penalty parameter of the solution in units of u/p; None without a penalty.
    """

    solver: str
    iterations: int
    krylov: int
    history: tuple[Step, ...]
    seconds: float
    reason: int
    roundoff_limited: bool = False
    from_afar: bool = False
    active: np.ndarray | None = None
    eps: float | None = None

    @property
    def converged(self) -> bool:
        return self.reason > 0


def run(
    problem: System,
    name: str,
    options: Mapping[str, Any],
    stopping: Stopping,
    *,
    penalised: bool = True,
    objective: bool = False,
    prepare: Callable[[PETSc.SNES], None] | None = None,
    multigrid: Multigrid | None = None,
    direct: bool = False,
) -> Outcome:
    """Solve from the problem's present state; w is the last state whatever happens (collective).

    Args:
        problem: What to solve.
        name: Name of the solver, and prefix of its options where the problem has none of its own.
        options: Its defaults, without the prefix; the user's PETSc options win.
        stopping: When to stop.
        penalised: Whether the penalty is part of the residual.
        objective: Give the line search the energy.
        prepare: Called with the SNES before it solves.
        multigrid: Preconditioner, unless the user's options name another.
        direct: Solve linear systems directly. So it is done, up to `LARGEST` unknowns, where the other way fails:
            tensions that jump by 1e6 within a few cells defeat algebraic multigrid.
    """
    start = time.perf_counter()
    prefix = problem.options_of(name)
    chosen = user_has_set(f"{prefix}pc_type")
    if direct or chosen:
        multigrid = None
    linear: Mapping[str, Any] = {**(LINEAR if problem.symmetric else GENERAL), **problem.preconditioner}
    directly = multigrid is None and not (chosen or problem.preconditioner) and direct_first(problem.dofs)
    if direct or problem.direct or not problem.nodal or directly:
        linear = DIRECT  # algebraic multigrid fails with a large penalty that couples nodes
    held: Multigrid | HeldRows | None = None if penalised else multigrid
    if problem.preconditioner and not (penalised or chosen or linear is DIRECT):
        held = HeldRows(problem)
        # SNES VI reads the options again when the active set changes
        linear = {key: value for key, value in linear.items() if key != "pc_type"}
    by_rigid_motions = bool(problem.preconditioner) and penalised and not chosen and linear is not DIRECT
    inexact = multigrid is not None or (by_rigid_motions and problem.symmetric)
    database = {**options, **(linear if multigrid is None else INEXACT)}
    if problem.direct:
        database |= SADDLE
    if problem.comm.size > 1 and not problem.affine:
        database |= COARSEST
    if inexact:
        database["ksp_norm_type"] = INEXACT["ksp_norm_type"]
    if user_has_set(f"{prefix}ksp_type"):
        for key in ("ksp_norm_type", "ksp_pc_side"):  # the natural norm is one of few methods
            database.pop(key, None)
    snes = PETSc.SNES().create(problem.comm)
    x = problem.vector()
    residual = x.duplicate()
    # a NaN is seen by PETSc on all ranks; an exception would leave the others waiting
    snes.setFunction(lambda _, x, out: problem.residual(x, out, penalised=penalised), residual)

    def jacobian(_: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        if multigrid is not None and penalised:
            problem.set_state(x)
            multigrid.truncate(problem.matrices.penalty_diagonal())
        else:
            problem.jacobian(x, penalised=penalised)
            if linear is not DIRECT and not problem.affine:
                check_diagonal(problem.A, problem.comm)

    snes.setJacobian(jacobian, problem.A if held is None else Reduced.whole(problem.A))
    if objective:
        snes.setObjective(lambda _, x: problem.energy(x, penalised=penalised))
    snes.setOptionsPrefix(prefix)
    with defaults(prefix, database):
        if multigrid is not None and penalised:
            multigrid.install(snes.ksp.pc)
        snes.setFromOptions()
        if by_rigid_motions:
            snes.ksp.pc.setType("python")
            snes.ksp.pc.setPythonContext(KeptLevels(problem, prefix))
        if held is not None:
            snes.ksp.pc.setType("python")
            snes.ksp.pc.setPythonContext(OnInactive(held, prefix))
        if prepare is not None:
            prepare(snes)
        if inexact:
            snes.ksp.setConvergenceTest(Inexact(stopping, cold_start=multigrid is None))
        snes.setConvergenceTest(stopping)  # last: setting bounds or setting up a VI installs PETSc's own
        finished = attempt(lambda: snes.solve(None, x), snes, x, residual)
        finished = total(problem.comm, not finished) == 0  # an error may be of one rank alone
    problem.set_state(x)
    unsolved = PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
    reason = snes.getConvergedReason() if finished else unsolved
    if direct and reason == unsolved and problem.affine and not problem.symmetric:
        reason = MEANINGLESS  # A is singular up to round-off
    outcome = Outcome(
        name, snes.getIterationNumber(), snes.getLinearSolveIterations(), tuple(stopping.history),
        time.perf_counter() - start, reason, stopping.roundoff_limited,
        stopping.from_afar, stopping.before,
    )  # fmt: skip
    for owner in (x, residual):
        owner.destroy()
    if problem.keeps_solver:
        problem.solver = _detached(snes)
    else:
        snes.destroy()
    failed = outcome.reason == unsolved and linear is not DIRECT
    if failed and problem.dofs <= LARGEST and not any(user_has_set(f"{prefix}{key}") for key in LINEAR):
        _log.info("an iterative linear solver did not converge; a direct solver is used")
        stopping.begin_again()
        again = run(problem, name, options, stopping, penalised=penalised, objective=objective, prepare=prepare,
                    direct=True)  # fmt: skip
        outcome = replace(
            again, iterations=outcome.iterations + again.iterations, krylov=outcome.krylov + again.krylov,
            seconds=outcome.seconds + again.seconds,
        )  # fmt: skip
    return outcome


def _detached(snes: PETSc.SNES) -> PETSc.SNES:
    """The SNES without its callbacks. They refer to the problem, which Python could not free as long as they do."""
    snes.setFunction(lambda *_: None, snes.getFunction()[0])
    snes.setJacobian(lambda *_: None, snes.getJacobian()[0])
    snes.setObjective(lambda *_: 0.0)
    for solver in (snes, snes.ksp):
        solver.setConvergenceTest(lambda *_: 0)
    if snes.ksp.pc.getType() == PETSc.PC.Type.PYTHON:
        snes.ksp.pc.setType(PETSc.PC.Type.NONE)
    return snes


def is_on(value: str) -> bool:
    """Whether an option without a value, or with this one, is on."""
    return value.lower() not in ("0", "false", "no", "off")


def refuse(problem: System, solver: str, options: Mapping[str, tuple[Callable[[str], bool], str]]) -> None:
    """Reject values of the user's PETSc options that a solver does not take.

    Args:
        problem: Says how its options begin.
        solver: The name of the solver.
        options: By their names without prefix, which values are not taken, and why.

    Raises:
        InputError: With the option.
    """
    for key, (is_wrong, why) in options.items():
        option = problem.options_of(solver) + key
        if user_has_set(option) and is_wrong(value := PETSc.Options().getString(option, "")):
            raise InputError(f"PETSc option {option} = {value}: {why}")


def is_limited(problem: System, solver: str) -> bool:
    """Whether the user's options limit the number of steps of a solver: the limit is kept."""
    return user_has_set(problem.options_of(solver) + "snes_max_it")


def require(outcome: Outcome, problem: System, eps: float | None, tolerance: float) -> Outcome:
    """The outcome, if it converged to a solution (collective).

    Raises:
        NotConverged: Otherwise: no unconverged state is ever an answer, and none that no solution can be.
    """
    if not outcome.converged:
        reason = in_words(outcome.reason) + problem.hint
        eps = None if outcome.reason == MEANINGLESS else eps
        raise NotConverged(outcome.solver, reason, outcome.iterations, eps=eps, h=problem.h)
    if tolerance < ON_THE_WAY and outcome.active is not None:
        # before `violation`, which may leave another matrix in A
        stiffness = stiffness_of(problem, exact_bounds=outcome.solver == "vi") if outcome.roundoff_limited else None
        found = violation(problem, outcome.active)
        unbalanced = outcome.history[-1].unbalanced
        if stiffness is not None and not determined(problem, outcome.active, stiffness, unbalanced):
            found = in_words(MEANINGLESS)
        if found is not None:
            raise NotConverged(outcome.solver, found, outcome.iterations, eps=None, h=problem.h)
    return outcome

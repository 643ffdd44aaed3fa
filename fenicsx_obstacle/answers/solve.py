"""solve(): a scene on one mesh, or on meshes that are refined until a tolerance is reached."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path

from mpi4py import MPI

from fenicsx_obstacle.answers.adapt import Adaptation
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.budget import Budget
from fenicsx_obstacle.answers.guaranteed_outputs import with_guaranteed_outputs
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.catalogue import SCENE, changed
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.signatures import checked


@checked(scene=SCENE, budget="a text such as '60s', '8GB' or '1e6 unknowns'", eps="a number, a formula in h, or 'auto'")
def solve(
    scene: Scene | str | Path,
    *,
    eps: float | str | None = None,
    cells: int | None = None,
    refine: int | None = None,
    method: str | None = None,
    start: str | None = None,
    element: str | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    yardstick: bool = False,
    bound: bool = False,
    tol: float | None = None,
    tol_absolute: float | None = None,
    goal: str | None = None,
    budget: str | None = None,
    restart: str | Path | None = None,
    keep: str | Path | None = None,
    uncertainty: bool = False,
) -> Answer:
    """Solve a scene (collective).

    Args:
        scene: A Scene, its file, or its name in the catalogue. The other arguments take precedence over its values.
        eps: Penalty parameter: "auto", a number in the unit of u/p, or a formula in h.
        cells: Number of cells along x, for meshes that are shapes.
        refine: Number of uniform refinements.
        method: "penalty", "successive" or "vi".
        start: "nested": start on the coarsest mesh; "cold": solve on the finest mesh only.
        element: "P1", "P2", "Q1", "Q2", "P1-voronoi" or "Q1-gauss".
        comm: Communicator; not used if the scene has a DOLFINx mesh.
        yardstick: Also measure the time of one linear Poisson solve on the same mesh.
        bound: Also compute a bound of the energy error, `answer.bound`.
        tol: Tolerance for the energy error, relative to the energy norm of u: 0.05 is 5 %. The mesh is refined and, if
            eps is "auto", eps is reduced until the bound is below the tolerance.
        tol_absolute: Tolerance for the energy error, in the unit of the energy norm.
        goal: Apply the tolerance to this quantity in place of the energy error: "energy", "force" ("force.lower" or
            "force.upper" if there are two obstacles), or a name of [report] that depends on u differentiably.
        budget: With a tolerance: a limit, such as "60s", "8GB" or "1e6 unknowns". If the limit ends the refinement, the
            best solution so far is returned, and `answer.adaptive.reached` is False.
        restart: With [time]: continue from the state in this folder. Any number of ranks may have saved it.
        keep: With [time]: save the state into this folder every 20 s and at the end.
        uncertainty: Estimate the error of each quantity from two coarser meshes: `answer.record["uncertainty"]`.

    Returns:
        The solution. A solve that does not converge returns no solution, but raises an error.

    Raises:
        InputError: If the data are invalid.
        NotConverged: If a solver fails, with PETSc's reason.
    """
    given = {"eps": eps, "cells": cells, "refine": refine, "method": method, "start": start, "element": element}
    scene, limits = changed(scene, given), Budget.of(budget)
    if scene.model.vector_valued:
        from fenicsx_obstacle.answers.bodies import BodyContext  # only where a scene has an elastic body

        asked = {"bound": bound, "tol": tol, "tol_absolute": tol_absolute, "budget": budget, "yardstick": yardstick,
                 "restart": restart, "uncertainty": uncertainty}  # fmt: skip
        for key, value in asked.items():
            if value not in (None, False):
                scene.only_scalar(key)
        return BodyContext(scene, comm).answer()
    if bound:
        check_equilibrium(scene)
    if scene.time is None and restart is not None:
        raise InputError(f"{scene.source}: has no [time], so there is no state to continue from")
    if tol is not None or tol_absolute is not None:
        if uncertainty:
            raise InputError(
                "--uncertainty takes three meshes whose cells halve, which adaptive meshes do not: with a tolerance "
                "there is the error bound; for an uncertainty of each value give --cells or --refine instead of --tol"
            )
        return adaptation(scene, tol, tol_absolute, goal=goal, budget=limits, comm=comm).answer(yardstick=yardstick)
    for name, given_one in (("a budget", budget), ("--of", goal)):
        if given_one is not None:
            raise InputError(f"{name} needs a tolerance: add --tol")
    with closing(SolverContext(scene, comm)) as context:
        begin, states = (None if folder is None else Path(folder) for folder in (restart, keep))
        answer = context.answer(yardstick=yardstick, bound=bound, restart=begin, keep=states, errors=False)
        if bound:
            answer = with_guaranteed_outputs(answer, context)
        context.forget_levels()
        if uncertainty:
            from fenicsx_obstacle.answers.uncertainty import with_uncertainties  # only where it is asked for

            answer = with_uncertainties(answer, context.problem.data)
        return context.measured(answer)


def check_equilibrium(scene: Scene) -> None:
    """Reject a scene that moves: there is no error bound for it.

    Raises:
        InputError: If the scene has [time].
    """
    if scene.time is not None:
        raise InputError(f"{scene.source}: the error bound is for one equilibrium, not for scenes with [time]")


def adaptation(
    scene: Scene,
    tol: float | None,
    tol_absolute: float | None = None,
    *,
    goal: str | None = None,
    budget: Budget | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Adaptation:
    """The adaptive refinement for a tolerance; nothing is computed yet.

    Args:
        scene: What to solve.
        tol: Relative tolerance, or None.
        tol_absolute: Absolute tolerance, or None.
        goal: The quantity that has the tolerance; None for the energy norm.
        budget: Its limits.
        comm: Communicator; not used if the scene has a DOLFINx mesh.

    Raises:
        InputError: If the tolerance or the quantity is wrong, or the scene moves.
    """
    check_equilibrium(scene)
    if tol is not None and tol_absolute is not None:
        raise InputError("two tolerances: give --tol or --tol-absolute")
    option, number = ("--tol-absolute", tol_absolute) if tol is None else ("--tol", tol)
    if number is None or not 0 < number < math.inf:
        raise InputError(f"{option} {number}: must be positive and finite")
    if tol is not None and tol >= 1:
        raise InputError(f"--tol {tol:g}: the tolerance is relative and must be below 1: 0.05 is 5 %")
    tolerance = number, tol is not None
    if goal is None:
        return Adaptation(scene, comm, tolerance, budget)
    from fenicsx_obstacle.answers.goal import GoalAdaptation  # only where there is one

    return GoalAdaptation(scene, goal, tolerance, budget, comm)

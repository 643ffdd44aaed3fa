"""The one path from a discrete problem at rest to its solution: fields, contact and counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fenicsx_obstacle.algebra.methods import Method, method_of
from fenicsx_obstacle.algebra.nested import Levels, solve_nested
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.stopping import TOLERANCE, StepMonitor
from fenicsx_obstacle.discrete.contact_set import Contact, contact_of
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.fields.scalar import Fields


@dataclass(frozen=True, eq=False)
class State:
    """Fields and contact of a solution.

    Attributes:
        fields: u, pressure, contact set and obstacles; later values of the obstacles do not change them.
        contact: Contact set and forces.
        energy: Of what is at rest, the penalty's included; None where there is none.
    """

    fields: Fields
    contact: Contact
    energy: float | None

    def sides(self, problem: Problem) -> dict[str, float]:
        """The force on each obstacle there is, >= 0."""
        forces = {"lower": self.contact.lower_force, "upper": self.contact.upper_force}
        gaps = {"lower": problem.below, "upper": problem.above}
        return {side: force for side, force in forces.items() if gaps[side] is not None}


def solve(
    levels: Levels,
    options: SolverOptions,
    *,
    known: float | None = None,
    start: Callable[[float | None], None] | None = None,
    ready: int = 0,
    tolerance: float = TOLERANCE,
    monitor: StepMonitor | None = None,
) -> tuple[list[Outcome], State]:
    """Solve the finest problem of some levels, for its present data (collective).

    Scenes, forms, elastic bodies and their coarser meshes all come here. Steps in time repeat the middle line.

    Args:
        levels: Those of the problem.
        options: Method and eps.
        known: As for `method_of`.
        start: As for `solve_nested`, as the next three.
        ready: The number of coarsest levels that are solved.
        tolerance: Unbalanced force over acting forces.
        monitor: Called after each step.

    Returns:
        The outcomes of the levels that were solved, the finest last, and the state on the finest.

    Raises:
        InputError: For a bad eps.
        NotConverged: With PETSc's reason.
    """
    problem = levels.finest
    assert isinstance(problem, Problem)
    method = method_of(problem, options, known=known)
    outcomes = solve_nested(levels, method, start=start, solved=ready, tolerance=tolerance, monitor=monitor)
    return outcomes, state_of(problem, method)


def state_of(problem: Problem, method: Method) -> State:
    """The state of a problem after a solve (collective)."""
    data, contact = problem.data, contact_of(problem, method.pressure(problem))
    energy = None
    if problem.has_energy:
        x = problem.vector()
        energy = problem.energy(x, penalised=method.eps is not None, moving=False)
        if method.eps is not None and problem.share != 1.0:  # the problem's eps is that of a step
            energy = (1 - problem.share) * problem.energy(x, penalised=False, moving=False) + problem.share * energy
        x.destroy()
    touching = problem.in_q((contact.lower | contact.upper).astype(float))
    pressure = problem.pressures(contact.pressure * problem.thickness)
    sides = (None if side is None or data.thin else side.copy() for side in (data.lower, data.upper))
    return State(Fields(problem.level, problem.solution(), pressure, touching, *sides), contact, energy)

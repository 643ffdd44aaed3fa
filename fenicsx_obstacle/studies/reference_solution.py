"""Reference solutions for errors: the exact solution, or the finest solution within a budget, with its bound."""

from __future__ import annotations

import logging
from collections.abc import Generator, Mapping
from contextlib import closing
from itertools import product
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.answers.adapt import Adaptation
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.cloud import Cloud, Nearby, on_simplices
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.estimation.exact_contact import exact_contact
from fenicsx_obstacle.estimation.norms import Distance, Exact
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.studies.choices import uniform_meshes

_log = logging.getLogger(__name__)
FINER = 4.0  # times the seconds and unknowns of a row: what a reference may take
GROWTH = 3.0  # of unknowns from one adaptive mesh to the next, about
Errors = dict[str, float]


class ExactReference:
    """Errors relative to [exact], and of the contact if it is known.

    Attributes:
        record: What was taken for the truth.
        occupied: MB that measuring errors on the present mesh takes, as far as somebody noted it.
    """

    def __init__(self, scene: Scene, comm: MPI.Comm):
        """Find contact area and force of the exact solution (collective)."""
        assert scene.exact is not None
        self.solution = scene.exact
        self._contact = exact_contact(scene.model, scene.exact, meshes.build(scene, comm, 0))
        self.record: dict[str, Any] = {"exact": True, **self._contact}
        self._exact: tuple[SolverContext, Exact] | None = None
        self.occupied = 0.0

    def errors(self, context: SolverContext, answer: Answer) -> Errors:
        """By norm; `pressure` too where the scene knows it (collective)."""
        if self._exact is None or self._exact[0] is not context:
            self._exact = context, Exact(context.problem, self.solution)
        found, _ = self._exact[1].errors(answer.u, answer.pressure, answer.record["eps"])
        norms = {"energy": "energy", "l2": "l2", "max": "max", "pressure_l2": "pressure"}
        errors = {name: found[key] for key, name in norms.items() if key in found}
        return errors | _contact_errors(answer, self._contact)

    def forget(self) -> None:
        """Release the solver context."""
        self._exact, self.occupied = None, 0.0


class Reference:
    """Errors against a solution on another mesh, at the quadrature points of the cells of that with more cells.

    Attributes:
        answer: The solution.
        record: Unknowns, bound, and how much the last refinement changed of each norm.
        occupied: MB that measuring errors on the present mesh takes, as far as somebody noted it.
    """

    def __init__(self, answer: Answer, record: Mapping[str, Any]):
        self.answer, self.record = answer, dict(record)
        self._simplices = on_simplices(answer)
        self._cloud = Cloud.of(answer)
        self._nearby: tuple[Level, Nearby] | None = None
        self.occupied = 0.0

    def errors(self, _: object, answer: Answer) -> Errors:
        """By norm; the maximum is over the points (collective)."""
        answer = on_simplices(answer)
        finer, coarser = self._simplices, answer
        if answer.level.cells > self._simplices.level.cells:  # the slopes of the answer jump inside the other's cells
            finer, coarser = coarser, finer
        cloud = self._cloud if finer is self._simplices else Cloud.of(finer, coarser.level.pair.degree)
        if self._nearby is None or self._nearby[0] is not answer.level:
            self._nearby = answer.level, Nearby(cloud, coarser.level)
        nearby = self._nearby[1]
        nearby.cloud = cloud  # of the same points
        return {**nearby.norms(coarser.u), **_contact_errors(answer, self.record)}

    def forget(self) -> None:
        """Release the mesh."""
        self._nearby, self.occupied = None, 0.0


Truth = ExactReference | Reference


def contact_of(answer: Answer) -> dict[str, float]:
    """Contact area and force of both obstacles."""
    contact = answer.record["contact"]
    force = sum(contact[side]["force"] for side in ("lower", "upper") if side in contact)
    return {"area": contact["area"], "force": force}


def sizes_of(distance: Distance, answer: Answer) -> Errors:
    """The norms of the solution itself, by which errors become relative (collective)."""
    pressure = {"pressure": distance.pressure(answer.pressure.x.array)}
    return {**distance.of_u(answer.u.x.array), **contact_of(answer), **pressure}


def _contact_errors(answer: Answer, truth: Mapping[str, float]) -> Errors:
    return {name: abs(value - truth[name]) for name, value in contact_of(answer).items() if name in truth}


def make_reference(scene: Scene, seconds: float, unknowns: float, comm: MPI.Comm) -> Reference:
    """The finest solution within the limits, times `FINER` (collective).

    Refined where the error is, with its bound, where there are bounds for the scene; else on the finest uniform mesh.
    With quadratic elements, if they are possible.

    Args:
        scene: What is solved.
        seconds: Limit of a row.
        unknowns: Limit of a row.
        comm: Communicator.

    Raises:
        ObstacleError: If the scene cannot be solved.
    """
    for way, element in product((_refined, _uniform), dict.fromkeys(("P2", scene.pair.name))):
        found = list[Answer]()
        try:
            with closing(way(scene.change({"solve.element": element}), comm)) as answers:
                for answer, next_seconds, next_unknowns in answers:
                    found = [*found[-1:], answer]
                    last = next_seconds > FINER * seconds or next_unknowns > FINER * unknowns
                    if len(found) > 1 and comm.bcast(last):
                        break
            break
        except (InputError, NotConverged) as error:
            _log.info("no reference: %s", error)
            refused = error
    else:
        raise refused
    answer, before = found[-1], found[0]
    bound = answer.bound
    record = {"exact": False, "dofs": answer.record["dofs"], "eps": answer.record["eps"], **contact_of(answer)}
    if bound is not None:
        record["bound"] = {"total": bound.total, "relative": bound.relative, "words": bound.words,
                           "guaranteed": bound.guaranteed}  # fmt: skip
    reference = Reference(answer, record)
    reference.record["changed"] = reference.errors(None, before)
    reference.forget()
    return reference


Answers = Generator[tuple[Answer, float, float], None, None]  # with about the seconds and unknowns of the next mesh


def _refined(scene: Scene, comm: MPI.Comm) -> Answers:
    """Answers on meshes refined where the error is (collective)."""
    refinement = Adaptation(next(uniform_meshes(scene)), comm)
    with closing(refinement.meshes()) as meshes:
        for _, answer in meshes:
            yield answer, (1 + GROWTH / 2) * refinement.path[-1]["seconds"], GROWTH * answer.record["dofs"]


def _uniform(scene: Scene, comm: MPI.Comm) -> Answers:
    """Answers on uniform meshes (collective)."""
    for finer in uniform_meshes(scene):
        with closing(SolverContext(finer, comm)) as context:
            answer = context.answer()
        growth = 2.0**answer.level.mesh.topology.dim
        yield answer, growth * answer.record["seconds"]["total"], growth * answer.record["dofs"]

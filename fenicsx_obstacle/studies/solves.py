"""Solves of a study: meshes, matrices and solutions are reused if the next scene allows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.hierarchy import nested
from fenicsx_obstacle.errors import NotConverged
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.scene import Scene

if TYPE_CHECKING:
    from fenicsx_obstacle.answers.bodies import BodyContext

NEAR = 1.0  # layers of nodes by which contact may move so that the last solution is a better start than a coarse one


class Solves:
    """Reuses the solver context if scenes differ in options only, and its mesh if they differ in data only.

    Attributes:
        comm: Communicator.
        work: The solver context of the last scene; None before the first.
    """

    def __init__(self, comm: MPI.Comm):
        self.comm = comm
        self.work: SolverContext | BodyContext | None = None
        self._last: tuple[Mapping[str, Any], Answer] | None = None
        self._speed: tuple[str, float] | None = None  # nodes that contact gained or lost, for a unit of this key

    def close(self) -> None:
        """Free what it holds (collective)."""
        self._last = self._speed = None
        if self.work is not None:
            self.work.close()
        self.work = None

    def answer(self, values: Mapping[str, Any], scene: Scene, *, uncertainty: bool = False) -> Answer:
        """The solution of a scene (collective).

        Args:
            values: In which the scenes differ.
            scene: With these values.
            uncertainty: Of each quantity.
        """
        near = None
        if self.work is None:
            self.work = self._context(scene)
        elif not self._serves(scene):
            if meshes.same(self.work.scene, scene):
                near = self._near(values, scene)
                self.work = self.work.renewed(scene)
            else:
                self.close()  # the old mesh goes before the new one comes
                self.work = self._context(scene)
        answer = self._solved(self.work, scene, near, uncertainty=uncertainty)
        self._measure(values, answer)
        self._last = values, answer
        return answer

    def _solved(
        self, work: SolverContext | BodyContext, scene: Scene, near: np.ndarray | None, *, uncertainty: bool
    ) -> Answer:
        """The solution of a scene, from a near one if that converges (collective)."""
        if not isinstance(work, SolverContext):
            if uncertainty:
                scene.only_scalar("uncertainty")
            return work.answer(scene.options)
        solve = partial(work.answer, scene.options, yardstick=True, errors=False)
        try:
            answer = solve(near=near)
        except NotConverged:
            if near is None:
                raise
            answer = solve()
        if uncertainty:
            from fenicsx_obstacle.answers.uncertainty import with_uncertainties  # only where it is asked for

            answer = with_uncertainties(answer, work.problem.data)
        return work.measured(answer)

    def _context(self, scene: Scene) -> SolverContext | BodyContext:
        if not scene.model.vector_valued:
            return SolverContext(scene, self.comm)
        from fenicsx_obstacle.answers.bodies import BodyContext  # only where a scene has an elastic body

        return BodyContext(scene, self.comm)

    def to_reference(self, answer: Answer) -> dict[str, float]:
        """Distance to the solution of the variational inequality on the mesh of the last solve (collective)."""
        assert isinstance(self.work, SolverContext)
        reference, distance = self.work.inequality, self.work.distance
        u, p = answer.u.x.array - reference.u.x.array, reference.pressure.x.array
        distances = {**distance.of_u(u), "pressure_max": largest(answer.level.comm, np.abs(p))}
        if not answer.scene.model.thin:  # otherwise it is a force per length
            distances["pressure_l2"] = distance.pressure(answer.pressure.x.array - p)
        return distances

    def _serves(self, scene: Scene) -> bool:
        """Whether the scene differs from the last in its method and its eps only."""
        assert self.work is not None
        before = self.work.scene
        ours = replace(before.options, eps=scene.options.eps, method=scene.options.method)
        # data from Python have the same names in the tables, whatever they are
        pairs = [(before.objects.get(name), scene.objects.get(name)) for name in {*before.objects, *scene.objects}]
        return before.with_options(ours).tables == scene.tables and all(one is other for one, other in pairs)

    def _near(self, values: Mapping[str, Any], scene: Scene) -> np.ndarray | None:
        """The last solution, where Newton's method is expected to need few steps from there (collective).

        Contact moves by about one layer of nodes in a step. Nested iteration is right up to a layer or two; where it
        does not serve, any neighbour is better than a cold start.
        """
        if self._last is None or scene.time is not None or scene.options.method == "successive":
            return None
        if scene.options.start == "cold" or not all(effect.convex for effect in scene.effects):
            return None  # with several solutions the last must not decide which
        before, answer = self._last
        if nested(scene.effects, scene.pair, scene.options):
            step = _step(before, values)
            if step is None or self._speed is None or self._speed[0] != step[0]:
                return None
            dim = answer.level.mesh.topology.dim
            if self._speed[1] * step[1] > NEAR * answer.level.dofs ** (1 - 1 / dim):
                return None
        return answer.u.x.array[: answer.level.owned]

    def _measure(self, values: Mapping[str, Any], answer: Answer) -> None:
        """Number of nodes that enter or leave contact when a number changes (collective)."""
        if self._last is None or self._last[1].level is not answer.level:
            self._speed = None
            return
        before, other = self._last
        step = _step(before, values)
        if step is not None:
            own = answer.level.Q.dofmap.index_map.size_local
            changed = (answer.contact.x.array[:own] > 0.5) != (other.contact.x.array[:own] > 0.5)
            self._speed = step[0], total(answer.level.comm, np.count_nonzero(changed)) / step[1]


def _step(before: Mapping[str, Any], values: Mapping[str, Any]) -> tuple[str, float] | None:
    """The one number that differs, and by how much."""
    changed = [key for key in values if values[key] != before.get(key)]
    if len(changed) != 1:
        return None
    pair = before.get(changed[0]), values[changed[0]]
    if not all(isinstance(value, int | float) for value in pair):
        return None
    return changed[0], abs(pair[1] - pair[0])

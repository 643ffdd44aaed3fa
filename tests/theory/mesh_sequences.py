"""Sequences of meshes: a scene of the catalogue, solved on each by SNES VI and by (3.4) with several eps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.norms import Distance
from fenicsx_obstacle.scenes.catalogue import scene
from fenicsx_obstacle.scenes.scene import Scene

VI = "u_h"  # stands among values of eps for no penalty
Eps = float | str  # a number, a formula in h, or VI
CURVE, SINGULAR, JUMP, KINK = -1 / 2, 0.0, 1 / 2, 3 / 2  # s of a pressure on a curve, like 1/r, with a jump, a kink


@dataclass(frozen=True)
class MeshSequence:
    """A scene on a family of meshes.

    Attributes:
        words: Its name in rows and pictures.
        name: In the catalogue.
        smooth: s, where the exact pressure is in H^t for all t < s: 1/2 with a jump, -1/2 for a measure on a curve.
        changes: Of the scene: cells, diagonals, the element.
        cells: Cells a side of each mesh.
    """

    words: str
    name: str
    smooth: float
    changes: Mapping[str, Any] = field(default_factory=dict)
    cells: Sequence[int] = (32, 64, 128)

    def contexts(self, comm: MPI.Comm) -> Iterator[SolverContext]:
        """A solver context for each mesh, the coarsest first (collective)."""
        for n in self.cells:
            with closing(SolverContext(scene(self.name).change({"mesh.cells": n, **self.changes}), comm)) as context:
                yield context


@dataclass
class Measured:
    """What was measured on a sequence of meshes, a value per mesh.

    Attributes:
        on: What was solved.
        h: Of each mesh.
        values: By eps, or `VI`, and the name of what was measured.
    """

    on: MeshSequence
    h: list[float] = field(default_factory=list)
    values: dict[tuple[Eps, str], list[float]] = field(default_factory=dict)

    def __getitem__(self, key: tuple[Eps, str]) -> list[float]:
        return self.values[key]

    def note(self, eps: Eps, /, **values: float) -> None:
        """Add the values of the next mesh."""
        for name, value in values.items():
            self.values.setdefault((eps, name), []).append(value)


def gap(sequence: MeshSequence, epsilons: Sequence[Eps], comm: MPI.Comm) -> Measured:
    """How far (3.4) is from the variational inequality of the same mesh, for each eps (collective).

    Measured are `eps` as a number, `e` = ||u_eps - u_h||_1, `d` = ||p_eps - p_h||_0 and `part` = |u_eps - u_h|_a over
    eps |p_h|_a; of `VI`, `size` = ||p_h||_0.
    """
    found = Measured(sequence)
    for context in sequence.contexts(comm):
        problem = context.problem
        distance, reference = Distance(problem), context.answer(solved_with(context.scene, VI))
        found.h.append(problem.level.h)
        found.note(VI, size=distance.pressure(reference.pressure.x.array))
        steep = distance.energy(reference.pressure.x.array)  # the nodes of I are those of V_h
        for value in epsilons:
            answer = context.answer(solved_with(context.scene, value))
            e, d = answer.u.x.array - reference.u.x.array, answer.pressure.x.array - reference.pressure.x.array
            eps = answer.record["eps"]
            found.note(value, eps=eps, e=math.hypot(distance.energy(e), distance.l2(e)), d=distance.pressure(d),
                       part=distance.energy(e) / (eps * steep))  # fmt: skip
    return found


def errors(sequence: MeshSequence, epsilons: Sequence[Eps], comm: MPI.Comm, *, dual: bool = False) -> Measured:
    """Distances to the exact solution for each eps, or `VI` (collective).

    They have the names of the record; beside these there are `close`, |u_h - I_h u|_a, and if wanted `dual`,
    ||p - p_h||_1*, which costs another linear solve.
    """
    found = Measured(sequence)
    for context in sequence.contexts(comm):
        assert context.exact is not None
        found.h.append(context.problem.level.h)
        distance = Distance(context.problem)
        for value in epsilons:
            answer = context.answer(solved_with(context.scene, value))
            assert answer.error is not None
            found.note(value, **answer.record["errors"], close=distance.energy(answer.error.x.array))
            if dual:
                found.note(value, dual=context.exact.dual.error(answer.pressure, answer.record["eps"]))
    return found


def solved_with(scene: Scene, eps: Eps) -> SolverOptions:
    """The options of a scene with this eps, or for the variational inequality."""
    return scene.options_with(method="vi") if eps == VI else scene.options_with(eps=eps)

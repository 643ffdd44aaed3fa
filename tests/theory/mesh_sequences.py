"""Sequences of meshes: a scene of the catalogue, solved on each by SNES VI and by (3.4) with several eps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.answers.answer import Answer
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
class Gap:
    """How far (3.4) is from the variational inequality of the same mesh, for each eps: a value per mesh.

    Attributes:
        on: What is solved.
        h: Of each mesh.
        eps: As numbers.
        e: ||u_eps - u_h||_1.
        d: ||p_eps - p_h||_0.
        part: |u_eps - u_h|_a over eps |p_h|_a.
        size: ||p_h||_0.
    """

    on: MeshSequence
    h: list[float] = field(default_factory=list)
    eps: dict[Eps, list[float]] = field(default_factory=dict)
    e: dict[Eps, list[float]] = field(default_factory=dict)
    d: dict[Eps, list[float]] = field(default_factory=dict)
    part: dict[Eps, list[float]] = field(default_factory=dict)
    size: list[float] = field(default_factory=list)

    def at(self, cells: int) -> int:
        """Place of a mesh in the lists."""
        return list(self.on.cells).index(cells)


def gap(sequence: MeshSequence, epsilons: Sequence[Eps], comm: MPI.Comm) -> Gap:
    """Solve on each mesh for each eps (collective)."""
    found = Gap(sequence)
    for context in sequence.contexts(comm):
        problem = context.problem
        distance, reference = Distance(problem), context.answer(solved_with(context.scene, VI))
        found.h.append(problem.level.h)
        found.size.append(distance.pressure(reference.pressure.x.array))
        steep = distance.energy(reference.pressure.x.array)  # the nodes of I are those of V_h
        for value in epsilons:
            answer = context.answer(solved_with(context.scene, value))
            e, d = answer.u.x.array - reference.u.x.array, answer.pressure.x.array - reference.pressure.x.array
            eps = answer.record["eps"]
            found.eps.setdefault(value, []).append(eps)
            found.e.setdefault(value, []).append(math.hypot(distance.energy(e), distance.l2(e)))
            found.d.setdefault(value, []).append(distance.pressure(d))
            found.part.setdefault(value, []).append(distance.energy(e) / (eps * steep))
    return found


@dataclass
class Errors:
    """Distances to the exact solution, for each eps: a value per mesh.

    Attributes:
        on: What is solved.
        h: Of each mesh.
        errors: By the names of the record, for each eps; and `dual`, ||p - p_h||_1*, `close`, |u_h - I_h u|_a.
    """

    on: MeshSequence
    h: list[float] = field(default_factory=list)
    errors: dict[Eps, dict[str, list[float]]] = field(default_factory=dict)

    def __getitem__(self, key: tuple[Eps, str]) -> list[float]:
        return self.errors[key[0]][key[1]]


def errors(sequence: MeshSequence, epsilons: Sequence[Eps], comm: MPI.Comm, *, dual: bool = False) -> Errors:
    """Solve on each mesh for each eps, or `VI` (collective); the dual norm costs another linear solve."""
    found = Errors(sequence)
    for context in sequence.contexts(comm):
        assert context.exact is not None
        found.h.append(context.problem.level.h)
        distance = Distance(context.problem)
        for value in epsilons:
            answer = context.answer(solved_with(context.scene, value))
            norms = {**answer.record["errors"], "close": distance.energy(_nodal_error(answer))}
            if dual:
                norms["dual"] = context.exact.dual.error(answer.pressure, answer.record["eps"])
            lists = found.errors.setdefault(value, {})
            for name, norm in norms.items():
                lists.setdefault(name, []).append(norm)
    return found


def solved_with(scene: Scene, eps: Eps) -> SolverOptions:
    """The options of a scene with this eps, or for the variational inequality."""
    return scene.options_with(method="vi") if eps == VI else scene.options_with(eps=eps)


def _nodal_error(answer: Answer) -> np.ndarray:
    assert answer.error is not None
    return np.asarray(answer.error.x.array)

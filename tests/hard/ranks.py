"""The same scene on several ranks: fields, and what their differences may be.

Nodes are numbered differently on other ranks: fields are compared in the order of their places.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.check.finding import Finding
from fenicsx_obstacle.parallel import gathered
from fenicsx_obstacle.scenes.scene import Scene
from tests.hard import bodies
from tests.hard.bodies import GRID, by_place
from tests.hard.invariants import energy_round_off
from tests.hard.judge import METHODS, TRIAL, take
from tests.hard.solved import ReferenceProblem

Fields = dict[str, np.ndarray]


def fields_of(scene: Scene, comm: MPI.Comm) -> Fields:
    """u, p, how far they may be off, and the energy of each method, at nodes in the order of places, on rank 0;
    empty elsewhere (collective)."""
    if scene.model.vector_valued:
        return bodies.fields_of(scene, comm)
    found: Fields = {}
    with closing(SolverContext(scene, comm)) as context, closing(ReferenceProblem(context.problem)) as ground:
        level = context.problem.level
        points = gathered(level.comm, level.points.T[: level.owned])
        order = None if points is None else by_place(points)
        for method in ("vi", *METHODS):
            context.answer(replace(context.scene.options, method=method, eps=TRIAL))
            solved = take(context, ground, None if method == "vi" else TRIAL)
            energy = np.array([solved.energy or 0.0, energy_round_off(solved) if solved.energy is not None else 0.0])
            for name, values in (("u", solved.w + solved.r), ("p", solved.p), ("z", solved.z), ("q", solved.q)):
                whole = gathered(level.comm, values)
                if whole is not None:
                    found[f"{method}.{name}"] = whole[order]
            if level.comm.rank == 0:
                found[f"{method}.energy"], found[f"{method}.R"] = energy, np.array(solved.R)
        if points is not None:
            found["monotone"], found["held"] = np.array(ground.monotone), np.array(ground.held)
            found["points"] = points[order]
        if level.comm.size == 1:
            found |= _matrix(ground, order)
    return found


def _matrix(ground: ReferenceProblem, order: np.ndarray | None) -> Fields:
    """The entries of the matrix that are not 0, between free nodes, in the order of places (one rank)."""
    assert order is not None
    starts, columns, values = ground.A.getValuesCSR()
    rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    place = np.argsort(order)
    return {"rows": place[rows], "columns": place[columns], "values": values * ground.free[rows]}


def agree_on(one: Fields, other: Fields, method: str) -> list[Finding]:
    """Findings of one method on one rank and on another number of ranks."""
    if f"{method}.u" not in one:
        return bodies.agree_on(one, other, method)
    apart = {name: np.abs(one[f"{method}.{name}"] - other[f"{method}.{name}"]) for name in "up"}
    margin = {name: one[f"{method}.{name}"] + other[f"{method}.{name}"] for name in "zq"}
    energies = one[f"{method}.energy"], other[f"{method}.energy"]
    claimed, held = bool(one["monotone"]), bool(one["held"])
    e = one[f"{method}.u"] - other[f"{method}.u"]
    squared = float(np.sum(e[one["rows"]] * one["values"] * e[one["columns"]]))
    return [
        Finding("ranks: the same nodes", "one mesh", float(np.abs(one["points"] - other["points"]).max()),
                GRID * float(np.ptp(one["points"]))),
        Finding("ranks: the same u in the energy norm", "unique", max(squared, 0.0) ** 0.5,
                float(one[f"{method}.R"] + other[f"{method}.R"]), held),
        Finding("ranks: the same u at every node", "unique", float((apart["u"] - margin["z"]).max()), 0.0, claimed),
        Finding("ranks: the same pressure", "unique", float((apart["p"] - margin["q"]).max()), 0.0, claimed),
        Finding("ranks: the same energy", "unique", float(abs(energies[0][0] - energies[1][0])),
                float(energies[0][1] + energies[1][1])),
    ]  # fmt: skip

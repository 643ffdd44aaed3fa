"""Theorems 3.1 and 3.2: u_eps tends to u_h and p_eps to p_h, from one side, within computable bounds."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.linear_solvers import DIRECT, defaults
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.norms import Distance
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes import catalogue
from fenicsx_obstacle.scenes.scene import Scene
from tests.theory.statement import Curve, Finding, Found, Panel, check, constant, statement

EPS = tuple(10.0**-k for k in range(1, 11))
WHERE = "Thm 3.1, 3.2"
ZERO = 1e-16  # a height: round-off of g = 0.1, from which it is counted


Approach = dict[str, list[float]]  # what `approach` measures, a value for each of `EPS`


def approach(scene: Scene, comm: MPI.Comm, epsilons: Sequence[float] = EPS) -> Approach:
    """Solve the variational inequality of a scene with one obstacle, and (3.4) for each eps (collective).

    Signs are such that the obstacle is above: e = u_eps - u_h >= 0 is how far u_eps goes beyond.

    Returns:
        energy: ||e|| in the energy norm; highest: largest e at a node; lowest: smallest e, over the range of u; above,
        below: largest e over eps max |p_h|, and over eps max |p_eps|, 1 at most; rise: largest growth of u_eps at a
        node since the last, larger eps, over the range of u; pressure: ||p_eps - p_h||_I; size: ||p_eps||_I over
        ||p_h||_I, 1 at most; work: a(e, e) over (eps/4) ||p_h||_I^2, 1 at most.
    """
    seen: list[dict[str, float]] = []
    direct = [defaults(prefix, DIRECT) for prefix in ("penalty_", "vi_")]
    with direct[0], direct[1], closing(SolverContext(scene, comm)) as context:
        problem = context.problem
        distance, D, own = Distance(problem), problem.weights, problem.level.owned
        side = 1.0 if problem.above is not None else -1.0
        reference = context.answer(replace(context.scene.options, method="vi"))
        p, height = reference.pressure.x.array[:own], reference.record["u_range"]
        limit, most = total(comm, D * p**2), largest(comm, np.abs(p))
        before = None
        for eps in epsilons:
            answer = context.answer(replace(context.scene.options, eps=eps))
            excess = side * (answer.u.x.array - reference.u.x.array)
            mine = answer.pressure.x.array[:own]
            energy, highest = distance.energy(excess), largest(comm, excess)
            seen.append({
                "energy": energy, "highest": highest, "lowest": smallest(comm, excess) / height,
                "above": highest / (eps * most), "below": highest / (eps * largest(comm, np.abs(mine))),
                "rise": -np.inf if before is None else largest(comm, excess - before) / height,
                "pressure": float(np.sqrt(total(comm, D * (mine - p) ** 2))),
                "size": float(np.sqrt(total(comm, D * mine**2) / limit)), "work": energy**2 / (eps / 4 * limit),
            })  # fmt: skip
            before = excess
    return {name: [one[name] for one in seen] for name in seen[0]}


@statement("3.1", "u_eps and p_eps converge to u_h and p_h as eps tends to 0, with computable bounds", "3.2")
def limits(comm: MPI.Comm) -> Found:
    """Down to eps = 1e-10, on M-matrix meshes, and where there is nothing, or everything, to touch (collective)."""
    scenes: dict[str, tuple[str, dict[str, Any]]] = {
        "ceiling": ("disk_flat", {"mesh.cells": 32}),
        "ceiling, crossed": ("disk_flat", {"mesh.cells": 16, "mesh.diagonal": "crossed"}),
        "ball": ("ball", {"mesh.cells": 16}), "string": ("string_parabola", {"mesh.cells": 64}),
    }  # fmt: skip
    seen = {name: approach(catalogue.scene(*of), comm) for name, of in scenes.items()}
    return Found([*_limits(list(seen.values())), *_bounds(list(seen.values())), *extremes(comm)], _panels(seen))


def _limits(all_seen: list[Approach]) -> list[Finding]:
    falls = [(a["energy"], a["highest"], a["pressure"]) for a in all_seen]
    decreasing = all(np.all(np.diff(values) < 0) for three in falls for values in three)
    return [
        check(WHERE, "|u_eps - u_h|_a at eps = 1e-10 over 0.1, the most of 4 scenes", "tends to 0",
              max(a["energy"][-1] / a["energy"][0] for a in all_seen), decreasing),
        check(WHERE, "|p_eps - p_h|_I at eps = 1e-10 over 0.1, the most of 4 scenes", "tends to 0",
              max(a["pressure"][-1] / a["pressure"][0] for a in all_seen), decreasing),
    ]  # fmt: skip


def _bounds(all_seen: list[Approach]) -> list[Finding]:
    """What M-matrices, and (3.23)-(3.24) without LBB, give beyond the paper."""
    ratio = max(max(a["above"]) for a in all_seen)
    rise = max(max(a["rise"]) for a in all_seen)
    lowest = min(min(a["lowest"]) for a in all_seen)
    return [
        check("Thm 3.1", "smallest u_eps - u_h at a node over the range of u", "M-matrix: 0 at least", lowest,
              lowest > -1e-12),
        constant("Thm 3.1", "largest u_eps - u_h over eps max |p_h|", "M-matrix: 1 at most", 1.0, ratio, "sharp"),
        check("Thm 3.1", "the same over eps max |p_eps|: u_eps - eps max |p_eps| <= u_h", "M-matrix: 1 at most",
              *_at_most_one([a["below"] for a in all_seen], 1e-6)),
        check("Thm 3.1", "largest growth of u_eps at a node as eps falls, over the range of u", "M-matrix: 0 at most",
              rise, rise < 1e-12),
        check("Thm 3.2", "|p_eps|_I over |p_h|_I, the most: without LBB", "1 at most",
              *_at_most_one([a["size"] for a in all_seen], 1e-9)),
        check("Thm 3.2", "a(e, e) over (eps/4) |p_h|_I^2, the most: without LBB", "1 at most",
              *_at_most_one([a["work"] for a in all_seen], 0.0), "not sharp"),
    ]  # fmt: skip


def _at_most_one(values: list[list[float]], round_off: float) -> tuple[float, bool]:
    most = max(map(max, values))
    return most, most <= 1 + round_off


def extremes(comm: MPI.Comm) -> list[Finding]:
    """The ends of the hypotheses: no force, no contact, contact everywhere, and no admissible u at all (collective)."""
    square: dict[str, Any] = {"mesh": {"shape": "rectangle", "cells": 16}, "tension": 1, "boundary": [{"value": 0}]}
    dead, lake, full = (_solved(Scene(**square, **data), comm) for data in (
        {"load": 0, "upper": 0.1}, {"load": 1, "upper": 1}, {"load": 1, "upper": 0}))  # fmt: skip
    refused = _refused(Scene(**square, load=1, upper=-0.1), comm)
    return [
        check("Thm 3.1", "f = 0 below g = 0.1: largest |p_eps|", "u = p = 0", dead[1], dead[0] < ZERO and dead[1] == 0),
        check("Thm 3.1", "g out of reach: largest |p_eps|", "p = 0", lake[1], lake[1] == 0 < lake[0]),
        constant("Thm 3.1", "f = 1 under g = 0: largest |p_eps|, eps = 1e-6", "p_h = -f", 1.0, full[1]),
        constant("Thm 3.1", "the same, largest u_eps over eps", "u_h = 0", 1.0, full[0] / 1e-6),
        check("Thm 3.1", "g < 0 on the boundary, K_h empty: rejected as invalid input", "K_h not empty", refused,
              refused, "needs hypothesis"),
    ]  # fmt: skip


def _solved(scene: Scene, comm: MPI.Comm) -> tuple[float, float]:
    """Largest |u_eps| and |p_eps| at eps = 1e-6."""
    with closing(SolverContext(scene, comm)) as context:
        answer = context.answer(replace(context.scene.options, eps=1e-6))
    return largest(comm, np.abs(answer.u.x.array)), largest(comm, np.abs(answer.pressure.x.array))


def _refused(scene: Scene, comm: MPI.Comm) -> bool:
    try:
        SolverContext(scene, comm).close()
    except InputError:
        return True
    return False


def _panels(seen: dict[str, Approach]) -> list[Panel]:
    first = next(iter(seen.values()))
    return [
        Panel("flat ceiling, N = 32", "eps", "distance", [
            Curve("|u_eps - u_h|_a", EPS, first["energy"], 1.0), Curve("max (u_eps - u_h)", EPS, first["highest"], 1.0),
            Curve("|p_eps - p_h|_I", EPS, first["pressure"], 1.0)]),
        Panel("nodal bound: 1 at most, on M-matrices", "eps", "max (u_eps - u_h) / (eps max |p_h|)",
              [Curve(name, EPS, a["above"]) for name, a in seen.items()], ("log", "linear")),
        Panel("without LBB: 1 at most", "eps", "a(e, e) / ((eps/4) |p_h|_I^2)",
              [Curve(name, EPS, a["work"]) for name, a in seen.items()]),
    ]  # fmt: skip

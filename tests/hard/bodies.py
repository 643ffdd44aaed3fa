"""Scenes with an elastic body on one mesh: penalty and SNES VI on the same discrete problem, against what is known."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.bodies import BodyContext
from fenicsx_obstacle.check.finding import Finding
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes.scene import Scene
from tests.hard.row import FLOOR, Row, asked, judged_row, refused

SOLVED = 1e-8  # relative: how far solves are from the discrete solution
UNIT = "unit"  # name under [define] of the factor of all stiffnesses and loads, 1 in MPa
PASCALS = 1e6
GRID = 1e-6  # of the extent: places nearer than this are one
AUTO = 1e-3  # eps = "auto" in units of h/E


def _squared(context: BodyContext, values: np.ndarray) -> float:
    """a(v, v) for values of v at local dofs (collective)."""
    u, kept = context.body.u, context.body.u.x.array.copy()
    u.x.array[:] = values
    energy = fem.assemble_scalar(releases.form(context.body.law.energy))
    u.x.array[:] = kept
    return 2 * total(context.body.level.comm, float(energy))


def _work(one: Answer) -> float:
    """sum p_i^2 D_i."""
    return float(one.nodes.pressure**2 @ one.nodes.areas)


def judge_body(
    scene: Scene,
    comm: MPI.Comm,
    epsilons: Sequence[float | str],
    refuse: str,
    known: Mapping[str, float],
    *,
    units: bool,
) -> Iterator[Row]:
    """Solve by SNES VI, and by the penalty for each eps in units of h/E; a row for each answer (collective).

    Args:
        scene: With an elastic body.
        comm: Communicator.
        epsilons: From large to small.
        refuse: Part of the message with which the scene must be rejected; empty where it has a solution.
        known: Names of [report] whose values are 0 by equilibrium, symmetry or a formula, and how far they may be off.
        units: Solve with pascals for megapascals as well.
    """
    start, found = time.perf_counter(), []
    ways: list[tuple[str, float | str | None]] = [("vi", None), *(("penalty", eps) for eps in epsilons)]
    try:
        with closing(BodyContext(scene, comm)) as context:
            scale = None
            for method, eps in ways:
                start = time.perf_counter()
                if isinstance(eps, float) and scale is None:
                    auto = context.answer(asked(scene, "penalty", "auto")).eps
                    assert auto is not None
                    scale = auto / AUTO
                try:
                    number = eps * scale if isinstance(eps, float) and scale else eps
                    one = context.answer(asked(scene, method, number))
                except (InputError, NotConverged) as error:
                    if isinstance(error, InputError) and (refuse or FLOOR not in str(error)):
                        raise
                    yield refused(scene, method, eps, start, error)
                    continue
                found.append(one)
                checked = context.body.verify(one)
                findings = [*checked.findings, *_penetration(one)]
                findings += [Finding(f"known: {name}", "equilibrium", abs(float(one.record["report"][name])), limit)
                             for name, limit in known.items()]  # fmt: skip
                findings += _beside(context, one, found[0]) if found[0] is not one else []
                p, exact = one.nodes.pressure, found[0].nodes.pressure
                off = np.abs(p - exact).max(initial=0.0) / max(np.abs(exact).max(initial=0.0), 1e-300)
                yield _verdict(scene, method, eps, start, one, findings, refuse, off=float(off))
    except InputError as error:
        yield refused(scene, "", None, start, error, refuse)
        return
    if units and UNIT in scene.tables.define and found:
        start, other = time.perf_counter(), scene.change({f"define.{UNIT}": PASCALS})
        with closing(BodyContext(other, comm)) as context:
            one = context.answer(asked(other, "vi", None))
            yield _verdict(scene, "vi", None, start, one, _in_pascals(found[0], one), "", trial="pascals")


def _verdict(
    scene: Scene, method: str, eps: float | str | None, start: float, one: Answer, findings: Sequence[Finding],
    refuse: str, *, off: float | None = None, trial: str = "",
) -> Row:  # fmt: skip
    record = {**one.record, "monotone": None, "digits": {"off": off}}
    return judged_row(scene, method, eps, start, record, findings, trial, refuse)


def _penetration(one: Answer) -> list[Finding]:
    """Of the penalty: eps times the pressure, at each node."""
    p, gap, eps = one.nodes.pressure, one.nodes.gap, one.eps
    if eps is None:
        return []
    most, size = float(p.max(initial=0.0)), float(np.abs(gap).max(initial=0.0))
    margin = SOLVED * (eps * most + 1e-4 * size)
    return [Finding("penetration", "eps max|p_h|", float((-gap).max(initial=0.0)), eps * most + margin)]


def _beside(context: BodyContext, one: Answer, exact: Answer) -> list[Finding]:
    """The penalty and the variational inequality: a(e, e) <= eps/4 sum p_i^2 D_i, and the size of the pressure."""
    eps = one.eps
    assert eps is not None
    v, u = exact.u.x.array, one.u.x.array
    apart, size = _squared(context, u - v), float(np.sqrt(_squared(context, v)))
    return [
        Finding("penalty and inequality: energy norm", "Thm 3.3", float(np.sqrt(max(apart, 0.0))),
                float(np.sqrt(eps * _work(exact))) / 2 + SOLVED * size),
        Finding("penalty and inequality: size of the pressure", "Thm 3.2", float(np.sqrt(_work(one))),
                float(np.sqrt(_work(exact))) * (1 + SOLVED)),
    ]  # fmt: skip


def _in_pascals(before: Answer, one: Answer) -> list[Finding]:
    size = float(np.abs(before.nodes.forces).max(initial=0.0))
    new, old = (nodes.forces[by_place(nodes.points)] for nodes in (one.nodes, before.nodes))
    apart = float(np.abs(new / PASCALS - old).max(initial=0.0))
    more = abs(one.iterations - before.iterations)
    return [
        Finding("other units: steps", "equations scale", more, 1),
        Finding("other units: the same forces", "equations scale", apart, SOLVED * size),
    ]


def by_place(points: np.ndarray) -> np.ndarray:
    """Numbers of points (n, 3) in the order of their places, whatever their round-off."""
    extent = max(float(np.ptp(points)), 1e-300)
    return np.lexsort(np.rint(points / (GRID * extent)).T)


def fields_of(scene: Scene, comm: MPI.Comm) -> dict[str, np.ndarray]:
    """Contact nodes and pressures of each method, in the order of places, the same on every rank (collective)."""
    found: dict[str, np.ndarray] = {}
    for method in ("vi", "penalty"):
        with closing(BodyContext(scene, comm)) as context:
            nodes = context.answer(asked(scene, method, None if method == "vi" else "auto")).nodes
        order = by_place(nodes.points)
        found |= {"points": nodes.points[order], f"{method}.p": nodes.pressure[order]}
    return found


def agree_on(one: dict[str, np.ndarray], other: dict[str, np.ndarray], method: str) -> list[Finding]:
    """Findings of one method on one rank and on another number of ranks."""
    p, q = one[f"{method}.p"], other[f"{method}.p"]
    apart = float(np.abs(p - q).max()) if p.shape == q.shape else np.inf
    return [Finding("ranks: the same pressure", "unique", apart, SOLVED * float(np.abs(p).max()))]

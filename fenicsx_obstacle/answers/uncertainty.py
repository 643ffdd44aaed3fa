"""An uncertainty for each output quantity, from its values on the last three meshes of nested iteration.

Nested iteration has a problem on each coarser mesh already, with a state near its solution. Two of them are solved to
the end, with eps scaled as h^2. With [time] the scene is solved on two coarser meshes, with steps scaled as h. Where
the changes from mesh to mesh have a ratio that the element can have, Richardson extrapolation says how far the last
value is from the limit for h and eps to 0 (Roache 1994; Eca and Hoekstra 2014: without such an order the estimate rests
on the largest change). Where a datum jumps inside cells nothing is settled: each mesh has the jump elsewhere, three
nested ones perhaps at the same wrong place, and the values do not tell.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from fenicsx_obstacle.algebra.nested import Levels, as_it_is, begin_from
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.levels import of_pair
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.time_discretization import EQUILIBRIA
from fenicsx_obstacle.errors import PenetrationWarning
from fenicsx_obstacle.problems.solve import State, solve
from fenicsx_obstacle.scenes.scene import Scene

MESHES = 3
EPS_TIMES = (16.0, 4.0)  # that of the finest mesh: eps is scaled as h^2
FEWEST = 4  # cells along x on the coarsest of them
ROUND_OFF = 1e-9  # relative change that is the solver's tolerance
LEAST = 0.4  # observed order that counts as one
ABOVE = 0.1  # an order is observed up to this beyond twice the degree, the highest that an output quantity can have
HIGHEST = 2.0  # order that is believed at most
SAFETY = 1.5  # times what extrapolation says
SHRINKS = 0.85  # last change over the one before, from which on it does not become smaller
GROWS = 0.03  # last change over the value, from which on a value that grows is called unbounded
REASON = "it takes two coarser meshes: a number of cells that 4 divides, 16 or more, or --refine 2 for a file"
REASON_STEPS = "it takes two solves with fewer steps: a number of steps under [time] that 4 divides"
REASON_TOLERANCE = "it takes steps that are scaled as h, and [time] tolerance chooses them; give their number instead"
Values = dict[str, float | None]


@dataclass(frozen=True)
class Uncertainty:
    """Of one quantity; units are its own.

    Attributes:
        values: On the three meshes, the finest last.
        change: From the last mesh but one to the last.
        error: Estimated distance of the last value from its limit for h and eps to 0; None where nothing is settled.
        order: Observed order in h; None where the three values have none that the element can have.
        verdict: settled; 'not settled', where changes do not become smaller; or 'unbounded', where the value grows by
            changes of one sign that do not become smaller.
    """

    values: tuple[float, ...]
    change: float
    error: float | None
    order: float | None
    verdict: str

    @classmethod
    def of(cls, values: Sequence[float], degree: int = 1) -> Uncertainty:
        """What three values on meshes whose h halves say of the last, with elements of this degree."""
        coarse, middle, fine = values
        before, last = middle - coarse, fine - middle
        size, a, b = max(map(abs, values)), abs(before), abs(last)
        found = tuple(values), last
        if max(a, b) <= ROUND_OFF * size or size == 0:
            return cls(*found, ROUND_OFF * size, None, "settled")
        same = before * last > 0
        if b >= SHRINKS * a:
            grows = same and abs(fine) > abs(middle) > abs(coarse) and b >= GROWS * size
            return cls(*found, None, None, "unbounded" if grows else "not settled")
        order = math.log2(a / b) if same else None
        if order is None or not LEAST <= order <= 2 * degree + ABOVE:
            return cls(*found, max(b, a / 2), None, "settled")  # as of order 1 after the change before
        return cls(*found, SAFETY * max(b, a / 2**HIGHEST) / (2 ** min(order, HIGHEST) - 1), order, "settled")


def quantities(record: Mapping[str, Any]) -> dict[str, Any]:
    """The output quantities in the record of a solution, by the same fields."""
    contact = {name: record[name] for name in ("penetration", "contact")} if len(record["contact"]) > 1 else {}
    return {"energy": record["energy"], **contact, "report": dict(record.get("report") or {})}


def compared(found: Sequence[Any], degree: int = 1, *, resolved: bool = True, bounded: bool = False) -> Any:
    """The uncertainty of values on three meshes, by the same fields; values that are not finite on some mesh have none.

    Args:
        found: On each mesh.
        degree: Of the element.
        resolved: Whether all data are resolved by the meshes; nothing is settled otherwise.
        bounded: Whether the values are known to be.
    """
    if isinstance(found[0], Mapping):
        parts = {
            key: compared([one[key] for one in found], degree, resolved=resolved, bounded=bounded or key == "contact")
            for key in found[0]
        }
        if "penetration" in parts and parts["penetration"]["error"] is not None:
            parts["penetration"]["error"] = abs(found[-1]["penetration"])  # its limit is 0
        return {key: part for key, part in parts.items() if part}
    if any(value is None for value in found):
        return None
    said = Uncertainty.of(found, degree)
    if not resolved or (bounded and said.error is None):
        said = replace(said, error=None, order=None, verdict="not settled")
    return asdict(said)


def on_coarser_meshes(
    levels: Levels,
    options: SolverOptions,
    eps: float | None,
    report: Callable[[Problem, State], Values],
    *,
    solved: bool,
) -> list[dict[str, Any]]:
    """The output quantities on the two next coarser meshes, the coarser first (collective).

    Args:
        levels: Of the last solve; left with other states and active sets, except for the finest.
        options: Of the last solve.
        eps: On the finest mesh, or None.
        report: The values of [report] of a problem that is in this state.
        solved: Whether nested iteration has left a state near the solution on each mesh.

    Returns:
        The quantities; none where there are no two such meshes.

    Raises:
        NotConverged: With PETSc's reason.
    """
    first = next(k for k, system in enumerate(levels.systems) if isinstance(system, Problem))
    meshes = levels[first:]
    assert isinstance(levels.finest, Problem)
    pair = levels.finest.level.pair
    of_degree_2 = pair.has_p1_coarse_space
    coarser = meshes[: -2 if of_degree_2 else -1][1 - MESHES :]
    if len(coarser) < MESHES - 1:
        return []
    found, below = [], None
    for number, times in enumerate(EPS_TIMES):
        here = coarser[number : number + 1]
        problem = here.finest
        assert isinstance(problem, Problem)
        if of_degree_2:
            fine = Problem(Data(problem.model, of_pair(problem.level, pair)))
            begin_from(fine, problem)
            here, problem = here.with_finer([fine])[1:], fine
        elif below is not None and not solved:
            begin_from(problem, below)
        with warnings.catch_warnings():  # eps is that of the finest mesh, for which the user is warned
            warnings.simplefilter("ignore", PenetrationWarning)
            state = solve(here, _scaled(options, eps, times), start=as_it_is).state
        found.append(quantities({
            "energy": state.energy, "penetration": state.contact.penetration, "report": report(problem, state),
            "contact": {"area": state.contact.area, **{side: {"force": f} for side, f in state.sides(problem).items()}},
        }))  # fmt: skip
        below = problem
    return found


def coarser_scenes(scene: Scene, options: SolverOptions, eps: float | None) -> list[tuple[Scene, SolverOptions]]:
    """The scene on two coarser meshes, the coarser first, with steps scaled as h; none where it has none.

    Args:
        scene: The scene.
        options: Of its solve.
        eps: On its mesh, or None.
    """
    mesh, moments, found = scene.tables.mesh, scene.time, []
    for times, halvings in zip(EPS_TIMES, (2, 1), strict=True):
        less, rest = min(halvings, mesh.refine), halvings - min(halvings, mesh.refine)
        changes: dict[str, Any] = {"mesh.refine": mesh.refine - less} if less else {}
        if rest:
            if mesh.shape is None or scene.mesh is not None or mesh.cells % 2**rest or mesh.cells < FEWEST * 2**rest:
                return []
            changes["mesh.cells"] = mesh.cells // 2**rest
        if moments is not None and moments.order > EQUILIBRIA:
            changes["time.steps"] = moments.steps // 2**halvings
        found.append((scene.change(changes), _scaled(options, eps, times)))
    return found


def reason(scene: Scene) -> str | None:
    """Why a scene with [time] has no uncertainty, whatever its mesh; None if it may have one."""
    moments = scene.time
    if moments is None or moments.order == EQUILIBRIA:
        return None
    if moments.tolerance is not None:
        return REASON_TOLERANCE
    return REASON_STEPS if moments.steps % 4 else None


def _scaled(options: SolverOptions, eps: float | None, times: float) -> SolverOptions:
    return options if eps is None else replace(options, eps=times * eps)

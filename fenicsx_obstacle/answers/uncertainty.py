"""An uncertainty for each output quantity, from its values on three meshes whose h halves.

The scene is solved on two coarser meshes, with eps scaled as h^2 and, with [time], steps scaled as h. Where the changes
from mesh to mesh have a ratio that the element can have, Richardson extrapolation says how far the last value is from
the limit for h and eps to 0 (Roache 1994; Eca and Hoekstra 2014: without such an order the estimate rests on the
largest change). Where a datum jumps inside cells nothing is settled: each mesh has the jump elsewhere, three nested
ones perhaps at the same wrong place, and the values do not tell.
"""

from __future__ import annotations

import logging
import math
import time
import warnings
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from typing import Any

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.jumps import unresolved
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.time_discretization import EQUILIBRIA
from fenicsx_obstacle.errors import InputError, NotConverged, PenetrationWarning
from fenicsx_obstacle.scenes.meshes import shape_of
from fenicsx_obstacle.scenes.scene import Scene

_log = logging.getLogger(__name__)
EPS_TIMES = (16.0, 4.0)  # that of the finest mesh: eps is scaled as h^2
FEWEST = 4  # cells along x on the coarsest of them
ROUND_OFF = 1e-9  # relative change that is the solver's tolerance
LEAST = 0.4  # observed order that counts as one
ABOVE = 0.1  # an order is observed up to this beyond twice the degree, the highest that an output quantity can have
HIGHEST = 2.0  # order that is believed at most
SAFETY = 1.5  # times what extrapolation says
SHRINKS = 0.85  # last change over the one before, from which on it does not become smaller
GROWS = 0.03  # last change over the value, from which on a value that grows is called unbounded
REASON = (
    "it takes two coarser meshes: along each side a number of cells that 4 divides, 16 or more along x; or --refine 2 "
    "for a file"
)
REASON_STEPS = "it takes two solves with fewer steps: a number of steps under [time] that 4 divides"
REASON_TOLERANCE = "it takes steps that are scaled as h, and [time] tolerance chooses them; give their number instead"


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


def with_uncertainties(answer: Answer, data: Data) -> Answer:
    """The answer with `record["uncertainty"]`: what coarser meshes say of each quantity, or why they say nothing
    (collective).

    Args:
        answer: Solution of a scene with scalar u.
        data: Of the scene on its mesh.
    """
    start, level = time.perf_counter(), answer.level
    try:
        three = [*_on_coarser_meshes(answer), quantities(answer.record)]
    except InputError as error:
        found = {"reason": str(error)}
    else:
        reason = unresolved(data)
        remark = {} if reason is None else {"reason": reason}
        found = {**compared(three, level.pair.degree, resolved=reason is None), **remark}
        found = level.comm.bcast({**found, "seconds": time.perf_counter() - start})
    return replace(answer, record={**answer.record, "uncertainty": found})


def _on_coarser_meshes(answer: Answer) -> list[dict[str, Any]]:
    """The output quantities on two coarser meshes, the coarser first (collective).

    Raises:
        InputError: Saying why there are none.
    """
    found = []
    for coarser in coarser_scenes(answer.scene, answer.eps):
        try:
            with closing(SolverContext(coarser, answer.level.comm)) as context, warnings.catch_warnings():
                warnings.simplefilter("ignore", PenetrationWarning)  # it depends on the eps of the finest mesh
                if answer.bound is not None:
                    _ = context.estimator  # for a bound the load has its means in the cells: on all three meshes
                found.append(quantities(context.answer(errors=False).record))
        except (NotConverged, InputError) as error:
            _log.info("no uncertainty: %s", error)
            raise InputError("a coarser mesh could not be solved") from None
    return found


def coarser_scenes(scene: Scene, eps: float | None) -> list[Scene]:
    """The scene on two coarser meshes, the coarser first, with steps scaled as h.

    Args:
        scene: The scene.
        eps: On its mesh, or None.

    Raises:
        InputError: Saying why there are none.
    """
    mesh, moments, found = scene.tables.mesh, scene.time, []
    moving = moments is not None and moments.order > EQUILIBRIA
    if moments is not None and moving and (moments.tolerance is not None or moments.steps % 4):
        raise InputError(REASON_STEPS if moments.tolerance is None else REASON_TOLERANCE)
    for times, halvings in zip(EPS_TIMES, (2, 1), strict=True):
        less = min(halvings, mesh.refine)
        rest = halvings - less
        changes: dict[str, Any] = {"profile": {}, "mesh.refine": mesh.refine - less}  # a line may leave a coarser mesh
        if rest:
            if mesh.shape is None or scene.mesh is not None or mesh.cells % 2**rest or mesh.cells < FEWEST * 2**rest:
                raise InputError(REASON)
            changes["mesh.cells"] = mesh.cells // 2**rest
        if moments is not None and moving:
            changes["time.steps"] = moments.steps // 2**halvings
        coarser = scene.change(changes)
        if rest and shape_of(scene).cells != tuple(2**rest * n for n in shape_of(coarser).cells):
            raise InputError(REASON)
        found.append(coarser if eps is None else coarser.with_options(replace(coarser.options, eps=times * eps)))
    return found

"""Checks that the admissible set is not empty: obstacles do not cross, boundary values are between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.fields import OfFunction
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import first_given, largest, smallest, total

EPSILON = float(np.finfo(float).eps)
# obstacle and boundary value may come from different formulas
ROUND_OFF = 1e-10  # relative to the range of u
IRREVERSIBLE = (
    "if one is an earlier solution, which the penalty method puts beyond its obstacles by eps*p, copy it by "
    "np.clip(solution.u.x.array, solution.lower.x.array, solution.upper.x.array)"
)
AROUND = 1e-12  # relative to the obstacle in the cells around a node


def check_admissible(data: Data) -> None:
    """Reject obstacles that cross, and boundary values that are not between them (collective).

    Where a boundary value is beyond an obstacle by round-off only, the obstacle is moved to it.

    Raises:
        InputError: Naming the place and the gap.
    """
    dofs, values = data.fixed
    _check_parts(data)
    given, (lower, upper) = values.x.array[dofs], (data.lower, data.upper)
    if lower is not None and upper is not None:
        _refuse_crossing(data, lower, upper, given)
    for obstacle, sign, word in ((lower, 1, "lower"), (upper, -1, "upper")):
        if obstacle is None:
            continue
        beyond = np.full(len(values.x.array), -np.inf)
        beyond[dofs] = sign * (obstacle.x.array - values.x.array)[dofs]
        side = "below" if word == "lower" else "above"
        clear = _beyond_round_off(data, beyond, np.append(given, _extreme(data, obstacle)), [obstacle])
        _refuse_beyond(data, clear, values, obstacle, f"lies {side} the {word} obstacle")
        obstacle.x.array[beyond > 0] = values.x.array[beyond > 0]


def _refuse_crossing(data: Data, lower: fem.Function, upper: fem.Function, given: np.ndarray) -> None:
    """Reject obstacles that cross (collective)."""
    certain = np.append(given, [_extreme(data, lower), _extreme(data, upper)])
    found = worst(data, _beyond_round_off(data, lower.x.array - upper.x.array, certain, [lower, upper]))
    if found is not None:
        place = f"{data.model.source}: lower" if data.model.lower is None else data.model.lower.source
        message = f"{place} is above upper: by {found[0]:.3g} at {data.place(found[1])}"
        if any(isinstance(one, OfFunction) for one in (data.model.lower, data.model.upper)):
            message += f"; {IRREVERSIBLE}"
        raise InputError(message)


def _extreme(data: Data, obstacle: fem.Function) -> float:
    """The largest height of a lower obstacle, the least one of an upper obstacle: u is there or beyond (collective)."""
    found = largest if obstacle is data.lower else smallest
    return found(data.level.comm, obstacle.x.array)


def _beyond_round_off(
    data: Data, excess: np.ndarray, certain: np.ndarray, obstacles: Sequence[fem.Function]
) -> np.ndarray:
    """What is more than round-off of an excess at local dofs, otherwise -inf (collective).

    Round-off is relative to values that u certainly has, and to those of the obstacles in the cells around a node.
    Obstacles elsewhere may be as far off as they like.

    Args:
        data: Its obstacles.
        excess: By how much values are beyond others.
        certain: Heights that u has.
        obstacles: One or both.
    """
    comm, heights = data.level.comm, certain[np.isfinite(certain)]
    high, low = largest(comm, heights), smallest(comm, heights)
    tolerance = 0.0 if low > high else ROUND_OFF * (high - low) + 8 * EPSILON * max(abs(high), abs(low))
    if largest(comm, excess) <= tolerance:
        return np.full(len(excess), -np.inf)
    around = np.max([_heights_around(data, np.abs(obstacle.x.array)) for obstacle in obstacles], axis=0)
    return np.where(excess > tolerance + AROUND * around, excess, -np.inf)


def _heights_around(data: Data, heights: np.ndarray) -> np.ndarray:
    """The largest finite one of some heights at local dofs in the cells around each of these (local)."""
    finite = np.where(np.isfinite(heights), heights, 0.0)
    if data.level.scalar is not data.level:  # of contact nodes
        return finite
    cells, found = releases.cell_dofs(data.level.V), finite.copy()
    np.maximum.at(found, cells, finite[cells].max(axis=1, initial=0.0)[:, None])
    return found


def _check_parts(data: Data) -> None:
    """Reject fluxes, springs and obstacles on parts where u is given (collective)."""
    if all(part.value is not None for part in data.model.boundary):
        return
    held = np.unique(np.concatenate([np.empty(0, np.int32), *data.held]))
    for number, part in enumerate(data.model.boundary):
        both = np.isin(data.facets[number], held)
        if part.value is None and total(data.level.comm, np.count_nonzero(both)) > 0:
            sides = [side for side in ("lower", "upper") if getattr(part, side) is not None]
            key = [*data.model.acts(number), *sides][0]
            others = " and ".join(
                f"no. {other + 1}"
                for other, facets in enumerate(data.held)
                if total(data.level.comm, np.count_nonzero(np.isin(facets, data.facets[number]))) > 0
            )
            raise InputError(f"{data.model.source}: {part.name} {key} has no effect where u is given, by {others}")


def _refuse_beyond(data: Data, beyond: np.ndarray, values: fem.Function, obstacle: fem.Function, where: str) -> None:
    """Reject boundary values beyond an obstacle, naming the table that gives the value (collective)."""
    found = worst(data, beyond)
    if found is not None:
        _, point, dof = found
        mine = None
        if dof is not None:
            both = f"{values.x.array[dof]:.6g} against {obstacle.x.array[dof]:.6g}"
            mine = f"{giver(data, dof)} {where}: {both}"
        raise InputError(f"{first_given(data.level.comm, mine)} at {data.place(point)}, so that no u satisfies both")


def giver(data: Data, dof: int) -> str:
    """Where the boundary value at a local dof stands (local)."""
    return next(place for place, dofs in reversed(data.givers) if dof in dofs)


def worst(data: Data, excess: np.ndarray, tolerance: float = 0.0) -> tuple[float, np.ndarray, int | None] | None:
    """The largest excess above the tolerance, its place, and the dof there on ranks that have it (collective).

    Of places alike it is the first by coordinates, whatever the partition.
    """
    gap = largest(data.level.comm, excess)
    if gap <= tolerance:
        return None
    dofs = np.flatnonzero(excess >= gap * (1 - 1e-9))
    mine = min(((data.level.points[:, dof].tolist(), int(dof)) for dof in dofs), default=None)
    point = min(one[0] for one in data.level.comm.allgather(mine) if one is not None)
    return gap, np.array(point), None if mine is None or mine[0] != point else mine[1]

"""Checks that the admissible set is not empty: obstacles do not cross, boundary values are between them."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.solvability import PRESCRIBE
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import first_given, largest, smallest, total

ROUND_OFF = 1e-10  # relative to the values: obstacle and boundary value may come from different formulas


def check_admissible(data: Data) -> None:
    """Reject obstacles that cross, and boundary values that are not between them (collective).

    Where a boundary value is beyond an obstacle by round-off only, the obstacle is moved to it.

    Raises:
        InputError: Naming the place and the gap.
    """
    comm, source = data.level.comm, data.model.source
    dofs, values = data.fixed
    holds = any(effect.holds or effect.gives_way for effect in data.model.effects)
    if data.lower is None and data.upper is None and total(comm, len(dofs)) == 0 and not holds:
        raise InputError(f"{source}: u is given nowhere, and there is no obstacle: {PRESCRIBE}")
    _check_parts(data)
    u_values = [f.x.array for f in (data.lower, data.upper) if f is not None] + [values.x.array[dofs]]
    if data.thin:
        u_values = [part[np.isfinite(part)] for part in u_values]
    high, low = largest(comm, np.concatenate(u_values)), smallest(comm, np.concatenate(u_values))
    tolerance = ROUND_OFF * (high - low) + 8 * float(np.finfo(float).eps) * max(abs(high), abs(low))
    if data.lower is not None and data.upper is not None:
        crossing = data.lower.x.array - data.upper.x.array
        place = f"{source}: lower" if data.model.lower is None else data.model.lower.source
        _refuse_gap(data, crossing, tolerance, f"{place} is above upper")
    for obstacle, sign, word in ((data.lower, 1, "lower"), (data.upper, -1, "upper")):
        if obstacle is None:
            continue
        beyond = np.full(len(values.x.array), -np.inf)
        beyond[dofs] = sign * (obstacle.x.array - values.x.array)[dofs]
        side = "below" if word == "lower" else "above"
        _refuse_beyond(data, beyond, tolerance, values, obstacle, f"lies {side} the {word} obstacle")
        obstacle.x.array[beyond > 0] = values.x.array[beyond > 0]


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


def _refuse_beyond(
    data: Data, beyond: np.ndarray, tolerance: float, values: fem.Function, obstacle: fem.Function, where: str
) -> None:
    """Reject boundary values beyond an obstacle, naming the table that gives the value (collective)."""
    found = worst(data, beyond, tolerance)
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


def _refuse_gap(data: Data, excess: np.ndarray, tolerance: float, message: str) -> None:
    """All ranks raise if the largest excess is above the tolerance, naming its place (collective)."""
    found = worst(data, excess, tolerance)
    if found is not None:
        raise InputError(f"{message}: by {found[0]:.3g} at {data.place(found[1])}")


def worst(data: Data, excess: np.ndarray, tolerance: float) -> tuple[float, np.ndarray, int | None] | None:
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

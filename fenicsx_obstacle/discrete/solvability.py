"""Solvability: total forces on connected parts of the mesh on which u is given nowhere."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.newton import diagonal_of
from fenicsx_obstacle.algebra.plausibility import SUM
from fenicsx_obstacle.algebra.system import PRESCRIBE
from fenicsx_obstacle.discrete.mesh_system import MeshSystem
from fenicsx_obstacle.effects.effect import is_support
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total

Sums: TypeAlias = Callable[[np.ndarray], np.ndarray]  # values at owned dofs, summed over each component
ROUND_OFF = 1e-12  # of the sum of its parts: what cancels


def check_support(problem: MeshSystem) -> None:
    """Check that each connected part of the mesh is supported, and note in `start`, `floating`, `borne`,
    `unheld` and `held` of the problem what only contact or supports hold (collective).

    With v = 1 on a connected component where u is given nowhere, (3.4) says that loads, supports and contact add up to
    0. A support whose answer to u = 1 is below the round-off of the stiffness holds nothing; then an obstacle must, and
    an obstacle only pushes.

    Args:
        problem: At u = 0; it is so again afterwards.

    Raises:
        InputError: Since no u is in balance, or since round-off would decide which one is.
    """
    comm, level = problem.level.comm, problem.level
    problem.start, problem.floating, problem.borne, problem.unheld, problem.held = None, False, None, None, None
    if level.shape is not None and total(comm, np.count_nonzero(problem.fixed)) > 0:
        return
    count, component = level.parts
    own = component[: level.owned]
    problem.parts = count, own

    def sums(values: np.ndarray) -> np.ndarray:
        return np.asarray(comm.allreduce(np.bincount(own, values, count)))

    loose = sums(problem.fixed.astype(float)) == 0
    if not loose.any():
        return
    data = problem.data
    hard = tuple(none if side is None else side.x.array for side, none in ((data.lower, -np.inf), (data.upper, np.inf)))
    soft = problem.soft_obstacles()
    rest, shift = _between(comm, soft)
    at_rest = problem.law.forces_at(rest)
    stiffness, forces = sums(diagonal_of(problem)), sums(np.abs(at_rest))
    if problem.affine:  # any shift is as good: one whose forces are not lost in the round-off of the load
        shift = float(np.divide(forces, stiffness, out=np.zeros(count), where=loose & (stiffness > 0)).max()) or shift
    scale = stiffness * (SUM if problem.affine else ROUND_OFF)
    held = sums(problem.law.forces_at(rest + shift) - at_rest) / shift
    holds = held > scale
    net = -sums(at_rest)  # the load, and what supports answer to `rest`
    size = ROUND_OFF * forces + scale * abs(rest)
    stiff = [_stiffness(problem, g, side, sums) - held for g, side in zip(soft, (-1, 1), strict=True)]
    up, down = ((one > scale) | _reached(problem, g, sums) for one, g in zip(stiff, hard, strict=True))
    presses = np.where(net < -size, up, np.where(net > size, down, up & down))
    bad = loose & ~holds & ~(up & down) & ~presses
    if not problem.symmetric and bad.any():
        # not 1 but another positive test function, which is not known, has no stiffness
        rises, falls = (sums(np.maximum(sign * at_rest, 0.0)) > 0 for sign in (-1, 1))
        bad &= ~((up & falls) | (down & rises))
    if bad.any():
        _refuse(problem, int(np.flatnonzero(bad)[0]), up, down, np.where(np.abs(net) > size, net, 0.0), held, count)
    alone = loose & ~holds
    unheld = loose & all(one is None for one in soft)
    borne = unheld & alone & (np.abs(net) > size)
    if problem.symmetric:  # if not, the load may be any where the rows of A have no sum
        unheld &= ~borne
    problem.borne, problem.unheld = (flags if flags.any() else None for flags in (borne, unheld))
    if problem.affine and (loose & holds).any():
        problem.held = np.where(loose & holds, held, np.inf)
    side = np.where(up & (~down | (net <= 0)), -1, 1)
    side[~(loose & (up | down) & (~holds | problem.constrained))] = 0
    if not side.any():
        return
    start = np.full(len(component), np.nan)
    for sign, obstacle, soft_one, one in zip((-1, 1), hard, soft, stiff, strict=True):
        here, u_values = (side == sign)[component], np.broadcast_to(obstacle, len(component))
        if soft_one is not None:
            depth = np.abs(net) / np.where(one > scale, one, 1.0)
            start[here] = (soft_one + sign * np.where(depth > 0, depth, 1.0)[component])[here]
        known = here & np.isfinite(u_values)
        extreme = (smallest if sign < 0 else largest)(comm, u_values[known])
        if np.isfinite(extreme):
            # beside an obstacle on a part of the boundary: at its lowest or highest place
            start[here] = np.nextafter(extreme, sign * np.inf)
            start[known] = np.nextafter(u_values[known], sign * np.inf)
    if any(is_support(effect) for effect in problem.model.effects):
        # a support below round-off may still hold u before it reaches an obstacle that is far off
        far = np.zeros(count)
        np.fmax.at(far, component, np.abs(start - rest))
        comm.Allreduce(MPI.IN_PLACE, far, op=MPI.MAX)
        undecided = loose & ~holds & (side != 0) & (scale * far > np.abs(net))
        if undecided.any():
            nowhere = np.zeros(count, dtype=bool)
            _refuse(problem, int(np.flatnonzero(undecided)[0]), nowhere, nowhere, net, held, count)
    problem.start, problem.floating = start[: level.owned], bool(alone.any())


def _between(comm: MPI.Comm, soft: tuple[np.ndarray | None, np.ndarray | None]) -> tuple[float, float]:
    """A constant u between the soft obstacles, and a shift to another such constant (collective)."""
    lower = None if soft[0] is None else largest(comm, soft[0])
    upper = None if soft[1] is None else smallest(comm, soft[1])
    if lower is None and upper is None:
        return 0.0, 1.0
    if lower is None or upper is None:
        rest = upper if lower is None else lower
        assert rest is not None
        return rest, (-1.0 if lower is None else 1.0) * (abs(rest) or 1.0)
    return (lower + upper) / 2, (upper - lower) / 4 or 1.0


def _stiffness(problem: MeshSystem, soft: np.ndarray | None, side: int, sums: Sums) -> np.ndarray:
    """The force on each component per unit of u, where all of it is beyond a soft obstacle (collective)."""
    if soft is None:
        return sums(np.zeros(problem.level.owned))
    comm = problem.level.comm
    beyond = smallest(comm, soft) if side < 0 else largest(comm, soft)
    shift = side * (abs(beyond) or 1.0)
    return sums(problem.law.forces_at(beyond + 2 * shift) - problem.law.forces_at(beyond + shift)) / shift


def _refuse(
    problem: MeshSystem, one: int, up: np.ndarray, down: np.ndarray, net: np.ndarray, held: np.ndarray, count: int
) -> None:
    """Raise the error for a component without support."""
    source = f"{problem.model.source}: "
    where = "u is given nowhere" if count == 1 else f"u is given nowhere on one of {count} separate parts of the mesh"
    if up[one] or down[one]:
        side = "lower" if up[one] else "upper"
        why = "no solution exists" if net[one] else "if a solution exists, u is determined only up to a constant"
        raise InputError(
            f"{source}{where}, and the load, {net[one] + 0.0:.3g} in all, does not press against the {side} obstacle: "
            f"{why}; {PRESCRIBE}"
        )
    if any(is_support(effect) or effect.role == "soft obstacle" for effect in problem.model.effects):
        raise InputError(
            f"{source}{where}, and the stiffness of its supports, {max(held[one], 0.0):.3g} in all, is below "
            "the round-off of the "
            f"tension, so that round-off would determine u; {PRESCRIBE}, or use a stiffer support"
        )
    raise InputError(f"{source}{where}, and no obstacle supports it: {PRESCRIBE}")


def _reached(problem: MeshSystem, obstacle: np.ndarray | float, sums: Sums) -> np.ndarray:
    """Whether a component has an obstacle somewhere (collective)."""
    there = np.isfinite(np.broadcast_to(obstacle, len(problem.level.parts[1]))[: problem.owned])
    return sums((there & ~problem.fixed).astype(float)) > 0

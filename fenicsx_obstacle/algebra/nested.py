"""Nested iteration: the solution of each level, interpolated and relaxed, is the start on the next finer one.

Active-set methods move the boundary of contact by about one layer of nodes per step, so a cold start takes O(1/h)
steps. From the next coarser level contact is right up to a layer or two, whatever h.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fenicsx_obstacle.algebra.methods import Method
from fenicsx_obstacle.algebra.relaxation import relax
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.stopping import ON_THE_WAY, TOLERANCE, StepMonitor
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.truncated_multigrid import Multigrid
from fenicsx_obstacle.errors import NotConverged

_log = logging.getLogger(__name__)
FEW = 5  # Newton steps from a start that is said to be near, before coarser levels give one


@dataclass(frozen=True)
class Levels:
    """The systems on which a problem is solved, one after the other.

    Attributes:
        systems: From the coarsest to the finest, which is the problem.
        multigrids: Of each; None where truncated multigrid does not serve.
    """

    systems: tuple[System, ...]
    multigrids: tuple[Multigrid | None, ...]

    @classmethod
    def of(cls, systems: Sequence[System], *, multigrid: bool) -> Levels:
        """The levels of these systems.

        Args:
            systems: From the coarsest to the finest.
            multigrid: Whether truncated multigrid serves. A single level has none.
        """
        levels = cls((), ())
        if multigrid and len(systems) > 1:
            return levels.with_finer(systems)
        return cls(tuple(systems), (None,) * len(systems))

    def with_finer(self, systems: Sequence[System]) -> Levels:
        """These levels, and finer ones with multigrid on them."""
        multigrids = list(self.multigrids)
        if multigrids == [None]:  # a level that was alone
            multigrids = [Multigrid(self.systems[0], None)]
        for system in systems:
            multigrids.append(Multigrid(system, multigrids[-1] if multigrids else None))
        return Levels((*self.systems, *systems), tuple(multigrids))

    def __len__(self) -> int:
        return len(self.systems)

    def __getitem__(self, part: slice) -> Levels:
        return Levels(self.systems[part], self.multigrids[part])

    @property
    def finest(self) -> System:
        """The problem."""
        return self.systems[-1]

    @property
    def below(self) -> tuple[System, ...]:
        """The systems but for the problem."""
        return self.systems[:-1]


def solve_nested(
    levels: Levels,
    method: Method,
    *,
    start: Callable[[float | None], None] | None = None,
    solved: int = 0,
    tolerance: float = TOLERANCE,
    monitor: StepMonitor | None = None,
) -> list[Outcome]:
    """Solve on each level, from the coarsest to the finest (collective).

    Args:
        levels: The finest system holds the solution afterwards.
        method: How each is solved.
        start: Gives the finest system, for this eps, a state that is near the solution: Newton's method begins there.
            Where few steps do not do, and there are coarser levels, these give another start.
        solved: The number of coarsest levels that hold their solutions already.
        tolerance: Unbalanced force over acting forces to stop at on the finest level.
        monitor: Called after each step, on the levels of meshes.

    Returns:
        The outcome of each level that was solved, the finest last.

    Raises:
        NotConverged: On the finest level; where the coarsest level is algebraic, or contact alone bears the load, from
            a cold start too. A coarse state is a start, converged or not, if the problem is affine.
    """
    finest, spent = levels.finest, 0
    of_finest: dict[str, Any] = {"tolerance": tolerance, "monitor": monitor}
    if start is not None:
        start(method.eps)
        patience = {"patience": FEW} if len(levels) > 1 else {}
        try:
            return [method.solve(finest, multigrid=levels.multigrids[-1], **patience, **of_finest)]
        except NotConverged as error:
            if not patience:
                raise
            _log.info("the start is too far away: continuing from the coarser levels")
            spent = error.iterations
    outcomes: list[Outcome] = []
    before = levels.systems[solved - 1] if solved else None
    for system, multigrid in zip(levels.systems[solved:], levels.multigrids[solved:], strict=True):
        if before is None:
            system.set_reference(system.cold_start())
        else:
            begin_from(system, before)
            if system.constrained and multigrid is not None:
                relax(system, _stiffness_of_contact(system, method.eps))
        how = of_finest
        if system is not finest:  # an algebraic level has nothing to be shown on
            how = {"least": 1, "tolerance": ON_THE_WAY, "monitor": monitor if system.on_mesh else None}
        try:
            outcomes.append(method.solve(system, multigrid=multigrid, **how))
        except NotConverged as error:
            if system is finest:
                algebraic = not levels.systems[0].on_mesh
                if len(levels) == 1 or not (algebraic or system.borne is not None):
                    raise
                _log.info("no convergence from the coarser levels: continuing with a cold start")
                system.set_reference(system.cold_start())
                spent += error.iterations
                outcomes.append(method.solve(system, **of_finest))
            if not system.affine:  # it may be anywhere
                before = None
                continue
        before = system
    return [*outcomes[:-1], replace(outcomes[-1], iterations=spent + outcomes[-1].iterations)]


def as_it_is(_: float | None) -> None:
    """A `start` for `solve_nested`: the present state of the finest system."""


def _stiffness_of_contact(system: System, eps: float | None) -> np.ndarray:
    """What an obstacle adds to the diagonal at each point of I: D_i/eps, infinite without a penalty."""
    stiffness = np.inf if eps is None else 1.0 / eps
    return np.multiply(stiffness, system.weights, out=np.zeros(len(system.weights)), where=system.weights > 0)


def begin_from(system: System, coarse: System) -> None:
    """Set the state to the interpolant of the next coarser level (collective).

    Where both ends of an edge are in contact its middle is: gaps, not values of u, are interpolated there, or
    the middle of a curved obstacle's edge would start far off.
    """
    transfer, w = system.transfer, system.w
    system.set_unknown(transfer.interpolate(coarse.u))
    for ours, theirs, sign in ((system.below, coarse.below, 1), (system.above, coarse.above, -1)):
        if ours is None or theirs is None:
            continue
        distance = sign * (coarse.w - theirs)
        touching = transfer.all_of(distance <= 0) & ~system.fixed
        between = transfer.interpolate(np.minimum(distance, 0.0))
        w[touching] = ours[touching] + sign * between[touching]
    system.state.share()

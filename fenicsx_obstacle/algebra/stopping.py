"""Stopping test: unbalanced forces small relative to the acting forces; of (3.4)* also the active set unchanged.

PETSc's own tests compare with the first residual, which for a small eps is ~ 1/eps and makes anything look small.
Here the unbalanced force, summed over the free nodes, is compared with the forces that act: load, supports, contact.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle.algebra import releases
from fenicsx_obstacle.algebra.data_scales import (
    EPSILON,
    ROUNDOFF_MARGIN,
    determined,
    negligible_force,
    stiffness_of,
)
from fenicsx_obstacle.algebra.separate_parts import SeparateParts
from fenicsx_obstacle.algebra.system import LIMIT, System
from fenicsx_obstacle.parallel import largest, total

_log = logging.getLogger(__name__)
TOLERANCE = 1e-10  # unbalanced force / acting forces
# the same on coarse levels, whose discretisation error is larger by far: a state is a start then, and is not judged
ON_THE_WAY = 1e-2
ROUNDOFF_LIMITED = 1e-8  # round-off / acting forces above which r in w = u - r is updated (`System.update_reference`)
SMALL_CORRECTION = 1e-6  # of the range of u: the sum of |r_i|/A_ii
OF_A_PART = 1e-9  # the same of a part whose contact may change still, when the sum of all forces is in balance
UNEVEN = 1e-6  # of |w|: where |r_i|/A_ii is larger, the forces of some part may be small beside those of others
SMALLER, IN_VAIN = 0.5, 3  # a correction is not smaller than half of the least before, in so many steps
NEARLY_CONSTANT = 1e-2  # of |u|: below it the range of u is no scale
FAR = 1e-3  # unbalanced / acting forces that cannot be round-off while contact changes
STALLED = 10  # steps
CONVERGED = PETSc.SNES.ConvergedReason.CONVERGED_FNORM_ABS
CYCLING = PETSc.SNES.ConvergedReason.DIVERGED_LOCAL_MIN  # no reason of PETSc's says 'active sets repeat'
MEANINGLESS = PETSc.SNES.ConvergedReason.DIVERGED_DTOL  # nor 'balanced, but not determined by the data'
TOO_MANY = PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
CONTINUE = PETSc.SNES.ConvergedReason.ITERATING


@dataclass(frozen=True)
class Step:
    """One Newton step, as in history.csv.

    Attributes:
        active: Number of nodes in contact.
        changed: Number of nodes that entered or left contact in this step.
        unbalanced: Sum of the absolute values of the residual forces at the nodes where u is not given.
        forces: Sum of the absolute values of the acting forces: loads, contact forces and reactions.
        krylov: Number of steps of the linear solver for this Newton step.
    """

    active: int
    changed: int
    unbalanced: float
    forces: float
    krylov: int


# called in each step, with the obstacle in contact with each owned point of I: -1 lower, 1 upper, 0 none (collective)
StepMonitor = Callable[[System, Step, np.ndarray], None]


@dataclass
class Stopping:
    """PETSc convergence test: forces in balance, and a state that the data determine.

    Attributes:
        problem: What is solved.
        exact_bounds: Whether contact is held by bounds (SNES VI) instead of the penalty.
        unchanged: Stop only if the active set has not changed, as (3.4)* does.
        watch_cycles: Give up where an active set comes back.
        least: Steps to take at least.
        tolerance: Unbalanced force over acting forces.
        patience: Steps after which to give up.
        monitor: Called after each step.
        roundoff_limited: Balance was only reached up to the round-off of w.
        from_afar: The round-off of w exceeds the tolerance, and hardly any of it is that of u.
        exact: Linear systems have to be solved to the end, as Newton has cycled with inexact ones.
        uneven: The same, as the forces of some part are small beside others.
        before: Which obstacle held each owned node at the last state, -1 lower, 1 upper, 0 none; before the first
            state that of an earlier attempt, or None.
        history: One `Step` per evaluation.
    """

    problem: System
    exact_bounds: bool = False
    unchanged: bool = False
    watch_cycles: bool = False
    least: int = 0
    tolerance: float = TOLERANCE
    patience: int = 10**9
    monitor: StepMonitor | None = None
    roundoff_limited: bool = False
    from_afar: bool = False
    exact: bool = False
    uneven: bool = False
    before: np.ndarray | None = None
    history: list[Step] = field(default_factory=list)
    _correction: float = np.inf
    _vain: int = 0
    _seen: dict[tuple[bytes, ...], int] = field(default_factory=dict)
    _krylov: int = 0

    def __call__(self, snes: PETSc.SNES, iteration: int, norms: Any) -> int:
        """PETSc's callback (collective); the state is the one of the last residual."""
        problem = self.problem
        comm = problem.comm
        elastic = problem.elastic.array_r
        active, residual = self._unbalanced(elastic)
        unbalanced = total(comm, np.abs(residual))
        del residual  # memory
        changed = active != self.before if self.before is not None else active != 0
        forces = problem.load + total(comm, np.abs(elastic[problem.fixed | problem.active_dofs(active != 0)]))
        krylov = snes.getLinearSolveIterations()
        step = Step(
            active=int(total(comm, np.count_nonzero(active))),
            changed=int(total(comm, np.count_nonzero(changed))),
            unbalanced=unbalanced,
            forces=forces,
            krylov=krylov - self._krylov,
        )
        self.history.append(step)
        if self.monitor is not None and not (iteration == 0 and self.before is not None):  # the same state again
            self.monitor(problem, step, active)
        _log.info("step %d: %d in contact, %d changed, unbalanced %.1e of %.1e",
                  iteration, step.active, step.changed, unbalanced, forces)  # fmt: skip
        self.before, self._krylov = active, krylov
        if not np.isfinite(unbalanced):  # on all ranks, being a sum over them
            return releases.NOT_A_NUMBER
        # balance in this scale holds only with the correct active set; nodes that still change then
        # carry no force (contact without pressure)
        left = ROUNDOFF_MARGIN * self.round_off()
        nothing_acts = problem.affine and forces <= left  # not for films: their forces stay bounded when u diverges
        far = len(self.history) < 2 or (step.changed > 0 and unbalanced > FAR * forces and not nothing_acts)
        floor = 0.0 if far else left + self._nothing
        balanced = self._is_balanced(active, elastic, floor)
        self.roundoff_limited = floor > ROUNDOFF_LIMITED * forces
        self.from_afar = balanced and floor > self.tolerance * forces and self._counts_from_afar(active)
        if balanced and iteration >= self.least and not (self.unchanged and self._changes(changed, floor)):
            # where round-off limits w, r is updated first; a load below round-off would seem balanced in the first step
            self.roundoff_limited |= far and left > ROUNDOFF_LIMITED * forces
            if self.tolerance >= ON_THE_WAY or self.roundoff_limited or self._is_determined(active):
                return CONVERGED
            if problem.affine:
                return MEANINGLESS  # the next step would solve the same system
        if problem.affine and self._stalls():
            return MEANINGLESS
        if self.watch_cycles and step.changed and self._repeats(active):
            if self.exact:
                return CYCLING
            self.exact = True  # inexact linear systems may have been the reason
            self._seen.clear()
        return CONTINUE if iteration < self.patience else TOO_MANY

    def begin_again(self) -> None:
        """Go on with another SNES, which counts its iterations from 0."""
        self._krylov, self._vain, self._correction = 0, 0, np.inf

    def _unbalanced(self, elastic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The obstacle in contact with each node (-1 lower, 1 upper, 0 none), and the unbalanced forces."""
        problem = self.problem
        lower, upper = problem.gaps() if self.exact_bounds else problem.pressed_gaps()
        if self.exact_bounds:
            # complementarity: at the lower bound the support may only push up, a(u, phi) - f >= 0
            below, above = (lower <= 0) & (elastic > 0), (upper <= 0) & (elastic < 0)
            residual = np.where((below | above) & problem.touchable, 0.0, elastic)
        else:
            below, above = lower < 0, upper < 0
            residual = elastic + problem.reaction.array_r if problem.constrained else elastic.copy()
        residual[problem.fixed] = 0.0
        active = above.astype(np.int8) - below.astype(np.int8)
        active[~problem.touchable] = 0
        return active, residual

    def _is_balanced(self, active: np.ndarray, elastic: np.ndarray, floor: float) -> bool:
        """Whether forces are in balance, up to the round-off (collective)."""
        step = self.history[-1]
        allowed = may_be_left(step.forces, floor, self.tolerance)
        return step.unbalanced <= allowed and self._correction_is_done(elastic)

    def _is_determined(self, active: np.ndarray) -> bool:
        """Whether the data, and not round-off, determine the state (collective)."""
        return determined(self.problem, active, self._stiffness(), self.history[-1].unbalanced)

    def _correction_is_done(self, elastic: np.ndarray) -> bool:
        """Whether the correction of u by one step of Jacobi, the sum of |r_i|/A_ii, is small beside its range, or no
        step makes it smaller (collective).

        Forces of one part, such as those of a stiff layer or spring, may exceed those of all others by so much that
        the balance of their sum says nothing of these. Where F is not linear the A_ii are those of the last step, or of
        the state where a form degenerates: a correction that does not become smaller is no reason to go on.
        """
        if not self.row_by_row:
            return True
        problem = self.problem
        stiffness, moved = self._stiffness(), self._unbalanced(elastic)[1]  # in place: they are large
        moved[stiffness <= 0] = 0.0
        np.abs(np.divide(moved, stiffness, out=moved, where=stiffness > 0), out=moved)
        left = total(problem.comm, moved)
        rounded = ROUNDOFF_MARGIN * EPSILON * total(problem.comm, np.abs(problem.u))
        small = small_correction(problem)
        if left <= small + rounded:
            apart = self._is_uneven(moved, stiffness) and not small_in_parts(problem, moved)
            self.uneven = apart or self._moves_as_a_whole(elastic, small)
            return not self.uneven
        # a bound's line search may stand still: it goes by the norm of all forces, round-off of a stiff part included
        stands = self.exact_bounds and left > LIMIT / SMALL_CORRECTION * small
        return self._in_vain(left) and not stands

    def _in_vain(self, left: float) -> bool:
        """Whether no step makes the correction of a nonlinear problem smaller; called once in a step."""
        self._vain = self._vain + 1 if left > SMALLER * self._correction else 0
        self._correction = min(left, self._correction)
        return not self.problem.affine and self._vain >= IN_VAIN

    def _moves_as_a_whole(self, elastic: np.ndarray, small: float) -> bool:
        """Whether what is left of the forces moves a part that weak supports alone hold by more than a small correction
        (collective).

        Sums over nodes do not see that: a constant meets the supports alone, not the stiffness of each node. Contact
        holds a part, too, unless its forces are not more than what is left.
        """
        problem = self.problem
        if problem.held is None or problem.parts is None:
            return False
        count, component = problem.parts
        active, residual = self._unbalanced(elastic)
        contact = np.where(problem.active_dofs(active != 0), np.abs(elastic), 0.0)
        rounded = ROUNDOFF_MARGIN * EPSILON * self._stiffness() * np.abs(problem.u)
        columns = np.array([np.bincount(component, values, count) for values in (residual, contact, rounded)])
        left, pressing, noise = problem.comm.allreduce(columns)
        left = np.abs(left)
        return bool(np.any((pressing <= left / FAR) & (left > small * problem.held + noise)))

    def _is_uneven(self, moved: np.ndarray, stiffness: np.ndarray) -> bool:
        """Whether some |r_i|/A_ii is more than `UNEVEN` of w there and around (collective).

        It overwrites the stiffness.
        """
        x = self.problem.vector()
        y = x.duplicate()
        x.array[:] = np.abs(x.array_r)
        self.problem.A.mult(x, y)
        own, around = x.array, y.array  # in place: they are large
        own *= stiffness
        around -= own  # the diagonal
        np.abs(around, out=around)
        around += own
        around *= UNEVEN
        stiffness *= moved
        uneven = np.any(stiffness > around)
        for vector in (x, y):
            vector.destroy()
        return total(self.problem.comm, uneven) > 0

    @property
    def row_by_row(self) -> bool:
        """Whether forces are judged beside the stiffness of their nodes, too."""
        return self.tolerance < ON_THE_WAY and self.problem.nodal

    def _changes(self, changed: np.ndarray, floor: float) -> bool:
        """Whether the active set has changed; nodes whose contact force is round-off are not counted."""
        if self.history[-1].changed == 0 or not self.problem.nodal:
            return self.history[-1].changed > 0
        pressing = np.where(changed, np.abs(self.problem.reaction.array_r), 0.0)
        return total(self.problem.comm, pressing) > floor

    def _stalls(self) -> bool:
        """Whether the same linear system was solved STALLED times, and its residual did not become smaller."""
        last = self.history[-STALLED - 1 :]
        same = len(last) > STALLED and not any(step.changed for step in last)
        return same and min(step.unbalanced for step in last[1:]) >= last[0].unbalanced

    def round_off(self) -> float:
        """The round-off of exact balance (collective)."""
        return round_off(self.problem, self._stiffness())

    def _counts_from_afar(self, active: np.ndarray) -> bool:
        """Whether most of the round-off is that of a reference r far from u, as of an obstacle that was near the start
        (collective)."""
        problem = self.problem
        stiffness = np.where(problem.active_dofs(active != 0), 0.0, self._stiffness())
        far, near = (total(problem.comm, stiffness * np.abs(values)) for values in (problem.w, problem.u))
        return near < SMALLER * far

    @cached_property
    def _nothing(self) -> float:
        """A force that is negligible, for data that are all zero (collective)."""
        return negligible_force(self.problem, self._stiffness())

    def _stiffness(self) -> np.ndarray:
        """Diagonal of the present matrix at owned free dofs, with the penalty diagonal where there is one."""
        return stiffness_of(self.problem, exact_bounds=self.exact_bounds)

    def _repeats(self, active: np.ndarray) -> bool:
        """Whether this active set was met before: Newton cycles (collective)."""
        digests = self.problem.comm.allgather(blake2b(active.tobytes(), digest_size=8).digest())
        key = tuple(digests)
        self._seen[key] = self._seen.get(key, 0) + 1
        return self._seen[key] > 1


def may_be_left(forces: float, floor: float, tolerance: float = TOLERANCE) -> float:
    """The largest sum of unbalanced forces of a solution.

    Args:
        forces: Sum of the acting forces.
        floor: The round-off of exact balance.
        tolerance: Unbalanced force over acting forces.
    """
    return max(tolerance * forces, floor)


def round_off(problem: System, stiffness: np.ndarray) -> float:
    """The round-off of exact balance (collective): machine epsilon times |A| |w|, row by row.

    Rows of a stiffness matrix sum to about 0, so |A| |w| is about twice its diagonal part, and unit round-off is half
    of epsilon.

    Args:
        problem: Holds w.
        stiffness: Diagonal of A at owned free dofs, with the penalty diagonal where there is one; 0 at fixed dofs.
    """
    return EPSILON * total(problem.comm, np.dot(stiffness, np.abs(problem.w)))


def small_correction(problem: System) -> float:
    """The largest sum of |r_i|/A_ii of a solution, in the unit of u: a share of its range, or of |u| where u is nearly
    constant (collective)."""
    comm = problem.comm
    sizes = (largest(comm, np.abs(values)) for values in (problem.w, problem.u))
    moved, size = (max(value, 0.0) for value in sizes)
    return SMALL_CORRECTION * max(problem.range_of_u() + moved, NEARLY_CONSTANT * size)


def small_in_parts(problem: System, moved: np.ndarray) -> bool:
    """Whether the correction is small in each part that given values separate (collective).

    In a part without data u is 0 at last: there it is measured beside the largest |u| of all.

    Args:
        problem: In the state at which its matrix A was assembled last.
        moved: |r_i|/A_ii at owned dofs.
    """
    u_values = problem.u
    parts, size = SeparateParts(problem, u_values), np.abs(u_values)
    heights = parts.ranges + parts.largest(np.abs(problem.w))
    allowed = OF_A_PART * np.maximum(heights, NEARLY_CONSTANT * parts.largest(size))
    rounded = ROUNDOFF_MARGIN * EPSILON * parts.sums(size) + EPSILON**2 * largest(problem.comm, size)
    return bool(np.all(parts.sums(moved) <= allowed + rounded))


def in_words(reason: int) -> str:
    """PETSc's reason for stopping, in words."""
    names = {value: name for name, value in vars(PETSc.SNES.ConvergedReason).items() if isinstance(value, int)}
    words = {
        TOO_MANY: "the limit of steps was reached",
        PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE: "a linear system could not be solved",
        PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: "the line search found no descent",
        releases.NOT_A_NUMBER: "the residual became infinite or not a number",
        MEANINGLESS: "round-off determines u: its forces are no small part of those of the data; u is not supported, "
        "or the equation is nearly singular",
        CYCLING: "the active sets repeat",
    }
    return f"{words.get(reason, 'the nonlinear solver stopped')} ({names.get(reason, reason)})"

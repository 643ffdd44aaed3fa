"""Time steps: difference formulas, and estimates of the local error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.time_discretization import INERTIA, RATE
from fenicsx_obstacle.parallel import largest

DEPTH = {"euler": 1, "bdf2": 2}  # of how many earlier moments a scheme makes u_t
SLOWER, FASTER = 0.2, 2.0  # how much a step may be shorter or longer than the one before
WORTH = 1.3  # times the length: a longer step pays for the matrix that it changes
SAFETY = 0.85
SAME = 1e-9  # of a step: round-off of t


class Steps:
    """The accepted time steps, and the difference formulas of the next one.

    Attributes:
        times: The last moments, the newest first.
        u_values: u there, ghosts included.
        velocity: u_t at the newest, with inertia.
        impulse: a(u, .) - f at the newest, at owned nodes, with inertia.
        eps: Penalty parameter of all steps, with the penalty method.
    """

    def __init__(self, order: int, scheme: str, t: float, u: np.ndarray, velocity: np.ndarray | None = None):
        self.order, self.depth = order, DEPTH.get(scheme, 1)
        self.times, self.u_values, self.velocity = [t], [u], velocity
        self.impulse: np.ndarray | None = None
        self.eps: float | None = None

    def prepare(self, problem: Problem, t: float) -> None:
        """Set the difference formulas of the step to t; `Problem.move` then updates the data."""
        assert problem.data.moment is not None
        assert problem.model.time is not None
        moment, dt, usual = problem.data.moment, t - self.times[0], problem.model.time.step
        dt = usual if abs(dt - usual) < SAME * usual else dt  # the numbers of the matrix stay, to the last digit
        moment.t = t
        if self.order == RATE:
            used = self._used()
            weights = difference([t, *self.times[:used]])
            moment.first = weights[0]
            problem.data.motion.past.x.array[:] = -sum(
                w * u for w, u in zip(weights[1:], self.u_values[:used], strict=True)
            )
        elif self.order == INERTIA:
            # twice rho (v1 - v0)/dt + (A u0 + A u1)/2 = f + p with v1 = 2 (u1 - u0)/dt - v0
            moment.first, moment.second = 2 / dt, 4 / dt**2
            assert self.velocity is not None and self.impulse is not None
            motion, u = problem.data.motion, self.u_values[0]
            motion.past.x.array[:] = 2 / dt * u
            motion.past_twice.x.array[:] = 4 / dt**2 * (u + dt * self.velocity)
            problem.law.impulse = -self.impulse

    def accept(self, t: float, u: np.ndarray) -> None:
        """Accept u as the solution at a new time."""
        if self.velocity is not None:
            self.velocity = 2 / (t - self.times[0]) * (u - self.u_values[0]) - self.velocity
        self.times = [t, *self.times][: self.depth + 1]
        self.u_values = [u, *self.u_values][: self.depth + 1]

    def error(self, problem: Problem, t: float, u: np.ndarray) -> float:
        """An estimate of the local error of the step to t, from its distance to an extrapolation (Milne's device).

        A difference of the depth k is wrong by D = u^(k+1)/(k+1)! (t - t_1) ... (t - t_k), which moves u by D/c; the
        extrapolation from k + 1 moments is off by that times (t - t_(k+1)) (Milne's device; collective).
        """
        used = self._used()
        known = min(used + 1, len(self.times))
        weights = extrapolation(t, self.times[:known])
        foreseen = sum(w * u_values for w, u_values in zip(weights, self.u_values[:known], strict=True))
        c = difference([t, *self.times[:used]])[0]
        off = np.abs(u - foreseen)
        off[problem.data.fixed[0]] = 0.0  # data
        return largest(problem.level.comm, off) / (1 + c * (t - self.times[known - 1]))

    def next_length(self, dt: float, error: float, tolerance: float) -> float:
        """Length of the next step, or of the same once more where its error was too large."""
        factor = SAFETY * (tolerance / max(error, 1e-300)) ** (1 / (self._used() + 1))
        factor = min(max(factor, SLOWER), FASTER)
        return dt * (factor if factor < 1 or factor > WORTH else 1.0)

    def _used(self) -> int:
        """Number of earlier time steps in the next difference formula; the first steps use fewer."""
        return min(self.depth, len(self.times))


def difference(times: Sequence[float]) -> list[float]:
    """Weights of values at these times whose sum is the derivative at the first one of the polynomial through them."""
    first, *others = times
    weights = []
    for j, t in enumerate(others, start=1):
        rest = [s for k, s in enumerate(times) if k not in (0, j)]
        weights.append(float(np.prod([first - s for s in rest]) / ((t - first) * np.prod([t - s for s in rest]))))
    return [-sum(weights), *weights]


def extrapolation(t: float, times: Sequence[float]) -> list[float]:
    """Weights of values at these times whose sum is the value at t of the polynomial through them."""
    return [float(np.prod([(t - s) / (one - s) for s in times if s != one])) for one in times]

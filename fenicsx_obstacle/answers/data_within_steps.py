"""Checks of the data within a time step: a step uses the data at its ends, and misses what they do between these.

A datum may leave the range of its values at the two ends of a step by a small amount only: by the tolerance where it is
an obstacle or a boundary value, and by the tolerance times rate/dt where it is a load. Both move u by the tolerance at
most where the maximum principle holds. Where a datum stays in the range of its values at the ends, the change of u over
the step shows what it does, and the estimate of the error contains it.

Formulas are bounded over intervals of t by interval arithmetic, at the points where the solver samples them. The
intervals are halved until their bounds are small enough, or until a value between the ends is too large. Data without
such bounds are sampled within the step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.time_discretization import NO_STEP, RATE
from fenicsx_obstacle.effects.field import Field, Names, TimeBounds
from fenicsx_obstacle.parallel import first_given, largest, smallest

BLOCK = 30_000  # points that are bounded together
PIECES = 32  # intervals of t per point, on average, before bounds are given up
FEWEST_PIECES = 10_000  # of all points together
SAMPLES = 8  # at least, of data without bounds, within a step
SAMPLES_PER_STEP = 4  # at least, of these, in a time of end/steps
GOLDEN = (5**0.5 - 1) / 2  # multiples of it, modulo 1, are spread evenly and have no period
RELATIVE = 0.01  # at most, of the largest value so far, where no unit says what a datum does to u
ROUND_OFF = 1e-12  # of the values that it must not exceed

LOWER, UPPER, GIVEN, LOAD, OTHER = "lower", "upper", "given", "load", "other"
OBSTACLES, UNIT_OF_U = (LOWER, UPPER), (LOWER, UPPER, GIVEN)


@dataclass(frozen=True, eq=False)
class _Moving:
    """A datum that depends on t.

    Attributes:
        field: The datum.
        kind: Which of the data it is.
        x: The local points where the solver samples it, shape (3, n); one if it is uniform.
        dofs: Of an obstacle, the local dofs where it acts; otherwise empty.
    """

    field: Field
    kind: str
    x: np.ndarray
    dofs: np.ndarray


class DataWithinSteps:
    """The data that depend on t, between the ends of a step.

    Attributes:
        sampled: Data that have been sampled only, in words: nothing is proved of what they do between the samples.
    """

    def __init__(self, data: Data, tolerance: float):
        """Take the data (collective).

        Args:
            data: Of the finest level, sampled before.
            tolerance: What a step may add to the error, in the unit of u.
        """
        self.data, self.tolerance = data, tolerance
        self.sampled: dict[str, None] = {}
        self._largest: dict[Field, float] = {}
        self._moving = list(_moving(data))

    def excess(
        self, start: float, end: float, size: float, u: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[str, float, float] | None:
        """The first datum found that a step would miss, in words, when, and by how much it is beyond its values at both
        ends; None if there is none (collective).

        An obstacle matters where it reaches u: a lower one where it is above u, and where it falls below a u that it
        supports.

        Args:
            start: Start of the step.
            end: Its end.
            size: The largest |u| so far.
            u: Solutions at both ends, at local dofs, if the obstacles are to be looked at; otherwise all other data
                are, before the step.
        """
        for one in self._moving:
            if (one.kind in OBSTACLES) == (u is not None):
                found = self._excess(one, start, end, size, u)
                if found is not None:
                    return found
        return None

    def _excess(
        self, one: _Moving, start: float, end: float, size: float, u: tuple[np.ndarray, np.ndarray] | None
    ) -> tuple[str, float, float] | None:
        data, comm = self.data, self.data.level.comm
        assert data.model.time is not None
        field, names = data.here(one.field), data.names(one.field)
        ends = [field.at(one.x, {**names, "t": t}) for t in (start, end)]
        highest = largest(comm, np.nan_to_num(np.abs(ends), nan=np.inf, posinf=np.inf))
        if not np.isfinite(highest):  # the message comes from the step
            return None
        allowed = self._allowed(one, end - start, size, highest)
        limits = np.minimum(*ends), np.maximum(*ends)
        if u is not None:
            limits = _reached(one, ends, [values[one.dofs] for values in u], self.tolerance)
        search = _Search(field, one.x, names, (start, end), ends, limits, allowed)
        if (found := search.by_bounds(NO_STEP * data.model.time.end)) is None and search.unknown:
            found = search.by_samples(data.model.time.step)
        first = first_given(comm, found)
        if first is not None:
            self._remember(one, first[1])
            return str(one.field), *first
        if comm.allreduce(search.unknown, op=MPI.LOR):
            self.sampled[str(one.field)] = None
        return None

    def _remember(self, one: _Moving, size: float) -> None:
        if np.isfinite(size):
            self._largest[one.field] = max(size, self._largest.get(one.field, 0.0))

    def _allowed(self, one: _Moving, dt: float, size: float, highest: float) -> float:
        """By how much a datum may leave the range of its values at the ends of a step (collective).

        Args:
            one: The datum.
            dt: Length of the step.
            size: The largest |u| so far.
            highest: The largest absolute value at the ends of the step.
        """
        if one.kind in UNIT_OF_U:
            return self.tolerance
        rates = [effect.value for effect in self.data.model.effects if effect.order == RATE]
        if one.kind == LOAD and rates:
            return self.tolerance * smallest(self.data.level.comm, self.data.values(rates[0], positive=True)) / dt
        self._remember(one, highest)
        return min(RELATIVE, self.tolerance / size if size > 0 else np.inf) * self._largest[one.field]


@dataclass(eq=False)
class _Search:
    """A search for a time within a step at which a datum leaves the range of its values at the ends (local).

    Attributes:
        field: The datum, on this mesh.
        x: Points, shape (3, n).
        names: As for `Field.at`.
        step: Start and end of the step.
        ends: Values there.
        limits: Least and largest value that the datum may have at each point, up to round-off.
        allowed: By how much it may exceed these.
        unknown: Whether neither such a time was found, nor bounds show that there is none.
    """

    field: Field
    x: np.ndarray
    names: Names
    step: tuple[float, float]
    ends: Sequence[np.ndarray]
    limits: tuple[np.ndarray, np.ndarray]
    allowed: float
    unknown: bool = False

    def by_bounds(self, shortest: float) -> tuple[float, float] | None:
        """Halve the step until bounds are small enough, or a value is too large.

        Args:
            shortest: Length of intervals that are not halved any more, unless the step itself is hardly longer.

        Returns:
            Time and size of the excess, if there is one.
        """
        shortest = min(shortest, (self.step[1] - self.step[0]) / SAMPLES)
        for first in range(0, self.x.shape[1], BLOCK):
            found = self._in_block(np.arange(first, min(first + BLOCK, self.x.shape[1])), shortest)
            if found is not None:
                self.unknown = False
                return found
        return None

    def _in_block(self, rows: np.ndarray, shortest: float) -> tuple[float, float] | None:
        left = FEWEST_PIECES + PIECES * len(rows)
        a, b = (np.full(len(rows), t) for t in self.step)
        at_a, at_b = (values[rows] for values in self.ends)
        while len(rows):
            left -= len(rows)
            bounds = self.field.over_time(self.x[:, rows], a, b, self.names) if left > 0 else None
            if bounds is None:
                self.unknown = True
                return None
            open_ = ~(self._most(rows, _sharpened(bounds, b - a, at_a, at_b)) <= self.allowed) & (b - a > shortest)
            rows, a, b, at_a, at_b = (values[open_] for values in (rows, a, b, at_a, at_b))
            middle = (a + b) / 2
            at_middle = self._at(rows, middle)
            if (found := self._beyond(rows, middle, at_middle)) is not None:
                return found
            rows = np.concatenate([rows, rows])
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
            at_a, at_b = np.concatenate([at_a, at_middle]), np.concatenate([at_middle, at_b])
        return None

    def by_samples(self, usual: float) -> tuple[float, float] | None:
        """Sample the datum within the step.

        Args:
            usual: Length of the first step.

        Returns:
            Time and size of the excess, if there is one.
        """
        rows, (start, end) = np.arange(self.x.shape[1]), self.step
        count = max(SAMPLES, int(np.ceil(SAMPLES_PER_STEP * (end - start) / usual)))
        for k in range(1, count + 1):
            t = start + k * GOLDEN % 1 * (end - start)
            if (found := self._beyond(rows, np.full(len(rows), t), self._at(rows, t))) is not None:
                return found
        return None

    def _at(self, rows: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        return self.field.at(self.x[:, rows], {**self.names, "t": t})

    def _beyond(self, rows: np.ndarray, t: np.ndarray, values: np.ndarray) -> tuple[float, float] | None:
        """Time and size of the largest excess of some values, where it is larger than allowed."""
        over = self._most(rows, (values, values))
        over[np.isnan(over)] = np.inf  # the message comes from the step that ends there
        if not len(over) or over.max() <= self.allowed:
            return None
        return float(t[np.argmax(over)]), float(over.max())

    def _most(self, rows: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """A bound of the excess over intervals."""
        low, high = (limit[rows] for limit in self.limits)
        low, high = low - ROUND_OFF * np.abs(low), high + ROUND_OFF * np.abs(high)
        with np.errstate(invalid="ignore"):
            above, below = bounds[1] - high, low - bounds[0]
        return np.maximum(np.where(high == np.inf, -np.inf, above), np.where(low == -np.inf, -np.inf, below))


def _sharpened(bounds: TimeBounds, dt: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds over intervals of length dt, where the values at their ends are a and b."""
    with np.errstate(invalid="ignore"):  # a first derivative of 0 and an infinite second one
        from_mean = bounds.first * dt / 2
        from_chord = bounds.second * dt**2 / 8
    least = np.fmax(np.fmax(bounds.lower, (a + b) / 2 - from_mean), np.minimum(a, b) - from_chord)
    most = np.fmin(np.fmin(bounds.upper, (a + b) / 2 + from_mean), np.maximum(a, b) + from_chord)
    return least, most


def _reached(
    one: _Moving,
    obstacle: Sequence[np.ndarray],
    u: Sequence[np.ndarray],
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value that an obstacle may have within a step without a change of u.

    Args:
        one: The obstacle.
        obstacle: Its values at the ends of the step.
        u: Those of u, at the dofs of the obstacle.
        tolerance: The distance that counts as contact.
    """
    if one.kind == UPPER:
        below = replace(one, kind=LOWER)
        low, high = _reached(below, [-values for values in obstacle], [-values for values in u], tolerance)
        return -high, -low
    free, bears = np.minimum(*u), u[1] <= obstacle[1] + tolerance
    if one.field.uniform:
        free, bears = np.min(free, initial=np.inf, keepdims=True), np.any(bears, keepdims=True)
    return np.where(bears, np.minimum(*obstacle), -np.inf), np.maximum(np.maximum(*obstacle), free)


def _moving(data: Data) -> Iterator[_Moving]:
    """The data that depend on t and have been sampled, each with its points (collective)."""
    level, model = data.level, data.model
    loads = [effect.value for effect in model.effects if effect.role == "load"]
    everywhere, of_cells = level.points, level.points_of(level.W)
    in_cells, at_nodes, on_parts = data.sampled
    for field in in_cells:
        kind = LOAD if any(field is load for load in loads) else OTHER
        parts: list[tuple[str | None, Field]] = [*field.parts.items()] if field.parts else [(None, field)]
        for name, part in parts:
            if part.moves:
                yield from _at(part, kind, of_cells if name is None else of_cells[:, level.indicator(name)])
    for field in at_nodes:
        yield from _at(field, OTHER, everywhere)
    for field, number in on_parts:
        yield from _at(field, OTHER, everywhere[:, data.dofs_on(data.facets[number])])
    for obstacle, kind in ((model.lower, LOWER), (model.upper, UPPER)):
        yield from _at(obstacle, kind, everywhere, np.arange(everywhere.shape[1]))
    for one, facets in zip(model.boundary, data.facets, strict=True):
        dofs = data.dofs_on(facets)
        for given, kind in ((one.value, GIVEN), (one.lower, LOWER), (one.upper, UPPER)):
            yield from _at(given, kind, everywhere[:, dofs], dofs)


def _at(field: Field | None, kind: str, x: np.ndarray, dofs: np.ndarray | None = None) -> Iterator[_Moving]:
    """The datum at its points, if it depends on t."""
    if field is not None and field.moves:
        yield _Moving(field, kind, np.zeros((3, 1)) if field.uniform else x, np.empty(0) if dofs is None else dofs)

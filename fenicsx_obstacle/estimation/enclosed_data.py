"""Enclosures of a datum in cells: polynomials on parts of the cells, with bounds of the remainder.

A datum that is a polynomial on a cell is that polynomial. Where it is smooth, its interpolant of degree 2 or 4 stands
for it, with a bound of the remainder from the derivatives of the next order; where a condition changes, a linear
function, or the middle of its bounds. Cells where that is rough, as a jump runs through them, are divided: the parts
need not be cells of any mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from math import factorial
from typing import TYPE_CHECKING

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.data.fields import Evaluated
from fenicsx_obstacle.effects.field import Bounds, Enclosed, Field, Names
from fenicsx_obstacle.estimation.parts import Parts
from fenicsx_obstacle.estimation.pieces import Group, Pieces, joined
from fenicsx_obstacle.estimation.quadrature import AT_ONCE, blocks
from fenicsx_obstacle.estimation.simplex_geometry import least_heights, sizes
from fenicsx_obstacle.mesh.cells import longest_edges

if TYPE_CHECKING:
    from fenicsx_obstacle.data.data import Data

NEGLIGIBLE_CURVATURE = 0.01  # of h^2 max|D^2 f|/2: an interpolant of degree 2 so near is enough
NEGLIGIBLE_REMAINDER = 1e-4  # of h/length max|f|: an interpolant of degree 2 so near is enough
THIN = 2e-3  # the same limit for the datum on parts that a condition cuts, times the root of their share
APART = 3.0  # so many times further than a condition may change from a line, it is decided
NARROW = 0.2  # of the range of a linear function: its line is no help where conditions may change further from it
EXACT = 5e-13  # of its size: round-off, which conditions do not see
BETTER = 0.9  # of half the distance of the bounds: the rest of a linear function that is worth while
NEGLIGIBLE = 1e-9  # unless it is below this, of the largest value there
DEEPEST = 8  # how often a part is divided on which no finite bounds are found
MAX_PARTS = 200_000  # in a block of cells, or twice as many as it has cells
FEW = 2000  # simplices that share such a limit, so that the parts of one do not depend on all others of the rank
SHARP = 0.1  # of the largest value: what varies so much between samples may jump
Enclose = Callable[[np.ndarray, np.ndarray], Enclosed]


@dataclass(frozen=True)
class Division:
    """Rules for the subdivision of simplices.

    Attributes:
        depth: How often at most, where there are finite bounds.
        rough: How far the datum may be from a polynomial, in parts of its range over a part.
        share: Parts in which a condition changes are not divided if they are smaller, in parts of a simplex.
        degree: Of interpolants: 4, or 2 where what counts is the distance to linear functions.
        length: Where the mean of what an interpolant lacks counts times a length, beside the size of the datum times
            that of the parts: this length.
        slopes: Whether the slope of the difference counts. On thin parts, as between two cuts, the interpolant of a
            smooth datum may be much steeper than the datum; then a linear function is taken.
    """

    depth: int
    rough: float = 0.1
    share: float = 1e-6
    degree: int = 4
    length: float = np.inf
    slopes: bool = False


def pieces_of(data: Data, datum: Field, corners: np.ndarray, cells: np.ndarray, division: Division) -> Pieces:
    """A datum on segments, triangles or tetrahedra, (E24) (collective where it is the first to need the distance).

    Args:
        data: Of the problem.
        datum: It, without parts.
        corners: Shape (simplices, corners, coordinates).
        cells: The owned cell that each lies in.
        division: When simplices are divided.
    """
    here, names = data.here(datum), data.names(datum)
    found = _Collected(len(corners))
    if datum.uniform:
        found.number(here.at(np.zeros((3, 1)), names)[0])
        return found.pieces()
    if not len(corners):
        return found.pieces()  # a formula would be walked through for nothing
    parts = Parts.whole(corners, cells)
    last = max(DEEPEST, division.depth)
    for split in range(last + 1):
        wanted, count = [], 0
        for block in blocks(len(parts.rows)):
            some = parts[block]
            near = _Near(partial(_enclosed, here, names), some, division, continuous=datum.continuous)
            found.sampled |= near.sampled
            open_ = near.open(division, some)
            found.rough[some.rows[open_]] = True
            large = (some.share > division.share) | near.whole
            divided = open_ & ((~near.finite & (split < DEEPEST)) | (large & (split < division.depth)))
            found.take(some, near, ~divided)
            if divided.any():
                wanted.append((some, near, divided))
                count += parts.times * np.count_nonzero(divided)
        if count > max(MAX_PARTS, 2 * found.count):
            if len(corners) > FEW:
                return _in_blocks(data, datum, corners, cells, division)
            for some, near, divided in wanted:
                found.take(some, near, divided)
            break
        if not wanted:
            break
        first, *others = (near.divided(some, np.flatnonzero(divided)) for some, near, divided in wanted)
        parts = first.and_(*others)
    return found.pieces()


def _in_blocks(data: Data, datum: Field, corners: np.ndarray, cells: np.ndarray, division: Division) -> Pieces:
    """The same, block by block of `FEW` simplices."""
    every = np.arange(len(corners))
    slices = [every[block] for block in blocks(len(corners), FEW)]
    return joined([(rows, pieces_of(data, datum, corners[rows], cells[rows], division)) for rows in slices], len(every))


def _enclosed(here: Field, names: Names, corners: np.ndarray, cells: np.ndarray) -> Enclosed:
    """A datum on simplices; samples of it where no bounds are known."""
    return here.over(corners, names, cells) or _Samples(here, 4, corners, names, cells)


def range_of(data: Data, datum: Field, corners: np.ndarray, cells: np.ndarray) -> Pieces:
    """Bounds of a datum (collective where it is the first to need the distance); the arguments are those of
    `pieces_of`. Simplices without finite bounds are divided."""
    here, names = data.here(datum), data.names(datum)
    if datum.uniform:
        number = np.full(len(cells), here.at(np.zeros((3, 1)), names)[0])
        return Pieces([], number, number, sampled=False)
    lower, upper, sampled = np.empty(len(cells)), np.empty(len(cells)), False
    for block in blocks(len(cells)):
        known = _enclosed(here, names, corners[block], cells[block])
        sampled |= isinstance(known, _Samples)
        lower[block], upper[block] = _defined(known.once())
    infinite = np.flatnonzero(~(np.isfinite(lower) & np.isfinite(upper)))
    divided = pieces_of(data, datum, corners[infinite], cells[infinite], Division(0))
    lower[infinite], upper[infinite] = divided.lower, divided.upper
    return Pieces([], lower, upper, sampled)


def _defined(bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds, infinite where a datum may have no value."""
    return np.where(bounds.defined, bounds.lower, -np.inf), np.where(bounds.defined, bounds.upper, np.inf)


class _Collected:
    """Parts found so far."""

    def __init__(self, count: int):
        self.count, self.sampled = count, False
        self.rough = np.zeros(count, dtype=bool)
        self._found: dict[tuple[int, bool, bool], list[Group]] = {}

    def number(self, value: float) -> None:
        """The same on all simplices."""
        same, none, rows = np.full(self.count, value), np.zeros(self.count), np.arange(self.count)
        group = Group(rows, None, np.ones(self.count), 0, same[:, None], none, same, same, none, smooth=True)
        self._found[0, True, True] = [group]

    def take(self, parts: Parts, near: _Near, wanted: np.ndarray) -> None:
        """What is near the datum on some of the parts."""
        for degree, smooth, chosen, coefficients in near.polynomials(wanted):
            if len(chosen):
                inside = None if parts.inside is None else parts.inside[chosen]
                group = Group(
                    parts.rows[chosen], inside, parts.share[chosen], degree, coefficients, near.rest[chosen],
                    near.lower[chosen], near.upper[chosen], near.steep[chosen], smooth,
                )  # fmt: skip
                self._found.setdefault((degree, smooth, inside is None), []).append(group)

    def pieces(self) -> Pieces:
        """All of it."""
        lower, upper = np.full(self.count, np.inf), np.full(self.count, -np.inf)
        groups = [group for found in self._found.values() for group in _together(found)]
        for group in groups:
            group.lower_to(lower, group.lower)
            group.raise_to(upper, group.upper)
        return Pieces(groups, lower, upper, self.sampled, self.rough)


def _together(found: list[Group]) -> Iterator[Group]:
    """Parts joined to groups of `AT_ONCE` parts at most; larger ones stay as they are, without a copy."""
    while found:
        sizes_ = np.cumsum([len(group.rows) for group in found])
        count = max(int(np.searchsorted(sizes_, AT_ONCE, "right")), 1)
        (first, *others), found = found[:count], found[count:]
        yield first.and_(*others) if others else first


class _Near:
    """What is near a datum on parts of simplices.

    Attributes:
        sampled: Whether this comes from samples.
        lower: Lower bound, infinite where none is known.
        upper: Upper bound.
        finite: Whether both are finite.
        whole: Whether no condition changes there.
        rest: Bound of its distance to a polynomial.
        steep: As in `Group`.
    """

    def __init__(self, enclosed: Enclose, parts: Parts, division: Division, *, continuous: bool):
        """Look for polynomials.

        Args:
            enclosed: Encloses the datum on simplices with these corners, in these cells.
            parts: Where.
            division: Says which interpolants are good enough.
            continuous: Whether it is, for sure.
        """
        self._known = known = enclosed(parts.x, parts.cells)
        self._corners, self.sampled = parts.size, isinstance(known, _Samples)
        bounds = known.once()
        within = replace(
            bounds, lower=np.maximum(bounds.lower, parts.least), upper=np.minimum(bounds.upper, parts.most)
        )
        self.lower, self.upper = _defined(within)
        self.finite = np.isfinite(self.lower) & np.isfinite(self.upper)
        self.whole = bounds.whole
        self._found: list[tuple[int, np.ndarray, np.ndarray]] = []
        constant = self.finite & (self.upper == self.lower) & (not self.sampled)
        self.rest, self.steep = self._half(), np.where(constant, 0.0, np.inf)
        smooth = bounds.whole & self.finite
        exact = smooth & (bounds.degree <= polynomials.MAX_DEGREE)
        for degree in np.unique(bounds.degree[exact]):
            rows = np.flatnonzero(exact & (bounds.degree == degree))
            self._interpolate(int(degree), rows, np.zeros(len(rows)), np.zeros(len(rows)))
        if (smooth & ~exact).any():
            self._smooth(np.flatnonzero(smooth & ~exact), bounds, enclosed, parts, division)
        others = self.finite & ~exact & (self.upper > self.lower)
        for _, chosen, _ in self._found:
            others[chosen] = False
        cut = np.flatnonzero(others)
        if len(cut):
            at_corners, rest, steep = known.linear(cut)
            near = rest < BETTER * self.rest[cut]
            self._take(1, cut[near], at_corners[near], rest[near], steep[near])
            far = cut[~near] if continuous else cut[~near & smooth[cut]]
            if len(far):
                self.steep[far] = bounds.derivative(1)[far]

    def _half(self) -> np.ndarray:
        return np.subtract(self.upper, self.lower, out=np.full(len(self.lower), np.inf), where=self.finite) / 2

    def _smooth(self, rows: np.ndarray, bounds: Bounds, enclosed: Enclose, parts: Parts, division: Division) -> None:
        """Interpolants of degree 2 where they are good enough, of degree 4 elsewhere."""
        x = parts.x if len(rows) == len(parts.x) else parts.x[rows]
        size = longest_edges(x)
        height = least_heights(x, size)
        good = np.zeros(len(rows), dtype=bool)
        if division.degree == 2:
            second, third = bounds.derivative(2)[rows], bounds.derivative(3)[rows]
            largest = np.maximum(np.abs(self.lower), np.abs(self.upper))[rows]
            near = np.flatnonzero(np.isfinite(second) & np.isfinite(third))
            enough = np.maximum(
                NEGLIGIBLE_CURVATURE * size[near] * second[near], NEGLIGIBLE_REMAINDER / division.length * largest[near]
            )
            good[near] = polynomials.REMAINDER[self._corners][2] * size[near] ** 2 * third[near] <= enough
            self._near(2, rows[good], third[good], size[good], height[good])
        far = ~good
        if far.any():
            there = enclosed(x[far], parts.cells[rows[far]]).once() if good.any() else bounds
            second, fifth = (there.derivative(k) if good.any() else there.derivative(k)[rows] for k in (2, 5))
            kept = np.ones(len(fifth), dtype=bool)
            if division.slopes:  # linear functions with nearly the gradient of the datum need no height
                kept = _steepness(self._corners, 4, size[far], height[far], fifth) <= 2 * size[far] * second
            chosen = np.flatnonzero(far)[kept]
            self._near(4, rows[chosen], fifth[kept], size[chosen], height[chosen])

    def _near(self, degree: int, rows: np.ndarray, bound: np.ndarray, size: np.ndarray, height: np.ndarray) -> None:
        """Let interpolants stand for the datum where they are nearer than the middle of its bounds.

        Args:
            degree: Of the interpolants.
            rows: Parts.
            bound: There of the derivative of the next order.
            size: Of the longest edge.
            height: The least one; thin parts may have none, up to round-off.
        """
        rest = polynomials.REMAINDER[self._corners][degree] * _scale(degree, size, bound)
        steep = _steepness(self._corners, degree, size, height, bound)
        better = rest < self.rest[rows]
        self._interpolate(degree, rows[better], rest[better], steep[better])

    def _interpolate(self, degree: int, chosen: np.ndarray, rest: np.ndarray, steep: np.ndarray) -> None:
        """Let interpolants of a degree stand for the datum on some parts."""
        if len(chosen):
            values = self._known.values(degree, chosen)
            coefficients = polynomials.coefficients(values, self._corners, degree)
            margin = polynomials.round_off(values, self._corners, degree)
            self._take(degree, chosen, coefficients, rest, steep, margin)

    def _take(
        self, degree: int, chosen: np.ndarray, coefficients: np.ndarray, rest: np.ndarray, steep: np.ndarray,
        margin: np.ndarray | float = 0.0,
    ) -> None:  # fmt: skip
        """Let polynomials stand for the datum on some parts."""
        self.rest[chosen], self.steep[chosen] = rest, steep
        allowance = rest + margin
        self.lower[chosen] = np.maximum(self.lower[chosen], polynomials.row_min(coefficients) - allowance)
        self.upper[chosen] = np.minimum(self.upper[chosen], polynomials.row_max(coefficients) + allowance)
        self._found.append((degree, chosen, coefficients))

    def open(self, division: Division, parts: Parts) -> np.ndarray:
        """Which parts are to be divided if they may be."""
        size = np.maximum(np.abs(self.lower), np.abs(self.upper))
        far = ~self.whole | (self.rest > 2 * division.rough * self._half())
        if np.isfinite(division.length) and parts.inside is not None:
            dim = parts.size - 1
            h = (factorial(dim) * sizes(parts.x) / parts.share) ** (1 / dim)  # of the simplex, about
            far &= division.length * parts.share ** (1 / dim) * self.rest > THIN * h * size
        return ~self.finite | (far & (self.rest > NEGLIGIBLE * size))

    def divided(self, parts: Parts, chosen: np.ndarray) -> Parts:
        """Some parts divided: along the line where a condition changes, if one is known, or halved."""
        within = replace(parts[chosen], least=self.lower[chosen], most=self.upper[chosen])
        if not len(chosen):
            return within.halved()
        values, rest = self._known.cuts(chosen)
        levels = APART * rest
        line = levels < NARROW * np.ptp(values, axis=1)
        levels = np.where(levels <= EXACT * polynomials.row_size(values), 0.0, levels)
        return within[line].cut(values[line], levels[line]).and_(within[~line].halved())

    def polynomials(self, wanted: np.ndarray) -> Iterator[tuple[int, bool, np.ndarray, np.ndarray]]:
        """Degree, whether they are interpolants, parts and coefficients, of those that are wanted."""
        rest = wanted.copy()
        for degree, chosen, coefficients in self._found:
            rest[chosen] = False
            kept = wanted[chosen]
            yield degree, True, *((chosen, coefficients) if kept.all() else (chosen[kept], coefficients[kept]))
        chosen = np.flatnonzero(rest)
        middle, finite = np.zeros(len(chosen)), self.finite[chosen]
        middle[finite] = (self.lower[chosen[finite]] + self.upper[chosen[finite]]) / 2
        if len(infinite := np.flatnonzero(~finite)):
            values = self._known.values(0, chosen[infinite])[:, 0]
            middle[infinite] = np.where(np.isfinite(values), values, 0.0)
        yield 0, False, chosen, middle[:, None]


def _scale(degree: int, size: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """size^(degree + 1) times a bound of the derivative of that order, infinite where none is known."""
    return np.multiply(size ** (degree + 1), bound, out=np.full(len(size), np.inf), where=np.isfinite(bound))


def _steepness(corners: int, degree: int, size: np.ndarray, height: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Bound of the gradient of a datum minus its interpolant; the arguments are those of `_Near._near`."""
    steep = polynomials.STEEPNESS[corners][degree] * _scale(degree, size, bound)
    return np.divide(steep, height, out=np.full(len(steep), np.inf), where=height > 0)


class _Samples(Evaluated):
    """What samples show of a datum of which no bounds are known; of conditions they show nothing."""

    def once(self) -> Bounds:
        samples = self.values(self.degree, np.arange(len(self.corners)))
        whole = np.ptp(samples, axis=1) <= SHARP * np.abs(samples).max(axis=1, initial=0.0)
        lower, upper = samples.min(axis=1, initial=np.inf), samples.max(axis=1, initial=-np.inf)
        return Bounds(lower, upper, np.full(len(samples), self.degree), whole, np.isfinite(samples).all(axis=1))

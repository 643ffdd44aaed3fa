"""Interval arithmetic on arrays: bounds of each operation that a formula may use, rounded outward.

An enclosure holds bounds over many cells; numbers that are the same everywhere have arrays of shape (). An infinite
bound means that nothing finite is known. Single points (lower == upper) are not widened: they are what NumPy computes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, reduce
from math import pi
from operator import and_, or_
from typing import Any

import numpy as np

from fenicsx_obstacle.effects.field import NO_POLYNOMIAL, Bounds, Truth
from fenicsx_obstacle.scenes import derivative_bounds
from fenicsx_obstacle.scenes.derivative_bounds import NONE, Series, has_nan
from fenicsx_obstacle.scenes.formulas import NUMPY

MOST = 2.0**50  # of integers whose quotients are rounded across no integer
_ROUND_OFF = 8 * np.finfo(float).eps  # relative; mathematical libraries are right to a few units
_TINY = 1e-300
MARGIN = 1 + 1e-12  # for round-off in bounds of derivatives, sums and products of positive numbers


@dataclass(frozen=True)
class Enclosure(Bounds):
    """Bounds of a value over cells.

    Attributes:
        whole: Whether one expression without conditions gives it on the whole cell.
        defined: Whether no root or logarithm of a negative number can occur, nor a comparison with one.
        square: Of a root, what it is the root of.
    """

    square: Enclosure | None = None

    def derivative(self, k: int) -> np.ndarray:
        with np.errstate(all="ignore"):
            return super().derivative(k) * MARGIN

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        return self.lower, self.upper, self.degree, self.whole, self.defined

    @property
    def is_number(self) -> bool:
        """Whether it is one number, the same everywhere."""
        return self.lower.ndim == 0 and bool(self.lower == self.upper)

    def cut(self, where: np.ndarray) -> Enclosure:
        """The same enclosure, marked as cut by a condition on some cells."""
        return replace(self, whole=self.whole & ~where)

    def clipped(self, least: Any, most: Any) -> Enclosure:
        """The same enclosure, intersected with other bounds."""
        return replace(self, lower=np.maximum(self.lower, least), upper=np.minimum(self.upper, most))

    def inheriting(self, other: Enclosure) -> Enclosure:
        """The same enclosure, whole and defined only where another one is."""
        return replace(self, whole=self.whole & other.whole, defined=self.defined & other.defined)


def of_bounds(lower: Any, upper: Any, degree: Any, slopes: Series = NONE) -> Enclosure:
    """Bounds as they are."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    return Enclosure(lower, upper, np.asarray(degree), np.asarray(True), np.asarray(True), slopes)


def constant(value: float) -> Enclosure:
    return of_bounds(value, value, 0)


def _made(lower: Any, upper: Any, degree: Any, *parents: Enclosure, slopes: Series, defined: Any = True) -> Enclosure:
    """Rounded outward, but where parents are single points, and 0 and infinity; what is not a number bounds nothing."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    point = lower == upper
    if point.any():
        point &= reduce(and_, (p.lower == p.upper for p in parents)) | (lower == 0) | np.isinf(lower)
    below, above = np.subtract(lower, _rounding(lower)), np.add(upper, _rounding(upper))
    if point.any() or lower.shape != upper.shape:
        below, above = np.where(point, lower, below), np.where(point, upper, above)
    below, above = _known(below, -np.inf), _known(above, np.inf)
    whole, known = _all([p.whole for p in parents]), _all([*(p.defined for p in parents), np.asarray(defined)])
    return Enclosure(below, above, np.minimum(degree, NO_POLYNOMIAL), whole, known, slopes)


def _rounding(values: np.ndarray) -> np.ndarray:
    """A bound of the round-off of one operation."""
    rounding = np.asarray(np.abs(values))
    rounding *= _ROUND_OFF
    rounding += _TINY
    return rounding


def _known(values: np.ndarray, otherwise: float) -> np.ndarray:
    """The same array with a given number in place of not-a-number."""
    return np.where(np.isnan(values), otherwise, values) if has_nan(values) else values


def _all(conditions: list[np.ndarray]) -> np.ndarray:
    """Where all of them hold; those that are one truth everywhere cost nothing."""
    found = conditions[0]
    for condition in conditions[1:]:
        if condition is not found and not (condition.ndim == 0 and condition):
            found = condition if found.ndim == 0 and found else found & condition
    return found


def widened(a: Enclosure) -> Enclosure:
    """With rounding for the round-off of one operation at single points too."""
    return replace(a, lower=a.lower - _ROUND_OFF * np.abs(a.lower), upper=a.upper + _ROUND_OFF * np.abs(a.upper))


def whole_numbers(a: Enclosure) -> np.ndarray:
    """Whether it is one integer, so small that a quotient of two such is rounded across none."""
    return (a.lower == a.upper) & (np.floor(a.lower) == a.lower) & (np.abs(a.lower) < MOST)


def _degree(*parents: Enclosure) -> np.ndarray:
    """Degree of a function that is not a polynomial; 0 if the argument is a number."""
    return np.where(_all([p.degree == 0 for p in parents]), 0, NO_POLYNOMIAL)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """0 times an infinite bound is 0."""
    found = np.asarray(a * b)
    return np.where(np.isnan(found) & ((a == 0) | (b == 0)), 0.0, found) if has_nan(found) else found


def negative(a: Enclosure) -> Enclosure:
    return replace(a, lower=-a.upper, upper=-a.lower)


def add(a: Enclosure, b: Enclosure) -> Enclosure:
    both = derivative_bounds.plus(a.slopes, b.slopes)
    return _made(a.lower + b.lower, a.upper + b.upper, np.maximum(a.degree, b.degree), a, b, slopes=both)


def multiply(a: Enclosure, b: Enclosure) -> Enclosure:
    if a.is_number:
        a, b = b, a
    if b.is_number:
        ends = [_product(a.lower, b.lower), _product(a.upper, b.lower)]
        low, high = ends if b.lower >= 0 else ends[::-1]
    else:
        ends = [_product(x, y) for x in (a.lower, a.upper) for y in (b.lower, b.upper)]
        low, high = (of(of(ends[0], ends[1]), of(ends[2], ends[3])) for of in (np.minimum, np.maximum))
    both = derivative_bounds.product(lambda: _largest(a), a.slopes, lambda: _largest(b), b.slopes)
    no_number = (_infinite(a) & (_smallest(b) == 0)) | (_infinite(b) & (_smallest(a) == 0))
    return _made(low, high, a.degree + b.degree, a, b, slopes=both, defined=~no_number)


def _infinite(a: Enclosure) -> np.ndarray:
    """Whether it is infinite everywhere."""
    return np.isinf(a.lower) & (a.lower == a.upper)


def _largest(a: Enclosure) -> np.ndarray:
    """The largest absolute value."""
    return np.maximum(np.abs(a.lower), np.abs(a.upper))


def _smallest(a: Enclosure) -> np.ndarray:
    """The smallest absolute value."""
    return np.where((a.lower <= 0) & (a.upper >= 0), 0.0, np.minimum(np.abs(a.lower), np.abs(a.upper)))


def _through(a: Enclosure, outer: Series) -> Series:
    """Bounds of derivatives of a function of a."""
    return derivative_bounds.composed(a.slopes, outer)


def _inverse(b: Enclosure) -> Enclosure:
    """Infinite where the divisor may be 0; of either sign where it may be 0, or -0, on a part of the cell."""
    lower, upper = 1 / b.upper, 1 / b.lower
    within = (b.lower < 0) & (b.upper > 0) | ((b.lower <= 0) & (b.upper >= 0) & ~b.whole)
    zero = (b.lower == 0) & (b.upper == 0)
    lower = np.where(within | zero | (b.upper == 0), -np.inf, lower)
    upper = np.where(within | zero | (b.lower == 0), np.inf, upper)
    outer = _through(b, derivative_bounds.of_inverse(b.lower, b.upper))
    return _beside_poles(_made(lower, upper, _degree(b), b, slopes=outer, defined=~zero), b)


def divide(a: Enclosure, b: Enclosure) -> Enclosure:
    found = multiply(a, _inverse(b))
    point = (a.lower == a.upper) & (b.lower == b.upper) & (b.lower != 0)
    lower = np.where(point, a.lower / b.lower, found.lower)  # as NumPy divides
    upper = np.where(point, lower, found.upper)
    no_number = (a.lower == 0) & (a.upper == 0) & (b.lower <= 0) & (b.upper >= 0)  # 0/0 is possible
    return replace(found, lower=np.where(no_number, -np.inf, lower), upper=np.where(no_number, np.inf, upper))


def power(a: Enclosure, n: int) -> Enclosure:
    """A whole power, n >= 0."""
    if n == 0:
        return of_bounds(np.ones_like(a.lower), np.ones_like(a.lower), 0).inheriting(a)
    if n % 2 == 0 and a.square is not None and not np.any(a.lower == a.upper):
        return power(a.square, n // 2).inheriting(a)
    low, high = a.lower**n, a.upper**n
    if n % 2 == 0:
        low, high = np.minimum(low, high), np.maximum(low, high)
        low = np.where((a.lower <= 0) & (a.upper >= 0), 0.0, low)
    return _made(
        low, high, a.degree * n, a, slopes=_through(a, derivative_bounds.of_whole_power(n, lambda: _largest(a)))
    )


def raised(a: Enclosure, b: Enclosure) -> Enclosure:
    """a^b."""
    if not b.is_number:
        return exp(multiply(b, log(a)))
    exponent = float(b.lower)
    found, point = _raised(a, exponent), a.lower == a.upper
    if not point.any():
        return found
    value = NUMPY["^"](a.lower, exponent)
    exact = point & np.isfinite(value)
    return replace(found, lower=np.where(exact, value, found.lower), upper=np.where(exact, value, found.upper))


def _raised(a: Enclosure, exponent: float) -> Enclosure:
    if abs(exponent) <= 1e6 and exponent == round(exponent):
        n = int(exponent)
        return power(a, n) if n >= 0 else _inverse(power(a, -n))
    defined = a.lower >= _least(a)
    low, high = (np.maximum(end, 0.0) ** abs(exponent) for end in (a.lower, a.upper))
    found = _made(low, high, _degree(a), a, slopes=NONE, defined=defined)
    outer = _through(a, derivative_bounds.of_power(exponent, a.lower, a.upper))
    return replace(found if exponent > 0 else _inverse(found), slopes=outer)


def _least(a: Enclosure) -> np.ndarray:
    """The round-off below 0 that is accepted in an argument that must not be negative."""
    return -1e-12 * np.where(np.isfinite(a.upper), np.abs(a.upper), 1.0)


def _beside_poles(found: Enclosure, *parts: Enclosure) -> Enclosure:
    """The same enclosure, cut where it is finite and what it is made of is not: it may jump at a pole."""
    infinite = reduce(or_, (np.isinf(part.lower) | np.isinf(part.upper) for part in parts))
    if not infinite.any():
        return found
    beside, slopes = infinite & found.finite, found.slopes
    steep = cache(lambda k: np.where(beside, np.inf, slopes(k)))
    return replace(found.cut(beside), slopes=steep)


def _outer(name: str, a: Enclosure) -> Series:
    """Bounds of derivatives of a function of a, by its name."""
    return _through(a, derivative_bounds.BOUNDS[name](a.lower, a.upper))


def _monotone(name: str, f: Callable[[np.ndarray], np.ndarray]) -> Callable[[Enclosure], Enclosure]:
    return lambda a: _beside_poles(_made(f(a.lower), f(a.upper), _degree(a), a, slopes=_outer(name, a)), a)


def sqrt(a: Enclosure) -> Enclosure:
    low, high = (np.sqrt(np.maximum(end, 0.0)) for end in (a.lower, a.upper))
    found = _made(low, high, _degree(a), a, slopes=_outer("sqrt", a), defined=a.lower >= _least(a))
    return replace(found, square=a)


def log(a: Enclosure) -> Enclosure:
    low, high = (np.log(np.maximum(end, 0.0)) for end in (a.lower, a.upper))
    return _made(low, high, _degree(a), a, slopes=_outer("log", a), defined=a.lower >= _least(a))


def log10(a: Enclosure) -> Enclosure:
    found = divide(log(a), constant(float(np.log(10.0))))
    low, high = (np.log10(np.maximum(end, 0.0)) for end in (a.lower, a.upper))
    point = a.lower == a.upper  # as NumPy has it
    return replace(found, lower=np.where(point, low, found.lower), upper=np.where(point, high, found.upper))


exp, sinh, tanh, atan = (
    _monotone(name, f) for name, f in (("exp", np.exp), ("sinh", np.sinh), ("tanh", np.tanh), ("atan", np.arctan))
)


def cosh(a: Enclosure) -> Enclosure:
    low, high = np.cosh(a.lower), np.cosh(a.upper)
    least = np.where((a.lower <= 0) & (a.upper >= 0), 1.0, np.minimum(low, high))
    return _made(least, np.maximum(low, high), _degree(a), a, slopes=_outer("cosh", a))


def cos(a: Enclosure) -> Enclosure:
    """Its extrema are at multiples of pi."""
    low, high = np.cos(a.lower), np.cos(a.upper)
    margin = 1e-15 * np.maximum(np.abs(a.lower), np.abs(a.upper)) + 1e-15
    start, end = (a.lower - margin) / pi, (a.upper + margin) / pi
    point = a.lower == a.upper
    large = ~(np.maximum(np.abs(start), np.abs(end)) < 1e14)
    even = (2 * np.floor(end / 2) >= start) | large
    odd = (2 * np.floor((end - 1) / 2) + 1 >= start) | large
    least = np.where(odd & ~point, -1.0, np.minimum(low, high))
    most = np.where(even & ~point, 1.0, np.maximum(low, high))
    return _beside_poles(_made(least, most, _degree(a), a, slopes=_outer("sin", a)).clipped(-1.0, 1.0), a)


def sin(a: Enclosure) -> Enclosure:
    found = cos(of_bounds(a.lower - pi / 2, a.upper - pi / 2, a.degree, a.slopes).inheriting(a))
    pad = 4e-16 * (np.abs(a.lower) + np.abs(a.upper) + 2)  # of the shift
    lower, upper = np.maximum(found.lower - pad, -1.0), np.minimum(found.upper + pad, 1.0)
    point = a.lower == a.upper
    if point.any():
        lower = np.where(point, np.sin(a.lower), lower)
        upper = np.where(point, lower, upper)
    return replace(found, lower=lower, upper=upper)


def tan(a: Enclosure) -> Enclosure:
    turns = [np.floor(end / pi + 0.5) for end in (a.lower, a.upper)]
    margin = 1e-14 * (1 + np.maximum(np.abs(a.lower), np.abs(a.upper)))
    away = [np.abs(end / pi + 0.5 - np.round(end / pi + 0.5)) * pi > margin for end in (a.lower, a.upper)]
    regular = (turns[0] == turns[1]) & away[0] & away[1]
    lower, upper = np.where(regular, np.tan(a.lower), -np.inf), np.where(regular, np.tan(a.upper), np.inf)

    def outer(k: int) -> np.ndarray:
        return np.where(regular, derivative_bounds.BOUNDS["tan"](a.lower, a.upper)(k), np.inf)

    return _made(lower, upper, _degree(a), a, slopes=_through(a, outer))


def _inside(a: Enclosure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arguments of asin and acos."""
    defined = (a.lower >= -1 - 1e-12) & (a.upper <= 1 + 1e-12)
    return np.clip(a.lower, -1, 1), np.clip(a.upper, -1, 1), defined


def asin(a: Enclosure) -> Enclosure:
    low, high, defined = _inside(a)
    return _made(np.arcsin(low), np.arcsin(high), _degree(a), a, slopes=_outer("asin", a), defined=defined)


def acos(a: Enclosure) -> Enclosure:
    low, high, defined = _inside(a)
    return _made(np.arccos(high), np.arccos(low), _degree(a), a, slopes=_outer("acos", a), defined=defined)


def hypot(a: Enclosure, b: Enclosure) -> Enclosure:
    root = sqrt(add(power(a, 2), power(b, 2)))
    # the squares may be too large or too small for a number
    least, most = (np.hypot(size(a), size(b)) for size in (_smallest, _largest))
    return replace(_made(least, most, root.degree, a, b, slopes=root.slopes), square=root.square)


def distance(root: Enclosure) -> Enclosure:
    """The root of a sum of squares that is the distance from a point: its derivatives are known better."""
    assert root.square is not None
    square = replace(root.square, slopes=cache(lambda k: 2 * root.upper if k == 1 else float(k == 2)))
    return replace(root, slopes=derivative_bounds.radius(np.maximum(root.lower, 0.0)), square=square)


def atan2(y: Enclosure, x: Enclosure) -> Enclosure:
    """It jumps across the negative x-axis, which counts as a condition; on one side of it, the axis included, it does
    not, unless y is 0 on a part of the cell, as min(y, 0)."""
    corners = [(v, u) for v in (y.lower, y.upper) for u in (x.lower, x.upper)]
    size = _largest(y)
    margin = 1e-12 * np.where(np.isfinite(size) & (y.degree <= 1) & y.whole, size, 0.0)
    across = (x.lower < 0) & (y.lower < -margin) & ((y.upper > margin) | ((y.upper >= 0) & ~y.whole))
    above, below = (x.lower < 0) & (y.lower >= -margin), (x.lower < 0) & (y.lower < -margin) & ~across
    angles = []
    for v, u in corners:
        v = np.where(below, np.minimum(v, -0.0), np.where(above, np.maximum(v, 0.0) + 0.0, v))
        turn = np.arctan2(v, u)
        angles.append(np.where(below & (turn == pi), -pi, turn))
    origin = (x.lower <= 0) & (x.upper >= 0) & (y.lower <= 0) & (y.upper >= 0)
    low, high = np.minimum.reduce(angles), np.maximum.reduce(angles)
    low = np.where(across | origin, np.where(y.lower >= -margin, 0.0, -pi), low)
    high = np.where(across | origin, np.where((y.upper <= margin) & (y.lower < -margin) & ~across, 0.0, pi), high)
    turning = derivative_bounds.angle(np.hypot(_smallest(x), _smallest(y)), x.slopes, y.slopes)
    through = origin & ((y.lower == y.upper) | (x.lower == x.upper))  # along an axis it jumps at the origin
    nowhere = (y.lower == y.upper) & (x.lower == x.upper) & origin  # the origin alone: no angle
    return _made(low, high, _degree(y, x), y, x, slopes=turning, defined=~nowhere).cut(across | through)


def absolute(a: Enclosure, up: np.ndarray, down: np.ndarray) -> Enclosure:
    """|a|.

    Args:
        a: The argument.
        up: Whether it may be positive.
        down: Whether it may be negative.
    """
    return replace(a, lower=_smallest(a), upper=_largest(a)).cut(up & down)


def extreme(name: str, a: Enclosure, b: Enclosure, above: np.ndarray, below: np.ndarray) -> Enclosure:
    """Minimum or maximum of two values.

    Args:
        name: min or max.
        a: The first.
        b: The second.
        above: Whether a may be above b.
        below: Whether a may be below b.
    """
    of = np.minimum if name == "min" else np.maximum
    first, second = (below, above) if name == "min" else (above, below)  # where a, and where b, may be the result
    picked = chosen(Truth(first | ~second, second), a, b)
    # it is not a number where one of the two is none, even where that one would not be the result
    bounds = of(a.lower, b.lower), of(a.upper, b.upper)
    return _beside_poles(replace(picked, lower=bounds[0], upper=bounds[1], defined=a.defined & b.defined), a, b)


def chosen(truth: Truth, yes: Enclosure, no: Enclosure) -> Enclosure:
    """`yes` where a condition holds, `no` where it fails, the hull where it may do both."""
    may_hold, may_fail = truth.may_hold, truth.may_fail
    both = may_hold & may_fail
    shared = [np.where(may_hold, a, b) for a, b in zip(yes.parts, no.parts, strict=True)]
    lower = np.where(both, np.minimum(yes.lower, no.lower), shared[0])
    upper = np.where(both, np.maximum(yes.upper, no.upper), shared[1])
    either = derivative_bounds.either(may_hold, may_fail, yes.slopes, no.slopes)
    # a condition that is undecided guards its branches against roots of negative numbers
    defined = (shared[4].astype(bool) | both) & truth.defined
    return Enclosure(lower, upper, shared[2], shared[3].astype(bool) & ~both, defined, either)


Rule = Callable[[Enclosure, Enclosure], Enclosure]
FUNCTIONS: dict[str, Callable[..., Enclosure]] = {
    "sin": sin, "cos": cos, "tan": tan, "asin": asin, "acos": acos, "atan": atan, "atan2": atan2, "sinh": sinh,
    "cosh": cosh, "tanh": tanh, "exp": exp, "ln": log, "log": log, "log10": log10, "sqrt": sqrt, "hypot": hypot,
}  # fmt: skip

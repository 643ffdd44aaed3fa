"""Bounds of derivatives up to order 5, for interval arithmetic.

Of a value f on each cell they are numbers f_k >= |D^k f(e, .., e)|/k!, k = 1 .. ORDER, for all unit vectors e and all
places in the cell. By Banach's theorem on symmetric forms f_k bounds the form for different vectors too, so that sums,
products and compositions are those of power series with these coefficients. Each order is computed when it is first
asked for: polynomials need none, most cells need three. A plain 0.0 is what is known to be zero: it costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from math import comb, factorial, prod
from typing import Any

import numpy as np
from numpy.polynomial import polynomial

ORDER = 5
Series = Callable[[int], Any]  # the bound of order k = 1 .. ORDER, divided by k!; of values each is found once

NONE: Series = cache(lambda k: 0.0)
COORDINATE: Series = cache(lambda k: 1.0 if k == 1 else 0.0)


def plus(f: Series, g: Series) -> Series:
    """Derivative bounds of f + g and f - g."""
    if f is NONE or g is NONE:
        return g if f is NONE else f
    return cache(lambda k: _sum((f(k), g(k))))


def product(f0: Callable[[], Any], f: Series, g0: Callable[[], Any], g: Series) -> Series:
    """Derivative bounds of f g; f0 and g0 return the largest absolute values of f and g."""
    if f is NONE and g is NONE:
        return NONE

    def find(k: int) -> Any:
        inside = [_times(f(j), g(k - j)) for j in range(1, k)]
        ends = [_times(size(), slope) for size, last in ((f0, g), (g0, f)) if not _is_zero(slope := last(k))]
        return _sum((*ends, *inside))

    return cache(find)


def composed(f: Series, outer: Series) -> Series:
    """Derivative bounds of p(f); outer returns those of p on the values of f, divided by factorials."""
    # of (f_1 t + f_2 t^2 + ..)^j the coefficient of t^k
    powers, outer = {1: f}, cache(outer)
    for j in range(2, ORDER + 1):
        powers[j] = _power(f, powers[j - 1], j)

    def find(k: int) -> Any:
        inner = [(j, powers[j](k)) for j in range(1, k + 1)]
        return _sum(_times(outer(j), power) for j, power in inner if not _is_zero(power))

    return NONE if f is NONE else cache(find)


def _power(f: Series, before: Series, j: int) -> Series:
    """Coefficients of the j-th power of a power series from those of the (j - 1)-th power."""
    return cache(lambda k: _sum(_times(before(k - i), f(i)) for i in range(1, k - j + 2)))


def radius(least: Any) -> Series:
    """Derivative bounds of |x|, from its least value.

    |x + t e| = |x| sum_k c_k (t/|x|)^k, c_k = (P_(k-2) - P_k)/(2 k - 1) of the cosine between e and x, P_k Legendre's.
    """
    factors = (1.0, 0.5, 0.1925, 0.125, 0.0824)
    return cache(lambda k: factors[k - 1] * _negative_power(least, k - 1))


def angle(least: Any, x: Series, y: Series) -> Series:
    """Derivative bounds of the angle of (x, y), from the least |(x, y)|: order k is at most (k - 1)!/|(x, y)|^k."""
    return composed(cache(lambda k: np.hypot(x(k), y(k))), turn(least))


def turn(least: Any) -> Series:
    """Derivative bounds of the angle as a function of the point."""
    return cache(lambda k: _negative_power(least, k) / k)


def either(may_hold: Any, may_fail: Any, yes: Series, no: Series) -> Series:
    """Derivative bounds of `where`; the larger ones if the condition is undecided."""
    if yes is NONE and no is NONE:
        return NONE
    return cache(lambda k: np.maximum(np.where(may_hold, yes(k), 0.0), np.where(may_fail, no(k), 0.0)))


def _is_zero(a: Any) -> bool:
    """Whether it is known to be 0."""
    return getattr(a, "ndim", 0) == 0 and bool(a == 0)


def _sum(parts: Iterable[Any]) -> Any:
    found: Any = 0.0
    for part in parts:
        found = part if _is_zero(found) else found + part
    return found


def _times(a: Any, b: Any) -> Any:
    """0 times infinity is 0 where the 0 is known to be exact, infinity elsewhere."""
    if _is_zero(a) or _is_zero(b):
        return 0.0
    found = np.asarray(a * b)
    return np.where(np.isnan(found), np.inf, found) if has_nan(found) else found


def has_nan(values: np.ndarray) -> bool:
    """Whether one of the values is no number: their least one is none then, which takes one pass and no memory."""
    return bool(np.isnan(values.min(initial=0.0)))


def _negative_power(least: Any, k: int) -> Any:
    return 1 / least**k if k else 1.0


# bounds of derivatives of functions on [low, high], divided by factorials; s is the largest absolute argument
def of_power(p: float, low: Any, high: Any) -> Series:
    """Derivative bounds of t^p for t >= 0 and p that is not a whole number >= 0."""
    return lambda k: prod(abs(p - i) / (i + 1) for i in range(k)) * np.maximum(low if p < k else high, 0.0) ** (p - k)


def of_whole_power(n: int, s: Callable[[], Any]) -> Series:
    """Derivative bounds of t^n for n >= 0 and |t| <= s."""
    return lambda k: comb(n, k) * s() ** (n - k) if k < n else float(k == n)


def of_inverse(low: Any, high: Any) -> Series:
    """Derivative bounds of 1/t."""
    return lambda k: 1 / np.where((low <= 0) & (high >= 0), 0.0, np.minimum(np.abs(low), np.abs(high))) ** (k + 1)


def _size(low: Any, high: Any) -> Any:
    return np.maximum(np.abs(low), np.abs(high))


def _of_log(low: Any, high: Any) -> Series:
    return lambda k: 1 / (k * np.maximum(low, 0.0) ** k)


def _of_sinh(low: Any, high: Any) -> Series:
    """Derivative bounds of sinh and cosh."""
    return lambda k: np.cosh(_size(low, high)) / factorial(k)


def _of_tan(low: Any, high: Any) -> Series:
    """Where it has no pole: each derivative is a polynomial in tan with coefficients >= 0, tan' = 1 + tan^2."""
    first = [1.0, 0.0, 1.0]

    def find(k: int) -> Any:
        derivative = np.array(first)
        for _ in range(k - 1):
            derivative = polynomial.polymul(polynomial.polyder(derivative), first)
        return polynomial.polyval(_size(np.tan(low), np.tan(high)), derivative) / factorial(k)

    return find


def _of_asin(low: Any, high: Any) -> Series:
    """Derivative bounds of asin and acos, which grow with |t|."""
    numerators = ((1.0,), (0.0, 1.0), (1.0, 0.0, 2.0), (0.0, 9.0, 0.0, 6.0), (9.0, 0.0, 72.0, 0.0, 24.0))

    def find(k: int) -> Any:
        s = np.minimum(_size(low, high), 1.0)
        return polynomial.polyval(s, numerators[k - 1]) * (1 - s**2) ** (0.5 - k) / factorial(k)

    return find


BOUNDS: dict[str, Callable[[Any, Any], Series]] = {
    "exp": lambda low, high: lambda k: np.exp(high) / factorial(k), "log": _of_log,
    "sqrt": lambda low, high: of_power(0.5, low, high), "sinh": _of_sinh, "cosh": _of_sinh, "tan": _of_tan,
    "asin": _of_asin, "acos": _of_asin, "sin": lambda low, high: lambda k: 1 / factorial(k),
    "tanh": lambda low, high: lambda k: (1.0, 0.77, 2.0, 4.1, 16.0)[k - 1] / factorial(k),
    "atan": lambda low, high: lambda k: 1 / k,
}  # fmt: skip

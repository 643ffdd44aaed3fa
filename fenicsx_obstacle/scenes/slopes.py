"""Bounds of derivatives, beside interval arithmetic.

Of a value f on each cell they are numbers f_k >= |D^k f(e, .., e)|/k!, k = 1 .. ORDER, for all unit vectors e and all
places in the cell. By Banach's theorem on symmetric forms f_k bounds the form for different vectors too, so that sums,
products and compositions are those of power series with these coefficients. They are computed when they are asked for,
as polynomials need none. A plain 0.0 is what is known to be zero: it costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from math import comb, factorial
from typing import Any

import numpy as np
from numpy.polynomial import polynomial

ORDER = 5
Orders = tuple[Any, ...]


class Slopes:
    """Bounds of the derivatives of one value, found when they are first asked for."""

    def __init__(self, find: Callable[[], Orders]):
        self._find = find

    @cached_property
    def orders(self) -> Orders:
        """One of each order, from the first on."""
        return self._find()


NONE = Slopes(lambda: (0.0,) * ORDER)
COORDINATE = Slopes(lambda: (1.0, *NONE.orders[1:]))


def plus(f: Slopes, g: Slopes) -> Slopes:
    """Of f + g and f - g."""
    if f is NONE or g is NONE:
        return g if f is NONE else f
    return Slopes(lambda: tuple(_sum(pair) for pair in zip(f.orders, g.orders, strict=True)))


def product(f0: Callable[[], Any], f: Slopes, g0: Callable[[], Any], g: Slopes) -> Slopes:
    """Of f g, f0 and g0 giving the largest absolute values."""
    if f is NONE and g is NONE:
        return NONE

    def find() -> Orders:
        first, second = (f0(), *f.orders), (g0(), *g.orders)
        return tuple(_sum(_times(first[j], second[k - j]) for j in range(k + 1)) for k in range(1, ORDER + 1))

    return Slopes(find)


def composed(f: Slopes, outer: Callable[[], Orders]) -> Slopes:
    """Of p(f); outer gives bounds of the derivatives of p on the values of f, divided by factorials too."""

    def find() -> Orders:
        factors, found = outer(), list(NONE.orders)
        power = f.orders  # coefficients of (f_1 t + f_2 t^2 + ..)^j, from t^1 on
        for j in range(1, ORDER + 1):
            if j > 1:
                shifted = [_sum(_times(power[i], f.orders[k - i - 1]) for i in range(k)) for k in range(1, ORDER)]
                power = (0.0, *shifted)
            found = [_sum((a, _times(factors[j - 1], b))) for a, b in zip(found, power, strict=True)]
        return tuple(found)

    return NONE if f is NONE else Slopes(find)


def radius(least: Any) -> Slopes:
    """Of |x|, from its least value.

    |x + t e| = |x| sum_k c_k (t/|x|)^k, c_k = (P_(k-2) - P_k)/(2 k - 1) of the cosine between e and x, P_k Legendre's.
    """
    factors = (1.0, 0.5, 0.1925, 0.125, 0.0824)
    return Slopes(lambda: tuple(c * _negative_power(least, k) for k, c in enumerate(factors)))


def angle(least: Any, x: Slopes, y: Slopes) -> Slopes:
    """Of the angle of (x, y), from the least |(x, y)|: it is harmonic, of order k at most (k - 1)!/|(x, y)|^k."""
    both = Slopes(lambda: tuple(np.hypot(a, b) for a, b in zip(x.orders, y.orders, strict=True)))
    return composed(both, lambda: turn(least).orders)


def turn(least: Any) -> Slopes:
    """Of the angle as a function of the point."""
    return Slopes(lambda: tuple(_negative_power(least, k) / k for k in range(1, ORDER + 1)))


def either(may_hold: Any, may_fail: Any, yes: Slopes, no: Slopes) -> Slopes:
    """Of what is chosen by a condition, the larger ones where it is undecided."""
    if yes is NONE and no is NONE:
        return NONE
    return Slopes(
        lambda: tuple(
            np.maximum(np.where(may_hold, a, 0.0), np.where(may_fail, b, 0.0))
            for a, b in zip(yes.orders, no.orders, strict=True)
        )
    )


def _sum(parts: Any) -> Any:
    found: Any = 0.0
    for part in parts:
        found = part if np.ndim(found) == 0 and found == 0 else found + part
    return found


def _times(a: Any, b: Any) -> Any:
    """0 times infinity is 0 where the 0 is known to be exact, infinity elsewhere."""
    if (np.ndim(a) == 0 and a == 0) or (np.ndim(b) == 0 and b == 0):
        return 0.0
    found = a * b
    return np.where(np.isnan(found), np.inf, found)


def _negative_power(least: Any, k: int) -> Any:
    return 1 / least**k if k else 1.0


# bounds of derivatives of functions on [low, high], divided by factorials; s is the largest absolute argument
def of_power(p: float, low: Any, high: Any) -> Orders:
    """Of t^p, t >= 0, p no whole number >= 0."""
    low, high, found, factor = np.maximum(low, 0.0), np.maximum(high, 0.0), [], 1.0
    for k in range(1, ORDER + 1):
        factor *= abs(p - k + 1) / k
        found.append(factor * (low if p < k else high) ** (p - k))
    return tuple(found)


def of_whole_power(n: int, s: Any) -> Orders:
    """Of t^n, n >= 0, |t| <= s."""
    return tuple(comb(n, k) * s ** (n - k) if k <= n else 0.0 for k in range(1, ORDER + 1))


def of_inverse(low: Any, high: Any) -> Orders:
    """Of 1/t."""
    least = np.where((low <= 0) & (high >= 0), 0.0, np.minimum(np.abs(low), np.abs(high)))
    return tuple(1 / least ** (k + 1) for k in range(1, ORDER + 1))


def _size(low: Any, high: Any) -> Any:
    return np.maximum(np.abs(low), np.abs(high))


def _by_factorials(*bounds: Any) -> Orders:
    return tuple(bound / factorial(k) for k, bound in enumerate(bounds, start=1))


def _of_log(low: Any, high: Any) -> Orders:
    low = np.maximum(low, 0.0)
    return tuple(1 / (k * low**k) for k in range(1, ORDER + 1))


def _of_sinh(low: Any, high: Any) -> Orders:
    """Of cosh too."""
    return _by_factorials(*[np.cosh(_size(low, high))] * ORDER)


def _of_tan(low: Any, high: Any) -> Orders:
    """Where it has no pole: each derivative is a polynomial in tan with coefficients >= 0, tan' = 1 + tan^2."""
    t, found = _size(np.tan(low), np.tan(high)), []
    derivative = np.array([1.0, 0.0, 1.0])
    for _ in range(ORDER):
        found.append(polynomial.polyval(t, derivative))
        derivative = polynomial.polymul(polynomial.polyder(derivative), [1.0, 0.0, 1.0])
    return _by_factorials(*found)


def _of_asin(low: Any, high: Any) -> Orders:
    """Of acos too: the derivatives of asin grow with |t|."""
    s = np.minimum(_size(low, high), 1.0)
    q = 1 - s**2
    return _by_factorials(q**-0.5, s * q**-1.5, (1 + 2 * s**2) * q**-2.5, (9 * s + 6 * s**3) * q**-3.5,
                          (9 + 72 * s**2 + 24 * s**4) * q**-4.5)  # fmt: skip


BOUNDS: dict[str, Callable[[Any, Any], Orders]] = {
    "exp": lambda low, high: _by_factorials(*[np.exp(high)] * ORDER), "log": _of_log,
    "sqrt": lambda low, high: of_power(0.5, low, high), "sinh": _of_sinh, "cosh": _of_sinh, "tan": _of_tan,
    "asin": _of_asin, "acos": _of_asin, "sin": lambda low, high: _by_factorials(*[1.0] * ORDER),
    "tanh": lambda low, high: _by_factorials(1.0, 0.77, 2.0, 4.1, 16.0),
    "atan": lambda low, high: tuple(1 / k for k in range(1, ORDER + 1)),
}  # fmt: skip

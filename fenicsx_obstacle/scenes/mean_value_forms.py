"""Enclosures of a formula in cells, by a walk through it and, where a condition changes, by mean value forms.

On a cell with the middle c a formula is within C + G (x - c), C and G intervals: G bounds the gradient of every branch
that may hold somewhere in the cell, C the values of these branches at c. Where branches meet smoothly G is narrow;
where they jump C is wide. Continuity is not assumed. Products and quotients take bounds over the whole cell for G: the
values at c would be enough for C + G (x - c), but not for the gradient.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Enclosed, Truth
from fenicsx_obstacle.scenes import intervals
from fenicsx_obstacle.scenes.formulas import BINARY, Formula, angle, is_condition
from fenicsx_obstacle.scenes.intervals import Enclosure, add, constant, divide, multiply, negative
from fenicsx_obstacle.scenes.tree_walk import Cells, TreeWalk
from fenicsx_obstacle.scenes.vocabulary import AXES, CONSTANTS

FEW = 2000  # cells, for which walking through a formula costs more than arithmetic
ZERO, ONE = constant(0.0), constant(1.0)
EITHER = intervals.of_bounds(-1.0, 1.0, 0)
UNKNOWN = intervals.of_bounds(-np.inf, np.inf, 0)


class OnCells(Enclosed):
    """One formula on cells."""

    def __init__(self, cells: Cells, formula: Formula):
        self.cells, self.formula = cells, formula

    @cached_property
    def _walk(self) -> TreeWalk:
        """It is kept, with all it finds."""
        return TreeWalk(self.cells, nearest_on)

    def once(self) -> Enclosure:
        with np.errstate(all="ignore"):
            found = self._walk.number(self.formula, self.formula.tree)
        lower, upper, degree, whole, defined = (np.broadcast_to(part, self.cells.count) for part in found.parts)
        return Enclosure(lower, upper, degree, whole, defined, found.slopes)

    def truth(self) -> Truth:
        with np.errstate(all="ignore"):
            return self._walk.condition(self.formula, self.formula.tree)

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return on_some(linear, self._walk, self.formula, cells)

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return on_some(lines, self._walk, self.formula, cells)

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        return self.cells.values(self.formula, degree, cells)


@dataclass(frozen=True)
class Form:
    """C + G (x - c) on each cell: enclosures of the branches' values at the middle and of their slopes."""

    value: Enclosure
    slopes: tuple[Enclosure, ...]  # one for each coordinate


def on_some(find: Callable[[TreeWalk, Formula], Any], walk: TreeWalk, formula: Formula, cells: np.ndarray) -> Any:
    """What a function finds by a walk, of some of its cells: by the same walk, which knows much of them already, unless
    it has many more."""
    if walk.cells.count <= FEW + 4 * len(cells):
        return tuple(part[cells] for part in find(walk, formula))
    return find(TreeWalk(walk.cells.of(cells), nearest_on), formula)


def linear(walk: TreeWalk, formula: Formula) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A linear function near a formula on each cell.

    Returns:
        Its values at the corners; bounds of its distance, and of the gradient of the difference.
    """
    with np.errstate(all="ignore"):
        return _at_corners(_Forms(walk).form(formula, formula.tree), walk.cells)


def lines(walk: TreeWalk, formula: Formula) -> tuple[np.ndarray, np.ndarray]:
    """Where a condition of a formula changes in cells, in the form of `effects.field.Enclosed.cuts`; of several
    conditions the one whose zero set is closest to a line."""
    cells = walk.cells
    found, rest = np.zeros((cells.count, cells.corners.shape[1])), np.full(cells.count, np.inf)
    with np.errstate(all="ignore"):
        walk.number(formula, formula.tree)
        for number, undecided in list(walk.undecided):
            values, away = nearest(walk, number)
            nearer = undecided & (away * np.ptp(found, axis=1) < rest * np.ptp(values, axis=1))
            nearer |= undecided & np.isinf(rest) & np.isfinite(away)
            found[nearer], rest[nearer] = values[nearer], away[nearer]
    return found, rest


def nearest_on(walk: TreeWalk, formula: Formula, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`nearest` on some of the cells."""
    return on_some(nearest, walk, formula, cells)


def nearest(walk: TreeWalk, formula: Formula) -> tuple[np.ndarray, np.ndarray]:
    """A linear function near a formula without conditions, and bounds: by `linear`, or the interpolant if that is
    closer."""
    values, rest, _ = linear(walk, formula)
    cells, x, corners = walk.cells, walk.cells.corners, walk.cells.corners.shape[1]
    if corners not in polynomials.REMAINDER:
        return values, rest
    edges = [x[:, i] - x[:, j] for i in range(corners) for j in range(i)]
    squares = np.max([(edge**2).sum(axis=1) for edge in edges], axis=0)
    away = polynomials.REMAINDER[corners][1] * squares * walk.number(formula, formula.tree).derivative(2)
    at_points = cells.values(formula, 1, np.arange(cells.count))
    away = away + polynomials.round_off(at_points, corners, 1)
    better = away < rest
    found = np.where(better[:, None], polynomials.coefficients(at_points, corners, 1), values)
    return found, np.where(better, away, rest)


def _at_corners(form: Form, cells: Cells) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The linear function given by the midpoints of the intervals of a form, and bounds as in `linear`."""
    value = _middle_and_width(form.value, cells.count)
    away = cells.corners - cells.corners.mean(axis=1, keepdims=True)
    at_corners, rest, square = np.repeat(value[0][:, None], away.shape[1], axis=1), value[1], np.zeros(cells.count)
    for axis, slope in enumerate(form.slopes):
        middle, width = _middle_and_width(slope, cells.count)
        at_corners = at_corners + middle[:, None] * away[..., axis]
        rest = rest + width * polynomials.row_size(away[..., axis])
        square = square + width**2
    size = polynomials.row_size(at_corners)
    return at_corners, rest + 1e-14 * size, np.sqrt(square)


def _middle_and_width(a: Enclosure, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Midpoint and half width, infinite where a bound is."""
    finite = np.broadcast_to(a.finite, count)
    lower, upper = (np.where(finite, bound, 0.0) for bound in (a.lower, a.upper))
    return (lower + upper) / 2, np.where(finite, (upper - lower) / 2, np.inf)


class _Forms:
    """One walk through a formula and the definitions it uses."""

    def __init__(self, walk: TreeWalk):
        self._walk, self._known, cells = walk, dict[str, Form](), walk.cells
        self._none = (ZERO,) * cells.corners.shape[2]
        self._middle = np.zeros((cells.count, 3))
        self._middle[:, : cells.corners.shape[2]] = cells.corners.mean(axis=1)

    def form(self, formula: Formula, node: ast.expr) -> Form:
        """The mean value form of a node; C is its enclosure and G is 0 if it is constant between jumps."""
        match node:
            case ast.Name(id=name):
                if name not in self._known:
                    self._known[name] = self._name(name)
                return self._known[name]
            case ast.BinOp(left=left, op=ast.Mod(), right=right):
                one, by = self.form(formula, left), self._walk.number(formula, right)
                slopes = [_hull(slope, ZERO) if by.is_number else UNKNOWN for slope in one.slopes]
                return Form(self._walk.number(formula, node), tuple(slopes))
            case ast.BinOp(left=left, op=op, right=right):
                return self._operation(formula, BINARY[type(op)], left, right)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                inner = self.form(formula, operand)
                return Form(negative(inner.value), tuple(negative(slope) for slope in inner.slopes))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.form(formula, operand)
            case ast.Call(func=ast.Name(id="where"), args=[test, yes, no]):
                truth, one, other = self._walk.condition(formula, test), self.form(formula, yes), self.form(formula, no)
                return self._pairwise(one, other, lambda a, b: intervals.chosen(truth, a, b))
            case ast.Call(func=ast.Name(id=name), args=args) if not is_condition(node):
                return self._call(formula, node, name, args)
        return Form(self._walk.number(formula, node), self._none)

    @staticmethod
    def _pairwise(one: Form, other: Form, rule: intervals.Rule) -> Form:
        slopes = [rule(a, b) for a, b in _pairs(one, other)]
        return Form(rule(one.value, other.value), tuple(slopes))

    def _name(self, name: str) -> Form:
        x, y, z = self._middle.T
        if name in CONSTANTS:
            return Form(constant(CONSTANTS[name]), self._none)
        if name in AXES:
            axis = AXES.index(name)
            return Form(_point(self._middle[:, axis]), self._along(*(ONE if axis == k else ZERO for k in range(3))))
        if name == "distance":
            return Form(self._walk.name(name), tuple(EITHER for _ in self._none))
        if name == "r":
            r = self._walk.name("r")
            along = (divide(self._walk.name(axis), r).clipped(-1.0, 1.0) for axis in AXES)
            return Form(_point(np.sqrt(x**2 + y**2 + z**2)), self._along(*along))
        if name == "theta":
            r = intervals.hypot(self._walk.name("x"), self._walk.name("y"))
            over_x, over_y = (divide(self._walk.name(axis), r).clipped(-1.0, 1.0) for axis in "xy")
            slopes = self._along(negative(divide(over_y, r)), divide(over_x, r), ZERO)
            return _unless_cut(self._walk.name(name), Form(_point(angle(y, x)), slopes))
        defined = self._walk.cells.vocabulary.define[name]
        return self.form(defined, defined.tree)

    def _along(self, *slopes: Enclosure) -> tuple[Enclosure, ...]:
        """The slopes along the coordinates of the cells."""
        return slopes[: len(self._none)]

    def _operation(self, formula: Formula, sign: str, left: ast.expr, right: ast.expr) -> Form:
        one, other = self.form(formula, left), self.form(formula, right)
        a, b = self._walk.number(formula, left), self._walk.number(formula, right)
        match sign:
            case "+":
                return self._pairwise(one, other, _sum)
            case "-":
                return self._pairwise(one, other, lambda p, q: _sum(p, negative(q)))
            case "*":
                # f g - C_f C_g = (f - C_f) g + C_f (g - C_g), and grad(f g) = g grad f + f grad g
                a = a if a.is_number else _hull(a, one.value)
                slopes = [_sum(_product(p, b), _product(a, q)) for p, q in _pairs(one, other)]
                return Form(multiply(one.value, other.value), tuple(slopes))
            case "/":
                # f/g - C_f/C_g = (f - C_f)/g - C_f (g - C_g)/(g C_g), and grad(f/g) = grad f/g - f grad g/g^2
                factor = divide(_hull(a, one.value), multiply(b, _hull(b, other.value)))
                slopes = [
                    _sum(_product(p, divide(ONE, b)), negative(_product(factor, q))) for p, q in _pairs(one, other)
                ]
                return Form(divide(one.value, other.value), tuple(slopes))
        if not b.is_number:
            power = self._walk.number(formula, ast.BinOp(left=left, op=ast.Pow(), right=right))
            return Form(power, tuple(UNKNOWN for _ in one.slopes))
        exponent = float(b.lower)
        outer = multiply(b, intervals.raised(a, constant(exponent - 1))) if exponent else ZERO
        return _through(one, intervals.raised(one.value, b), outer)

    def _call(self, formula: Formula, node: ast.Call, name: str, args: list[ast.expr]) -> Form:
        found = self._walk.number(formula, node)
        if name in ("sign", "floor"):
            return Form(found, self._none)
        forms, parts = [self.form(formula, arg) for arg in args], [self._walk.number(formula, arg) for arg in args]
        one, a = forms[0], parts[0]
        if name == "abs":
            up, down = a.upper > 0, a.lower < 0
            slope = intervals.chosen(Truth(up, down), ONE, constant(-1.0))
            return _through(one, intervals.absolute(one.value, up, down), slope)
        if name in ("min", "max"):
            for other, b in zip(forms[1:], parts[1:], strict=True):
                gap = add(a, negative(b))
                one = self._extreme(name, one, other, gap.upper > 0, gap.lower < 0)
                a = intervals.extreme(name, a, b, gap.upper > 0, gap.lower < 0)
            return one
        if name in ("atan2", "hypot"):
            return self._of_two(name, forms, parts, found)
        value = intervals.FUNCTIONS[name](one.value)
        return _through(one, value, DERIVATIVES[name](a, found))

    @staticmethod
    def _extreme(name: str, one: Form, other: Form, above: np.ndarray, below: np.ndarray) -> Form:
        """max(f + a, g + b) - max(f, g) is between a and b."""
        first, second = (below, above) if name == "min" else (above, below)
        truth = Truth(first | ~second, second)
        slopes = [intervals.chosen(truth, p, q) for p, q in _pairs(one, other)]
        return Form(intervals.extreme(name, one.value, other.value, above, below), tuple(slopes))

    @staticmethod
    def _of_two(name: str, forms: list[Form], parts: list[Enclosure], found: Enclosure) -> Form:
        (one, other), (a, b) = forms, parts
        if name == "hypot":
            weights = [divide(a, found).clipped(-1.0, 1.0), divide(b, found).clipped(-1.0, 1.0)]
            value = intervals.hypot(one.value, other.value)
        else:
            square = add(intervals.power(a, 2), intervals.power(b, 2))
            weights = [divide(b, square), negative(divide(a, square))]
            value = intervals.atan2(one.value, other.value)
        slopes = [_sum(_product(weights[0], p), _product(weights[1], q)) for p, q in _pairs(one, other)]
        form = Form(value, tuple(slopes))
        return form if name == "hypot" else _unless_cut(found, form)


def _point(values: np.ndarray) -> Enclosure:
    """Enclosure of numbers that are known up to round-off."""
    return add(intervals.of_bounds(values, values, 0), intervals.of_bounds(-1e-15, 1e-15, 0))


def _hull(a: Enclosure, b: Enclosure) -> Enclosure:
    """Bounds of both."""
    return replace(a, lower=np.minimum(a.lower, b.lower), upper=np.maximum(a.upper, b.upper))


def _unless_cut(found: Enclosure, form: Form) -> Form:
    """A form; where a cut runs through a cell C are the bounds over it, so that 0 belongs to G."""

    def either(of_whole: Enclosure, of_cut: Enclosure) -> Enclosure:
        lower = np.where(found.whole, of_whole.lower, of_cut.lower)
        return replace(of_whole, lower=lower, upper=np.where(found.whole, of_whole.upper, of_cut.upper))

    value = replace(either(form.value, found), defined=found.defined)
    return Form(value, tuple(either(slope, _hull(slope, ZERO)) for slope in form.slopes))


def _through(inner: Form, value: Enclosure, outer: Enclosure) -> Form:
    """Mean value form of a function with a derivative within given bounds."""
    return Form(value, tuple(_product(outer, slope) for slope in inner.slopes))


def _pairs(one: Form, other: Form) -> list[tuple[Enclosure, Enclosure]]:
    return list(zip(one.slopes, other.slopes, strict=True))


def _sum(a: Enclosure, b: Enclosure) -> Enclosure:
    """a + b, not computed if one of them is the number 0."""
    if _is_zero(a):
        return b
    return a if _is_zero(b) else add(a, b)


def _product(a: Enclosure, b: Enclosure) -> Enclosure:
    """a b, not computed if one of them is the number 0 and the other is defined."""
    if (_is_zero(a) and b.defined.all()) or (_is_zero(b) and a.defined.all()):
        return ZERO
    return multiply(a, b)


def _is_zero(a: Enclosure) -> bool:
    return a.is_number and not a.lower and bool(a.defined)


def _one_less(a: Enclosure) -> Enclosure:
    """1 - a^2."""
    return add(ONE, negative(intervals.power(a, 2)))


# derivatives from the bounds of the argument and of the value
DERIVATIVES: dict[str, intervals.Rule] = {
    "sin": lambda a, f: intervals.cos(a), "cos": lambda a, f: negative(intervals.sin(a)),
    "tan": lambda a, f: add(ONE, intervals.power(f, 2)), "exp": lambda a, f: f,
    "asin": lambda a, f: divide(ONE, intervals.sqrt(_one_less(a))),
    "acos": lambda a, f: negative(divide(ONE, intervals.sqrt(_one_less(a)))),
    "atan": lambda a, f: divide(ONE, add(ONE, intervals.power(a, 2))),
    "sinh": lambda a, f: intervals.cosh(a), "cosh": lambda a, f: intervals.sinh(a),
    "tanh": lambda a, f: _one_less(f), "sqrt": lambda a, f: divide(constant(0.5), f),
    "ln": lambda a, f: divide(ONE, a), "log": lambda a, f: divide(ONE, a),
    "log10": lambda a, f: divide(constant(1 / float(np.log(10.0))), a),
}  # fmt: skip

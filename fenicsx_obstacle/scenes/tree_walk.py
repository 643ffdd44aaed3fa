"""A formula's tree evaluated in interval arithmetic on many cells together.

Each value is a pair of arrays, its bounds over the bounding box of each cell, rounded outward. Each node also carries
its degree as a polynomial, whether it is one expression on the whole cell (no condition in it changes
there), and whether it is defined.

A condition that changes on the boundary of a cell alone, up to 1e-12 of the numbers that are compared, counts as
decided, if what remains is thin: less than 1e-6 of the width of the cell. Where intervals do not decide and the numbers
compared are polynomials, their Bernstein coefficients may.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from operator import and_

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import NO_POLYNOMIAL, Truth
from fenicsx_obstacle.scenes import derivative_bounds, intervals
from fenicsx_obstacle.scenes.formulas import BINARY, COMPARE, Formula, is_condition
from fenicsx_obstacle.scenes.intervals import Enclosure
from fenicsx_obstacle.scenes.vocabulary import AXES, CONSTANTS, COORDINATES, Vocabulary

MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
TOUCHING = 1e-12  # of the numbers compared
EQUAL = 1e-14  # of the numbers compared: they are the same all over a cell
THIN = 1e-7  # of the range of a function in a cell
UNDERFLOW = 1e-290  # interval arithmetic makes 0 a number of this size
POINTS = 30_000  # in which a formula is evaluated together: what is made of them fits into the cache of a core
Distance = Callable[[np.ndarray], np.ndarray]


class Cells:
    """Simplices, and the names that formulas on them may use.

    Attributes:
        vocabulary: The names.
        corners: Shape (cells, corners, coordinates).
        distance: Distance to the boundary of points, shape (n, 3), for formulas that name it.
        count: How many there are.
    """

    def __init__(self, vocabulary: Vocabulary, corners: np.ndarray, distance: Distance | None = None):
        """Take them; see the attributes."""
        self.vocabulary, self.corners, self.distance = vocabulary, corners, distance
        self.count = len(corners)

    def of(self, cells: np.ndarray) -> Cells:
        """A selection of the cells."""
        return Cells(self.vocabulary, self.corners[cells], self.distance)

    def values(self, formula: Formula, degree: int, cells: np.ndarray) -> np.ndarray:
        """Values at the inner points for a degree, shape (cells, points)."""
        points = polynomials.inner_points(self.corners.shape[1], degree)
        found, at_once = np.empty((len(cells), len(points))), max(POINTS // len(points), 1)
        for start in range(0, len(cells), at_once):
            corners, own = self.corners[cells[start : start + at_once]], found[start : start + at_once]
            x = np.zeros((3, own.size))
            for axis in range(corners.shape[2]):
                along = corners[..., axis]
                np.matmul(along, points.T, out=x[axis].reshape(own.shape))
                # sums of barycentric coordinates are not exactly 1: points on a side stay on it
                low, high = polynomials.row_min(along)[:, None], polynomials.row_max(along)[:, None]
                np.clip(x[axis].reshape(own.shape), low, high, out=x[axis].reshape(own.shape))
            known = {} if self.distance is None else {"distance": self.distance(x.T)}
            own[:] = self.vocabulary.at_points(formula, x, known).reshape(own.shape)
        return found


@dataclass(frozen=True)
class Sign:
    """The possible signs of a value inside each cell; zeros between cells of other signs are not counted."""

    up: np.ndarray
    down: np.ndarray
    zero: np.ndarray


class TreeWalk:
    """One evaluation of a formula and of the definitions it uses.

    Attributes:
        undecided: Numbers whose sign was asked for, and the cells where it is not decided although no condition changes
            in them.
    """

    def __init__(self, cells: Cells, nearest: Nearest | None = None):
        """Begin.

        Args:
            cells: Where.
            nearest: Finds a linear function near a number without conditions on some of the cells, shape (cells,
                corners), and a bound of its distance: `mean_value_forms.nearest_on`. None: nothing more than interval
                arithmetic is done where that does not tell the sign of a number.
        """
        self.cells, self.known, self._nearest = cells, dict[str, Enclosure](), nearest
        self.undecided: list[tuple[Formula, np.ndarray]] = []
        self._nodes: dict[int, tuple[ast.expr, Enclosure]] = {}
        self._truths: dict[int, tuple[ast.expr, Truth]] = {}

    def name(self, name: str) -> Enclosure:
        if name not in self.known:
            self.known[name] = self._new(name)
        return self.known[name]

    def _new(self, name: str) -> Enclosure:
        corners = self.cells.corners
        if name in CONSTANTS:
            return intervals.constant(CONSTANTS[name])
        if name in AXES:
            axis = AXES.index(name)
            if axis >= corners.shape[2]:
                return intervals.constant(0.0)
            x = corners[:, :, axis]
            low, high = polynomials.row_min(x), polynomials.row_max(x)
            return intervals.of_bounds(low, high, np.where(low == high, 0, 1), derivative_bounds.COORDINATE)
        if name == "r":
            squares = [intervals.power(self.name(axis), 2) for axis in AXES]
            return intervals.distance(intervals.sqrt(intervals.add(intervals.add(*squares[:2]), squares[2])))
        if name == "theta":
            least = np.maximum(intervals.hypot(self.name("x"), self.name("y")).lower, 0.0)
            return replace(intervals.atan2(self.name("y"), self.name("x")), slopes=derivative_bounds.turn(least))
        if name == "distance":
            assert self.cells.distance is not None
            middle = np.zeros((len(corners), 3))
            middle[:, : corners.shape[2]] = corners.mean(axis=1)
            reach = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
            far = self.cells.distance(middle)
            bounds = np.maximum(far - reach, 0.0), far + reach
            found = intervals.of_bounds(*bounds, NO_POLYNOMIAL, derivative_bounds.COORDINATE)
            return found.cut(np.ones(len(corners), dtype=bool))
        defined = self.cells.vocabulary.define[name]
        return self.number(defined, defined.tree)

    def number(self, formula: Formula, node: ast.expr) -> Enclosure:
        """Bounds of a node, found once; a condition counts 1 or 0."""
        if id(node) not in self._nodes:
            self._nodes[id(node)] = node, self._number(formula, node)
        return self._nodes[id(node)][1]

    def _number(self, formula: Formula, node: ast.expr) -> Enclosure:
        if is_condition(node):
            truth = self.condition(formula, node)
            return intervals.chosen(truth, intervals.constant(1.0), intervals.constant(0.0))
        match node:
            case ast.Constant(value=int() | float() as value):
                return intervals.constant(float(value))
            case ast.Name(id=name):
                return self.name(name)
            case ast.BinOp(left=left, op=op, right=right):
                return self._operation(formula, BINARY[type(op)], left, right)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return intervals.negative(self.number(formula, operand))
            case ast.UnaryOp(operand=operand):
                return self.number(formula, operand)
            case ast.Call(func=ast.Name(id="where"), args=[test, yes, no]):
                branches = self.number(formula, yes), self.number(formula, no)
                return intervals.chosen(self.condition(formula, test), *branches)
            case ast.Call(func=ast.Name(id=name), args=args):
                return self._call(formula, name, args)
        raise AssertionError(ast.dump(node))

    def _operation(self, formula: Formula, sign: str, left: ast.expr, right: ast.expr) -> Enclosure:
        a, b = self.number(formula, left), self.number(formula, right)
        match sign:
            case "+":
                return intervals.add(a, b)
            case "-":
                return intervals.add(a, intervals.negative(b))
            case "*":
                same = type(left) is type(right) and ast.dump(left) == ast.dump(right)
                return intervals.power(a, 2) if same else intervals.multiply(a, b)
            case "/":
                return intervals.divide(a, self._argument(formula, right))
            case "^":
                whole = b.is_number and float(b.lower) >= 0 and float(b.lower).is_integer()
                return intervals.raised(a if whole else self._argument(formula, left), b)
        if a.is_number and b.is_number and b.lower != 0:
            return intervals.constant(float(np.mod(a.lower, b.lower))).inheriting(a).inheriting(b)
        # the remainder is that of the exact quotient, which may be on the other side of an integer; not so of integers
        quotient, exact = intervals.divide(a, b), intervals.whole_numbers(a) & intervals.whole_numbers(b)
        rough = intervals.widened(quotient)
        lower, upper = np.where(exact, quotient.lower, rough.lower), np.where(exact, quotient.upper, rough.upper)
        turns = self._floor(replace(quotient, lower=lower, upper=upper))
        remainder = intervals.add(a, intervals.negative(intervals.multiply(b, turns)))
        least, most = np.minimum(b.lower, 0.0), np.maximum(b.upper, 0.0)
        nonzero = (b.lower > 0) | (b.upper < 0)
        return replace(remainder.clipped(least, most), defined=remainder.defined & nonzero)

    def _call(self, formula: Formula, name: str, args: list[ast.expr]) -> Enclosure:
        number = self._argument if name in ("sqrt", "ln", "log", "log10") else self.number
        parts = [number(formula, arg) for arg in args]
        a = parts[0]
        match name:
            case "abs":
                sign = self._sign(formula, args[0], a)
                return intervals.absolute(a, sign.up, sign.down)
            case "sign":
                sign = self._sign(formula, args[0], a)
                found = intervals.chosen(Truth(sign.up, sign.down), intervals.constant(1.0), intervals.constant(-1.0))
                found = intervals.chosen(Truth(sign.zero, sign.up | sign.down), intervals.constant(0.0), found)
                return found.inheriting(a)
            case "floor":
                return self._floor(a)
            case "min" | "max":
                found, node = a, args[0]
                for other, arg in zip(parts[1:], args[1:], strict=True):
                    difference = ast.BinOp(left=node, op=ast.Sub(), right=arg)
                    gap = intervals.add(found, intervals.negative(other))
                    sign = self._sign(formula, difference, gap, [found, other])
                    found = intervals.extreme(name, found, other, sign.up, sign.down)
                    node = ast.Call(func=ast.Name(id=name), args=[node, arg], keywords=[])
                return found
        found = intervals.FUNCTIONS[name](*parts)
        if name == "hypot" and len({axis for arg in args if (axis := self._axis(formula, arg))}) == 2:
            return intervals.distance(found)
        return found

    def _axis(self, formula: Formula, node: ast.expr) -> str:
        """The coordinate that a node is, up to its sign and a number; otherwise empty."""
        if self.number(formula, node).slopes is not derivative_bounds.COORDINATE:  # nor shifted
            return ""
        needs = self.cells.vocabulary.needs(formula.part(node)) & {*COORDINATES, "distance"}
        return needs.pop() if len(needs) == 1 and needs <= set(AXES) else ""

    def _floor(self, a: Enclosure) -> Enclosure:
        """Decided where it is one number inside the cell."""
        # affine functions are largest and least on the boundary of a cell alone; 1 - y^2 is 1 on a line that may be
        # inside, and x^20 nearly 0 in most of a cell
        round_off = TOUCHING * np.maximum(np.maximum(np.abs(a.lower), np.abs(a.upper)), 1.0)  # integers differ by 1
        affine = a.whole & (a.degree <= 1) & (a.upper - a.lower > 4 * round_off)
        margin = np.where(affine, np.minimum(round_off, THIN * (a.upper - a.lower)), 0.0)
        low = np.floor(a.lower + margin)
        high = np.where(affine, np.ceil(a.upper - margin) - 1, np.floor(a.upper))
        one = (high <= low) & a.whole
        found = intervals.of_bounds(np.floor(a.lower), np.floor(a.upper), NO_POLYNOMIAL).cut(~one)
        number = intervals.of_bounds(low, low, 0)
        return intervals.chosen(Truth(one, ~one), number, found).inheriting(a)

    def condition(self, formula: Formula, node: ast.expr) -> Truth:
        """Whether a node may be true and may be false as a condition, computed once; numbers other than 0 are true."""
        if id(node) not in self._truths:
            self._truths[id(node)] = node, self._condition(formula, node)
        return self._truths[id(node)][1]

    def _condition(self, formula: Formula, node: ast.expr) -> Truth:
        match node:
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return _fails(self.condition(formula, operand))
            case ast.BoolOp(op=op, values=operands):
                truths = [self.condition(formula, child) for child in operands]
                return _all_of(truths) if isinstance(op, ast.And) else _any_of(truths)
            case ast.Compare(left=left, ops=ops, comparators=rest):
                sides = [left, *rest]
                return _all_of(
                    [self._compared(formula, COMPARE[type(op)], sides[k], sides[k + 1]) for k, op in enumerate(ops)]
                )
        return self._compared(formula, "!=", node, ast.Constant(0.0))

    def _compared(self, formula: Formula, sign: str, left: ast.expr, right: ast.expr) -> Truth:
        match left, right:
            case ast.Call(func=ast.Name(id="max" | "min" as name), args=parts), _ if sign in MIRRORED:
                # which of them is the largest need not be known
                truths = [self._compared(formula, sign, part, right) for part in parts]
                truth = (_all_of if (name == "max") == sign.startswith("<") else _any_of)(truths)
                # where one of them is no number, neither is the largest
                defined = np.asarray(reduce(and_, (one.defined for one in truths)))
                return Truth(truth.may_hold | ~defined, truth.may_fail | ~defined, defined)
            case _, ast.Call(func=ast.Name(id="max" | "min")) if sign in MIRRORED:
                return self._compared(formula, MIRRORED[sign], right, left)
        a, b = self.number(formula, left), self.number(formula, right)
        difference = ast.BinOp(left=left, op=ast.Sub(), right=right)
        found = self._sign(formula, difference, intervals.add(a, intervals.negative(b)), [a, b])
        # a root of a negative number is equal to nothing, above and below nothing
        defined = a.defined & b.defined
        up, down, zero = found.up | ~defined, found.down | ~defined, found.zero
        match sign:
            case ">" | "<=":
                above = Truth(up, down | zero, defined)
                return above if sign == ">" else _fails(above)
            case "<" | ">=":
                below = Truth(down, up | zero, defined)
                return below if sign == "<" else _fails(below)
        # a line inside the cell where they are equal is of measure zero, but samples may lie on it
        equal = Truth(zero | (up & down), up | down, defined)
        return equal if sign == "==" else _fails(equal)

    def _sign(self, formula: Formula, node: ast.expr, a: Enclosure, compared: list[Enclosure] | None = None) -> Sign:
        """Sign of a node.

        Args:
            formula: Where the node is from.
            node: A number.
            a: Its bounds.
            compared: Of a difference, the bounds of the two numbers: their size tells what round-off is.
        """
        low, high, degree, whole = (np.broadcast_to(part, self.cells.count) for part in a.parts[:4])
        up, down, zero = high > 0, low < 0, (low <= 0) & (high >= 0)
        open_ = self._open(formula, node, low, high, whole)
        if len(open_):
            part, scale = formula.part(node), np.broadcast_to(_size(compared or [a]), self.cells.count)
            low, high = low.copy(), high.copy()
            for d in np.unique(degree[open_]):
                cells, polynomial = open_[degree[open_] == d], d <= polynomials.MAX_DEGREE
                values, least, most, rounding = self._sharp(part, int(d), cells)
                low[cells], high[cells] = np.fmax(low[cells], least), np.fmin(high[cells], most)
                equal, touching = EQUAL * scale[cells], TOUCHING * scale[cells]
                if d <= 1:
                    equal, touching = np.maximum(rounding, equal), np.maximum(rounding, touching)
                allowance = np.maximum(rounding if d <= 2 else UNDERFLOW, self._thin(a, values, cells, touching))
                # coefficients of one sign: it is 0 on the boundary of the cell at most, unlike y^2 across y = 0
                inside = (least < -allowance) & (most > allowance)
                # an expression without conditions that is not 0 at one place is 0 almost nowhere
                nothing = polynomials.row_size(values) <= equal
                above, below = high[cells] > allowance, low[cells] < -allowance
                unclear = (nothing & (not polynomial)) | ~(nothing | above | below) | ~np.isfinite(values).all(axis=1)
                up[cells] = (above & ~nothing) | unclear
                down[cells] = (below & ~nothing) | unclear
                zero[cells] = nothing | unclear | inside
            self.undecided.append((part, up & down & whole))
        return Sign(up, down, zero)

    def _thin(self, a: Enclosure, values: np.ndarray, cells: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """How near to 0 a number may come so that it is nearer in a thin part of a cell alone; 0 if this is not known.

        With values that differ by s, its slope in the direction from one to the other is at least s/4 by the width of
        the cell, all over it, if second derivatives change the slope by less than the rest of s. Then it is less than d
        on 4 d/s of the width. Without this it may be less on much of the cell, as exp(240*x) - 1000 on (0, 1/4), or
        x^20.

        Args:
            a: Bounds of the number.
            values: At some points of these cells.
            cells: Some of the cells.
            touching: What round-off is.
        """
        spread = polynomials.row_max(values) - polynomials.row_min(values)
        width = np.linalg.norm(np.ptp(self.cells.corners[cells], axis=1), axis=1)  # at least the diameter
        bent = np.broadcast_to(2 * a.derivative(2), self.cells.count)[cells] * width**2
        return np.where(bent <= 0.75 * spread, np.minimum(touching, THIN * spread), 0.0)

    def _sharp(self, part: Formula, degree: int, cells: np.ndarray) -> tuple[np.ndarray, ...]:
        """Values at some points, and bounds over cells with their round-off: of a polynomial by Bernstein coefficients,
        of others by a linear function."""
        if degree <= polynomials.MAX_DEGREE:
            values, corners = self.cells.values(part, degree, cells), self.cells.corners.shape[1]
            least, most = polynomials.bounds(values, corners, degree)
            return values, least, most, 2 * polynomials.round_off(values, corners, degree)
        assert self._nearest is not None  # `_open` leaves no cells
        at_corners, rest = self._nearest(self, part, cells)
        values = self.cells.values(part, 1, cells)
        return (
            values,
            polynomials.row_min(at_corners) - rest,
            polynomials.row_max(at_corners) + rest,
            np.zeros(len(cells)),
        )

    def _argument(self, formula: Formula, node: ast.expr) -> Enclosure:
        """Bounds of what a root is taken of, or a logarithm, or what is divided by: sharper where they contain 0."""
        a = self.number(formula, node)
        low, high, degree, whole = (np.broadcast_to(part, self.cells.count) for part in a.parts[:4])
        open_ = self._open(formula, node, low, high, whole)
        if not len(open_):
            return a
        low, high = low.copy(), high.copy()
        for d in np.unique(degree[open_]):
            cells = open_[degree[open_] == d]
            _, least, most, _ = self._sharp(formula.part(node), int(d), cells)
            low[cells], high[cells] = np.fmax(low[cells], least), np.fmin(high[cells], most)
        return replace(a, lower=low, upper=high)

    def _open(
        self, formula: Formula, node: ast.expr, low: np.ndarray, high: np.ndarray, whole: np.ndarray
    ) -> np.ndarray:
        """Cells where the sign of a node is to be looked for, since its bounds do not tell it."""
        found = np.flatnonzero((low <= 0) & (high >= 0) & (low < high) & whole)
        known = self._nearest is not None and len(found) > 0 and self._can_sample(formula, node)
        return found if known else found[:0]

    def _can_sample(self, formula: Formula, node: ast.expr) -> bool:
        needs = self.cells.vocabulary.needs
        unknown = self.cells.distance is None and "distance" in needs(formula)
        return not (unknown and "distance" in needs(formula.part(node)))


Nearest = Callable[[TreeWalk, Formula, np.ndarray], tuple[np.ndarray, np.ndarray]]


def _size(enclosures: list[Enclosure]) -> np.ndarray:
    """Size of numbers that are compared where they are equal: that of the one that is less, unless this is 0."""
    sizes = np.broadcast_arrays(*(np.maximum(np.abs(part.lower), np.abs(part.upper)) for part in enclosures))
    least, largest = np.minimum.reduce(sizes), np.maximum.reduce(sizes)
    size = np.where(least > 0, least, largest)
    return np.where(np.isfinite(size), size, 0.0)


def _fails(truth: Truth) -> Truth:
    """Whether a condition fails."""
    return Truth(truth.may_fail, truth.may_hold, truth.defined)


def _all_of(truths: list[Truth]) -> Truth:
    """Whether all of several conditions hold: not if one of them fails, whatever the others are."""
    may_hold = np.logical_and.reduce([truth.may_hold for truth in truths])
    may_fail = np.logical_or.reduce([truth.may_fail for truth in truths])
    one_fails = np.logical_or.reduce([truth.defined & ~truth.may_hold for truth in truths])
    return Truth(may_hold, may_fail, one_fails | reduce(and_, (truth.defined for truth in truths)))


def _any_of(truths: list[Truth]) -> Truth:
    """Whether one of several conditions holds."""
    return _fails(_all_of([_fails(truth) for truth in truths]))

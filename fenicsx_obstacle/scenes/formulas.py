"""Formulas such as "where(r < a, sqrt(1 - r^2), 0)": parsed, never evaluated as Python.

One tree, two alphabets: NumPy arrays for data at nodes, UFL for the exact solution, whose gradient is needed.
"""

from __future__ import annotations

import ast
import keyword
import math
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import counted, nearest, plain

MAX_LENGTH = 2000  # characters; the parser of Python itself runs out of memory at 1e5 signs
MAX_DEPTH = 150  # nested operations
SHOWN = 80  # characters of a formula in a message

BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^", ast.Mod: "%"}
COMPARE = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}

_ONE_ARGUMENT = tuple(
    "sin cos tan asin acos atan sinh cosh tanh exp ln log log10 sqrt abs sign floor".split()  # noqa: SIM905
)
# name: least and largest number of arguments
FUNCTIONS = {
    **dict.fromkeys(_ONE_ARGUMENT, (1, 1)),
    "atan2": (2, 2),
    "hypot": (2, 2),
    "min": (2, 9),
    "max": (2, 9),
    "where": (3, 3),
}
FUNCTIONALS = {"integral": (1, 3), "at": (2, 4), "sup": (1, 1), "inf": (1, 1)}  # in [report] only
OVER_NODES = {"max": "sup", "min": "inf"}  # there, of one argument


def check_name(name: str, place: str) -> None:
    """Check that a formula can use this name.

    Raises:
        InputError: If not.
    """
    if not name.isidentifier() or keyword.iskeyword(name) or unicodedata.normalize("NFKC", name) != name:
        raise InputError(f"{place}: not a name; take letters, digits and _, and no word of Python")


@dataclass(frozen=True)
class Formula:
    """A parsed formula.

    Attributes:
        text: As the user wrote it.
        place: Where it stands, e.g. "ball.toml: [obstacle] lower", for messages.
        tree: Its syntax tree.
    """

    text: str
    place: str
    tree: ast.expr

    @cached_property
    def names(self) -> set[str]:
        """Names of the values it needs."""
        called = {id(node.func) for node in ast.walk(self.tree) if isinstance(node, ast.Call)}
        return {n.id for n in ast.walk(self.tree) if isinstance(n, ast.Name) and id(n) not in called}

    @property
    def may_jump(self) -> bool:
        """Whether anything in it may, except for poles: `intervals` finds these in cells."""
        nodes = list(ast.walk(self.tree))
        called = {node.func.id for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
        conditions = ast.Compare | ast.BoolOp | ast.Not | ast.Mod
        return bool(called & {"where", "sign", "floor", "atan2"}) or any(isinstance(n, conditions) for n in nodes)

    def check_names(self, known: Mapping[str, Any] | set[str]) -> None:
        """Reject unknown names.

        Raises:
            InputError: Pointing at the column, with the nearest known name.
        """
        unknown = {name for name in self.names if name not in known}
        for node in ast.walk(self.tree) if unknown else ():
            if isinstance(node, ast.Name) and node.id in unknown:
                hint = "; t is for data that move, with a table [time]" if node.id == "t" else nearest(node.id, known)
                raise InputError(self.pointing(node, f"unknown name '{node.id}'{hint}"))

    def part(self, node: ast.expr) -> Formula:
        """A formula within this one."""
        return Formula(self.text, self.place, node)

    def pointing(self, node: ast.AST, message: str) -> str:
        """A message with the formula and a sign below the place of `node`."""
        return _caret(self, _column(self.text, getattr(node, "col_offset", 0)), message)

    def evaluate(self, values: Mapping[str, Any], alphabet: Mapping[str, Callable[..., Any]]) -> Any:
        """Value of the formula.

        Args:
            values: Value of each name: arrays of one shape for NumPy, expressions for UFL.
            alphabet: Operations by sign or name, as `NUMPY` below.
        """
        self.check_names(values)
        value = _walk(self, self.tree, values, alphabet)
        return alphabet["where"](value, 1.0, 0.0) if is_condition(self.tree) else value

    def on_arrays(
        self, values: Mapping[str, Any], alphabet: Mapping[str, Callable[..., Any]] | None = None
    ) -> np.ndarray:
        """Value as a float array; not-a-numbers are left for the caller to report."""
        with np.errstate(all="ignore"):
            return np.asarray(self.evaluate(values, NUMPY if alphabet is None else alphabet), dtype=np.float64)


def parse(text: str | float, place: str, *, functionals: bool = False) -> Formula:
    """Parse a formula or a number.

    Args:
        text: The formula.
        place: Where it stands.
        functionals: Whether `integral`, `at`, `sup` and `inf` may be called; `max` and `min` of one argument are these.

    Raises:
        InputError: With the place and the column of what cannot be read.
    """
    if isinstance(text, bool):
        raise InputError(f"{place}: expected a number or a formula, found {str(text).lower()}")
    if not isinstance(text, str):
        try:
            return Formula(plain(text), place, ast.Constant(float(text)))
        except OverflowError:
            raise InputError(f"{place}: a number with too many digits") from None
    if len(text) > MAX_LENGTH:
        raise InputError(f"{place}: formula of {len(text)} characters; the limit is {MAX_LENGTH}")
    bare = Formula(text, place, ast.Constant(0.0))
    if not text.strip():
        raise InputError(f"{place}: empty formula")
    if "#" in text:  # Python would leave out what follows
        raise InputError(_caret(bare, text.index("#"), "cannot read this formula"))
    try:
        tree = ast.parse(text.replace("^", "**").strip(), mode="eval").body
    except SyntaxError as error:
        offset = _column(text, (error.offset or 1) - 1)
        raise InputError(_caret(bare, offset, "cannot read this formula")) from None
    except (MemoryError, RecursionError, ValueError):
        raise InputError(f"{place}: this formula is nested too deeply or has invalid characters") from None
    if functionals:
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) == 1:
                node.func.id = OVER_NODES.get(node.func.id, node.func.id)
    formula = Formula(text, place, tree)
    _check(formula, tree, 0, {**FUNCTIONS, **FUNCTIONALS} if functionals else FUNCTIONS)
    return formula


def _check(formula: Formula, node: ast.expr, depth: int, functions: Mapping[str, tuple[int, int]]) -> None:
    """Reject everything that is not arithmetic."""
    if depth > MAX_DEPTH:
        raise InputError(f"{formula.place}: formula nested deeper than {MAX_DEPTH} operations")
    children: list[ast.expr]
    match node:
        case ast.Constant(value=bool()) | ast.Constant(value=complex()):
            raise InputError(formula.pointing(node, "only real numbers"))
        case ast.Constant(value=int() as value) if abs(value) > 10**300:
            raise InputError(formula.pointing(node, "a number with too many digits"))
        case ast.Constant(value=int() | float()) | ast.Name():
            children = []
        case ast.BinOp(left=left, op=op, right=right) if type(op) in BINARY:
            children = [left, right]
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() | ast.Not(), operand=operand):
            children = [operand]
        case ast.Compare(left=left, ops=ops, comparators=rest) if all(type(op) in COMPARE for op in ops):
            children = [left, *rest]
        case ast.BoolOp(values=parts):
            children = parts
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            if name not in functions:
                hint = "; it belongs in [report]" if name in FUNCTIONALS else nearest(name, functions)
                raise InputError(formula.pointing(node, f"unknown function '{name}'" + hint))
            least, most = functions[name]
            if not least <= len(args) <= most:
                wanted = counted(least, "argument") if least == most else f"{least} to {most} arguments"
                over = len(args) == 1 and name in OVER_NODES
                hint = f"; in [report] {name} of one argument is over the whole domain" if over else ""
                raise InputError(formula.pointing(node, f"{name} takes {wanted}, not {len(args)}{hint}"))
            children = args
            if name == "integral":
                for part in args[1:]:
                    if not (isinstance(part, ast.Constant) and isinstance(part.value, str)):
                        raise InputError(formula.pointing(part, "expected the name of a part of the mesh, in quotes"))
                children = args[:1]
        case _:
            hint = ""
            if isinstance(node, ast.Subscript):
                hint = "; the coordinates are x, y and z"
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                hint = f"; functions have no prefix: {node.func.attr}(...)"
            raise InputError(formula.pointing(node, "not allowed in a formula" + hint))
    for child in children:
        _check(formula, child, depth + 1, functions)


def _walk(formula: Formula, node: ast.expr, values: Mapping[str, Any], do: Mapping[str, Callable[..., Any]]) -> Any:
    def condition(child: ast.expr) -> Any:
        """Truth value: comparisons as they are, numbers by being different from zero."""
        value = _walk(formula, child, values, do)
        return value if is_condition(child) else do["!="](value, 0.0)

    def number(child: ast.expr) -> Any:
        """Numeric value: a comparison counts 1 or 0."""
        value = _walk(formula, child, values, do)
        return do["where"](value, 1.0, 0.0) if is_condition(child) else value

    match node:
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case ast.Name(id=name):
            return values[name]
        case ast.BinOp(op=op) if BINARY[type(op)] not in do:
            raise InputError(formula.pointing(node, f"{BINARY[type(op)]} cannot be differentiated, so not in [exact]"))
        case ast.BinOp(left=left, op=op, right=right):
            return do[BINARY[type(op)]](number(left), number(right))
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return do["not"](condition(operand))
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -number(operand)
        case ast.UnaryOp(operand=operand):
            return number(operand)
        case ast.Compare(left=left, ops=ops, comparators=rest):
            sides = [number(side) for side in (left, *rest)]
            parts = [do[COMPARE[type(op)]](a, b) for op, a, b in zip(ops, sides[:-1], sides[1:], strict=True)]
            return reduce(do["and"], parts)
        case ast.BoolOp(op=op, values=operands):
            return reduce(do["and" if isinstance(op, ast.And) else "or"], [condition(child) for child in operands])
        case ast.Call(func=ast.Name(id="where"), args=[test, yes, no]):
            return do["where"](condition(test), number(yes), number(no))
        case ast.Call(func=ast.Name(id=name), args=args):
            if name not in do:
                raise InputError(formula.pointing(node, f"{name} cannot be differentiated, so not in [exact]"))
            parts = [number(arg) for arg in args]
            return reduce(do[name], parts) if name in ("min", "max") else do[name](*parts)
    raise AssertionError(ast.dump(node))  # _check let nothing else pass


def is_condition(node: ast.expr) -> bool:
    return isinstance(node, ast.Compare | ast.BoolOp) or (
        isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
    )


def _column(text: str, offset: int) -> int:
    """Column in the user's text of an offset in the parsed text, where ^ had become **."""
    lead = len(text) - len(text.lstrip())
    parsed = 0
    for column, sign in enumerate(text[lead:]):
        if parsed >= offset:
            return lead + column
        parsed += 2 if sign == "^" else 1
    return len(text)


def _caret(formula: Formula, column: int, message: str) -> str:
    """The message, the formula, or what is near the column of a long one, and a sign below the column."""
    text, first = formula.text, 0
    if len(text) > SHOWN:
        first = max(0, min(column - SHOWN // 2, len(text) - SHOWN))
        text = text[first : first + SHOWN]
        text = f"{'... ' if first else ''}{text}{' ...' if first + SHOWN < len(formula.text) else ''}"
        column += 4 * bool(first) - first
    text = "".join(sign if sign.isprintable() else " " for sign in text)
    return f"{formula.place}: {message}\n    {text}\n    {' ' * column}^"


def _power(base: Any, exponent: Any) -> Any:
    """np.power, which takes 20 times as long for a square as a product, and 10 times as long for a cube."""
    if np.ndim(exponent) == 0 and exponent in (2.0, 3.0):
        square = np.multiply(base, base)
        return square if exponent == 2.0 else np.multiply(square, base)
    return np.power(base, exponent)


def _comparison(compare: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """A comparison that is not-a-number where a side is: neither true nor false."""

    def compared(a: Any, b: Any) -> Any:
        found, unknown = compare(a, b), np.isnan(a) | np.isnan(b)
        return np.where(unknown, np.nan, found) if unknown.any() else found

    return compared


def _is_known(*conditions: Any) -> bool:
    """Whether conditions are true or false everywhere, and not numbers that may be not-a-number."""
    return all(np.asarray(one).dtype == bool for one in conditions)


def _and(a: Any, b: Any) -> Any:
    """False where one is, whatever the other is."""
    return np.logical_and(a, b) if _is_known(a, b) else np.where((a == 0) | (b == 0), 0.0, np.multiply(a, b))


def _or(a: Any, b: Any) -> Any:
    """True where one is, whatever the other is."""
    return np.logical_or(a, b) if _is_known(a, b) else np.where((a == 1) | (b == 1), 1.0, np.add(a, b, dtype=float))


def _not(a: Any) -> Any:
    return np.logical_not(a) if _is_known(a) else 1.0 - a


def _where(condition: Any, yes: Any, no: Any) -> Any:
    """Not-a-number where the condition is."""
    if _is_known(condition):
        return np.where(condition, yes, no)
    return np.where(np.isnan(condition), np.nan, np.where(condition != 0, yes, no))


def angle(y: Any, x: Any) -> Any:
    """atan2(y, x), with pi, not -pi, where y is -0 and x is negative."""
    return np.arctan2(y + 0.0, x)


NUMPY: dict[str, Callable[..., Any]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "^": _power, "%": np.mod,
    "<": _comparison(np.less), "<=": _comparison(np.less_equal), ">": _comparison(np.greater),
    ">=": _comparison(np.greater_equal), "==": _comparison(np.equal), "!=": _comparison(np.not_equal),
    "and": _and, "or": _or, "not": _not, "where": _where,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": angle, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "exp": np.exp, "ln": np.log,
    "log": np.log, "log10": np.log10, "sqrt": np.sqrt, "abs": np.abs, "sign": np.sign, "floor": np.floor,
    "hypot": np.hypot, "min": np.minimum, "max": np.maximum,
}  # fmt: skip


# conditions are false where a side is not-a-number, and nothing is without a value because of them
TWO_VALUED: dict[str, Callable[..., Any]] = {
    **NUMPY,
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
}  # fmt: skip


def ufl_alphabet() -> dict[str, Callable[..., Any]]:
    """The same operations in UFL; `floor` and `%` have none."""
    import ufl

    from fenicsx_obstacle import releases

    return {
        "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b,
        "^": lambda a, b: a**b, "<": ufl.lt, "<=": ufl.le, ">": ufl.gt, ">=": ufl.ge, "==": ufl.eq, "!=": ufl.ne,
        "and": ufl.And, "or": ufl.Or, "not": ufl.Not, "where": ufl.conditional,
        "sin": ufl.sin, "cos": ufl.cos, "tan": ufl.tan, "asin": ufl.asin, "acos": ufl.acos, "atan": ufl.atan,
        "atan2": releases.atan2, "sinh": ufl.sinh, "cosh": ufl.cosh, "tanh": ufl.tanh, "exp": ufl.exp, "ln": ufl.ln,
        "log": ufl.ln, "log10": lambda a: ufl.ln(a) / math.log(10), "sqrt": ufl.sqrt, "abs": abs, "sign": ufl.sign,
        "hypot": lambda a, b: ufl.sqrt(a * a + b * b), "min": ufl.min_value, "max": ufl.max_value,
    }  # fmt: skip

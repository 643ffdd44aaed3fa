"""A formula of a scene as a datum: sampled, enclosed on cells, or differentiated."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fenicsx_obstacle.effects.field import Enclosed, Field, Names, TimeBounds
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.formulas import NUMPY, TWO_VALUED, Formula, angle, ufl_alphabet
from fenicsx_obstacle.scenes.vocabulary import CONSTANTS, COORDINATES, TIME, Vocabulary

if TYPE_CHECKING:
    from fenicsx_obstacle.data.fields import Symbols


class FormulaField(Field):
    """A formula with the definitions of its scene.

    Attributes:
        formula: The formula.
        vocabulary: The scene, which knows the names in it.
        needs: Names that it uses, itself and through definitions.
    """

    def __init__(self, formula: Formula, vocabulary: Vocabulary):
        """See the attributes."""
        self.formula, self.vocabulary, self.needs = formula, vocabulary, vocabulary.needs(formula)
        self.source, self.text = formula.place, formula.text
        self.uniform = not self.needs & {*COORDINATES, "distance"}
        self.moves, self.needs_distance = TIME in self.needs, "distance" in self.needs
        used = [formula, *(one for key, one in vocabulary.define.items() if key in self.needs)]
        self.continuous = "theta" not in self.needs and not any(one.may_jump for one in used)

    @property
    def pointwise(self) -> bool:
        return True

    @property
    def in_full(self) -> str:
        used = [f"{key} = {one.text}" for key, one in self.vocabulary.define.items() if key in self.needs]
        return f"{self.text} with {', '.join(used)}" if used else self.text

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        return self.vocabulary.at_points(self.formula, x, self._known(x, names))

    def margins(self, x: np.ndarray, names: Names) -> list[np.ndarray]:
        """For each condition in the formula and in its definitions a value that is positive only where the condition
        holds: a continuous function, whose sign decides the condition.

        `a < b` has b - a, `and` the smaller of two. `abs`, `sign`, `min` and `max` have such a value too: there they
        bend.
        """
        found: list[np.ndarray] = []

        def record(margin: Any, value: Any) -> Any:
            found.append(np.broadcast_to(margin, x.shape[1:]))
            return value

        more: dict[str, Callable[..., Any]] = {
            "<": lambda a, b: b - a, "<=": lambda a, b: b - a, ">": lambda a, b: a - b, ">=": lambda a, b: a - b,
            "==": lambda a, b: -np.abs(a - b), "!=": lambda a, b: np.abs(a - b),
            "and": np.minimum, "or": np.maximum, "not": np.negative,
            "where": lambda test, yes, no: record(test, np.where(test > 0, yes, no)),
            "abs": lambda a: record(a, np.abs(a)), "sign": lambda a: record(a, np.sign(a)),
            "min": lambda a, b: record(b - a, np.minimum(a, b)), "max": lambda a, b: record(b - a, np.maximum(a, b)),
        }  # fmt: skip
        with np.errstate(all="ignore"):
            self.vocabulary.at_points(self.formula, x, self._known(x, names), {**NUMPY, **more})
        return found

    def over(self, corners: np.ndarray, names: Names, cells: np.ndarray) -> Enclosed:
        from fenicsx_obstacle.scenes.mean_value_forms import Cells, OnCells  # only where bounds are asked for

        return OnCells(Cells(self.vocabulary, corners, names.get("distance")), self.formula)

    def over_time(self, x: np.ndarray, start: np.ndarray, end: np.ndarray, names: Names) -> TimeBounds:
        from fenicsx_obstacle.scenes import derivative_bounds, intervals  # only where a tolerance chooses the steps
        from fenicsx_obstacle.scenes.tree_walk import Cells, TreeWalk

        # a "cell" is an interval of t: the coordinates are numbers in it, and derivatives are those by t
        walk = TreeWalk(Cells(self.vocabulary, np.empty((x.shape[1], 0, 0))))
        fixed = dict(zip("xyz", x, strict=True))
        fixed |= {"r": np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2), "theta": angle(x[1], x[0])}
        if self.needs_distance:
            fixed["distance"] = self._known(x, names)["distance"]
        walk.known.update({name: intervals.of_bounds(values, values, 0) for name, values in fixed.items()})
        walk.known[TIME] = intervals.of_bounds(start, end, 1, derivative_bounds.COORDINATE)
        with np.errstate(all="ignore"):
            found = walk.number(self.formula, self.formula.tree)
            smooth = found.whole & found.finite
            first, second = (np.where(smooth, found.derivative(k), np.inf) for k in (1, 2))
            lower, upper = np.where(found.defined, found.lower, -np.inf), np.where(found.defined, found.upper, np.inf)
        return TimeBounds(*(np.broadcast_to(part, x.shape[1:]) for part in (lower, upper, first, 2 * second)))

    def because(self, point: np.ndarray, names: Names) -> str:
        known = {key: names[key] for key in names if key != "distance"}
        return self.vocabulary.infinite(self.formula, point, known) + self._undecided(point, names)

    def _undecided(self, point: np.ndarray, names: Names) -> str:
        """The remedy where a value is not-a-number because of a comparison; may be empty."""
        x = point.reshape(3, 1)
        if np.isfinite(self.at(x, names)) or not np.isfinite(
            self.vocabulary.at_points(self.formula, x, self._known(x, names), TWO_VALUED)
        ):
            return ""
        return ", where a side of a comparison has no value: first say where it has one, as in x >= 0 and sqrt(x) > 1"

    def expression(self, symbols: Symbols) -> Any:
        from fenicsx_obstacle import releases  # only where there is an exact solution

        alphabet, made = ufl_alphabet(), symbols.made.setdefault(id(self.vocabulary), {})
        angle = releases.atan2(symbols.axes[1], symbols.axes[0])
        values = dict(zip(COORDINATES, (*symbols.axes, symbols.radius, angle), strict=True))
        names = {**CONSTANTS, **symbols.names, **values}
        try:
            for key, definition in self.vocabulary.define.items():  # others may hold what UFL cannot differentiate
                if key in self.needs and key not in made:
                    made[key] = definition.evaluate({**names, **made}, alphabet)
            expression = self.formula.evaluate({**names, **made}, alphabet) + symbols.zero
            if not releases.finite(expression):
                raise ValueError("it holds an infinite number, or not a number")
            return expression
        except releases.UFL_ERRORS as error:
            raise InputError(f"{self}: cannot be differentiated: {error}") from None

    def _known(self, x: np.ndarray, names: Names) -> Names:
        """The names with the distance of these points, where it is needed."""
        if not self.needs_distance:
            return names
        return {**names, "distance": names["distance"](x.T)}

"""A formula of a scene as a datum: sampled, enclosed on cells, or differentiated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fenicsx_obstacle.effects.field import Enclosed, Field, Names, TimeBounds
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.formulas import NUMPY, TWO_VALUED, Formula, ufl_alphabet
from fenicsx_obstacle.scenes.vocabulary import CONSTANTS, COORDINATES, TIME, Vocabulary

if TYPE_CHECKING:
    from fenicsx_obstacle.data.fields import Symbols


@dataclass(frozen=True, eq=False)
class FormulaField(Field):
    """A formula with the definitions of its scene.

    Attributes:
        formula: The formula.
        vocabulary: The scene, which knows the names in it.
    """

    formula: Formula
    vocabulary: Vocabulary

    @property
    def source(self) -> str:  # type: ignore[override]
        return self.formula.place

    @property
    def text(self) -> str:  # type: ignore[override]
        return self.formula.text

    @property
    def needs(self) -> set[str]:
        """Names that it uses, itself and through definitions."""
        return self.vocabulary.needs(self.formula)

    @property
    def uniform(self) -> bool:  # type: ignore[override]
        return not self.needs & {*COORDINATES, "distance"}

    @property
    def moves(self) -> bool:  # type: ignore[override]
        return TIME in self.needs

    @property
    def needs_distance(self) -> bool:  # type: ignore[override]
        return "distance" in self.needs

    @property
    def continuous(self) -> bool:  # type: ignore[override]
        used = [self.formula, *(one for key, one in self.vocabulary.define.items() if key in self.needs)]
        return "theta" not in self.needs and not any(formula.may_jump for formula in used)

    @property
    def pointwise(self) -> bool:
        return True

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        return self.vocabulary.at_points(self.formula, x, self._known(x, names))

    def margins(self, x: np.ndarray, names: Names) -> list[np.ndarray]:
        with np.errstate(all="ignore"):
            return margins(self.vocabulary, self.formula, x, self._known(x, names))

    def over(self, corners: np.ndarray, names: Names, cells: np.ndarray) -> Enclosed:
        from fenicsx_obstacle.scenes.enclosures import Cells, OnCells  # only where bounds are asked for

        return OnCells(Cells(self.vocabulary, corners, names.get("distance")), self.formula)

    def over_time(self, x: np.ndarray, start: np.ndarray, end: np.ndarray, names: Names) -> TimeBounds:
        from fenicsx_obstacle.scenes.enclosures import over_time  # only where a tolerance chooses the steps

        distance = self._known(x, names)["distance"] if self.needs_distance else None
        return over_time(self.vocabulary, self.formula, x, distance, start, end)

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


def margins(scene: Vocabulary, formula: Formula, x: np.ndarray, values: Mapping[str, Any]) -> list[np.ndarray]:
    """For each condition in a formula and in its definitions a value that is positive only where the condition holds: a
    continuous function, whose sign decides the condition.

    `a < b` has b - a, `and` the smaller of two. `abs`, `sign`, `min` and `max` have such a value too: there they bend.

    Args:
        scene: Whose formula it is.
        formula: From `scene.formula()`.
        x: Points, shape (3, n).
        values: Further names, as for `Vocabulary.at_points`.

    Returns:
        Arrays of n values, as many at all points.
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
    scene.at_points(formula, x, values, {**NUMPY, **more})
    return found

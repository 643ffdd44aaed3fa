"""The names that a scene's formulas may use, and their values at points."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes import formulas
from fenicsx_obstacle.scenes.formulas import Formula

AXES = ("x", "y", "z")
COORDINATES = (*AXES, "r", "theta")
CONSTANTS = {"pi": math.pi}
TIME = "t"


class Vocabulary:
    """The names of formulas: definitions of a scene, coordinates and constants.

    Attributes:
        source: Where the scene comes from, for messages.
        define: Formula of each defined name, in order: later ones may use earlier ones.
        moves: Whether there is time.
    """

    source: str
    define: Mapping[str, Formula]
    moves: bool

    @property
    def known_names(self) -> set[str]:
        """Names that formulas at points may use."""
        return {*self.define, *CONSTANTS, *COORDINATES, "distance", *([TIME] if self.moves else [])}

    def needs(self, formula: Formula) -> set[str]:
        """Names that a formula uses, itself and through definitions."""
        found, new = set[str](), formula.names
        while new:
            found |= new
            new = {name for key in new & set(self.define) for name in self.define[key].names} - found
        return found

    def operations(self, formula: Formula) -> int:
        """Number of operations of a formula after its definitions are inserted."""
        counts: dict[str, int] = {}
        for key, defined in self.define.items():
            counts[key] = _operations(defined, counts)
        return _operations(formula, counts)

    def is_constant(self, name: str) -> bool:
        """Whether a known name has one value everywhere."""
        used = {name, *(self.needs(self.define[name]) if name in self.define else ())}
        return not used & {*COORDINATES, "distance"}

    def infinite(self, formula: Formula, point: np.ndarray, values: Mapping[str, Any] | None = None) -> str:
        """Which definitions that a formula needs are not finite at a point, in words; empty if all are."""
        found = []
        for key in (key for key in self.define if key in self.needs(formula)):
            defined = self.define[key]
            if "distance" not in self.needs(defined) and not np.isfinite(
                self.at_points(defined, point.reshape(3, 1), values)
            ):
                found.append(f"[define] {key} = {defined.text}")
        return f", because of {' and '.join(found[:2])}" if found else ""

    def formula(self, value: float | str, place: str) -> Formula:
        """Parse a value of this scene; `place` is its table and key."""
        return formulas.parse(value, f"{self.source}: {place}")

    def at_points(
        self,
        formula: Formula,
        x: np.ndarray,
        values: Mapping[str, Any] | None = None,
        alphabet: Mapping[str, Callable[..., Any]] = formulas.NUMPY,
    ) -> np.ndarray:
        """Values of a formula.

        Args:
            formula: From `formula()`.
            x: Points, shape (3, n).
            values: Further names, such as eps; `distance`, where the formula needs it.
            alphabet: Operations by sign or name.

        Returns:
            Array of n values.
        """
        names: dict[str, Any] = {**CONSTANTS, **(values or {}), **dict(zip("xyz", x, strict=True))}
        needed = self.needs(formula)  # of a million points, only what the formula needs
        if "r" in needed:
            names["r"] = np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
        if "theta" in needed:
            names["theta"] = formulas.angle(x[1], x[0])
        for key in (key for key in self.define if key in needed):
            names[key] = self.define[key].on_arrays(names, alphabet)
        return np.broadcast_to(formula.on_arrays(names, alphabet), x.shape[1:])

    def number(self, value: float | str, place: str, values: Mapping[str, float] | None = None) -> float:
        """A value that must be one finite number, such as a corner of the mesh.

        Raises:
            InputError: If it depends on the place or is not finite.
        """
        formula = self.formula(value, place)
        names: dict[str, Any] = {**CONSTANTS, **(values or {})}
        for key, defined in self.define.items():
            if defined.names <= set(names):
                names[key] = float(defined.on_arrays(names))
        formula.check_names(names)
        result = float(formula.on_arrays(names))
        if not math.isfinite(result):
            raise InputError(f"{formula.place} = {formula.text}: is {result}")
        return result


def _operations(formula: Formula, counts: Mapping[str, int]) -> int:
    nodes = list(ast.walk(formula.tree))
    return len(nodes) + sum(counts.get(node.id, 0) for node in nodes if isinstance(node, ast.Name))

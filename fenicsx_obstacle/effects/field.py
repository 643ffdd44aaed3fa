"""Fields: the data of a problem, such as tension, load, obstacle or boundary value, in any form the user gives.

A `Field` is a scalar function of place and time. `data.fields` makes one of what users of DOLFINx have; formulas of
a scene are another class of it, and a plug-in may have one of its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import agree

# what a datum may depend on in addition to x: t, eps, `distance` as a function of points (n, 3)
Names = Mapping[str, Any]
NO_POLYNOMIAL = 1000  # the degree of what is no polynomial


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of a datum over simplices.

    Attributes:
        lower: Lower bound over each simplex, shape (simplices,).
        upper: Upper bound, shape (simplices,).
        degree: As a polynomial where it is `whole`; `NO_POLYNOMIAL` or more if it is none.
        whole: Whether no condition cuts a simplex.
        defined: Whether it has a value all over it.
        slopes: Bounds of its derivatives by their order, see `derivative`.
    """

    lower: np.ndarray
    upper: np.ndarray
    degree: np.ndarray
    whole: np.ndarray
    defined: np.ndarray
    slopes: Callable[[int], Any] = field(default=lambda k: np.inf, repr=False)

    @property
    def finite(self) -> np.ndarray:
        """Whether finite bounds are known and the value is defined."""
        return np.isfinite(self.lower) & np.isfinite(self.upper) & self.defined

    def derivative(self, k: int) -> np.ndarray:
        """A bound of its derivative of order k = 1 .. 5 in any direction, divided by k!; where it is not `whole` the
        first alone holds, on both sides of what may be a kink or a jump."""
        return np.broadcast_to(np.asarray(self.slopes(k)), self.lower.shape)


@dataclass(frozen=True)
class Truth:
    """Whether a condition may hold and whether it may fail on each simplex, up to a set of measure zero.

    Attributes:
        may_hold: Whether it may hold.
        may_fail: Whether it may fail.
        defined: Whether it does not depend on a comparison with what may be no number.
    """

    may_hold: np.ndarray
    may_fail: np.ndarray
    defined: np.ndarray | bool = True


@dataclass(frozen=True)
class TimeBounds:
    """Bounds of a datum at points, each over an interval of t; infinite where nothing is known.

    Attributes:
        lower: Lower bound.
        upper: Upper bound.
        first: Bound of the absolute value of its derivative by t.
        second: Bound of the absolute value of its second derivative by t.
    """

    lower: np.ndarray
    upper: np.ndarray
    first: np.ndarray
    second: np.ndarray


class Enclosed(ABC):
    """Enclosure of a datum on simplices; by default nothing is known where a condition cuts them.

    Attributes:
        corners: Of the simplices, shape (simplices, corners, coordinates).
    """

    corners: np.ndarray

    @abstractmethod
    def once(self) -> Bounds:
        """Bounds over each simplex."""

    def truth(self) -> Truth:
        """Whether it may be true and may be false as a condition; numbers other than 0 are true."""
        found = self.once()
        return Truth((found.lower != 0) | (found.upper != 0), (found.lower <= 0) & (found.upper >= 0))

    def linear(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of some simplices that a condition cuts.

        Returns:
            Values of a linear function at the corners, shape (simplices, corners); bounds of its distance to the datum;
            and bounds of the gradient of the difference, where the datum is continuous.
        """
        unknown = np.full(len(cells), np.inf)
        return np.zeros((len(cells), self.corners.shape[1])), unknown, unknown

    def cuts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where a condition changes in some simplices.

        Returns:
            Values at the corners, shape (simplices, corners), of a linear function whose sign decides a condition, but
            where it is no larger than the second result; that is infinite where no line is known.
        """
        return np.zeros((len(cells), self.corners.shape[1])), np.full(len(cells), np.inf)

    @abstractmethod
    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        """Values at the points that determine a polynomial of a degree, shape (simplices, points)."""


class Field:
    """A scalar datum; its user decides on the unit.

    Attributes:
        source: Where it stands, for messages: "ball.toml: [obstacle] lower".
        text: What stands there.
    """

    source: str
    text: str
    uniform: bool = False  # the same number everywhere, at one moment
    moves: bool = False  # depends on the time t
    needs_distance: bool = False  # depends on the distance to the boundary of the domain
    everywhere: bool = True  # has a value at any point, on every rank
    continuous: bool = False  # for sure, wherever it is defined
    parts: Mapping[str, Field] | None = None  # one for the cells of each name

    @property
    def pointwise(self) -> bool:
        """Whether it has one value at a point, whichever cell it is asked in."""
        return self.continuous

    @property
    def in_full(self) -> str:
        """What stands there, with what it refers to."""
        return self.text

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        """Values at points (local; a Function: within the cells of this rank, not-a-number elsewhere).

        Args:
            x: Shape (3, n).
            names: Values of t and of what else it depends on.
            cells: The local cell of each point, where it is known: a Function may jump between cells.

        Returns:
            Shape (n,).
        """
        raise NotImplementedError

    def interpolate(self, V: fem.FunctionSpace, x: np.ndarray, names: Names) -> np.ndarray:
        """Values at the local dofs of a scalar space (collective).

        Args:
            V: The space.
            x: Points of its dofs, shape (3, dofs); of what jumps between cells a little within them.
            names: As for `at`.
        """
        with agree(V.mesh.comm):
            values = self.at(x, names)
        return values

    def on(self, level: Any) -> Field:
        """The datum on the mesh of a `mesh.levels.Level`; Functions of other meshes are interpolated
        (collective)."""
        return self

    def margins(self, x: np.ndarray, names: Names) -> list[np.ndarray]:
        """For each condition in it a value at points that is positive where it holds: a search follows them."""
        return []

    def over(self, corners: np.ndarray, names: Names, cells: np.ndarray) -> Enclosed | None:
        """Bounds over simplices; None where none are known.

        Args:
            corners: Shape (simplices, corners, coordinates).
            names: As for `at`.
            cells: The local cell that each lies in.
        """
        return None

    def over_time(self, x: np.ndarray, start: np.ndarray, end: np.ndarray, names: Names) -> TimeBounds | None:
        """Bounds at points, each over an interval of t; None where none are known.

        Args:
            x: Shape (3, n).
            start: Start of the interval of each point, shape (n,).
            end: Its end.
            names: As for `at`; their t is not used.
        """
        return None

    def expression(self, symbols: Any) -> Any:
        """As a UFL expression that can be differentiated, made of `data.fields.Symbols`.

        Raises:
            InputError: If it cannot be.
        """
        raise InputError(f"{self}: cannot be differentiated")

    def because(self, point: np.ndarray, names: Names) -> str:
        """Why its value at a point (3,) is not finite, in words that end a sentence; may be empty."""
        return ""

    def __str__(self) -> str:
        return f"{self.source} = {self.text}"


class ByCells(Field):
    """Data by the names of cells: `tension = {steel = 1, rubber = "2 + x"}`."""

    parts: Mapping[str, Field]

    def __init__(self, parts: Mapping[str, Field], source: str):
        self.parts, self.source = parts, source

    @property
    def text(self) -> str:  # type: ignore[override]
        return "{" + ", ".join(f"{name} = {part.text}" for name, part in self.parts.items()) + "}"

    @property
    def moves(self) -> bool:  # type: ignore[override]
        return any(part.moves for part in self.parts.values())

    @property
    def needs_distance(self) -> bool:  # type: ignore[override]
        return any(part.needs_distance for part in self.parts.values())

    def because(self, point: np.ndarray, names: Names) -> str:
        found = (part.because(point, names) for part in self.parts.values())
        return next((words for words in found if words), "")

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        raise InputError(f"{self}: values by the names of cells do not say what holds at a node, which cells share")


def fields_in(data: Iterable[Any]) -> list[Field]:
    """The fields among some values and within tuples, lists and dicts of them."""
    found: list[Field] = []
    for part in data:
        if isinstance(part, Field):
            found.append(part)
        elif isinstance(part, tuple | list):
            found += fields_in(part)
        elif isinstance(part, dict):
            found += fields_in(part.values())
    return found


Rows = tuple[tuple[Field, ...], ...]  # of a matrix

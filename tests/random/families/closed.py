"""Closed forms: u and the tension by SymPy's expressions in parts of the plane; load and flux are derived from them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from math import cos, sin
from typing import Any

import numpy as np
import sympy
from mpi4py import MPI
from sympy import Expr

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families import integrals
from tests.random.families.elements import Field
from tests.random.families.family import Family, Judgement, toml
from tests.random.families.integrals import Nodes, Pieces, energy_error
from tests.random.families.meshes import OWN, made

x, y = sympy.symbols("x y", real=True)
COMPARED = (("{a} < {b}", "{a} >= {b}"), ("not {a} >= {b}", "not {a} < {b}"),
            ("sign({a} - {b}) < 0", "sign({a} - {b}) >= 0"), ("min({a}, {b}) < {b}", "max({a}, {b}) == {a}"),
            ("{b} - {a} > 0", "{b} <= {a}"))  # fmt: skip

LONGEST = 2000  # characters of a formula


@dataclass(frozen=True)
class Line:
    """A line direction . (x, y) = place; 'below' it is where the left side is less."""

    direction: tuple[float, float]
    place: float

    def below(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return self.direction[0] * x + self.direction[1] * y < self.place

    def sides(self, _: int) -> tuple[str, str]:
        """What is compared."""
        a, b = self.direction
        return f"({a!r}*x + {b!r}*y)", f"({self.place!r})"


@dataclass(frozen=True)
class Circle(integrals.Circle):
    """A circle; 'below' it is inside of it."""

    def below(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (x - self.middle[0]) ** 2 + (y - self.middle[1]) ** 2 < self.radius**2

    def sides(self, spelling: int) -> tuple[str, str]:
        """What is compared."""
        (a, b), R = self.middle, self.radius
        if spelling % 2:
            return f"((x - ({a!r}))^2 + (y - ({b!r}))^2)", f"({R**2!r})"
        return f"hypot(x - ({a!r}), y - ({b!r}))", f"({R!r})"


Curve = Line | Circle
Side = tuple[Curve, bool]  # a curve, and whether below it


def compared(side: Side, spelling: int) -> str:
    """A condition as text."""
    curve, below = side
    a, b = curve.sides(spelling // len(COMPARED))
    return "(" + COMPARED[spelling % len(COMPARED)][not below].format(a=a, b=b) + ")"


@dataclass(frozen=True)
class Piecewise:
    """Expressions, each where all its conditions hold and those of none before; the last one has no conditions."""

    parts: Sequence[tuple[Sequence[Side], Expr]]

    @property
    def curves(self) -> list[Curve]:
        return [curve for sides, _ in self.parts for curve, _ in sides]

    def map(self, action: Callable[..., Expr], *others: Piecewise) -> Piecewise:
        """In each part, from its expression and those of others with the same parts."""
        columns = zip(*([value for _, value in one.parts] for one in (self, *others)), strict=True)
        return Piecewise([(sides, action(*values)) for (sides, _), values in zip(self.parts, columns, strict=True)])

    def text(self, spelling: int = 0) -> str:
        """As a formula of a scene: `where` in `where`, or the other way round."""
        *first, (_, last) = self.parts
        found = f"({last})"
        for sides, value in reversed(first):
            condition = " and ".join(compared(side, spelling) for side in sides)
            turned = f"where(not ({condition}), {found}, {value})"
            found = turned if spelling % 3 == 2 else f"where({condition}, {value}, {found})"
        return found

    def at(self, points_x: np.ndarray, points_y: np.ndarray) -> np.ndarray:
        """Values."""
        found, free = np.zeros(points_x.shape), np.ones(points_x.shape, dtype=bool)
        for sides, value in self.parts:
            here = reduce(np.logical_and, (curve.below(points_x, points_y) == below for curve, below in sides), free)
            found[here] = sympy.lambdify([x, y], value, "numpy", cse=True)(points_x[here], points_y[here])
            free = free & ~here
        return found


def everywhere(value: Expr | float) -> Piecewise:
    """One expression."""
    return Piecewise([((), sympy.sympify(value))])


def expression(text: str) -> Expr:
    """Of x and y."""
    return sympy.sympify(text, {"x": x, "y": y})


def load_of(u: Expr, tension: Expr) -> Expr:
    """-div(tension grad u)."""
    found = -sum(sympy.diff(tension * sympy.diff(u, s), s) for s in (x, y))
    return sympy.expand(found) if found.is_polynomial(x, y) else found


def distance(line: Line) -> Expr:
    """Left side less right side."""
    return line.direction[0] * x + line.direction[1] * y - line.place


def line_at(angle: float, place: float) -> Line:
    """The line of the points whose distance from the origin along a direction is given."""
    return Line((round(cos(angle), 15), round(sin(angle), 15)), place)


def square(middle: tuple[float, float]) -> Expr:
    """Squared distance from a point."""
    return (x - middle[0]) ** 2 + (y - middle[1]) ** 2


@dataclass(frozen=True)
class ClosedForm(Family):
    """A scene whose u is a sum of piecewise expressions, given on the whole boundary.

    Attributes:
        mesh: The table [mesh], or what `meshes.made` takes.
        options: Of `solve`.
        spelling: Number of a way to write conditions.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    spelling: int

    @abstractmethod
    def u(self) -> list[Piecewise]:
        """Its sum is u."""

    @abstractmethod
    def data(self) -> dict[str, Any]:
        """What a scene has in addition to mesh and boundary values."""

    def tension(self) -> Piecewise:
        """As numbers or expressions."""
        return everywhere(1)

    def poles(self) -> list[tuple[float, float]]:
        """Where the gradient is infinite, or not continuous."""
        return []

    def value(self) -> str:
        """u as the scene has it."""
        return " + ".join(part.text(self.spelling) for part in self.u())

    def scene(self, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
        """The scene (collective)."""
        return Scene(mesh=made(self.mesh, comm), boundary=[{"value": self.value()}], **self.data())

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(lambda: self.scene(judgement.comm), **self.options)
        if answer is not None:
            judgement.certificate(answer, *self.error(Field(answer.u)))

    def curves(self) -> list[Curve]:
        """Where expressions change."""
        return [curve for part in (*self.u(), self.tension()) for curve in part.curves]

    def nodes(self, field: Field, count: int = 10) -> Nodes:
        """Gauss points between the curves of the data."""
        curves = self.curves()
        pieces = Pieces.of(field)
        for line in dict.fromkeys(curve for curve in curves if isinstance(curve, Line)):
            pieces = pieces.cut(line.direction, [line.place])
        circles = list(dict.fromkeys(curve for curve in curves if isinstance(curve, Circle)))
        return pieces.along(circles, self.poles(), count)

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, from below, and the norm of u (collective)."""
        slopes = [[part.map(lambda value, s=s: sympy.diff(value, s)) for part in self.u()] for s in (x, y)]

        def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            along, across = (sum((part.at(x, y) for part in parts), np.zeros(x.shape)) for parts in slopes)
            return along, across

        return energy_error(field, self.nodes(field), self.tension().at, gradient)

    @property
    def short(self) -> bool:
        """Whether all its formulas are short enough for a scene."""
        return all(len(str(text)) < LONGEST for text in (self.value(), *self.data().values()))

    def text(self) -> str:
        asked = f"solve(scene, {self.options})"
        if self.mesh["shape"] != OWN:
            return toml(self.scene(), asked)
        return f"from {type(self).__module__} import {type(self).__name__}\n{self!r}.scene()  # {asked}"

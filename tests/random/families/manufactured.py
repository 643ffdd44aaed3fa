"""Manufactured solutions: u and the tension by SymPy's expressions in parts of the plane; load and flux follow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, reduce
from math import cos, sin
from typing import Any

import numpy as np
import sympy
from mpi4py import MPI
from sympy import Expr

from tests.random.families.elements import Field
from tests.random.families.family import ClosedForm
from tests.random.families.integrals import BLOCK, Circle, Nodes, Pieces, intervals
from tests.random.families.meshes import made

x, y = sympy.symbols("x y", real=True)
COMPARED = (("{a} < {b}", "{a} >= {b}"), ("not {a} >= {b}", "not {a} < {b}"),
            ("sign({a} - {b}) < 0", "sign({a} - {b}) >= 0"), ("min({a}, {b}) < {b}", "max({a}, {b}) == {a}"),
            ("{b} - {a} > 0", "{b} <= {a}"))  # fmt: skip
SIDES = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}


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
        """In each part, from its expression and those of others with the same parts, or with one for all."""
        many = [list(one.parts) * (len(self.parts) if len(one.parts) == 1 else 1) for one in others]
        return Piecewise([
            (sides, action(value, *(part[1] for part in rest)))
            for (sides, value), *rest in zip(self.parts, *many, strict=True)
        ])  # fmt: skip

    def text(self, spelling: int = 0, *, products: bool = False) -> str:
        """As a formula of a scene: `where` in `where`, or the other way round, or products with conditions."""
        *first, (_, last) = self.parts
        found = f"({last})"
        for sides, value in reversed(first):
            condition = " and ".join(compared(side, spelling) for side in sides)
            if products and spelling % 3 == 1:
                found = f"(({value})*({condition}) + ({found})*(not ({condition})))"
            elif spelling % 3 == 2:
                other = " or ".join(compared((curve, not below), spelling) for curve, below in sides)
                found = f"where({other}, {found}, {value})"
            else:
                found = f"where({condition}, {value}, {found})"
        return found

    def at(self, points_x: np.ndarray, points_y: np.ndarray) -> np.ndarray:
        """Values."""
        found, free = np.zeros(points_x.shape), np.ones(points_x.shape, dtype=bool)
        for sides, value in self.parts:
            here = reduce(np.logical_and, (curve.below(points_x, points_y) == below for curve, below in sides), free)
            found[here] = _function(value)(points_x[here], points_y[here])
            free = free & ~here
        return found


@lru_cache(maxsize=100)
def _function(value: Expr) -> Callable[..., np.ndarray]:
    return sympy.lambdify([x, y], value, "numpy", cse=True)


def everywhere(value: Expr | float) -> Piecewise:
    """One expression."""
    return Piecewise([((), sympy.sympify(value))])


def expression(text: str) -> Expr:
    """Of x and y."""
    return sympy.sympify(text, {"x": x, "y": y})


def load_of(u: Expr, tension: Expr, foundation: Expr | float = 0, *, axial: bool = False) -> Expr:
    """-div(tension grad u) + foundation u; with axial symmetry x is the radius."""
    found = -sum(sympy.diff(tension * sympy.diff(u, s), s) for s in (x, y)) + foundation * u
    if axial:
        found -= tension * sympy.expand(sympy.expand(sympy.diff(u, x)) / x)
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
class Manufactured(ClosedForm):
    """A scene in the plane or on a line whose u is a sum of piecewise expressions.

    Attributes:
        spelling: Number of a way to write conditions.
    """

    spelling: int

    longest_flux = 4000

    def built(self, comm: MPI.Comm) -> Any:
        return made(self.mesh, comm)

    def u(self) -> list[Piecewise]:
        """Its sum is u, by default of the attribute `formula`; where `gradient` is given instead there are none."""
        formula = getattr(self, "formula", None)
        return [] if formula is None else [everywhere(expression(formula))]

    @property
    def sign(self) -> int:
        """-1 where all is upside down: a family that can be so has an attribute `upper`."""
        return -1 if getattr(self, "upper", False) else 1

    @property
    def side(self) -> str:
        """That of the obstacle."""
        return "lower" if self.sign > 0 else "upper"

    def tension(self) -> Piecewise:
        """As numbers or expressions; the same everywhere where the family has an attribute `stiff`, or 1."""
        return everywhere(expression(str(getattr(self, "stiff", 1))))

    def foundation(self) -> Piecewise | None:
        """Its stiffness, of the attribute `bed`, a formula."""
        bed = getattr(self, "bed", "0")
        return everywhere(expression(bed)) if bed != "0" else None

    @property
    def around_axis(self) -> bool:
        """Whether x is a radius: the attribute `axial`."""
        return getattr(self, "axial", False)

    def balance(self) -> Piecewise:
        """What the only part of u is in balance with where there is no contact."""
        (u,), k = self.u(), self.foundation() or everywhere(0)
        return u.map(lambda *of: load_of(*of, axial=self.around_axis), self.tension(), k)

    def data(self) -> dict[str, Any]:
        found: dict[str, Any] = {"tension": self.tension(), "load": self.balance(), "foundation": self.foundation()}
        found = {key: part.text(self.spelling) for key, part in found.items() if part is not None}
        return {**found, "axial_symmetry": True} if self.around_axis else found

    def boundary(self) -> list[dict[str, Any]]:
        """The parts of the boundary: without u at those of the attribute `sides`."""
        free = getattr(self, "sides", ())
        given = [side for side in self.held_sides() if side not in free]
        return [*([{"on": given, "value": self.value()}] if given else []),
                *(self.natural(side, self.support()) for side in free)] if free else super().boundary()  # fmt: skip

    def held_sides(self) -> Sequence[str]:
        """Those where u is given, or a flux."""
        return list(SIDES)

    def support(self) -> str:
        """Where a flux is given, as text; empty for none."""
        return ""

    def poles(self) -> list[tuple[float, float]]:
        """Where the gradient is infinite, or not continuous."""
        return []

    def value(self) -> str:
        return " + ".join(part.text(self.spelling) for part in self.u())

    def natural(self, side: str, spring: str = "", more: str = "") -> dict[str, Any]:
        """A side where the flux of u is given in place of u, with springs, and with more forces, as text."""
        nx, ny = SIDES[side]
        outward = (
            part.map(lambda u, tension: tension * (nx * sympy.diff(u, x) + ny * sympy.diff(u, y)), self.tension())
            for part in self.u()
        )
        flux = " + ".join(part.text(self.spelling) for part in outward) + more
        return {"on": side, "flux": f"{flux} + {spring}*({self.value()})", "spring": spring} if spring else {
            "on": side, "flux": flux}  # fmt: skip

    def curves(self) -> list[Curve]:
        """Where expressions change."""
        return [curve for part in (*self.u(), self.tension()) for curve in part.curves]

    def nodes(self, field: Field, count: int = 10) -> Nodes:
        """Gauss points between the curves of the data."""
        lines: dict[tuple[float, float], set[float]] = {}
        for curve in (curves := self.curves()):
            if isinstance(curve, Line):
                lines.setdefault(curve.direction, set()).add(curve.place)
        if field.vertices.shape[2] == 1:
            return intervals(field, sorted(lines.get((1.0, 0.0), ())))
        pieces = Pieces.of(field)
        for direction, places in lines.items():
            pieces = pieces.cut(direction, sorted(places))
        circles = list(dict.fromkeys(curve for curve in curves if isinstance(curve, Circle)))
        return pieces.along(circles, self.poles(), count)

    @cached_property
    def _slopes(self) -> list[list[Piecewise]]:
        return [[part.map(lambda value, s=s: sympy.diff(value, s)) for part in self.u()] for s in (x, y)]

    def gradient(self, px: np.ndarray, py: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of u at points."""
        along, across = (sum((part.at(px, py) for part in parts), np.zeros(px.shape)) for parts in self._slopes)
        return along, across

    def stiffness(self, px: np.ndarray, py: np.ndarray) -> np.ndarray:
        """The tension at points, or matrices of shape (n, 2, 2)."""
        return self.tension().at(px, py)

    def error(self, field: Field) -> tuple[float, float]:
        nodes, k = self.nodes(field), self.foundation()
        if self.around_axis:
            nodes = replace(nodes, weights=nodes.weights * nodes.points[:, 0])
        found = np.zeros(2)
        for some in np.array_split(np.arange(len(nodes.cells)), max(1, len(nodes.cells) // BLOCK)):
            part = nodes[some]
            (px, py), dim = part.coordinates, part.points.shape[1]
            stiff = self.stiffness(px, py)
            stiff = stiff if stiff.ndim == 3 else stiff[:, None, None] * np.eye(dim)
            true = np.stack(np.broadcast_arrays(*self.gradient(px, py))[:dim], axis=1)
            off = field.gradient(part.cells, part.points[:, None])[:, 0] - true
            found += [part.weights @ np.einsum("ni,nij,nj->n", one, stiff, one) for one in (off, true)]
            if k is not None:
                of_u = field.at(part.cells, part.points[:, None])[:, 0] - sum(one.at(px, py) for one in self.u())
                found[0] += part.weights @ (k.at(px, py) * of_u**2)
        error, norm = np.sqrt(field.comm.allreduce(found))
        return float(error), float(norm)

"""Tensions that jump along a circle, and loads with a pole: u is harmonic in parts, or a power of r."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.elements import Field
from tests.random.families.family import Family, Judgement, toml
from tests.random.families.integrals import Circle, Pieces, energy_error
from tests.random.families.strategies import bounds, grids, place, power

CIRCLES = ("where(r < {a}, {k}, 1)", "where(x^2 + y^2 < {aa}, {k}, 1)", "({k})*(r < {a}) + (r >= {a})",
           "where(hypot(x, y) >= {a}, 1, {k})")  # fmt: skip


@dataclass(frozen=True)
class Inclusion(Family):
    """A disk of another tension in a square: u = x (1 + B/r^2) outside of it, A x inside.

    Attributes:
        mesh: The table [mesh].
        options: Of `solve`.
        corner: Lower left corner of the unit square.
        radius: Of the disk, whose centre is the origin.
        tension: In the disk; 1 outside.
        spelling: How the jump is written.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    corner: tuple[float, float]
    radius: float
    tension: float
    spelling: str

    name = "inclusion"

    def scene(self) -> Scene:
        a, k = self.radius, self.tension
        value = f"where(r < {a!r}, {2 / (1 + k)!r}*x, x*(1 + ({(1 - k) / (1 + k) * a**2!r})/max(r, {a / 2!r})^2))"
        ends = {axis: [start, start + 1] for axis, start in zip("xy", self.corner, strict=True)}
        return Scene(mesh={**self.mesh, **ends}, boundary=[{"value": value}],
                     tension=self.spelling.format(a=repr(a), aa=repr(a**2), k=repr(k)))  # fmt: skip

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(self.scene, **self.options)
        if answer is not None:
            judgement.certificate(answer, *self.error(Field(answer.u)))

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, and the norm of u (collective)."""
        a, k = self.radius, self.tension
        B = (1 - k) / (1 + k) * a**2

        def tension(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return np.where(x**2 + y**2 < a**2, k, 1.0)

        def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            square = np.maximum(x**2 + y**2, a**2 / 4)
            inside = x**2 + y**2 < a**2
            along = 1 + B * (y**2 - x**2) / square**2
            return np.where(inside, 2 / (1 + k), along), np.where(inside, 0.0, -2 * B * x * y / square**2)

        return energy_error(field, Pieces.of(field).along([Circle((0.0, 0.0), a)]), tension, gradient)

    def text(self) -> str:
        return toml(self.scene(), f"solve(scene, {self.options})")


@st.composite
def inclusions(draw: st.DrawFn) -> Inclusion:
    """Contrasts up to 1e6; the square holds all of the disk or a quarter of it."""
    corner = draw(st.sampled_from([(0.0, 0.0), (-0.5, -0.5), (-0.613, 0.0), (-0.5, -0.377)]))
    return Inclusion(draw(grids()), draw(bounds()), corner, draw(place(0.1, 0.45 if corner[0] else 0.95)),
                     draw(st.one_of(power(-6, 6), power(-1, 1))), draw(st.sampled_from(CIRCLES)))  # fmt: skip


@dataclass(frozen=True)
class Pole(Family):
    """u = r^a: the load is a power of r, square integrable where a > 1.

    Attributes:
        mesh: The table [mesh].
        options: Of `solve`.
        corner: Lower left corner of the unit square.
        power: a.
        tension: The same everywhere.
        cut: Radius within which the load is that of this radius; 0 for a load that is set to 0 at the pole only.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    corner: tuple[float, float]
    power: float
    tension: float
    cut: float

    name = "pole"

    def scene(self) -> Scene:
        size, power_ = -self.tension * self.power**2, self.power - 2
        load = f"{size!r}*max(r, {self.cut!r})^({power_!r})" if self.cut else (
            f"where(r > 0, {size!r}*r^({power_!r}), 0)")  # fmt: skip
        ends = {axis: [start, start + 1] for axis, start in zip("xy", self.corner, strict=True)}
        return Scene(mesh={**self.mesh, **ends}, tension=self.tension, load=load,
                     boundary=[{"value": f"r^{self.power!r}"}])  # fmt: skip

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(self.scene, **self.options)
        if answer is None:
            return
        judgement.certificate(answer, *self.error(Field(answer.u)))
        if self.power <= 1 and not self.cut:
            judgement.not_certified(answer, "the load is not square integrable")

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field from below, since the last pieces at the pole are omitted; norm of u (collective)."""
        a = self.power

        def tension(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return np.full_like(x, self.tension)

        def gradient(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            slope = a * (x**2 + y**2) ** (a / 2 - 1)
            return slope * x, slope * y

        return energy_error(field, Pieces.of(field).along([], [(0.0, 0.0)], count=10), tension, gradient)

    def text(self) -> str:
        return toml(self.scene(), f"solve(scene, {self.options})")


@st.composite
def poles(draw: st.DrawFn) -> Pole:
    """Mostly loads that are not square integrable."""
    corner = draw(st.sampled_from([(0.0, 0.0), (-0.5, -0.5), (-0.377, -0.613), (-0.377, 0.0)]))
    exponent = draw(st.one_of(place(0.05, 1), place(1, 2)))
    return Pole(draw(grids()), draw(bounds()), corner, exponent, draw(st.sampled_from([1.0, 7.3])),
                draw(st.sampled_from([0.0, 0.0, 1e-12])))  # fmt: skip

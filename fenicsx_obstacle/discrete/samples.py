"""Formulas sampled on a mesh: at nodes, in cells, at points; what is not finite is refused with its place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property, partial
from typing import Any, TypeAlias, TypeVar

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes.formulas import Formula, nearest
from fenicsx_obstacle.scenes.materials import Materials, Value
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.vocabulary import COORDINATES, TIME

Cellwise: TypeAlias = fem.Function | fem.Constant
Sampled = TypeVar("Sampled", bound=Cellwise)
STEEP = 3.0  # quadratics through positive values stay positive up to 4 on triangles, 4.5 on squares, 3.09 on cubes
INWARD = 1e-6  # of the way to the middle of the cell


def array_of(function: Cellwise) -> np.ndarray:
    """Values at local dofs, or the one there is."""
    return np.atleast_1d(function.value) if isinstance(function, fem.Constant) else function.x.array


def _flatten_jumps(tension: fem.Function) -> None:
    """Give a cell in which positive nodal values jump their mean: the polynomial through them could be negative."""
    dofs = releases.cell_dofs(tension.function_space)
    values = tension.x.array[dofs]
    steep = values.max(axis=1) > STEEP * values.min(axis=1)
    tension.x.array[dofs[steep]] = values[steep].mean(axis=1)[:, None]


class Samples:
    """The formulas of a scene on one level.

    Attributes:
        moving: What depends on time, and how it is sampled.
    """

    def __init__(self, scene: Scene, level: Level):
        self.scene, self.level = scene, level
        self._cellwise: dict[str, Cellwise] = {}
        self.moving: dict[Cellwise, Callable[[], Cellwise]] = {}

    @property
    def now(self) -> dict[str, float]:
        """The value of t, where there is time."""
        return {}

    def follow(self, values: Iterable[Value], sample: Callable[[], Sampled]) -> Sampled:
        """What is sampled of some values; if they depend on time it is renewed whenever time goes on (collective)."""
        made = sample()
        if any(TIME in self.scene.needs(value) for value in values):
            self.moving[made] = sample
        return made

    def renew(self) -> None:
        """Sample anew what depends on time (collective).

        Raises:
            InputError: If it is not finite somewhere, or out of bounds.
        """
        for made, sample in self.moving.items():
            fresh = sample()  # has to live as long as its values are read
            if isinstance(made, fem.Constant):
                made.value = fresh.value
            else:
                made.x.array[:] = fresh.x.array

    def cellwise(self, value: Value, *, positive: bool = False, least: float | None = None) -> Cellwise:
        """One value per cell, taken at its midpoint, or as many as `Level.W` has (collective on first use).

        A Constant if all are the same.

        Raises:
            InputError: If it is not finite, or not positive, or below the least, somewhere, or a material has no value.
        """
        if value.place not in self._cellwise:
            sample = partial(self._checked_cells, value, positive, least)
            self._cellwise[value.place] = self.follow([value], sample)
        return self._cellwise[value.place]

    def nodal(self, value: Formula, values: Mapping[str, float] | None = None) -> fem.Function:
        """Nodal interpolant in V, with values of further names (collective).

        Raises:
            InputError: If it is not finite somewhere.
        """
        function = fem.Function(self.level.V)
        self._sample(function, value, values)
        return function

    def at_nodes(self, value: Value) -> np.ndarray:
        """Values of a formula at owned nodes (collective).

        Raises:
            InputError: If it is given by materials, which share nodes, or is not finite somewhere.
        """
        if isinstance(value, Materials):
            raise InputError(f"{value.place}: element {self.level.pair.name} takes one formula for all materials")
        return self.nodal(value).x.array[: self.level.owned]

    @cached_property
    def distance(self) -> fem.Function:
        """Nodal distance to the boundary (first use is collective)."""
        return self.nodal(self.scene.formula("distance", "distance"))

    @cached_property
    def boundary_distance(self) -> Callable[[np.ndarray], np.ndarray]:
        """Distance to the boundary of points (n, 3) (first use is collective)."""
        from fenicsx_obstacle.discrete.distance import BoundaryDistance  # with scipy: only where a scene names it

        return BoundaryDistance(self.level)

    def uniform(self, value: Value) -> bool:
        """Whether a value is the same number everywhere."""
        return isinstance(value, Formula) and not self.scene.needs(value) & {*COORDINATES, "distance"}

    def _points(self, V: fem.FunctionSpace) -> np.ndarray:
        """Points of the local dofs, shape (3, dofs)."""
        if V is self.level.V:
            return self.level.points
        points = np.array(V.tabulate_dof_coordinates().T)
        if V is self.level.W and self.level.pair.degree > 1:
            # what jumps between cells has its value from within
            dofs = releases.cell_dofs(V)
            middle = corners(self.level.mesh).mean(axis=1).T[:, :, None]
            points[:, dofs] += INWARD * (middle - points[:, dofs])
        return points

    def _sample(self, function: fem.Function, formula: Formula, values: Mapping[str, float] | None = None) -> None:
        if self.uniform(formula):
            function.x.array[:] = self.scene.at_points(formula, np.zeros((3, 1)), {**self.now, **(values or {})})
        else:
            function.x.array[:] = self._at_points(formula, self._points(function.function_space), values)
            function.x.scatter_forward()  # points of ghosts may differ from their owner's in the last digit
        self._refuse_infinite(formula, function)

    def _checked_cells(self, value: Value, positive: bool, least: float | None) -> Cellwise:
        made = self._sample_cells(value)
        if positive:
            self._refuse(value, made, array_of(made) <= 0, "must be positive; it is")
            if isinstance(made, fem.Function) and self.level.pair.degree > 1:
                _flatten_jumps(made)
        if least is not None:
            self._refuse(value, made, array_of(made) < least, f"must be at least {least:g}; it is")
        bound = 0.0 if positive else least
        if bound is not None and value.place not in self._cellwise:  # once: not for each moment
            self._check_between(value, bound, "be positive" if positive else f"be at least {bound:g}")
        return made

    def _check_between(self, value: Value, bound: float, what: str) -> None:
        """Refuse values below a bound where no cell has its midpoint (collective)."""
        parts = [(None, value)] if isinstance(value, Formula) else list(value.parts.items())
        for material, formula in parts:
            if self.uniform(formula):
                continue
            from fenicsx_obstacle.discrete.between import inadmissible  # only where a scene has formulas

            sample = partial(self._at_points, formula)
            found = inadmissible(self, [formula], sample, bound, material)
            if found is not None:
                number, point = found
                raise InputError(f"{value.place} = {value.text}: must {what}; it is {number:g} at {self.at(point)}")

    def _sample_cells(self, value: Value) -> Cellwise:
        if isinstance(value, Formula) and self.uniform(value):
            number = self.scene.at_points(value, np.zeros((3, 1)), self.now)[0]
            constant = fem.Constant(self.level.mesh, PETSc.ScalarType(number))
            self._refuse_infinite(value, constant)
            return constant
        function = fem.Function(self.level.W)
        if isinstance(value, Materials):
            self._sample_materials(function, value)
        else:
            self._sample(function, value)
        return function

    def _sample_materials(self, function: fem.Function, value: Materials) -> None:
        """Each formula in the cells of its material: every cell must have one value (collective)."""
        groups, comm, points = self.level.groups, self.level.comm, self._points(self.level.W)
        values, times = function.x.array, np.zeros(len(function.x.array), dtype=int)
        for name, formula in value.parts.items():
            if name not in groups:
                hint = nearest(name, groups) if groups else "; the mesh has no named groups of cells"
                raise InputError(f"{value.place}: no material named '{name}'" + hint)
            inside = self.level.indicator(name)
            values[inside] = self._at_points(formula, points[:, inside])
            times += inside
        for name in groups:
            if total(comm, np.count_nonzero(self.level.indicator(name) & (times == 0))) > 0:
                raise InputError(f"{value.place} = {value.text}: no value for the material '{name}'")
        for bad, what in ((times == 0, "no value for a cell without material"), (times > 1, "two values for a cell")):
            found = self._first(function, bad)
            if found is not None:
                raise InputError(f"{value.place} = {value.text}: {what} at {self.at(found[1])}")
        function.x.scatter_forward()
        self._refuse_infinite(value, function)

    def _at_points(self, formula: Formula, x: np.ndarray, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Values at points (3, n) (collective if the formula names the distance)."""
        return self.scene.at_points(formula, x, {**self.known(formula, x), **(values or {})})

    def known(self, formula: Formula, x: np.ndarray) -> dict[str, Any]:
        """Values of t and the distance at points (3, n) (collective if the formula names the distance)."""
        named = "distance" in self.scene.needs(formula)
        return {**self.now, **({"distance": self.boundary_distance(x.T)} if named else {})}

    def _refuse_infinite(self, formula: Value, function: Cellwise) -> None:
        self._refuse(formula, function, ~np.isfinite(array_of(function)), "is not a finite number: it is")

    def _refuse(self, formula: Value, function: Cellwise, bad: np.ndarray, what: str) -> None:
        """All ranks raise if any value is bad, naming one place (collective)."""
        if isinstance(function, fem.Constant):
            if bad.any():
                because = self.scene.infinite(formula, np.zeros(3), self.now)
                raise InputError(f"{formula.place} = {formula.text}: {what} {function.value:g}{because}")
            return
        found = self._first(function, bad)
        if found is not None:
            value, point = found
            because = self.scene.infinite(formula, point, self.now)
            raise InputError(f"{formula.place} = {formula.text}: {what} {value:g} at {self.at(point)}{because}")

    def _first(self, function: fem.Function, bad: np.ndarray) -> tuple[float, np.ndarray] | None:
        """Value and place of the first bad dof, the same on every rank (collective)."""
        points, values = self._points(function.function_space).T, function.x.array
        mine = (values[np.argmax(bad)], points[np.argmax(bad)]) if bad.any() else None
        return next((one for one in self.level.comm.allgather(mine) if one is not None), None)

    def at(self, point: np.ndarray) -> str:
        return "(" + ", ".join(f"{x:.4g}" for x in point[: self.level.mesh.geometry.dim]) + ")"

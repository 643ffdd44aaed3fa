"""A scene's formulas sampled on a mesh, once, and checked: nothing after this sees a formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TypeAlias

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes.formulas import Formula, nearest
from fenicsx_obstacle.scenes.materials import Materials, Value
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.vocabulary import COORDINATES

Cellwise: TypeAlias = fem.Function | fem.Constant
STEEP = 3.0  # quadratics through positive values stay positive up to 4 on triangles, 4.5 on squares, 3.09 on cubes
INWARD = 1e-6  # of the way to the middle of the cell
ROUND_OFF = 1e-10  # of the heights: obstacle and boundary value may come from different formulas


def array_of(function: Cellwise) -> np.ndarray:
    """Values at local dofs, or the one there is."""
    return np.atleast_1d(function.value) if isinstance(function, fem.Constant) else function.x.array


def _flatten_jumps(tension: fem.Function) -> None:
    """Give a cell in which positive nodal values jump their mean: the polynomial through them could be negative."""
    dofs = releases.cell_dofs(tension.function_space)
    values = tension.x.array[dofs]
    steep = values.max(axis=1) > STEEP * values.min(axis=1)
    tension.x.array[dofs[steep]] = values[steep].mean(axis=1)[:, None]


class Data:
    """What the effects, obstacles and boundary values of a scene are on one level.

    Everything is sampled on first use, which is collective, and kept.
    """

    def __init__(self, scene: Scene, level: Level):
        self.scene, self.level = scene, level
        self._cellwise: dict[str, Cellwise] = {}
        self._givers: list[tuple[str, np.ndarray]] = []  # where a boundary value stands, and the dofs that have it

    @cached_property
    def dx(self) -> ufl.Measure:
        """Integration over the domain."""
        return ufl.Measure("dx", domain=self.level.mesh)

    def cellwise(self, value: Value, *, positive: bool = False) -> Cellwise:
        """One value per cell, taken at its midpoint, or as many as `Level.W` has (collective on first use).

        A Constant if all are the same.

        Raises:
            InputError: If it is not finite, or not positive, somewhere, or a material has no value.
        """
        if value.place not in self._cellwise:
            made = self._sample_cells(value)
            if positive:
                self._refuse(value, made, array_of(made) <= 0, "must be positive; it is")
                if isinstance(made, fem.Function) and self.level.pair.degree > 1:
                    _flatten_jumps(made)
            self._cellwise[value.place] = made
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
    def lower(self) -> fem.Function | None:
        """Nodal lower obstacle (first use is collective)."""
        return self._obstacle("lower")

    @cached_property
    def upper(self) -> fem.Function | None:
        """Nodal upper obstacle (first use is collective)."""
        return self._obstacle("upper")

    @cached_property
    def held(self) -> list[np.ndarray]:
        """Local facets where u is given, of each [[boundary]] (first use is collective)."""
        parts = enumerate(self.scene.tables.boundary, start=1)
        return [self._facets(part.on, part.where, f"[[boundary]] (no. {number})") for number, part in parts]

    @cached_property
    def fixed(self) -> tuple[np.ndarray, fem.Function]:
        """Local dofs where u is given, sorted, and the values there (first use is collective)."""
        level, values = self.level, fem.Function(self.level.V)
        fixed = np.zeros(len(values.x.array), dtype=bool)
        for number, (part, facets) in enumerate(zip(self.scene.tables.boundary, self.held, strict=True)):
            place = f"[[boundary]] (no. {number + 1})"
            dofs = fem.locate_dofs_topological(level.V, level.mesh.topology.dim - 1, facets)
            formula = self.scene.formula(0.0 if part.value is None else part.value, f"{place} value")
            function = fem.Function(level.V)
            function.x.array[dofs] = self._at_points(formula, level.points[:, dofs])
            self._refuse_infinite(formula, function)
            values.x.array[dofs] = function.x.array[dofs]
            fixed[dofs] = True
            self._givers.append((f"{formula.place} = {formula.text}", dofs))
        values.x.scatter_forward()
        return np.flatnonzero(fixed).astype(np.int32), values

    def check(self) -> None:
        """Refuse obstacles that cross and boundary values beyond them: no u could satisfy both (collective).

        Where a boundary value is beyond an obstacle by round-off only, the obstacle gives way.

        Raises:
            InputError: Naming the place and the gap.
        """
        comm, source = self.level.comm, self.scene.source
        dofs, values = self.fixed
        if self.lower is None and self.upper is None and total(comm, len(dofs)) == 0:
            raise InputError(f"{source}: u is given nowhere, and no obstacle holds it: add a [[boundary]] with a value")
        heights = [f.x.array for f in (self.lower, self.upper) if f is not None] + [values.x.array[dofs]]
        high, low = largest(comm, np.concatenate(heights)), smallest(comm, np.concatenate(heights))
        tolerance = ROUND_OFF * (high - low) + 8 * float(np.finfo(float).eps) * max(abs(high), abs(low))
        if self.lower is not None and self.upper is not None:
            crossing = self.lower.x.array - self.upper.x.array
            self._refuse_gap(crossing, tolerance, f"{source}: [obstacle] lower is above upper")
        for obstacle, sign, word in ((self.lower, 1, "lower"), (self.upper, -1, "upper")):
            if obstacle is None:
                continue
            beyond = np.full(len(values.x.array), -np.inf)
            beyond[dofs] = sign * (obstacle.x.array - values.x.array)[dofs]
            side = "below" if word == "lower" else "above"
            self._refuse_beyond(beyond, tolerance, values, obstacle, f"lies {side} the {word} obstacle")
            obstacle.x.array[beyond > 0] = values.x.array[beyond > 0]

    def _obstacle(self, key: str) -> fem.Function | None:
        value = getattr(self.scene.tables.obstacle, key)
        return None if value is None else self.nodal(self.scene.formula(value, f"[obstacle] {key}"))

    def _facets(self, on: str | tuple[str, ...] | None, where: str | None, place: str) -> np.ndarray:
        level = self.level
        if where is not None:
            formula = self.scene.formula(where, f"{place} where")
            dim = level.mesh.topology.dim - 1
            values, rim = fem.Function(level.V), fem.locate_dofs_topological(level.V, dim, level.boundary_facets)
            values.x.array[rim] = self.scene.at_points(formula, level.points[:, rim])
            self._refuse_infinite(formula, values)
            found = dmesh.locate_entities_boundary(level.mesh, dim, lambda x: self.scene.at_points(formula, x) != 0)
            if total(level.comm, len(found)) == 0:
                raise InputError(f"{formula.place} = {formula.text}: holds on no facet of the boundary")
            return found
        if on is None:
            return level.boundary_facets
        names = (on,) if isinstance(on, str) else on
        for name in names:
            if name not in level.facets:
                raise InputError(
                    f"{self.scene.source}: {place} on: no part named '{name}'" + nearest(name, level.facets)
                )
            if total(level.comm, len(level.facets[name])) == 0:
                what = "no facet of the mesh lies on it; a part inside must be embedded in its domain"
                raise InputError(f"{self.scene.source}: {place} on = '{name}': {what}")
        return np.unique(np.concatenate([level.facets[name] for name in names])).astype(np.int32)

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
            function.x.array[:] = self.scene.at_points(formula, np.zeros((3, 1)), values)
        else:
            function.x.array[:] = self._at_points(formula, self._points(function.function_space), values)
            function.x.scatter_forward()  # points of ghosts may differ from their owner's in the last digit
        self._refuse_infinite(formula, function)

    def uniform(self, value: Value) -> bool:
        """Whether a value is the same number everywhere."""
        return isinstance(value, Formula) and not self.scene.needs(value) & {*COORDINATES, "distance"}

    def _sample_cells(self, value: Value) -> Cellwise:
        if isinstance(value, Formula) and self.uniform(value):
            number = self.scene.at_points(value, np.zeros((3, 1)))[0]
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
                raise InputError(f"{value.place} = {value.text}: {what} at {self._at(found[1])}")
        function.x.scatter_forward()
        self._refuse_infinite(value, function)

    @cached_property
    def boundary_distance(self) -> Callable[[np.ndarray], np.ndarray]:
        """Distance to the boundary of points (n, 3) (first use is collective)."""
        from fenicsx_obstacle.discrete.distance import BoundaryDistance  # with scipy: only where a scene names it

        return BoundaryDistance(self.level)

    def _at_points(self, formula: Formula, x: np.ndarray, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Values at points (3, n) (collective if the formula names the distance)."""
        named = "distance" in self.scene.needs(formula)
        known = {**(values or {}), **({"distance": self.boundary_distance(x.T)} if named else {})}
        return self.scene.at_points(formula, x, known)

    def _refuse_infinite(self, formula: Value, function: Cellwise) -> None:
        self._refuse(formula, function, ~np.isfinite(array_of(function)), "is not a finite number: it is")

    def _refuse(self, formula: Value, function: Cellwise, bad: np.ndarray, what: str) -> None:
        """All ranks raise if any value is bad, naming one place (collective)."""
        if isinstance(function, fem.Constant):
            if bad.any():
                because = self.scene.infinite(formula, np.zeros(3))
                raise InputError(f"{formula.place} = {formula.text}: {what} {function.value:g}{because}")
            return
        found = self._first(function, bad)
        if found is not None:
            value, point = found
            because = self.scene.infinite(formula, point)
            raise InputError(f"{formula.place} = {formula.text}: {what} {value:g} at {self._at(point)}{because}")

    def _first(self, function: fem.Function, bad: np.ndarray) -> tuple[float, np.ndarray] | None:
        """Value and place of the first bad dof, the same on every rank (collective)."""
        points, values = self._points(function.function_space).T, function.x.array
        mine = (values[np.argmax(bad)], points[np.argmax(bad)]) if bad.any() else None
        return next((one for one in self.level.comm.allgather(mine) if one is not None), None)

    def _refuse_beyond(
        self, beyond: np.ndarray, tolerance: float, values: fem.Function, obstacle: fem.Function, where: str
    ) -> None:
        """Likewise for boundary values beyond an obstacle, naming who gave the value (collective)."""
        found = self._worst(beyond, tolerance)
        if found is not None:
            _, point, dof = found
            mine = None
            if dof is not None:
                giver = next(place for place, dofs in reversed(self._givers) if dof in dofs)
                mine = f"{giver} {where}: {values.x.array[dof]:.6g} against {obstacle.x.array[dof]:.6g}"
            message = next(text for text in self.level.comm.allgather(mine) if text is not None)
            raise InputError(f"{message} at {self._at(point)}, so that no u satisfies both")

    def _refuse_gap(self, excess: np.ndarray, tolerance: float, message: str) -> None:
        """All ranks raise if the largest excess is above the tolerance, naming its place (collective)."""
        found = self._worst(excess, tolerance)
        if found is not None:
            raise InputError(f"{message}: by {found[0]:.3g} at {self._at(found[1])}")

    def _worst(self, excess: np.ndarray, tolerance: float) -> tuple[float, np.ndarray, int | None] | None:
        """The largest excess above the tolerance, its place, and the dof there on ranks that have it (collective).

        Of places alike it is the first by coordinates, whatever the partition.
        """
        gap = largest(self.level.comm, excess)
        if gap <= tolerance:
            return None
        dofs = np.flatnonzero(excess >= gap * (1 - 1e-9))
        mine = min(((self.level.points[:, dof].tolist(), int(dof)) for dof in dofs), default=None)
        point = min(one[0] for one in self.level.comm.allgather(mine) if one is not None)
        return gap, np.array(point), None if mine is None or mine[0] != point else mine[1]

    def _at(self, point: np.ndarray) -> str:
        return "(" + ", ".join(f"{x:.4g}" for x in point[: self.level.mesh.geometry.dim]) + ")"

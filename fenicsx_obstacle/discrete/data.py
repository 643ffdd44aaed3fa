"""A scene's formulas sampled on a mesh, once, and checked: nothing after this sees a formula."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest
from fenicsx_obstacle.scenes.formulas import Formula, nearest
from fenicsx_obstacle.scenes.scene import Scene

ROUND_OFF = 1e-10  # of the heights: obstacle and boundary value may come from different formulas


class Data:
    """What the effects, obstacles and boundary values of a scene are on one level.

    Everything is sampled on first use, which is collective, and kept.
    """

    def __init__(self, scene: Scene, level: Level):
        self.scene, self.level = scene, level
        self._cellwise: dict[str, fem.Function] = {}

    @cached_property
    def dx(self) -> ufl.Measure:
        """Integration over the domain."""
        return ufl.Measure("dx", domain=self.level.mesh)

    def cellwise(self, value: Formula, *, positive: bool = False) -> fem.Function:
        """Function with one value per cell, taken at its midpoint (collective on first use).

        Raises:
            InputError: If it is not finite, or not positive, somewhere.
        """
        if value.place not in self._cellwise:
            function = fem.Function(self.level.W)
            self._sample(function, value)
            if positive:
                self._refuse(value, function, function.x.array <= 0, "must be positive; it is")
            self._cellwise[value.place] = function
        return self._cellwise[value.place]

    def nodal(self, value: Formula) -> fem.Function:
        """Nodal interpolant in V (collective).

        Raises:
            InputError: If it is not finite somewhere.
        """
        function = fem.Function(self.level.V)
        self._sample(function, value)
        return function

    @cached_property
    def lower(self) -> fem.Function | None:
        """Nodal lower obstacle (first use is collective)."""
        return self._obstacle("lower")

    @cached_property
    def upper(self) -> fem.Function | None:
        """Nodal upper obstacle (first use is collective)."""
        return self._obstacle("upper")

    @cached_property
    def fixed(self) -> tuple[np.ndarray, fem.Function]:
        """Local dofs where u is given, sorted, and the values there (first use is collective)."""
        level, values = self.level, fem.Function(self.level.V)
        fixed = np.zeros(len(values.x.array), dtype=bool)
        for number, part in enumerate(self.scene.tables.boundary):
            place = f"[[boundary]] (no. {number + 1})"
            facets = self._facets(part.on, part.where, place)
            dofs = fem.locate_dofs_topological(level.V, level.mesh.topology.dim - 1, facets)
            formula = self.scene.formula(0.0 if part.value is None else part.value, f"{place} value")
            function = fem.Function(level.V)
            function.x.array[dofs] = self.scene.at_points(formula, level.points[:, dofs])
            self._refuse_infinite(formula, function)
            values.x.array[dofs] = function.x.array[dofs]
            fixed[dofs] = True
        return np.flatnonzero(fixed).astype(np.int32), values

    def check(self) -> None:
        """Refuse obstacles that cross and boundary values beyond them: no u could satisfy both (collective).

        Where a boundary value is beyond an obstacle by round-off only, the obstacle gives way.

        Raises:
            InputError: Naming the place and the gap.
        """
        comm, source = self.level.comm, self.scene.source
        dofs, values = self.fixed
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
            message = f"{source}: no admissible state: the boundary value is beyond the {word} obstacle"
            self._refuse_gap(beyond, tolerance, message)
            obstacle.x.array[beyond > 0] = values.x.array[beyond > 0]

    def _obstacle(self, key: str) -> fem.Function | None:
        value = getattr(self.scene.tables.obstacle, key)
        return None if value is None else self.nodal(self.scene.formula(value, f"[obstacle] {key}"))

    def _facets(self, on: str | tuple[str, ...] | None, where: str | None, place: str) -> np.ndarray:
        level = self.level
        if where is not None:
            formula = self.scene.formula(where, f"{place} where")
            dim = level.mesh.topology.dim - 1
            return dmesh.locate_entities_boundary(level.mesh, dim, lambda x: self.scene.at_points(formula, x) != 0)
        if on is None:
            return level.boundary_facets
        names = (on,) if isinstance(on, str) else on
        for name in names:
            if name not in level.facets:
                raise InputError(
                    f"{self.scene.source}: {place} on: no part named '{name}'" + nearest(name, level.facets)
                )
        return np.unique(np.concatenate([level.facets[name] for name in names])).astype(np.int32)

    def _sample(self, function: fem.Function, formula: Formula) -> None:
        if not formula.names:
            function.x.array[:] = self.scene.number(formula.text, formula.place)
        elif function.function_space is self.level.V:
            function.x.array[:] = self.scene.at_points(formula, self.level.points)
        else:
            points = function.function_space.tabulate_dof_coordinates()
            function.x.array[:] = self.scene.at_points(formula, np.ascontiguousarray(points.T))
        self._refuse_infinite(formula, function)

    def _refuse_infinite(self, formula: Formula, function: fem.Function) -> None:
        self._refuse(formula, function, ~np.isfinite(function.x.array), "is not a finite number: it is")

    def _refuse(self, formula: Formula, function: fem.Function, bad: np.ndarray, what: str) -> None:
        """All ranks raise if any value is bad, naming one place (collective)."""
        mine = None
        if bad.any():
            first = int(np.argmax(bad))
            mine = function.x.array[first], function.function_space.tabulate_dof_coordinates()[first]
        found = next((one for one in self.level.comm.allgather(mine) if one is not None), None)
        if found is not None:
            raise InputError(f"{formula.place} = {formula.text}: {what} {found[0]:g} at {self._at(found[1])}")

    def _refuse_gap(self, excess: np.ndarray, tolerance: float, message: str) -> None:
        """All ranks raise if the largest excess is above the tolerance, naming its place (collective)."""
        worst = int(np.argmax(excess)) if len(excess) else 0
        mine = (float(excess[worst]), self.level.points[:, worst]) if len(excess) else (-np.inf, np.zeros(3))
        gap, point = max(self.level.comm.allgather(mine), key=lambda pair: pair[0])
        if gap > tolerance:
            raise InputError(f"{message}: by {gap:.3g} at {self._at(point)}")

    def _at(self, point: np.ndarray) -> str:
        return "(" + ", ".join(f"{x:.4g}" for x in point[: self.level.mesh.geometry.dim]) + ")"

"""Where a scene gives u, and what u may not cross: boundary values and obstacles, at the nodes of a level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.samples import Samples
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes.formulas import Formula, nearest
from fenicsx_obstacle.scenes.parts import part_place
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.vocabulary import TIME

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.motion import Moment


class Limits(Samples):
    """Boundary values and obstacles, sampled on first use, which is collective, and kept.

    Attributes:
        thin: Whether obstacles are on the boundary, or on curves inside, instead of in the domain.
        moment: Where it is in time, or None.
        givers: Where each boundary value stands, and the dofs that have it.
    """

    def __init__(self, scene: Scene, level: Level, moment: Moment | None = None):
        super().__init__(scene, level)
        if scene.time is not None and moment is None:
            from fenicsx_obstacle.discrete.motion import Moment  # only where a scene has time

            moment = Moment.at_start(scene.time)
        self.moment = moment
        self.thin = scene.thin
        self.givers: list[tuple[str, np.ndarray]] = []

    @property
    def now(self) -> dict[str, float]:
        return {} if self.moment is None else {TIME: self.moment.t}

    def dofs_on(self, facets: np.ndarray) -> np.ndarray:
        """Local dofs on local facets (collective)."""
        return fem.locate_dofs_topological(self.level.V, self.level.mesh.topology.dim - 1, facets)

    @cached_property
    def lower(self) -> fem.Function | None:
        """Nodal lower obstacle (first use is collective)."""
        return self._obstacle("lower")

    @cached_property
    def upper(self) -> fem.Function | None:
        """Nodal upper obstacle (first use is collective)."""
        return self._obstacle("upper")

    @cached_property
    def facets(self) -> list[np.ndarray]:
        """Local facets of each [[boundary]] (first use is collective)."""
        parts = enumerate(self.scene.tables.boundary)
        return [self._facets(part.on, part.where, part_place(number)) for number, part in parts]

    @cached_property
    def held(self) -> list[np.ndarray]:
        """Those where u is given; none of a [[boundary]] without a value (first use is collective)."""
        parts = zip(self.scene.tables.boundary, self.facets, strict=True)
        return [facets[:0] if part.value is None else facets for part, facets in parts]

    @cached_property
    def fixed(self) -> tuple[np.ndarray, fem.Function]:
        """Local dofs where u is given, sorted, and the values there (first use is collective)."""
        dofs = [self.dofs_on(facets) for facets in self.held]
        fixed = np.unique(np.concatenate([np.empty(0, np.int32), *dofs])).astype(np.int32)
        formulas = (formula for _, formula in self._given())
        return fixed, self.follow(formulas, partial(self._boundary_values, dofs))

    def _given(self) -> list[tuple[int, Formula]]:
        """The parts with a value, and its formula."""
        values = ((number, part.value) for number, part in enumerate(self.scene.tables.boundary))
        return [(n, self.scene.formula(v, f"{part_place(n)} value")) for n, v in values if v is not None]

    def _boundary_values(self, dofs: Sequence[np.ndarray]) -> fem.Function:
        """The values where u is given; of parts that meet the last one counts (collective)."""
        values = fem.Function(self.level.V)
        self.givers = []
        for number, formula in self._given():
            here, part = dofs[number], fem.Function(self.level.V)
            part.x.array[here] = self._at_points(formula, self.level.points[:, here])
            self._refuse_infinite(formula, part)
            values.x.array[here] = part.x.array[here]
            self.givers.append((f"{formula.place} = {formula.text}", here))
        values.x.scatter_forward()
        return values

    @cached_property
    def extent(self) -> float:
        """Longest side of the box around the mesh: makes an area of a length of contact (first use is collective)."""
        x, comm = self.level.points, self.level.comm
        return max(largest(comm, axis) - smallest(comm, axis) for axis in x)

    def _obstacle(self, key: str) -> fem.Function | None:
        places: list[tuple[Any, str]] = [(self.scene.tables.obstacle, "[obstacle]")]
        if self.thin:
            places = [(part, part_place(number)) for number, part in enumerate(self.scene.tables.boundary)]
        given = [(number, getattr(table, key), place) for number, (table, place) in enumerate(places)]
        found = {n: self.scene.formula(value, f"{place} {key}") for n, value, place in given if value is not None}
        if not found:
            return None
        sample = partial(self._thin_obstacle, found, key) if self.thin else partial(self.nodal, found[0])
        return self.follow(found.values(), sample)

    def _thin_obstacle(self, found: Mapping[int, Formula], key: str) -> fem.Function:
        """Nodal obstacle on parts of the boundary; infinitely far off elsewhere (collective)."""
        function = fem.Function(self.level.V)
        function.x.array[:] = -np.inf if key == "lower" else np.inf
        for number, formula in found.items():
            dofs, part = self.dofs_on(self.facets[number]), fem.Function(self.level.V)
            part.x.array[dofs] = self._at_points(formula, self.level.points[:, dofs])
            self._refuse_infinite(formula, part)
            function.x.array[dofs] = part.x.array[dofs]
        function.x.scatter_forward()
        return function

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

"""The data of a problem on a mesh, sampled once and checked: forms and solvers see Functions and Constants only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, partial
from math import factorial
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.system import NO_BOUND, with_infinities
from fenicsx_obstacle.data.between_samples import check_between, check_definite, inadmissible
from fenicsx_obstacle.data.cell_means import average
from fenicsx_obstacle.data.fields import Cellwise, array_of
from fenicsx_obstacle.data.model import Model, Part
from fenicsx_obstacle.data.samples import Samples
from fenicsx_obstacle.data.time_discretization import Moment, Motion
from fenicsx_obstacle.effects.field import Field, Rows
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.cells import cell_volumes
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.shared_dofs import share
from fenicsx_obstacle.mesh.tags import check_both_sides
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.text import counted, nearest

if TYPE_CHECKING:
    from fenicsx_obstacle.data.measures import Parts, Weighted

ROUND_OFF = 2e-15  # of the largest value of a datum


class Data(Samples):
    """The data of a model on one mesh: of the effects, boundary values and obstacles.

    Everything is sampled on first use, which is collective, and kept.

    Attributes:
        thin: Whether obstacles are on the boundary, or on curves inside, instead of in the domain.
        givers: Where each boundary value stands, and the dofs that have it.
    """

    def __init__(
        self,
        model: Model,
        level: Level,
        moment: Moment | None = None,
        bcs: Sequence[Any] = (),
        *,
        live: bool = False,
    ):
        """Sample nothing yet.

        Args:
            model: As for `Samples`.
            level: As for `Samples`.
            moment: As for `Samples`.
            bcs: Dirichlet conditions of V besides those of the model's boundary.
            live: As for `Samples`.
        """
        super().__init__(model, level, moment, live=live)
        self.thin, self._bcs = model.thin, bcs
        self.givers: list[tuple[str, np.ndarray]] = []
        # one datum may be given for several purposes, with other bounds in each
        self._cellwise: dict[tuple[Field, bool, float | None], Cellwise] = {}
        self._heights: dict[Field, fem.Function] = {}
        self._on_part: dict[tuple[Field, int, float | None], fem.Function] = {}
        self._definite: set[Rows] = set()

    def on(self, level: Level) -> Data:
        """The same data for other elements on the same mesh: what was interpolated is taken as it is."""
        other = Data(self.model, level, self.moment, self._bcs)
        other._here = self._here
        return other

    def move(self) -> bool:
        """Sample anew what depends on time, for the present moment (collective).

        Returns:
            Whether the numbers of the derivatives in time have changed.

        Raises:
            InputError: If it is not finite somewhere, or out of bounds.
        """
        self._sample_again()
        for rows in self._definite:
            if any(entry.moves for row in rows for entry in row):
                check_definite(self.level, rows, self.matrices(rows))
        assert self.model.time is not None
        return self.model.time.order > 0 and self.motion.follow()

    def renew(self) -> None:
        """Sample data anew that the caller may have changed (collective).

        Raises:
            InputError: If they are not finite somewhere.
        """
        self._here.clear()  # values of Constants, and what was interpolated from another mesh
        self._sample_again()

    @property
    def sampled(self) -> tuple[list[Field], list[Field], list[tuple[Field, int]]]:
        """The data that have been sampled in cells, at all nodes, and at the nodes of a part of the boundary."""
        in_cells = list(dict.fromkeys(key[0] for key in self._cellwise))
        return in_cells, list(self._heights), list(dict.fromkeys(key[:2] for key in self._on_part))

    # fields in cells and at nodes

    def cellwise(self, field: Field, *, positive: bool = False, least: float | None = None) -> Cellwise:
        """One value per cell, taken at its midpoint, or as many as `Level.W` has (collective on first use).

        A Constant if all are the same.

        Raises:
            InputError: If it is not finite, or not positive, or below the least, somewhere, or a material has no value.
        """
        key = field, positive, least
        if key not in self._cellwise:
            self._cellwise[key] = self.follow([field], partial(self._checked_cells, *key))
        return self._cellwise[key]

    def values(self, field: Field, *, positive: bool = False) -> np.ndarray:
        """The values of `cellwise` at local dofs of W, or the one there is (collective on first use)."""
        return array_of(self.cellwise(field, positive=positive))

    def height(self, field: Field) -> fem.Function:
        """Nodal interpolant in V, kept (collective on first use)."""
        if field not in self._heights:
            self._heights[field] = self.follow([field], partial(self.nodal, field))
        return self._heights[field]

    def number(self, value: float | np.ndarray) -> fem.Constant:
        """A number, or a vector, that is not compiled into forms."""
        return fem.Constant(self.level.mesh, PETSc.ScalarType(value))

    def field(self, components: tuple[Field, ...]) -> ufl.core.expr.Expr:
        """A vector, one per cell (collective on first use).

        Raises:
            InputError: If it has not as many components as points have coordinates.
        """
        dim = self.level.mesh.geometry.dim
        if len(components) != dim:
            place = components[0].source.partition("[0]")[0]
            raise InputError(f"{place}: has {len(components)} components, but points have {counted(dim, 'coordinate')}")
        return ufl.as_vector([self.cellwise(part) for part in components])

    def matrix(self, rows: Rows) -> ufl.core.expr.Expr:
        """A symmetric, positive definite matrix, one per cell (collective on first use).

        Raises:
            InputError: If it is neither somewhere, or has not as many rows as points have coordinates.
        """
        entries = [[self.cellwise(entry) for entry in row] for row in rows]
        if rows not in self._definite:
            check_definite(self.level, rows, self.matrices(rows))
            check_between(self, rows)
            self._definite.add(rows)
        return ufl.as_matrix(entries)

    def matrices(self, rows: Rows) -> np.ndarray:
        """Values of a matrix at local dofs of W, shape (dofs or 1, rows, rows) (collective on first use)."""
        entries = np.broadcast_arrays(*(self.values(entry) for row in rows for entry in row))
        return np.stack(entries, axis=1).reshape(-1, len(rows), len(rows))

    def eigenvalues(self, rows: Rows) -> np.ndarray:
        """Eigenvalues of its symmetric part, ascending, shape (dofs or 1, rows) (collective on first use)."""
        matrices = self.matrices(rows)
        return np.linalg.eigvalsh((matrices + matrices.transpose(0, 2, 1)) / 2)

    # the domain

    @cached_property
    def dx(self) -> Any:
        """Integration over the domain."""
        dx = ufl.Measure("dx", domain=self.level.mesh)
        if not self.model.radial:
            return dx
        from fenicsx_obstacle.data.measures import Weighted  # only with axial symmetry

        return Weighted(dx, None, self.radius)

    @property
    def axial(self) -> bool:
        """Whether x is the distance from an axis, the weight of all integrals."""
        return self.model.radial

    @cached_property
    def radius(self) -> Cellwise:
        """Distance from the axis, positive in each cell (first use is collective)."""
        key = next(effect.key for effect in self.model.effects if effect.role == "radial weight")
        if self.level.mesh.geometry.dim > 2:
            raise InputError(f"{self.model.source}: [effects] {key} is for intervals and plane meshes")
        from fenicsx_obstacle.effects.domain.axial_symmetry import Radius  # only with axial symmetry

        return self.cellwise(Radius(f"{self.model.source}: [effects] {key}, radius"), positive=True)

    @cached_property
    def dI(self) -> Any:
        """The same by the pair's rule, where its points are the nodes of V_h."""
        pair = self.level.pair
        return pair.rule(releases.cell_name(self.level.mesh)).on(self.dx) if pair.at_vertices else self.dx

    @cached_property
    def extent(self) -> float:
        """Longest side of the box around the mesh: makes an area of a length of contact (first use is collective)."""
        low, high = self.level.box
        return float(np.max(high - low))

    @cached_property
    def cell_size(self) -> Cellwise:
        """The side of each cell, sqrt(2|T|) or (6|T|)^(1/3); of other cells than simplices the grid's."""
        mesh = self.level.mesh
        if releases.cell_name(mesh) not in SIMPLICES:
            return fem.Constant(mesh, PETSc.ScalarType(self.level.h))
        sizes, dim = fem.Function(releases.functionspace(mesh, "DG", 0)), mesh.topology.dim
        dofs = releases.cell_dofs(sizes.function_space)[:, 0]
        sizes.x.array[dofs] = (factorial(dim) * cell_volumes(mesh)) ** (1 / dim)
        return sizes

    @cached_property
    def distance(self) -> fem.Function:
        """Nodal distance to the boundary (first use is collective)."""
        function = fem.Function(self.level.V)
        function.x.array[:] = self.boundary_distance(self.level.points.T)
        function.x.scatter_forward()  # points of ghosts may differ from their owner's in the last digit
        return function

    @cached_property
    def motion(self) -> Motion:
        """Derivatives in time."""
        assert self.moment is not None
        return Motion(self.level, self.moment)

    # obstacles

    @cached_property
    def lower(self) -> fem.Function | None:
        """Nodal lower obstacle (first use is collective)."""
        return self._obstacle("lower", -np.inf)

    @cached_property
    def upper(self) -> fem.Function | None:
        """Nodal upper obstacle (first use is collective)."""
        return self._obstacle("upper", np.inf)

    def heights(self, sign: float) -> np.ndarray:
        """The lower (sign 1) or the upper obstacle (-1) at local dofs, where there is none a number: `NO_BOUND`."""
        obstacle = self.lower if sign > 0 else self.upper
        assert obstacle is not None
        return np.clip(obstacle.x.array, -NO_BOUND, NO_BOUND)

    def _obstacle(self, side: str, none: float) -> fem.Function | None:
        parts = {number: getattr(part, side) for number, part in enumerate(self.model.boundary)}
        thin = {number: obstacle for number, obstacle in parts.items() if obstacle is not None}
        if thin:
            return self.follow(thin.values(), partial(self._thin_obstacle, thin, none))
        obstacle = getattr(self.model, side)
        return None if obstacle is None else self.follow([obstacle], partial(self._obstacle_inside, obstacle, none))

    def _obstacle_inside(self, obstacle: Field, none: float) -> fem.Function:
        """Nodal obstacle in the domain; infinitely far off where there is none (collective)."""
        function = self._interpolant(obstacle)
        self._mark_none(function, obstacle, none)
        return function

    def _thin_obstacle(self, obstacles: Mapping[int, Field], none: float) -> fem.Function:
        """Nodal obstacle on parts of the boundary; infinitely far off elsewhere (collective).

        Of two tables for one facet the later one counts, at a node of facets of several the nearer obstacle.
        """
        function, nearer = fem.Function(self.level.V), np.maximum if none < 0 else np.minimum
        function.x.array[:] = none
        for number, obstacle in obstacles.items():
            one, dofs = fem.Function(self.level.V), self.dofs_on(self.last_facets(number, obstacles))
            one.x.array[:] = none
            one.x.array[dofs] = self._at_dofs(obstacle, self.level.V, dofs)
            self._mark_none(one, obstacle, none)
            share(one)
            function.x.array[:] = nearer(function.x.array, one.x.array)
        return function

    def last_facets(self, number: int, parts: Iterable[int]) -> np.ndarray:
        """The local facets of a part that none of the later ones among some parts has."""
        later = [self.facets[other] for other in parts if other > number]
        return np.setdiff1d(self.facets[number], np.concatenate([np.empty(0, dtype=np.int32), *later]))

    def _mark_none(self, function: fem.Function, obstacle: Field, none: float) -> None:
        """Set an obstacle to infinity where its values mean that there is none (collective).

        Args:
            function: Its values as they were given.
            obstacle: What was sampled.
            none: Infinity with the sign that means 'no obstacle' on this side.

        Raises:
            InputError: If another value is not finite.
        """
        function.x.array[:] = with_infinities(function.x.array)
        self.refuse_infinite(function, obstacle, none=none)

    # the boundary

    def dofs_on(self, facets: np.ndarray) -> np.ndarray:
        """Local dofs on local facets (collective)."""
        return fem.locate_dofs_topological(self.level.V, self.level.mesh.topology.dim - 1, facets)

    @cached_property
    def facets(self) -> list[np.ndarray]:
        """Local facets of each part of the boundary (first use is collective)."""
        return [self._facets(part) for part in self.model.boundary]

    @cached_property
    def held(self) -> list[np.ndarray]:
        """The facets of each part on which u is given (first use is collective)."""
        parts = zip(self.model.boundary, self.facets, strict=True)
        return [facets[:0] if part.value is None else facets for part, facets in parts]

    @cached_property
    def fixed(self) -> tuple[np.ndarray, fem.Function]:
        """Local dofs where u is given, sorted, and the values there (first use is collective)."""
        dofs = [self.dofs_on(facets) for facets in self.held]
        by_conditions = [np.asarray(bc.dof_indices()[0]) for bc in self._bcs]
        flags = fem.Function(self.level.V)
        flags.x.array[np.concatenate([np.empty(0, np.int32), *dofs, *by_conditions])] = 1.0
        share(flags)
        fixed = np.flatnonzero(flags.x.array).astype(np.int32)
        given = [part.value for part in self.model.boundary if part.value is not None]
        return fixed, self.follow(given, partial(self._boundary_values, dofs))

    def _boundary_values(self, dofs: Sequence[np.ndarray]) -> fem.Function:
        """The values where u is given; of parts that meet the last one counts (collective)."""
        values = fem.Function(self.level.V)
        self.givers = []
        for part, here in zip(self.model.boundary, dofs, strict=True):
            if part.value is not None:
                values.x.array[here] = self._on_dofs(part.value, here).x.array[here]
                self.givers.append((str(part.value), here))
        if self._bcs:
            releases.set_values(values.x.array, self._bcs)
            self.refuse_infinite(values, words=f"{self.model.source}: a value of bcs")
            here = np.concatenate([np.asarray(bc.dof_indices()[0]) for bc in self._bcs])
            self.givers.append((f"{self.model.source}: a value of bcs", here))
        share(values)
        return values

    def on_part(self, field: Field, part: int, *, least: float | None = None) -> fem.Function:
        """A datum at the nodes of a part of the boundary, counted from 0 (collective on first use).

        Raises:
            InputError: If it is not finite, or below the least, somewhere.
        """
        key = field, part, least
        if key not in self._on_part:
            self._on_part[key] = self.follow([field], partial(self._sample_part, *key))
        return self._on_part[key]

    def _sample_part(self, field: Field, part: int, least: float | None) -> fem.Function:
        function = self._on_dofs(field, self.dofs_on(self.facets[part]))
        share(function)
        if least is not None:
            self._raise_to(field, function, least)
        return function

    @cached_property
    def parts(self) -> Parts:
        """Measures of the parts of the boundary on which something acts (first use is collective).

        Raises:
            InputError: If a part is inside, and no rank has the cells on both sides of a facet.
        """
        from fenicsx_obstacle.data.measures import Parts  # only where a model names one

        found = []
        for number, part in enumerate(self.model.boundary):
            keys = [*self.model.acts(number), *(["contact"] if part.bears else [])]
            found += [(number, key, self.facets[number]) for key in keys]
            if keys:
                check_both_sides(self.level.mesh, self.facets[number], f"{self.model.source}: {part.name}")
        return Parts(self.level, found, radial=self.model.radial)

    def over(self, part: int, key: str, *, nodal: bool = False) -> Weighted:
        """Integration over the part of the boundary, counted from 0, that has a key (collective on first use)."""
        return self.parts.over(part, key, nodal=nodal)

    def _facets(self, part: Part) -> np.ndarray:
        level = self.level
        if part.where is not None:
            return self._facets_where(part.where)
        if part.on is None:
            return level.boundary_facets
        for name in part.on:
            if name not in level.facets:
                none = " (the mesh has no named parts; in Python, facet_tags and facet_names define them)"
                known = nearest(name, level.facets) if level.facets else none
                raise InputError(f"{self.model.source}: {part.name} on: no part named '{name}'{known}")
            if total(level.comm, len(level.facets[name])) == 0:
                what = "no facet of the mesh lies on it; a part inside must be embedded in its domain"
                raise InputError(f"{self.model.source}: {part.name} on = '{name}': {what}")
        return np.unique(np.concatenate([level.facets[name] for name in part.on])).astype(np.int32)

    def _facets_where(self, where: Field) -> np.ndarray:
        """Facets of the boundary at whose vertices a condition holds."""
        level = self.level
        dim = level.mesh.topology.dim - 1
        self._on_dofs(
            where, fem.locate_dofs_topological(level.V, dim, level.boundary_facets)
        )  # rejects infinite values
        found = dmesh.locate_entities_boundary(level.mesh, dim, lambda x: self.at(where, x) != 0)
        if total(level.comm, len(found)) == 0:
            raise InputError(f"{where}: holds on no facet of the boundary")
        return found

    def _checked_cells(self, field: Field, positive: bool, least: float | None) -> Cellwise:
        made = self._sample_cells(field)
        if positive:
            self._refuse(field, made, array_of(made) <= 0, "must be positive; it is")
            if isinstance(made, fem.Function):
                average(self, field, made)
        if least is not None:
            self._raise_to(field, made, least)
        bound = 0.0 if positive else least
        if bound is not None and (field, positive, least) not in self._cellwise:  # once: not for each moment
            self._check_between(field, bound, "be positive" if positive else f"be at least {bound:g}")
        return made

    def _raise_to(self, field: Field, made: Cellwise, least: float) -> None:
        """Reject values below the least one, and raise those that are it but for round-off (collective)."""
        values = array_of(made)
        limit = least - ROUND_OFF * max(largest(self.level.comm, np.abs(values)), 0.0)
        self._refuse(field, made, values < limit, f"must be at least {least:g}; it is")
        if isinstance(made, fem.Function):
            np.maximum(values, least, out=values)

    def _check_between(self, field: Field, bound: float, what: str) -> None:
        """Reject values below a bound at points that are no midpoints of cells (collective)."""
        parts: Mapping[str | None, Field] = field.parts or {None: field}  # type: ignore[assignment]
        for material, part in parts.items():
            found = None if part.uniform else inadmissible(self, [part], partial(self.at, part), bound, material)
            if found is not None:
                number, point = found
                raise InputError(f"{field}: must {what}; it is {number:g} at {self.place(point)}")

    def _sample_cells(self, field: Field) -> Cellwise:
        if field.uniform:
            number = self.here(field).at(np.zeros((3, 1)), self.now)[0]
            constant = fem.Constant(self.level.mesh, PETSc.ScalarType(number))
            self.refuse_infinite(constant, field)
            return constant
        function = fem.Function(self.level.W)
        if field.parts is not None:
            self._sample_materials(function, field, field.parts)
        else:
            self._sample(function, field)
            self.refuse_infinite(function, field)
        return function

    def _sample_materials(self, function: fem.Function, field: Field, parts: Mapping[str, Field]) -> None:
        """Each datum in the cells of its material: every cell must have one value (collective)."""
        groups, comm = self.level.groups, self.level.comm
        values, times = function.x.array, np.zeros(len(function.x.array), dtype=int)
        for name, part in parts.items():
            if name not in groups:
                hint = nearest(name, groups) if groups else "; the mesh has no named groups of cells"
                raise InputError(f"{field.source}: no material named '{name}'" + hint)
            inside = self.level.indicator(name)
            values[inside] = self._at_dofs(part, self.level.W, inside)
            times += inside
        for name in groups:
            if total(comm, np.count_nonzero(self.level.indicator(name) & (times == 0))) > 0:
                raise InputError(f"{field}: no value for the material '{name}'")
        for bad, what in ((times == 0, "no value for a cell without material"), (times > 1, "two values for a cell")):
            found = self._first(function, bad)
            if found is not None:
                raise InputError(f"{field}: {what} at {self.place(found[1])}")
        function.x.scatter_forward()
        self.refuse_infinite(function, field)

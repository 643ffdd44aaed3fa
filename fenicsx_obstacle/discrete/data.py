"""A scene's formulas sampled on a mesh, once, and checked: nothing after this sees a formula."""

from __future__ import annotations

from functools import cached_property
from math import factorial
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners, volumes
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.samples import Cellwise, Samples, array_of
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes.formulas import Formula, nearest
from fenicsx_obstacle.scenes.materials import Value
from fenicsx_obstacle.scenes.scene import Scene, part_place
from fenicsx_obstacle.words import counted

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.parts import Facets, Parts


class Weighted:
    """`integrand * Weighted` is the integral with a weight: a measure that is not that of the space itself."""

    def __init__(self, measure: ufl.Measure, weight: ufl.core.expr.Expr):
        self.measure, self.weight = measure, weight

    def __call__(self, **how: Any) -> Weighted:
        """The same with another rule: `metadata=...`, as for a measure."""
        return Weighted(self.measure(**how), self.weight)

    def __rmul__(self, integrand: Any) -> ufl.Form:
        return integrand * self.weight * self.measure


class Data(Samples):
    """What the effects, obstacles and boundary values of a scene are on one level.

    Everything is sampled on first use, which is collective, and kept.

    Attributes:
        thin: Whether obstacles are on the boundary, or on curves inside, instead of in the domain.
        givers: Where each boundary value stands, and the dofs that have it.
    """

    def __init__(self, scene: Scene, level: Level):
        super().__init__(scene, level)
        self.thin = scene.thin
        self._on_part: dict[str, fem.Function] = {}
        self._heights: dict[str, fem.Function] = {}
        self._definite: set[str] = set()
        self.givers: list[tuple[str, np.ndarray]] = []

    @cached_property
    def dx(self) -> Any:
        """Integration over the domain."""
        dx = ufl.Measure("dx", domain=self.level.mesh)
        return Weighted(dx, self.radius) if self.radial else dx

    @property
    def radial(self) -> bool:
        """Whether the scene is axially symmetric."""
        return any(effect.radial for effect in self.scene.effects)

    @cached_property
    def radius(self) -> Cellwise:
        """Distance from the axis, positive in each cell (first use is collective)."""
        if self.level.mesh.geometry.dim > 2:
            raise InputError(f"{self.scene.source}: [effects] axial_symmetry is for intervals and plane meshes")
        return self.cellwise(self.scene.formula("x", "[effects] axial_symmetry, radius"), positive=True)

    @cached_property
    def dI(self) -> Any:
        """The same by the pair's rule, where its points are the nodes of V_h."""
        pair = self.level.pair
        nodal = pair.nodal and pair.degree == 1
        return pair.rule(releases.cell_name(self.level.mesh)).on(self.dx) if nodal else self.dx

    def at_points(self, forces: tuple[tuple[tuple[float, ...], float], ...], place: str) -> np.ndarray:
        """Forces at points as forces at owned nodes, by barycentric coordinates (collective).

        Raises:
            InputError: If a point is outside the mesh or has another number of coordinates, or elements are not P1.
        """
        from fenicsx_obstacle.discrete.points import spread  # only where a scene names points

        return spread(self.level, forces, f"{self.scene.source}: {place}")

    def height(self, value: Formula) -> fem.Function:
        """Nodal interpolant in V, kept (collective on first use)."""
        if value.place not in self._heights:
            self._heights[value.place] = self.nodal(value)
        return self._heights[value.place]

    def number(self, value: float) -> fem.Constant:
        """A number that is not compiled into forms."""
        return fem.Constant(self.level.mesh, PETSc.ScalarType(value))

    def field(self, components: tuple[Formula, ...]) -> ufl.core.expr.Expr:
        """A vector, one per cell (collective on first use).

        Raises:
            InputError: If it has not as many components as points have coordinates.
        """
        dim = self.level.mesh.geometry.dim
        if len(components) != dim:
            place = components[0].place.partition("[0]")[0]
            raise InputError(f"{place}: has {len(components)} components, but points have {counted(dim, 'coordinate')}")
        return ufl.as_vector([self.cellwise(part) for part in components])

    @cached_property
    def cell_size(self) -> Cellwise:
        """The side of each cell, sqrt(2|T|) or (6|T|)^(1/3); of other cells than simplices the grid's."""
        mesh = self.level.mesh
        if releases.cell_name(mesh) not in SIMPLICES:
            return fem.Constant(mesh, PETSc.ScalarType(self.level.h))
        sizes, dim = fem.Function(releases.functionspace(mesh, "DG", 0)), mesh.topology.dim
        dofs = releases.cell_dofs(sizes.function_space)[:, 0]
        sizes.x.array[dofs] = (factorial(dim) * volumes(corners(mesh)[: len(dofs)])) ** (1 / dim)
        return sizes

    def values(self, value: Value) -> np.ndarray:
        """The values of `cellwise` at local dofs of W, or the one there is (collective on first use)."""
        return array_of(self.cellwise(value))

    def matrix(self, rows: tuple[tuple[Formula, ...], ...]) -> ufl.core.expr.Expr:
        """A symmetric, positive definite matrix, one per cell (collective on first use).

        Raises:
            InputError: If it is neither somewhere, or has not as many rows as points have coordinates.
        """
        entries = [[self.cellwise(entry) for entry in row] for row in rows]
        if rows[0][0].place not in self._definite:
            from fenicsx_obstacle.discrete.tensors import check_definite  # only where a scene has a matrix

            check_definite(self, rows)
            self._definite.add(rows[0][0].place)
        return ufl.as_matrix(entries)

    def eigenvalues(self, rows: tuple[tuple[Formula, ...], ...]) -> np.ndarray:
        """Of the symmetric part, ascending, at local dofs of W, shape (dofs or 1, rows) (collective on first use)."""
        from fenicsx_obstacle.discrete.tensors import matrices_of

        matrices = matrices_of(self, rows)
        return np.linalg.eigvalsh((matrices + matrices.transpose(0, 2, 1)) / 2)

    def on_part(self, value: Formula, part: int, *, least: float | None = None) -> fem.Function:
        """A formula at the nodes of the part of a [[boundary]], counted from 0 (collective on first use).

        Raises:
            InputError: If it is not finite, or below the least, somewhere.
        """
        if value.place not in self._on_part:
            function, dofs = fem.Function(self.level.V), self.dofs_on(self.facets[part])
            function.x.array[dofs] = self._at_points(value, self.level.points[:, dofs])
            function.x.scatter_forward()
            self._refuse_infinite(value, function)
            if least is not None:
                self._refuse(value, function, function.x.array < least, f"must be at least {least:g}; it is")
            self._on_part[value.place] = function
        return self._on_part[value.place]

    def dofs_on(self, facets: np.ndarray) -> np.ndarray:
        """Local dofs on local facets (collective)."""
        return fem.locate_dofs_topological(self.level.V, self.level.mesh.topology.dim - 1, facets)

    @cached_property
    def parts(self) -> Parts:
        """Measures of the parts of the boundary on which something acts (first use is collective)."""
        from fenicsx_obstacle.discrete.parts import Parts  # only where a scene names one

        found = []
        for number, part in enumerate(self.scene.tables.boundary):
            keys = [key for key in ("flux", "spring") if getattr(part, key) is not None]
            keys += ["contact"] * (part.lower is not None or part.upper is not None)
            found += [(number, key, self.facets[number]) for key in keys]
        return Parts(self.level, found, radial=self.radial)

    def over(self, part: int, key: str, *, nodal: bool = False) -> Facets:
        """Integration over the part that a [[boundary]], counted from 0, gives a key (collective on first use)."""
        return self.parts.over(part, key, nodal=nodal)

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
        level, values = self.level, fem.Function(self.level.V)
        fixed = np.zeros(len(values.x.array), dtype=bool)
        for number, (part, facets) in enumerate(zip(self.scene.tables.boundary, self.held, strict=True)):
            if part.value is None:
                continue
            dofs = self.dofs_on(facets)
            formula = self.scene.formula(part.value, f"{part_place(number)} value")
            function = fem.Function(level.V)
            function.x.array[dofs] = self._at_points(formula, level.points[:, dofs])
            self._refuse_infinite(formula, function)
            values.x.array[dofs] = function.x.array[dofs]
            fixed[dofs] = True
            self.givers.append((f"{formula.place} = {formula.text}", dofs))
        values.x.scatter_forward()
        return np.flatnonzero(fixed).astype(np.int32), values

    @cached_property
    def extent(self) -> float:
        """Longest side of the box around the mesh: makes an area of a length of contact (first use is collective)."""
        x, comm = self.level.points, self.level.comm
        return max(largest(comm, axis) - smallest(comm, axis) for axis in x)

    def _obstacle(self, key: str) -> fem.Function | None:
        if self.thin:
            return self._thin_obstacle(key)
        value = getattr(self.scene.tables.obstacle, key)
        return None if value is None else self.nodal(self.scene.formula(value, f"[obstacle] {key}"))

    def _thin_obstacle(self, key: str) -> fem.Function | None:
        """Nodal obstacle on parts of the boundary; infinitely far off elsewhere."""
        parts = [getattr(part, key) for part in self.scene.tables.boundary]
        if all(value is None for value in parts):
            return None
        function = fem.Function(self.level.V)
        function.x.array[:] = -np.inf if key == "lower" else np.inf
        for number, value in enumerate(parts):
            if value is not None:
                formula = self.scene.formula(value, f"{part_place(number)} {key}")
                dofs = self.dofs_on(self.facets[number])
                part = fem.Function(self.level.V)
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

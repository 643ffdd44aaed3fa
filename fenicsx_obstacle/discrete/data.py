"""A scene's formulas sampled on a mesh, once, and checked: nothing after this sees a formula."""

from __future__ import annotations

from functools import cached_property, partial
from math import factorial
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners, volumes
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.limits import Limits
from fenicsx_obstacle.discrete.samples import Cellwise, array_of
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.materials import Value
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.vocabulary import TIME
from fenicsx_obstacle.words import counted

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.motion import Moment, Motion
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


class Data(Limits):
    """What the effects of a scene are on one level, with its boundary values and obstacles.

    Everything is sampled on first use, which is collective, and kept.
    """

    def __init__(self, scene: Scene, level: Level, moment: Moment | None = None):
        super().__init__(scene, level, moment)
        self._on_part: dict[str, fem.Function] = {}
        self._heights: dict[str, fem.Function] = {}
        self._definite: dict[str, tuple[tuple[Formula, ...], ...]] = {}

    @cached_property
    def motion(self) -> Motion:
        """Derivatives in time."""
        from fenicsx_obstacle.discrete.motion import Motion  # only where a scene names one

        assert self.moment is not None
        return Motion(self.level, self.moment)

    def move(self) -> bool:
        """Sample anew what depends on time, for the present moment (collective).

        Returns:
            Whether the numbers of the derivatives in time have changed.

        Raises:
            InputError: If it is not finite somewhere.
        """
        self.renew()
        for rows in self._definite.values():
            if any(TIME in self.scene.needs(entry) for row in rows for entry in row):
                self._check_definite(rows)
        assert self.scene.time is not None
        return self.scene.time.order > 0 and self.motion.follow()

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
        key = next(effect.key for effect in self.scene.effects if effect.radial)
        if self.level.mesh.geometry.dim > 2:
            raise InputError(f"{self.scene.source}: [effects] {key} is for intervals and plane meshes")
        return self.cellwise(self.scene.formula("x", f"[effects] {key}, radius"), positive=True)

    @cached_property
    def dI(self) -> Any:
        """The same by the pair's rule, where its points are the nodes of V_h."""
        pair = self.level.pair
        return pair.rule(releases.cell_name(self.level.mesh)).on(self.dx) if pair.at_vertices else self.dx

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
            self._heights[value.place] = self.follow([value], partial(self.nodal, value))
        return self._heights[value.place]

    def peclet(self, velocity: tuple[Formula, ...]) -> float:
        """The largest |velocity| h/(2 tension) of all cells (collective)."""
        from fenicsx_obstacle.discrete.flow import peclet  # only where a scene has drift

        return peclet(self, velocity)

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
            from fenicsx_obstacle.discrete.tensors import check_between  # only where a scene has a matrix

            self._check_definite(rows)
            check_between(self, rows)
            self._definite[rows[0][0].place] = rows
        return ufl.as_matrix(entries)

    def _check_definite(self, rows: tuple[tuple[Formula, ...], ...]) -> None:
        from fenicsx_obstacle.discrete.tensors import check_definite  # only where a scene has a matrix

        check_definite(self, rows)

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
            self._on_part[value.place] = self.follow([value], partial(self._sample_part, value, part, least))
        return self._on_part[value.place]

    def _sample_part(self, value: Formula, part: int, least: float | None) -> fem.Function:
        function, dofs = fem.Function(self.level.V), self.dofs_on(self.facets[part])
        function.x.array[dofs] = self._at_points(value, self.level.points[:, dofs])
        function.x.scatter_forward()
        self._refuse_infinite(value, function)
        if least is not None:
            self._refuse(value, function, function.x.array < least, f"must be at least {least:g}; it is")
        return function

    @cached_property
    def parts(self) -> Parts:
        """Measures of the parts of the boundary on which something acts (first use is collective)."""
        from fenicsx_obstacle.discrete.parts import Parts  # only where a scene names one

        found = []
        for number, part in enumerate(self.scene.tables.boundary):
            keys = [effect.key for effect in self.scene.effects if getattr(effect, "part", None) == number]
            keys += ["contact"] * (part.lower is not None or part.upper is not None)
            found += [(number, key, self.facets[number]) for key in keys]
        return Parts(self.level, found, radial=self.radial)

    def over(self, part: int, key: str, *, nodal: bool = False) -> Facets:
        """Integration over the part that a [[boundary]], counted from 0, gives a key (collective on first use)."""
        return self.parts.over(part, key, nodal=nodal)

"""The fields of a vector-valued solution: displacement, contact nodes, gap and stress."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from dolfinx import fem
from scipy.spatial import cKDTree

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.contact_table import ContactTable
from fenicsx_obstacle.fields.cut import Cut
from fenicsx_obstacle.fields.scalar import PARTITION, Fields, Force
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.mesh.levels import Level, over
from fenicsx_obstacle.parallel import before
from fenicsx_obstacle.text import nearest

NO_STRESS = "give the problem its stress in UFL, stress=sigma(u)"


@dataclass(frozen=True)
class VectorForce(Force):
    """The contact forces of a body; the resultant and the moment are those of the forces on the body.

    Attributes:
        resultant: Sum of the forces, shape (gdim,).
        moment: Moment of the forces about the origin, shape (3,), in the plane a number. `nodes.moment(about)` is the
            moment about another point.
    """

    resultant: np.ndarray
    moment: np.ndarray | float


@dataclass(frozen=True, eq=False)
class VectorFields(Fields):
    """The fields of a vector-valued solution.

    Attributes:
        nodes: Coordinates, normals, areas, pressures and gaps of the contact nodes.
        gap: Distance to the nearest obstacle, a Function; not-a-number at nodes that are not on the contact boundary.
        von_mises: Von Mises stress in the middle of each cell, piecewise constant; None if no stress was given.
    """

    nodes: ContactTable = field(kw_only=True)
    gap: fem.Function = field(kw_only=True)
    von_mises: fem.Function | None = field(kw_only=True)

    @classmethod
    def restored(cls, level: Level, found: Mapping[str, fem.Function], nodes: Mapping[str, np.ndarray]) -> VectorFields:
        """Fields of what a folder holds (collective).

        Args:
            level: The mesh.
            found: Components u0, u1 and u2, and the other fields by name.
            nodes: Columns of the contact nodes.
        """
        over_mesh = over(level)
        u = over_mesh.of_components([found[f"u{k}"] for k in range(over_mesh.components)])
        kept = {name: found.get(name) for name in ("lower", "upper", "von_mises")}
        table = ContactTable(**{name: np.array(values) for name, values in nodes.items()})
        return cls(over_mesh, u, found["pressure"], found["contact"], gap=found["gap"], nodes=table, **kept)

    def functions(self) -> dict[str, fem.Function]:
        """The scalar fields by name; components of u are u0, u1, u2."""
        parts = {f"u{k}": self.level.component(self.u, k) for k in range(self.level.components)}
        return {**parts, "pressure": self.pressure, "contact": self.contact, "gap": self.gap}

    def by_cell(self) -> dict[str, fem.Function]:
        return {} if self.von_mises is None else {"von_mises": self.von_mises}

    def tables(self) -> dict[str, np.ndarray]:
        """The contact nodes."""
        return {f"nodes/{name}": values for name, values in vars(self.nodes).items()}

    def force(self, lower: float | None, upper: float | None) -> VectorForce:
        return VectorForce(lower, upper, self.nodes.resultant, self.nodes.moment())

    # on P1 simplices

    def _on_pieces(self, pieces: Cut) -> Self:
        von_mises = None
        if self.von_mises is not None:
            space = releases.functionspace(pieces.level.mesh, "DG", 0)
            von_mises = fem.Function(space)
            from_dofs = releases.cell_dofs(self.von_mises.function_space)[pieces.parents, 0]
            von_mises.x.array[releases.cell_dofs(space)[: len(from_dofs), 0]] = self.von_mises.x.array[from_dofs]
            von_mises.x.scatter_forward()
        return self._with(pieces.level, pieces.functions, von_mises)

    def _with(self, level: Level, fields: Mapping[str, fem.Function], von_mises: fem.Function | None) -> Self:
        """The same with other functions, on another mesh (collective)."""
        new, components = over(level), [fields[f"u{k}"] for k in range(level.mesh.geometry.dim)]
        rest = {name: fields[name] for name in ("pressure", "contact", "gap")}
        return replace(self, level=new, u=new.of_components(components), von_mises=von_mises, **rest)

    def arrays(self) -> dict[str, np.ndarray]:
        """The fields on P1 simplices, as files and pictures have them: u with three components, von_mises by cells
        (local)."""
        owned, fields = self.level.scalar.owned, self.functions()
        u = np.zeros((owned, 3))
        for k in range(self.level.components):
            u[:, k] = fields.pop(f"u{k}").x.array[:owned]
        found = {"u": u, **{name: function.x.array[:owned].copy() for name, function in fields.items()}}
        if self.von_mises is not None:
            dofs = releases.cell_dofs(self.von_mises.function_space)[: own_cells(self.level.mesh), 0]
            found["von_mises"] = self.von_mises.x.array[dofs]
        return found

    def with_values(self, given: Mapping[str, np.ndarray]) -> Self:
        """These fields, on P1 simplices, with other values (collective).

        Args:
            given: u, pressure, contact, gap and von_mises in the order of `io.folder.gather`, the same on every rank.
        """
        level, mesh = self.level.scalar, self.level.mesh
        fields, first = {}, level.V.dofmap.index_map.local_range[0]
        for name in self.functions():
            values = given["u"][:, int(name[1:])] if name not in given else given[name]
            fields[name] = fem.Function(level.V)
            fields[name].x.array[: level.owned] = values[first : first + level.owned]
            fields[name].x.scatter_forward()
        von_mises = None
        if "von_mises" in given:
            von_mises = fem.Function(releases.functionspace(mesh, "DG", 0))
            dofs = releases.cell_dofs(von_mises.function_space)[: own_cells(mesh), 0]
            start = before(level.comm, len(dofs))
            von_mises.x.array[dofs] = given["von_mises"][start : start + len(dofs)]
            von_mises.x.scatter_forward()
        points = np.concatenate(level.comm.allgather(level.points.T[: level.owned]))
        near = cKDTree(points[:, : mesh.geometry.dim]).query(self.nodes.points)[1]
        nodes = replace(self.nodes, **{name: given[name][near].astype(float) for name in ("pressure", "gap")})
        return replace(self._with(level, fields, von_mises), nodes=nodes)

    # at points

    def shape(self, of: str) -> tuple[int, ...]:
        return (self.level.mesh.geometry.dim,) if of == "u" else ()

    def values(self, points: np.ndarray, of: str = "u", tension: Any = None) -> np.ndarray:
        if of != "gap":
            return super().values(points, of, tension)
        level, unknown = self.level.scalar, np.isnan(self.gap.x.array)
        gap, known = fem.Function(level.V), fem.Function(level.V)
        known.x.array[:] = ~unknown
        gap.x.array[:] = np.where(unknown, 0.0, self.gap.x.array)
        inside = self._evaluated(known, points) > 1 - PARTITION  # all nodes that count there have a gap
        return np.where(inside, self._with_infinities(gap, points), np.nan)

    def along(self, points: np.ndarray, tension: Any) -> dict[str, Any]:
        names = ("u", "pressure", "gap", *(("von_mises",) if self.von_mises is not None else ()))
        return {name: self.values(points, name) for name in names}

    def _components(self, of: str, tension: Any) -> list[fem.Function]:
        known = ("u", "pressure", "gap", "von_mises")
        if of not in known:
            raise InputError(
                f"at() of a vector-valued solution has no quantity '{of}'{nearest(of, known)}; "
                "normals and forces are in solution.nodes"
            )
        if of == "u":
            return [self.level.component(self.u, k) for k in range(self.level.components)]
        if of == "von_mises" and self.von_mises is None:
            raise InputError(f"at() has no von_mises here: {NO_STRESS}")
        return [getattr(self, of)]

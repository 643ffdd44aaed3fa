"""Vector-valued problems: weighted measures of facets, contact tables and solutions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self, TypeVar

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.discrete.contact_nodes import VectorLevel, over
from fenicsx_obstacle.discrete.fields import check_real, foreign
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.points import values_of
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.vector_problem import VectorProblem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.contact import Contact
from fenicsx_obstacle.parallel import before
from fenicsx_obstacle.problems.input_checks import check_measure, facets_of
from fenicsx_obstacle.problems.solution import PARTITION, Solution
from fenicsx_obstacle.problems.values import Force
from fenicsx_obstacle.text import nearest, shown

SAME = 1e-9  # of the size of the contact set: coordinates that differ by round-off
Vector = TypeVar("Vector", bound="VectorSolution")
NO_STRESS = "give the problem its stress in UFL, stress=sigma(u)"


@dataclass(frozen=True, eq=False)
class ContactTable:
    """The contact nodes of all ranks, in the order of their coordinates; the same arrays on every rank.

    Attributes:
        points: Coordinates, shape (n, gdim).
        normals: Unit normals N_i, shape (n, gdim).
        areas: D_i, the area (in the plane the length) that belongs to a node, with the factor of the measure.
        pressure: Contact pressure p_i: >= 0 at the lower obstacle, <= 0 at the upper obstacle.
        gap: Distance to the nearest obstacle along N_i. In contact it is -eps |p_i|.
    """

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    pressure: np.ndarray
    gap: np.ndarray

    @property
    def forces(self) -> np.ndarray:
        """Forces p_i D_i N_i of the obstacles on the body, shape (n, gdim)."""
        return (self.pressure * self.areas)[:, None] * self.normals

    @property
    def resultant(self) -> np.ndarray:
        """Sum of the forces, shape (gdim,)."""
        return self.forces.sum(axis=0)

    def moment(self, about: Any = None) -> np.ndarray | float:
        """Moment of the forces about a point, in the plane a number.

        Args:
            about: Point, shape (gdim,); by default the origin.
        """
        arms = self.points if about is None else self.points - np.asarray(about, dtype=float)
        if arms.shape[1] == 3:
            return np.cross(arms, self.forces).sum(axis=0)
        return float(np.sum(arms[:, 0] * self.forces[:, 1] - arms[:, 1] * self.forces[:, 0]))

    def radius_of_gyration(self, about: Any = None) -> float:
        """The square root of sum |p_i| D_i |x_i - c|^2 / sum |p_i| D_i, a length; not-a-number without contact.

        The half-width of a Hertzian contact is this length times 2 for a cylinder, and times sqrt(5/2) for a ball. The
        error of this half-width is O(h^2); a half-width from counting nodes in contact has an error of O(h).

        Args:
            about: The middle c, shape (gdim,); by default the mean of the contact points, weighted by their forces.
        """
        size = np.abs(self.pressure * self.areas)
        if size.sum() == 0:
            return np.nan
        middle = size @ self.points / size.sum() if about is None else np.asarray(about, dtype=float)
        return float(np.sqrt(size @ ((self.points - middle) ** 2).sum(axis=1) / size.sum()))

    def ends(self) -> np.ndarray:
        """The two ends of each piece of the contact set, for plane and axially symmetric bodies; shape (pieces, 2, 2).

        Near the contact of smooth surfaces the gap grows like d^(3/2) with the distance d from the contact. Therefore
        gap^(2/3) is linear. It is extrapolated to 0 from the second to the fourth node without contact. The error is
        much smaller than the distance between nodes. If contact reaches the last node of the boundary, the end is this
        node. If one of the three nodes does not exist or is in contact, the end is not-a-number.

        Raises:
            InputError: If the body is not plane.
        """
        if self.points.shape[1] != 2:
            raise InputError("ends() is for plane and axially symmetric bodies; radius_of_gyration() also for others")
        along = np.linalg.svd(self.points - self.points.mean(axis=0), full_matrices=False)[2][0]
        along = along * np.sign(along[np.argmax(np.abs(along))])
        s = self.points @ along
        order = np.argsort(s)
        s, points, gap, closed = s[order], self.points[order], self.gap[order], self.pressure[order] != 0
        steps = np.diff(np.concatenate([[False], closed, [False]]).astype(int))
        found = []
        for first, last in zip(np.flatnonzero(steps == 1), np.flatnonzero(steps == -1) - 1, strict=True):
            end = [_zero(s, gap, closed, first, -1), _zero(s, gap, closed, last, 1)]
            found.append(np.column_stack([np.interp(end, s, column) for column in points.T]))
        return np.array(found).reshape(-1, 2, 2)


def _zero(s: np.ndarray, gap: np.ndarray, closed: np.ndarray, last: int, step: int) -> float:
    """Where the gap vanishes beyond the last closed node, in the direction of a step."""
    if not 0 <= last + step < len(s):
        return float(s[last])
    rows = last + step * np.array([2, 3, 4])
    rows = rows[(rows >= 0) & (rows < len(s))]
    if len(rows) < 3 or closed[rows].any() or not (np.isfinite(gap[rows]) & (gap[rows] > 0)).all():
        return float("nan")
    slope, value = np.polyfit(s[rows], gap[rows] ** (2 / 3), 1)
    return float(-value / slope)


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
class VectorSolution(Solution):
    """A converged vector-valued solution.

    Attributes:
        nodes: Coordinates, normals, areas, pressures and gaps of the contact nodes.
        gap: Distance to the nearest obstacle, a Function; not-a-number at nodes that are not on the contact boundary.
        von_mises: Von Mises stress in the middle of each cell, piecewise constant; None if no stress was given.
    """

    nodes: ContactTable = field(kw_only=True, repr=False)
    gap: fem.Function = field(kw_only=True, repr=False)
    von_mises: fem.Function | None = field(kw_only=True, repr=False)
    level: VectorLevel

    @property
    def force(self) -> VectorForce:
        """The contact forces: `lower` and `upper`, both >= 0, the `resultant` on the body and its `moment`."""
        sides = super().force
        return VectorForce(sides.lower, sides.upper, self.nodes.resultant, self.nodes.moment())

    def _quantities(self, points: np.ndarray) -> dict[str, Any]:
        names = ("u", "pressure", "gap", *(("von_mises",) if self.von_mises is not None else ()))
        return {name: self.at(points, name) for name in names}

    def values(self, points: np.ndarray, of: str = "u") -> np.ndarray:
        if of != "gap":
            return super().values(points, of)
        level, unknown = self.level.scalar, np.isnan(self.gap.x.array)
        gap, known = fem.Function(level.V), fem.Function(level.V)
        known.x.array[:] = ~unknown
        gap.x.array[:] = np.where(unknown, 0.0, self.gap.x.array)
        inside = self._evaluated(known, points) > 1 - PARTITION  # all nodes that count there have a gap
        return np.where(inside, self._with_infinities(gap, points), np.nan)

    def _shape(self, of: str) -> tuple[int, ...]:
        return (self.level.mesh.geometry.dim,) if of == "u" else ()

    def _components(self, of: str) -> list[fem.Function]:
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

    def _evaluated(self, function: fem.Function, points: np.ndarray) -> np.ndarray:
        return values_of(function, points)

    def functions(self) -> dict[str, fem.Function]:
        """The scalar fields by name; components of u are u0, u1, u2."""
        parts = {f"u{k}": self.level.component(self.u, k) for k in range(self.level.components)}
        return {**parts, "pressure": self.pressure, "contact": self.contact, "gap": self.gap}

    def by_cell(self) -> dict[str, fem.Function]:
        return {} if self.von_mises is None else {"von_mises": self.von_mises}

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

    def tables(self) -> dict[str, np.ndarray]:
        """The contact nodes."""
        return {f"nodes/{one.name}": getattr(self.nodes, one.name) for one in dataclasses.fields(self.nodes)}

    def on_pieces(self, level: Level, fields: Mapping[str, fem.Function], parents: np.ndarray) -> Self:
        von_mises = None
        if self.von_mises is not None:
            space = releases.functionspace(level.mesh, "DG", 0)
            von_mises = fem.Function(space)
            from_dofs = releases.cell_dofs(self.von_mises.function_space)[parents, 0]
            von_mises.x.array[releases.cell_dofs(space)[: len(parents), 0]] = self.von_mises.x.array[from_dofs]
            von_mises.x.scatter_forward()
        return _assembled(self, level, fields, von_mises)

    def with_values(self, given: Mapping[str, np.ndarray]) -> Self:
        """This solution, of P1 simplices, with other values (collective).

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
        return replace(_assembled(self, level, fields, von_mises), nodes=nodes)


def _assembled(
    solution: Vector, level: Level, fields: Mapping[str, fem.Function], von_mises: fem.Function | None
) -> Vector:
    """The same solution with other functions, on another mesh (collective)."""
    new, components = over(level), [fields[f"u{k}"] for k in range(level.mesh.geometry.dim)]
    rest = {name: fields[name] for name in ("pressure", "contact", "gap")}
    return replace(solution, level=new, u=new.vector(components), von_mises=von_mises, **rest)


def saved(fields: Mapping[str, Any]) -> VectorSolution:
    """A solution of what a folder holds (collective).

    Args:
        fields: Those of `fenicsx_obstacle.io.folder.read`.
    """
    level = over(fields["level"])
    u = level.vector([fields[f"u{k}"] for k in range(level.components)])
    kept = {name: fields[name] for name in ("pressure", "contact", "lower", "upper", "history", "record", "gap")}
    nodes = ContactTable(**{name: np.array(values) for name, values in fields["nodes"].items()})
    return VectorSolution(level=level, u=u, nodes=nodes, von_mises=fields.get("von_mises"), **kept)


class VonMises:
    """The von Mises stress, compiled once.

    Args:
        stress: A tensor in UFL, shape (3, 3), or (2, 2) of plane stress.
        mesh: Where it is evaluated.
        name: Of the problem, for messages.

    Raises:
        InputError: If it is no such tensor.
    """

    def __init__(self, stress: Any, mesh: dmesh.Mesh, name: str):
        if not isinstance(stress, ufl.core.expr.Expr) or stress.ufl_shape not in ((2, 2), (3, 3)):
            raise InputError(
                f"{name}: stress = {shown(stress)}: expected a tensor in UFL with three rows, in plane stress two"
            )
        if foreign(stress, mesh.ufl_domain()):
            raise InputError(f"{name}: stress holds a Function or coordinates of another mesh than u")
        check_real(stress, f"{name}: stress")
        full = stress
        if stress.ufl_shape == (2, 2):
            full = ufl.as_matrix([[stress[0, 0], stress[0, 1], 0], [stress[1, 0], stress[1, 1], 0], [0, 0, 0]])
        deviator = full - ufl.tr(full) / 3 * ufl.Identity(3)
        self.space = releases.functionspace(mesh, "DG", 0)
        self.expression = releases.expression(ufl.sqrt(1.5 * ufl.inner(deviator, deviator)), self.space)

    def now(self) -> fem.Function:
        """At the present u, in the middle of each cell (collective)."""
        found = fem.Function(self.space, name="von_mises")
        found.interpolate(self.expression)
        found.x.scatter_forward()
        return found


def vector_solution(
    problem: Problem, contact: Contact, von_mises: fem.Function | None, fields: tuple[Any, ...]
) -> VectorSolution:
    """The solution of a solved problem (collective).

    Args:
        problem: Vector-valued.
        contact: Its contact.
        von_mises: Its von Mises stress.
        fields: Those of `Solution` after the level, from u to the tension.
    """
    assert isinstance(problem, VectorProblem)
    nodes, gap = contact_table(problem, contact.pressure), problem.gap_function(np.minimum(*problem.gaps()))
    solution = VectorSolution(problem.level, *fields, nodes=nodes, gap=gap, von_mises=von_mises)
    more = {"resultant": nodes.resultant.tolist(), "moment": np.asarray(nodes.moment()).tolist(),
            "patches": contact_patches(problem, contact, solution.contact)}  # fmt: skip
    record = {**solution.record, "contact": {**solution.record["contact"], **more}}
    return replace(solution, record=record)


def contact_table(problem: VectorProblem, p: np.ndarray) -> ContactTable:
    """The contact nodes of a solved problem (collective).

    Args:
        problem: Vector-valued.
        p: Its pressure at owned dofs.
    """
    contact, level = problem.data.contact, problem.level
    own = contact.dofs < level.owned
    dofs, gdim = contact.dofs[own], level.mesh.geometry.dim
    gap = np.minimum(*problem.gaps())[dofs]
    columns = [level.nodes.T[contact.nodes[own], :gdim], contact.normals[own], contact.weights[own], p[dofs], gap]
    gathered = (np.concatenate(level.comm.allgather(column)) for column in columns)
    points, *values = gathered
    order = np.lexsort(points.T[::-1])
    return ContactTable(points[order], *(value[order] for value in values))


def contact_patches(problem: VectorProblem, contact: Contact, touching: fem.Function) -> list[dict[str, Any]]:
    """Force, area, peak of abs(p) and middle of each connected patch of the contact set, in the order of their first
    nodes; the same on every rank (collective).

    Nodes in contact on one facet are connected. Areas and forces of all patches add up to those of the contact.

    Args:
        problem: Vector-valued.
        contact: Of its solution.
        touching: 1 at nodes in contact, in Q.
    """
    found, level = problem.data.contact, problem.level
    pressed = np.zeros(len(level.nodes.T), dtype=bool)
    pressed[level.node_of] = touching.x.array > 0.5
    rows, there = found.facet_nodes, pressed[found.facet_nodes]
    first = np.take_along_axis(rows, np.argmax(there, axis=1)[:, None], axis=1)
    own = (found.dofs < level.owned) & pressed[found.nodes]
    dofs, global_of = found.dofs[own], level.V.dofmap.index_map.local_to_global
    sizes = found.weights[own] * contact.pressure[dofs]
    columns = [global_of(found.nodes[own].astype(np.int32)), global_of(np.broadcast_to(first, rows.shape)[there]),
               global_of(rows[there]), level.nodes.T[found.nodes[own], : level.mesh.geometry.dim],
               sizes[:, None] * found.normals[own], found.weights[own] * contact.shares[dofs] / problem.thickness,
               np.abs(contact.pressure[dofs])]  # fmt: skip
    names, a, b, points, forces, areas, pressures = (np.concatenate(level.comm.allgather(one)) for one in columns)
    order, shape = np.argsort(names), (len(names), len(names))
    ends = tuple(order[np.searchsorted(names[order], one)] for one in (a, b))
    patch = connected_components(coo_matrix((np.ones(len(a)), ends), shape=shape), directed=False)[1]
    if not len(points):
        return []
    size = SAME * float(np.ptp(points, axis=0).max()) or 1.0
    before, patches, seen = np.lexsort(np.round(points.T[::-1] / size)), list[dict[str, Any]](), set[int]()
    for number in patch[before].tolist():
        if number not in seen:
            seen.add(number)
            of = before[patch[before] == number]  # sums in one order on any number of ranks
            weights = np.linalg.norm(forces[of], axis=1)
            patches.append({
                "force": forces[of].sum(axis=0).tolist(), "area": float(areas[of].sum()),
                "peak": float(pressures[of].max()), "at": (weights @ points[of] / weights.sum()).tolist(),
            })  # fmt: skip
    return patches


def facets_and_weight(measure: Any, mesh: dmesh.Mesh, name: str) -> tuple[np.ndarray, Any]:
    """Local facets of a measure of the boundary, and the factor before it, or None (collective).

    Args:
        measure: `ds(3)`, or a factor times it.
        mesh: Mesh of u.
        name: Of the problem, for messages.

    Raises:
        InputError: If it is neither, or has no facets.
    """
    wanted = "expected ds, of facets where contact can be, or a factor times it, such as x[0] * ds(3)"
    weight = None
    if isinstance(measure, ufl.Form):
        integrals = measure.integrals()
        weight = integrals[0].integrand()
        if measure.arguments() or any(one.integrand() != weight for one in integrals):
            raise InputError(f"{name}: measure = {shown(measure)}: {wanted}")
        if foreign(weight, mesh.ufl_domain()):
            raise InputError(f"{name}: the factor of measure is of another mesh than u")
        check_real(weight, f"{name}: the factor of measure")
        for one in integrals:
            check_measure(one, mesh, f"{name}: measure")
        ids: list[Any] = []
        for one in integrals:
            ids += list(one.subdomain_id()) if isinstance(one.subdomain_id(), tuple) else [one.subdomain_id()]
        measure = ufl.Measure(integrals[0].integral_type(), domain=mesh, subdomain_data=integrals[0].subdomain_data())
        measure = measure if "everywhere" in ids else measure(tuple(ids))
    if not isinstance(measure, ufl.Measure) or measure.integral_type() != "exterior_facet":
        raise InputError(f"{name}: u is vector-valued: measure = {shown(measure)}: {wanted}")
    return facets_of(measure, mesh, name), weight

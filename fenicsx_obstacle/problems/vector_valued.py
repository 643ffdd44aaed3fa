"""Vector-valued problems: weighted measures of facets, contact tables and solutions."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.contact_nodes import VectorLevel
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.points import locate, mean_over_cells
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.vector_problem import VectorProblem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.problems.residual_form import facets_of
from fenicsx_obstacle.problems.solution import Solution
from fenicsx_obstacle.text import nearest, shown

NO_FILES = (
    "a vector-valued solution is neither saved nor drawn: write u, pressure and contact with dolfinx.io, as with "
    "VTXWriter(comm, 'u.bp', [solution.u])"
)


@dataclass(frozen=True, eq=False)
class ContactTable:
    """The contact nodes in the order of their coordinates, the same on every rank.

    Attributes:
        points: Coordinates, shape (n, gdim).
        normals: Unit normals N_i, shape (n, gdim).
        areas: D_i, the area (in the plane the length) that belongs to a node, with the factor of the measure.
        pressure: p_i, <= 0 against the upper obstacle.
        gap: Distance to the nearest obstacle along N_i; negative by eps |p_i| in contact.
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
        """Their sum, shape (gdim,)."""
        return self.forces.sum(axis=0)

    def moment(self, about: Any = None) -> np.ndarray | float:
        """Their moment, in the plane a number.

        Args:
            about: Point, shape (gdim,); by default the origin.
        """
        arms = self.points if about is None else self.points - np.asarray(about, dtype=float)
        found = np.cross(arms, self.forces).sum(axis=0)
        return found if found.ndim else float(found)


@dataclass(frozen=True, eq=False)
class VectorSolution(Solution):
    """A converged vector-valued solution.

    Attributes:
        nodes: Pressures, gaps and normals at the contact nodes; their resultant.
    """

    nodes: ContactTable | None = field(default=None, repr=False)

    @property
    def plain(self) -> VectorSolution:
        return self

    def save(self, folder: str | Path) -> NoReturn:
        """Not for vector-valued solutions.

        Raises:
            InputError: With what writes them.
        """
        raise InputError(NO_FILES)

    def plot(self, path: str | Path | None = None) -> NoReturn:
        """Not for vector-valued solutions.

        Raises:
            InputError: With what draws them.
        """
        raise InputError(NO_FILES)

    def _shape(self, of: str) -> tuple[int, ...]:
        return (self.level.mesh.geometry.dim,) if of == "u" else ()

    def _components(self, of: str) -> list[fem.Function]:
        known = ("u", "pressure")
        if of not in known:
            raise InputError(
                f"at() of a vector-valued solution knows no '{of}'{nearest(of, known)}; it knows u and pressure; gaps "
                "and normals are in solution.nodes"
            )
        if of == "pressure":
            return [self.pressure]
        level = self.level
        assert isinstance(level, VectorLevel)
        components = [fem.Function(level.Q) for _ in range(level.components)]
        for k, component in enumerate(components):
            component.x.array[:] = self.u.x.array[level.components * level.node_of + k]
        return components

    def _evaluated(self, function: fem.Function, points: np.ndarray) -> np.ndarray:
        mesh = self.level.mesh
        if releases.cell_name(mesh) in SIMPLICES:
            rows, cells, _ = locate(Level(mesh, self.level.h), points)
        else:
            rows, cells = releases.cells_near(mesh, points, 0.0, within=True)
        found = function.eval(points[rows], cells.astype(np.int32)) if len(rows) else np.empty(0)
        return mean_over_cells(mesh.comm, len(points), rows, np.ravel(found))


def contact_table(problem: Problem, p: np.ndarray) -> ContactTable:
    """The contact nodes of a solved problem (collective).

    Args:
        problem: Vector-valued.
        p: Its pressure at owned dofs.
    """
    assert isinstance(problem, VectorProblem)
    contact, level = problem.data.contact, problem.level
    own = contact.dofs < level.owned
    dofs, gdim = contact.dofs[own], level.mesh.geometry.dim
    gap = np.minimum(*problem.gaps())[dofs]
    columns = [level.nodes.T[contact.nodes[own], :gdim], contact.normals[own], contact.weights[own], p[dofs], gap]
    gathered = (np.concatenate(level.comm.allgather(column)) for column in columns)
    points, *values = gathered
    order = np.lexsort(points.T[::-1])
    return ContactTable(points[order], *(value[order] for value in values))


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
        ids: list[Any] = []
        for one in integrals:
            ids += list(one.subdomain_id()) if isinstance(one.subdomain_id(), tuple) else [one.subdomain_id()]
        measure = ufl.Measure(integrals[0].integral_type(), domain=mesh, subdomain_data=integrals[0].subdomain_data())
        measure = measure if "everywhere" in ids else measure(tuple(ids))
    if not isinstance(measure, ufl.Measure) or measure.integral_type() != "exterior_facet":
        raise InputError(f"{name}: u is vector-valued: measure = {shown(measure)}: {wanted}")
    return facets_of(measure, mesh, name), weight

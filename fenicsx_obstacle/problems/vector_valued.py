"""Vector-valued problems: weighted measures of facets, von Mises stress, contact nodes and their patches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.fields import check_real, foreign
from fenicsx_obstacle.discrete.contact_set import Contact
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.vector_problem import VectorProblem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.contact_table import ContactTable
from fenicsx_obstacle.fields.scalar import Fields
from fenicsx_obstacle.fields.vector import VectorFields
from fenicsx_obstacle.problems.input_checks import check_measure, facets_of, ids_of
from fenicsx_obstacle.text import shown

SAME = 1e-9  # of the size of the contact set: coordinates that differ by round-off


def von_mises_of(stress: Any, mesh: dmesh.Mesh, name: str) -> Callable[[], fem.Function]:
    """A function that returns the von Mises stress at the present u, in the middle of each cell; compiled once (both
    are collective).

    Args:
        stress: A tensor in UFL, shape (3, 3), or (2, 2) of plane stress.
        mesh: Where it is evaluated.
        name: Of the problem, for messages.

    Raises:
        InputError: If it is no such tensor.
    """
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
    space = releases.functionspace(mesh, "DG", 0)
    expression = releases.expression(ufl.sqrt(1.5 * ufl.inner(deviator, deviator)), space)

    def now() -> fem.Function:
        found = fem.Function(space, name="von_mises")
        found.interpolate(expression)
        found.x.scatter_forward()
        return found

    return now


def vector_fields(
    problem: Problem, contact: Contact, scalar: Fields, von_mises: fem.Function | None
) -> tuple[VectorFields, dict[str, Any]]:
    """The fields of a solved problem, and what its record says of contact besides (collective).

    Args:
        problem: Vector-valued.
        contact: Its contact.
        scalar: u, pressure, contact set and obstacles.
        von_mises: Its von Mises stress.
    """
    assert isinstance(problem, VectorProblem)
    nodes, gap = contact_table(problem, contact.pressure), problem.gap_function(np.minimum(*problem.gaps()))
    fields = VectorFields(
        problem.level, scalar.u, scalar.pressure, scalar.contact, scalar.lower, scalar.upper, nodes=nodes, gap=gap,
        von_mises=von_mises,
    )  # fmt: skip
    more = {"resultant": nodes.resultant.tolist(), "moment": np.asarray(nodes.moment()).tolist(),
            "patches": contact_patches(problem, contact, fields.contact)}  # fmt: skip
    return fields, more


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
            pushes = np.linalg.norm(forces[of], axis=1)
            middle = np.average(points[of], axis=0, weights=pushes if pushes.any() else None)  # contact without force
            patches.append({
                "force": forces[of].sum(axis=0).tolist(), "area": float(areas[of].sum()),
                "peak": float(pressures[of].max()), "at": middle.tolist(),
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
        weight, tags, kind = integrals[0].integrand(), integrals[0].subdomain_data(), integrals[0].integral_type()
        ids = [number for one in integrals for number in ids_of(one)]
        alike = all(one.integrand() == weight and one.subdomain_data() is tags and one.integral_type() == kind
                    for one in integrals)  # fmt: skip
        once = len(set(ids)) == len(ids) and ("everywhere" not in ids or len(ids) == 1)
        if measure.arguments() or not (alike and once):
            raise InputError(f"{name}: measure = {shown(measure)}: {wanted}")
        if foreign(weight, mesh.ufl_domain()):
            raise InputError(f"{name}: the factor of measure is of another mesh than u")
        check_real(weight, f"{name}: the factor of measure")
        for one in integrals:
            check_measure(one, mesh, f"{name}: measure")
        measure = ufl.Measure(kind, domain=mesh, subdomain_data=tags)
        measure = measure if "everywhere" in ids else measure(tuple(ids))
    if not isinstance(measure, ufl.Measure) or measure.integral_type() != "exterior_facet":
        raise InputError(f"{name}: u is vector-valued: measure = {shown(measure)}: {wanted}")
    return facets_of(measure, mesh, name), weight

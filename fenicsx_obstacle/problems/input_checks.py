"""Checks of what callers pass to an ObstacleProblem beside its form: obstacles, conditions, measures and options."""

from __future__ import annotations

import numbers
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from ufl.algorithms import extract_coefficients

from fenicsx_obstacle.data.fields import field
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.tags import check_both_sides, check_tags
from fenicsx_obstacle.parallel import total, warn
from fenicsx_obstacle.text import shown


def check_unknown(u: Any, place: str, *, lower: Any, upper: Any, of: Any, measure: Any, stress: Any) -> None:
    """Reject a problem without an obstacle, a u that is no Function, for a scalar u what is for vectors, and for bounds
    of components what has no meaning there.

    Raises:
        InputError: Naming the argument.
    """
    if lower is None and upper is None:
        raise InputError(f"{place}: give an obstacle, lower= or upper=")
    if not isinstance(u, fem.Function):
        raise InputError(f"{place}: u = {shown(u)}: expected the Function that F is to be solved for")
    if u.ufl_shape == (1,):
        raise InputError(f"{place}: u is a vector with one component: take a Function of a scalar Lagrange space")
    vector_valued = u.function_space.dofmap.index_map_bs > 1
    if of is not None and not vector_valued:
        raise InputError(f"{place}: of= is for vector-valued u; obstacles bound a scalar u itself")
    if stress is not None and not vector_valued:
        raise InputError(f"{place}: stress= is for vector-valued u")
    for key, value in (("of", of), ("measure", measure), ("stress", stress)):
        if value is not None and (isinstance(lower, Mapping) or isinstance(upper, Mapping)):
            raise InputError(f"{place}: {key}= has no meaning where lower or upper is a dict: leave it out")


def checked_options(options: Any, place: str, example: str = "{'ksp_type': 'cg'}") -> dict[str, Any]:
    """A copy of options of PETSc or of a compiler, empty for None.

    Raises:
        InputError: If they are no dict with texts as keys.
    """
    if options is not None and not (isinstance(options, Mapping) and all(isinstance(key, str) for key in options)):
        raise InputError(f"{place} = {shown(options)}: expected a dict, such as {example}")
    return {} if options is None else dict(options)


def conditions(bcs: Any, V: fem.FunctionSpace, place: str) -> list[Any]:
    """Dirichlet conditions of V, from a list of them, one, or None.

    Raises:
        InputError: For anything else.
    """
    given = [] if bcs is None else [bcs] if hasattr(bcs, "dof_indices") else bcs
    if not isinstance(given, Sequence):
        raise InputError(f"{place}: bcs = {shown(bcs)}: expected a list of what dolfinx.fem.dirichletbc returns")
    for number, bc in enumerate(given):
        if not hasattr(bc, "dof_indices"):
            wanted = "expected what dolfinx.fem.dirichletbc returns"
            raise InputError(f"{place}: bcs[{number}] = {shown(bc)}: {wanted}")
        space = bc.function_space
        if not V._cpp_object.contains(getattr(space, "_cpp_object", space)):
            raise InputError(f"{place}: bcs[{number}] is of another space than u: take u.function_space for it")
        nodes, dofs = V.dofmap.index_map, np.asarray(bc.dof_indices()[0])
        beyond = dofs[(dofs < 0) | (dofs >= (nodes.size_local + nodes.num_ghosts) * V.dofmap.index_map_bs)]
        if len(beyond) > 0:
            raise InputError(
                f"{place}: bcs[{number}] has the dof {beyond[0]}, which u does not have: dirichletbc takes dofs as "
                "locate_dofs_topological returns them for the same space; for vector-valued u they are numbers of "
                "nodes, and one component is in the space u.function_space.sub(k)"
            )
    return list(given)


def number_of(eps: Any, place: str) -> float | str:
    """The value of eps: a positive number, or "auto".

    Raises:
        InputError: For anything else.
    """
    value = float(eps.value) if isinstance(eps, fem.Constant) and eps.ufl_shape == () else eps
    if isinstance(value, str) and value == "auto":
        return value
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise InputError(f"{place}: eps = {shown(eps)}: expected a number, a Constant or 'auto'")
    number = float(value)
    if not 0 < number < np.inf:
        raise InputError(f"{place}: eps = {number:g}: must be positive and finite")
    return number


def obstacle(g: Any, u: fem.Function, place: str) -> Field:
    """An obstacle as a datum.

    Args:
        g: A Function of the space of u, of another one or on another mesh; a number, a UFL expression or a callable.
        u: The unknown, which g must not hold.
        place: What messages call it.

    Raises:
        InputError: If g is none of these, or holds u.
    """
    if g is u:
        raise InputError(f"{place} is u itself, which changes during the solve: pass a copy, u.copy()")
    if isinstance(g, ufl.core.expr.Expr) and u in extract_coefficients(g):
        raise InputError(
            f"{place} depends on u: an obstacle must not depend on the solution; for a fixed-point iteration "
            "use a copy, u.copy()"
        )
    found = field(g, place)
    if found.moves:
        raise InputError(
            f"{place}: the callable takes two arguments: it gets x alone, an array of shape (3, n), whose rows are "
            "the coordinates x[0], x[1], x[2]"
        )
    return found


def ids_of(integral: ufl.Integral | ufl.Measure) -> tuple[Any, ...]:
    """The tags of an integral or a measure, or 'everywhere'."""
    found = integral.subdomain_id()
    return found if isinstance(found, tuple) else (found,)


def check_measure(measure: ufl.Measure | ufl.Integral, mesh: dmesh.Mesh, place: str) -> None:
    """Reject a measure, or the measure of an integral, whose domain or MeshTags are of another mesh, and one of facets
    inside of which no rank has both sides (collective).

    Args:
        measure: What was given; its domain may be open.
        mesh: Mesh of u.
        place: What messages call it.

    Raises:
        InputError: With the remedy.
    """
    domain, tags = measure.ufl_domain(), measure.subdomain_data()
    if domain is not None and domain != mesh.ufl_domain():
        raise InputError(f"{place} is of another mesh than u: take domain=u.function_space.mesh")
    codim = {"cell": 0, "exterior_facet": 1, "interior_facet": 1}.get(measure.integral_type())
    if codim is not None and hasattr(tags, "find"):
        check_tags(tags, mesh, mesh.topology.dim - codim, f"{place}: subdomain_data")
    if measure.integral_type() == "interior_facet":
        numbered = hasattr(tags, "find") and "everywhere" not in ids_of(measure)
        found = np.concatenate([tags.find(int(tag)) for tag in ids_of(measure)]) if numbered else None
        check_both_sides(mesh, found, place)


def warn_of_conditions(bcs: Sequence[Any], comm: MPI.Comm, place: str) -> None:
    """Warn of Dirichlet conditions without dofs (collective).

    Args:
        bcs: The conditions.
        comm: Communicator of the mesh.
        place: What messages call the problem.
    """
    for number, bc in enumerate(bcs):
        if total(comm, len(bc.dof_indices()[0])) == 0:
            warn(comm, f"{place}: bcs[{number}] has no dofs, so that it has no effect", stacklevel=4)


def facets_of(measure: Any, mesh: dmesh.Mesh, name: str) -> np.ndarray:
    """Owned facets of a measure (collective).

    Raises:
        InputError: If it is no measure of facets of this mesh, or has no facets.
    """
    kinds = ("exterior_facet", "interior_facet")
    if not isinstance(measure, ufl.Measure) or measure.integral_type() not in kinds:
        raise InputError(f"{name}: measure = {shown(measure)}: expected ds or dS, of facets where contact can be")
    check_measure(measure, mesh, f"{name}: measure")
    tags, ids = measure.subdomain_data(), measure.subdomain_id()
    mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    boundary = np.asarray(dmesh.exterior_facet_indices(mesh.topology), dtype=np.int32)
    found = np.arange(mesh.topology.index_map(mesh.topology.dim - 1).size_local, dtype=np.int32)
    if ids_of(measure) != ("everywhere",):
        if not hasattr(tags, "find"):
            raise InputError(f"{name}: measure has the tag {ids} without MeshTags: give it subdomain_data=")
        found = np.intersect1d(found, np.concatenate([tags.find(number) for number in ids_of(measure)]))
    # as in integrals, a tag of ds has no facets inside, and one of dS none of the boundary
    keep = np.intersect1d if measure.integral_type() == "exterior_facet" else np.setdiff1d
    found = keep(found, boundary).astype(np.int32)
    if total(mesh.comm, len(found)) == 0:
        kinds_of_facets = "ds is for facets of the boundary, and dS for those inside"
        raise InputError(f"{name}: measure has no facets: no facet is tagged {ids}; {kinds_of_facets}")
    return found


def vertex_digests(level: Level) -> list[bytes]:
    """Digests of the local vertices of a mesh, and of those that it was refined from (local)."""
    meshes = {id(one.mesh): one.mesh for one in level.downward}
    return [sha256(np.ascontiguousarray(mesh.geometry.x).data).digest() for mesh in meshes.values()]


def check_not_moved(level: Level, digests: list[bytes], place: str) -> None:
    """Reject a mesh that was moved: weights, eps and sampled obstacles are those of its former vertices (collective).

    Args:
        level: With the mesh.
        digests: The `vertex_digests` of before.
        place: What messages call the problem.

    Raises:
        InputError: On all ranks, if vertices of any rank were moved.
    """
    moved = vertex_digests(level) != digests
    if total(level.comm, float(moved)) > 0:
        raise InputError(f"{place}: the mesh was moved since this problem was created: create a new one")

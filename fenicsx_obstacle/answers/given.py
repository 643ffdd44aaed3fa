"""What callers of `solve_form` pass, checked, and brought into the space of u."""

from __future__ import annotations

import numbers
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.corealg.traversal import unique_pre_traversal

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.points import values_of
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import agree
from fenicsx_obstacle.signatures import shown

_OBSTACLE = "a Function, a number, a UFL expression, or a callable of x, as Function.interpolate takes it"


def check_form(form: Any, u: fem.Function, name: str, arguments: int) -> None:
    """Reject what is not a form of u with so many arguments, on the mesh and in the space of u.

    Raises:
        InputError: Naming what came, and what is expected.
    """
    kind = {0: "a functional of u", 1: "a linear form in one test function"}[arguments]
    if not isinstance(form, ufl.Form):
        raise InputError(f"solve_form: {name} = {shown(form)}: expected a UFL form, {kind}")
    found = form.arguments()
    if len(found) != arguments:
        words = "must be linear in one test function, and hold no trial function" if arguments else f"must be {kind}"
        raise InputError(f"solve_form: {name} {words}")
    if any(argument.ufl_function_space() != u.function_space for argument in found):
        raise InputError(f"solve_form: {name}: its test function is of another space than u")
    if u not in form.coefficients():
        raise InputError(f"solve_form: {name} does not depend on u: write it with the Function u, not a trial function")
    domain = u.function_space.mesh.ufl_domain()
    foreign = [integral for integral in form.integrals() if _foreign(integral.integrand(), domain)]
    if foreign or any(one != domain for one in form.ufl_domains()):
        raise InputError(f"solve_form: {name} holds a Function or a measure of another mesh than that of u")


def conditions(bcs: Any, V: fem.FunctionSpace) -> list[Any]:
    """Dirichlet conditions of V, from a list of them, one, or None.

    Raises:
        InputError: For anything else.
    """
    given = [] if bcs is None else [bcs] if hasattr(bcs, "dof_indices") else bcs
    if not isinstance(given, Sequence):
        raise InputError(f"solve_form: bcs = {shown(bcs)}: expected a list of what dolfinx.fem.dirichletbc returns")
    for number, bc in enumerate(given):
        if not hasattr(bc, "dof_indices"):
            wanted = "expected what dolfinx.fem.dirichletbc returns"
            raise InputError(f"solve_form: bcs[{number}] = {shown(bc)}: {wanted}")
        space = bc.function_space
        if getattr(space, "_cpp_object", space) != V._cpp_object:
            raise InputError(f"solve_form: bcs[{number}] is of another space than u: take u.function_space for it")
    return list(given)


def penalty_parameter(eps: Any) -> float | str | None:
    """The value of eps: a positive number, None, or "auto".

    Raises:
        InputError: For anything else.
    """
    value = eps
    if isinstance(eps, fem.Constant) and eps.ufl_shape == ():
        value = float(eps.value)
    if value is None or (isinstance(value, str) and value == "auto"):
        return value
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise InputError(f"solve_form: eps = {shown(eps)}: expected a number, a Constant, 'auto', or None for the "
                         "variational inequality")  # fmt: skip
    number = float(value)
    if not 0 < number < np.inf:
        raise InputError(f"solve_form: eps = {number:g}: must be positive and finite")
    return number


def obstacle(g: Any, u: fem.Function, level: Level, name: str) -> fem.Function:
    """An obstacle as a Function of the space of u: interpolated at the vertices (collective).

    Args:
        g: A Function of this space, of another one or on another mesh; a number, a UFL expression or a callable.
        u: The unknown, which g must not hold.
        level: Its mesh and space.
        name: lower or upper, for messages.

    Raises:
        InputError: If g is none of these, or has no value at some vertex.
    """
    place = f"solve_form: {name}"
    taken = fem.Function(level.V)
    if isinstance(g, fem.Function):
        taken.x.array[:] = _of_function(g, u, level, place)
    elif isinstance(g, ufl.core.expr.Expr):
        _check_expression(g, u, place)
        taken.interpolate(releases.expression(g, level.V))
    elif isinstance(g, numbers.Real) and not isinstance(g, bool):
        taken.x.array[:] = float(g)
    elif callable(g) and not isinstance(g, type):
        taken.x.array[:] = _of_callable(g, level, place)
    else:
        raise InputError(f"{place} = {shown(g)}: expected {_OBSTACLE}")
    return taken


def _of_function(g: fem.Function, u: fem.Function, level: Level, place: str) -> np.ndarray:
    """Its values at the local vertices (collective)."""
    V = g.function_space
    if g is u:
        raise InputError(f"{place} is u itself, which is about to change: give a copy, u.copy()")
    if V == level.V:
        return g.x.array
    if g.ufl_shape != ():
        raise InputError(f"{place} is a Function with {int(np.prod(g.ufl_shape))} components: expected one of one")
    if not V.dofmap.dof_layout.entity_dofs(0, 0):
        raise InputError(f"{place} is a Function that is not continuous: at a vertex each cell has a value of its own; "
                         "interpolate it into a continuous space")  # fmt: skip
    if V.mesh.ufl_domain() == level.mesh.ufl_domain():
        taken = fem.Function(level.V)
        taken.interpolate(releases.expression(g, level.V))
        return taken.x.array
    if MPI.Comm.Compare(V.mesh.comm, level.comm) not in (MPI.IDENT, MPI.CONGRUENT):
        raise InputError(f"{place} is a Function on a mesh of other ranks: make that mesh with the communicator of u's")
    parts = level.comm.allgather(level.points.T)
    points, start = np.vstack(parts), sum(len(part) for part in parts[: level.comm.rank])
    values = values_of(g, points)
    lost = np.flatnonzero(~np.isfinite(values))
    if len(lost):
        where = ", ".join(f"{x:.4g}" for x in min(points[lost].tolist())[: level.mesh.geometry.dim])
        raise InputError(f"{place} is a Function on another mesh, with no finite value at ({where}): is that outside?")
    return values[start : start + len(parts[level.comm.rank])]


def _of_callable(g: Callable[[np.ndarray], Any], level: Level, place: str) -> np.ndarray:
    """Its values at the local vertices (collective)."""
    values = np.empty(0)
    with agree(level.comm):
        try:
            values = np.asarray(g(level.points.copy()), dtype=np.float64)
            values = np.broadcast_to(values, level.points.shape[1:])
        except Exception as error:
            got = f"{type(error).__name__}: {error}"
            wanted = "takes x of shape (3, n), as Function.interpolate does, and returns n values"
            raise InputError(f"{place}: the callable {wanted}; this one: {got}") from error
    return values


def _check_expression(g: Any, u: fem.Function, place: str) -> None:
    """Reject expressions that have no value at a vertex of the mesh of u."""
    if g.ufl_shape != ():
        raise InputError(f"{place} is an expression of shape {g.ufl_shape}: expected one of one component")
    if u in extract_coefficients(g):
        raise InputError(
            f"{place} depends on u: obstacles are given; put a copy, u.copy(), into it to iterate over them"
        )
    if extract_arguments(g):
        raise InputError(f"{place} holds a test or trial function: expected {_OBSTACLE}")
    if _foreign(g, u.function_space.mesh.ufl_domain()):
        raise InputError(f"{place} is an expression on another mesh: interpolate it there, and give that Function")


def _foreign(expression: Any, domain: Any) -> bool:
    """Whether any part of an expression lives on another mesh."""
    leaves = (node for node in unique_pre_traversal(expression) if not node.ufl_operands)
    return any(one != domain for leaf in leaves for one in ufl.domain.extract_domains(leaf))

"""What callers of `solve_form` pass, checked."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import extract_coefficients

from fenicsx_obstacle.discrete.fields import field, foreign
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.words import shown


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
    elsewhere = [integral for integral in form.integrals() if foreign(integral.integrand(), domain)]
    if elsewhere or any(one != domain for one in form.ufl_domains()):
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


def obstacle(g: Any, u: fem.Function, name: str) -> Field:
    """An obstacle as a datum.

    Args:
        g: A Function of the space of u, of another one or on another mesh; a number, a UFL expression or a callable.
        u: The unknown, which g must not hold.
        name: lower or upper, for messages.

    Raises:
        InputError: If g is none of these, or holds u.
    """
    place = f"solve_form: {name}"
    if g is u:
        raise InputError(f"{place} is u itself, which is about to change: give a copy, u.copy()")
    if isinstance(g, ufl.core.expr.Expr) and u in extract_coefficients(g):
        raise InputError(
            f"{place} depends on u: obstacles are given; put a copy, u.copy(), into it to iterate over them"
        )
    return field(g, place)

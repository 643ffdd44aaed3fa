"""The penalty (1/eps) I((u - g)^+, v) of (3.4) and the contact pressure (3.7)-(3.8)."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.rules import Rule, facet_of, has_nodal_rule, nodal_rule
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.signatures import names_checked
from fenicsx_obstacle.text import shown


def positive_part(t: Any) -> Any:
    """t^+ = max(t, 0), whose derivative at 0 is 0: the choice of the paper's iteration (3.4)*."""
    return ufl.max_value(t, 0.0)


@names_checked
def penalty(
    u: Any,
    v: Any,
    *,
    eps: Any,
    lower: Any = None,
    upper: Any = None,
    rule: Rule | None = None,
    measure: Any = None,
) -> ufl.Form:
    """The penalty term of the residual F(u; v), for a solver of your own: `F += penalty(u, v, lower=g, eps=1e-4)`.

    The term is (1/eps) I((u - upper)^+ - (lower - u)^+, v), as in equation (3.4) of Kikuchi (1981). I is the quadrature
    rule whose points are the nodes, so that the term is diagonal in the nodal values.

    Args:
        u: The unknown, or any scalar UFL expression of it, such as `ufl.dot(u, n)`.
        v: Test function, or the same scalar expression of the test function.
        eps: Penalty parameter > 0 in the unit of u/p. The value of a Constant can be changed later.
        lower: Lower obstacle, a number, a Constant, a Function or a UFL expression; None if there is none.
        upper: Upper obstacle, of the same kinds; None if there is none.
        rule: Quadrature rule I; by default `nodal_rule` for the element of v.
        measure: Where contact can happen; by default the whole domain, `ds(3)` for a part of the boundary.

    Returns:
        A linear form in v.

    Raises:
        InputError: If eps is not positive, no obstacle is given or one is infinite, or the element of v has no nodal
            rule (P2 on triangles and tetrahedra, degree 3 and above).
    """
    if lower is None and upper is None:
        raise InputError("penalty: give an obstacle, lower= or upper=")
    arguments = ufl.algorithms.extract_arguments(v)
    if not arguments:
        raise InputError("penalty: v must be a test function, or a scalar part of one")
    for g in (lower, upper):
        if g is not None:
            _check_finite(g)
    space = arguments[0].ufl_function_space()
    domain = space.ufl_domain()
    measure = ufl.Measure("dx", domain=domain) if measure is None else measure
    if rule is None:
        cell = releases.called(domain.ufl_cell().cellname)
        if "facet" in measure.integral_type():
            cell = facet_of(cell)
        degree = releases.called(space.ufl_element().degree)
        if not has_nodal_rule(cell, degree):
            raise InputError(
                f"penalty: v has degree {degree} on a {cell}: the nodes have no quadrature rule with positive weights; "
                "take degree 1, or degree 2 with ObstacleProblem"
            )
        rule = nodal_rule(cell, degree)
    dI = rule.on(measure)
    eps = _constant(domain, eps)
    above = 0 if upper is None else (1 / eps) * positive_part(u - upper)
    below = 0 if lower is None else (1 / eps) * positive_part(lower - u)
    return (above - below) * v * dI


def penalty_energy(u: Any, *, eps: Any, dI: Any, lower: Any = None, upper: Any = None) -> ufl.Form:
    """I((u - g)^+ ^2, 1) / (2 eps), of which `penalty` is the derivative."""
    above = 0 if upper is None else positive_part(u - upper)
    below = 0 if lower is None else positive_part(lower - u)
    return (above**2 + below**2) / (2 * eps) * dI


@names_checked
def contact_pressure(u: Any, *, eps: Any, lower: Any = None, upper: Any = None) -> Any:
    """The contact pressure p at the nodes, after a solve with `penalty`.

    p = ((lower - u)^+ - (u - upper)^+)/eps, equations (3.7) and (3.8) of Kikuchi (1981). It is a load on the right-hand
    side, -div(mu grad u) = f + p: p >= 0 at a lower obstacle, p <= 0 at an upper obstacle. With P1 the contact force is
    the integral of `p * ufl.dx`. With a `measure` of `penalty` it is that of p times the measure; values at other nodes
    have no meaning.

    Args:
        u: Solution, a Function of the Lagrange space for which `penalty` was used.
        eps: The penalty parameter of the solve.
        lower: Lower obstacle: a Function of the same space, a number, or a UFL expression.
        upper: Upper obstacle: a Function of the same space, a number, or a UFL expression.

    Returns:
        Function of the same space with the nodal values of p.

    Raises:
        InputError: If eps is not positive or no obstacle is given.
    """
    if lower is None and upper is None:
        raise InputError("contact_pressure: give an obstacle, lower= or upper=")
    space = u.function_space
    value = _positive(getattr(eps, "value", eps), "contact_pressure: eps")
    p = fem.Function(space, name="p")
    u_values = u.x.array
    if upper is not None:
        p.x.array[:] -= np.maximum(u_values - _nodal(upper, space), 0.0) / value
    if lower is not None:
        p.x.array[:] += np.maximum(_nodal(lower, space) - u_values, 0.0) / value
    return p


def _nodal(g: Any, space: Any) -> Any:
    if isinstance(g, fem.Function) and g.function_space == space:
        return g.x.array
    if not isinstance(g, ufl.core.expr.Expr):
        return _real(g, "contact_pressure: the obstacle")
    nodal = fem.Function(space)
    nodal.interpolate(releases.expression(g, space))
    return nodal.x.array


def _check_finite(g: Any) -> None:
    """Reject an obstacle that is infinite at nodes: where it is interpolated, the nodes beside them would have none
    (collective).

    Raises:
        InputError: With the remedy.
    """
    if not isinstance(g, ufl.core.expr.Expr):
        bad = not np.isfinite(_real(g, "penalty: the obstacle"))
    else:
        functions = [one for one in ufl.algorithms.extract_coefficients(g) if isinstance(one, fem.Function)]
        bad = any(total(one.function_space.mesh.comm, ~np.isfinite(one.x.array)) > 0 for one in functions)
    if bad:
        raise InputError(
            "penalty: the obstacle is not finite: leave it out where it is infinite everywhere; at nodes without an "
            "obstacle take a number far beyond u, such as -1e20 below and 1e20 above"
        )


def _constant(domain: Any, eps: Any) -> Any:
    """eps as a Constant, so that no value of it is ever compiled into a form."""
    if isinstance(eps, ufl.core.expr.Expr):
        return eps
    return fem.Constant(domain, PETSc.ScalarType(_positive(eps, "penalty: eps")))


def _real(value: Any, place: str) -> float:
    if isinstance(value, bool | str) or not hasattr(value, "__float__") or np.size(value) != 1:
        raise InputError(f"{place} = {shown(value)}: expected a number, a Constant, a Function or UFL")
    return float(value)


def _positive(value: Any, place: str) -> float:
    eps = _real(value, place)
    if not 0 < eps < np.inf:
        raise InputError(f"eps = {eps}: must be positive and finite")
    return eps

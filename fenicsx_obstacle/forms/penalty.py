"""The penalty (1/eps) I((u - g)^+, v) of (3.4) and the contact pressure (3.7)-(3.8)."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from petsc4py import PETSc

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.rules import Rule, facet_of, nodal_rule
from fenicsx_obstacle.releases import called
from fenicsx_obstacle.text import shown


def positive_part(t: Any) -> Any:
    """t^+ = max(t, 0), whose derivative at 0 is 0: the choice of the paper's iteration (3.4)*."""
    return ufl.max_value(t, 0.0)


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
    """The term that makes a residual F(u; v) the penalised obstacle problem: `F += penalty(u, v, upper=g, eps=eps)`.

    (3.4): a(u, v) + (1/eps) I((u - g)^+, v) = f(v) for u <= g, and its mirror image for u >= lower.

    Args:
        u: Displacement, any scalar UFL expression.
        v: Test function, or a scalar part of one.
        eps: Penalty parameter > 0 in units of u/p; a Constant can be changed later without compiling again.
        lower: Obstacle below, anything UFL takes; None for none.
        upper: Obstacle above, anything UFL takes; None for none.
        rule: Quadrature I; by default the nodal rule of v's element.
        measure: Where contact can happen; by default the whole domain, `ds(3)` for a part of the boundary.

    Returns:
        A linear form in v.

    Raises:
        InputError: If eps is not positive, no obstacle is given, or the element has no nodal rule.
    """
    if lower is None and upper is None:
        raise InputError("penalty: give an obstacle, lower= or upper=")
    arguments = ufl.algorithms.extract_arguments(v)
    if not arguments:
        raise InputError("penalty: v must be a test function, or a scalar part of one")
    for g in (lower, upper):
        if g is not None and not isinstance(g, ufl.core.expr.Expr):
            _real(g, "penalty: the obstacle")
    space = arguments[0].ufl_function_space()
    domain = space.ufl_domain()
    measure = ufl.Measure("dx", domain=domain) if measure is None else measure
    if rule is None:
        cell = called(domain.ufl_cell().cellname)
        on_facets = "facet" in measure.integral_type()
        rule = nodal_rule(facet_of(cell) if on_facets else cell, _degree(space))
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


def contact_pressure(u: Any, *, eps: Any, lower: Any = None, upper: Any = None) -> Any:
    """The contact pressure at the nodes: p(x_i) = -(u - g)^+(x_i) / eps, (3.7)-(3.8).

    p <= 0 where u presses against `upper`, p >= 0 against `lower`: -div(mu grad u) = f + p.

    Args:
        u: Solution, a Function of a Lagrange space whose nodes are the points of its rule.
        eps: The penalty parameter it was solved with.
        lower: Obstacle below: a Function of the same space, a number, or a UFL expression.
        upper: Obstacle above: a Function of the same space, a number, or a UFL expression.

    Returns:
        Function of the same space, nodal values of p in Q_h.

    Raises:
        InputError: If eps is not positive or no obstacle is given.
    """
    from dolfinx import fem

    if lower is None and upper is None:
        raise InputError("contact_pressure: give an obstacle, lower= or upper=")
    space = u.function_space
    value = _real(getattr(eps, "value", eps), "contact_pressure: eps")
    _check(value)
    p = fem.Function(space, name="p")
    u_values = u.x.array
    if upper is not None:
        p.x.array[:] -= np.maximum(u_values - _nodal(upper, space), 0.0) / value
    if lower is not None:
        p.x.array[:] += np.maximum(_nodal(lower, space) - u_values, 0.0) / value
    return p


def _nodal(g: Any, space: Any) -> Any:
    from dolfinx import fem

    from fenicsx_obstacle.releases import expression

    if isinstance(g, fem.Function) and g.function_space == space:
        return g.x.array
    if not isinstance(g, ufl.core.expr.Expr):
        return _real(g, "contact_pressure: the obstacle")
    nodal = fem.Function(space)
    nodal.interpolate(expression(g, space))
    return nodal.x.array


def _degree(space: Any) -> int:
    element = space.ufl_element()
    return called(element.degree)


def _constant(domain: Any, eps: Any) -> Any:
    """eps as a Constant, so that no value of it is ever compiled into a form."""
    if isinstance(eps, ufl.core.expr.Expr):
        return eps
    from dolfinx import fem

    value = _real(eps, "penalty: eps")
    _check(value)
    return fem.Constant(domain, PETSc.ScalarType(value))


def _real(value: Any, place: str) -> float:
    if isinstance(value, bool | str) or not hasattr(value, "__float__") or np.size(value) != 1:
        raise InputError(f"{place} = {shown(value)}: expected a number, a Constant, a Function or UFL")
    return float(value)


def _check(eps: float) -> None:
    if not 0 < eps < np.inf:
        raise InputError(f"eps = {eps}: must be positive and finite")

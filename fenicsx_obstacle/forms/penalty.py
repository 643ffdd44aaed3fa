"""The penalty (1/eps) I((u - g)^+, v) of (3.4) and the contact pressure (3.7)-(3.8)."""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.beside_others import BesideOthers
from fenicsx_obstacle.forms.pairs import SIMPLICES
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
        InputError: If eps is not positive, u or v is no scalar, no obstacle is given or one is infinite, not continuous
            or on another mesh, or the element of v has no nodal rule (P2 on triangles and tetrahedra, degree 3 and
            above, other elements than Lagrange's).
    """
    arguments = ufl.algorithms.extract_arguments(v) if isinstance(v, ufl.core.expr.Expr) else []
    if not arguments:
        raise InputError("penalty: v must be a test function, or a scalar part of one")
    for name, value in (("u", u), ("v", v)):
        _check_scalar(value, f"penalty: {name}")
    space = arguments[0].ufl_function_space()
    domain = space.ufl_domain()
    _check_obstacles("penalty", lower, upper, domain, at_nodes=rule is None)
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
        _check_nodes(space, degree, "penalty: v")
        rule = nodal_rule(cell, degree)
    eps = _constant(domain, eps)
    above = 0 if upper is None else (1 / eps) * positive_part(u - upper)
    below = 0 if lower is None else (1 / eps) * positive_part(lower - u)
    dI = rule.on(measure)
    return BesideOthers(((above - below) * v * dI).integrals())


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
        InputError: If eps is not positive or no number, u is no scalar Function, no obstacle is given or one is
            infinite, not continuous or on another mesh.
    """
    _check_scalar(u, "contact_pressure: u")
    if not isinstance(u, fem.Function) or u.function_space.component():
        raise InputError(f"contact_pressure: u = {shown(u)}: expected a Function; of a part take u.sub(0).collapse()")
    space = u.function_space
    _check_nodes(space, releases.called(space.ufl_element().degree), "contact_pressure: u")
    _check_obstacles("contact_pressure", lower, upper, space.mesh.ufl_domain())
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


def _check_scalar(value: Any, place: str) -> None:
    """Reject a vector or a matrix."""
    shape = getattr(value, "ufl_shape", ())
    if shape != ():
        raise InputError(f"{place} has the shape {shape}: expected a scalar, such as u[0] or ufl.dot(u, n)")


def _check_obstacles(name: str, lower: Any, upper: Any, domain: Any, *, at_nodes: bool = True) -> None:
    """Reject obstacles that have no values at the nodes of a mesh (collective).

    Infinite ones are interpolated: the nodes beside them would have none.

    Raises:
        InputError: With the remedy.
    """
    if lower is None and upper is None:
        raise InputError(f"{name}: give an obstacle, lower= or upper=")
    for side, g in (("lower", lower), ("upper", upper)):
        if g is None:
            continue
        if not isinstance(g, ufl.core.expr.Expr):
            bad = not np.isfinite(_real(g, f"{name}: the obstacle"))
        else:
            _check_scalar(g, f"{name}: {side}")
            if any(one != domain for one in ufl.domain.extract_domains(g)):
                raise InputError(f"{name}: {side} is on another mesh than u: interpolate it into the space of u")
            functions = [one for one in ufl.algorithms.extract_coefficients(g) if isinstance(one, fem.Function)]
            if at_nodes and not all(one.function_space.dofmap.dof_layout.entity_dofs(0, 0) for one in functions):
                what = "is not continuous, so that it has several values at a node"
                raise InputError(f"{name}: a Function in {side} {what}: interpolate it into the space of u")
            bad = any(total(one.function_space.mesh.comm, ~np.isfinite(one.x.array)) > 0 for one in functions)
        if bad:
            raise InputError(
                f"{name}: the obstacle is not finite: leave it out where it is infinite everywhere; at nodes without "
                "an obstacle take a number far beyond u, such as -1e20 below and 1e20 above"
            )


def _check_nodes(space: Any, degree: int, place: str) -> None:
    """Reject elements whose dofs are not values at the nodes of Lagrange elements of this degree (local).

    Raises:
        InputError: With the remedy.
    """
    if not isinstance(space, fem.FunctionSpace):
        return
    parts = [space] if space.num_sub_spaces == 0 or space.dofmap.bs > 1 else map(space.sub, range(space.num_sub_spaces))
    dim, simplex = space.mesh.topology.dim, releases.cell_name(space.mesh) in SIMPLICES
    nodes = comb(dim + degree, degree) if simplex else (degree + 1) ** dim
    for part in parts:
        layout = part.dofmap.dof_layout
        on_facets = not (layout.entity_dofs(0, 0) or layout.entity_dofs(dim, 0))  # Crouzeix and Raviart
        if layout.num_dofs != nodes or on_facets or not part.element.interpolation_ident:
            raise InputError(
                f"{place} is of {space.ufl_element()}, whose dofs are not all values at the nodes of degree {degree}"
                ": take Lagrange elements, and for a part of a mixed space rule=nodal_rule(cell, degree of this part)"
            )


def _constant(domain: Any, eps: Any) -> Any:
    """eps as a Constant, so that no value of it is ever compiled into a form."""
    if isinstance(eps, ufl.core.expr.Expr):
        return eps
    return fem.Constant(domain, PETSc.ScalarType(_positive(eps, "penalty: eps")))


def _real(value: Any, place: str) -> float:
    unknown = isinstance(value, bool | str | ufl.core.expr.Expr) and not hasattr(value, "value")
    if unknown or not hasattr(value, "__float__") or np.ndim(value) != 0:
        raise InputError(f"{place} = {shown(value)}: expected a number, a Constant, a Function or UFL")
    return float(value)


def _positive(value: Any, place: str) -> float:
    eps = _real(value, place)
    if not 0 < eps < np.inf:
        raise InputError(f"eps = {eps}: must be positive and finite")
    return eps

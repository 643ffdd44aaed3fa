"""The caller's own residual as an effect."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.algorithms import compute_form_data, extract_coefficients
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.algorithms.remove_complex_nodes import remove_complex_nodes
from ufl.classes import Abs, Condition, Division, Jacobian, MathFunction, MaxValue, MinValue, Power
from ufl.corealg.traversal import unique_pre_traversal

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.m_matrix import is_symmetric
from fenicsx_obstacle.effects.effect import Elastic

_NOT_SMOOTH = (Abs, Condition, MaxValue, MinValue)  # their derivative may hide that u decides
_NO_POLYNOMIAL = (*_NOT_SMOOTH, Division, MathFunction, Power)


@dataclass(frozen=True, eq=False)
class ResidualForm(Elastic):
    """The residual F(u; v) of the caller as an effect.

    Attributes:
        F: Residual.
        u: Its unknown.
        functional: Whose derivative F is, or None.
        J: The derivative of an F that is not linear, or None for UFL's own.
    """

    value: Any = None
    F: ufl.Form = None
    u: fem.Function = None
    functional: ufl.Form | None = None
    J: ufl.Form | None = None

    key = "F"

    @cached_property
    def affine(self) -> bool:  # type: ignore[override]
        """Whether F is linear in u plus what does not depend on u: its derivative is free of u, and no condition has
        u in it."""
        for integral in expanded(self.F).integrals():
            for node in unique_pre_traversal(integral.integrand()):
                if isinstance(node, _NOT_SMOOTH) and self.u in extract_coefficients(node):
                    return False
        return self.u not in expanded(self.slope).coefficients()

    @property
    def slope(self) -> ufl.Form:
        """The derivative of F."""
        return ufl.derivative(self.F, self.u)

    @cached_property
    def symmetric(self) -> bool:  # type: ignore[override]
        """Whether the derivative of F is: read off an affine F as it is written, or else found on its matrix (first
        use is collective)."""
        if not self.affine:
            return self.functional is not None
        plain = expanded(self.slope)
        if plain.signature() == expanded(ufl.adjoint(plain)).signature():
            return True
        A = fem.petsc.assemble_matrix(releases.form(self.slope))
        A.assemble()
        found = is_symmetric(A)
        A.destroy()
        return found

    def look_again(self, A: PETSc.Mat) -> None:
        """Check again whether an affine F is symmetric, after its coefficients have changed (collective)."""
        self.__dict__["symmetric"] = is_symmetric(A)

    @property
    def convex(self) -> bool:  # type: ignore[override]
        return self.functional is not None or (self.affine and self.symmetric)

    def terms(self, u: Any, v: Any, data: Any) -> ufl.Form:
        return ufl.replace(self.F, {self.u: u, self.F.arguments()[0]: v})

    def derivative(self, u: Any, v: Any, data: Any) -> ufl.Form | None:
        if self.J is None:
            return None
        return ufl.replace(self.J, {self.u: u, self.J.arguments()[0]: v})

    def energy(self, u: Any, data: Any) -> ufl.Form | None:
        if self.functional is not None:
            return ufl.replace(self.functional, {self.u: u})
        return super().energy(u, data)


def by_one_rule(F: ufl.Form) -> ufl.Form:
    """F with the quadrature degrees that UFL chooses for it.

    A and f of F = A u - f are forms of their own, for which it may choose others: with a coefficient that jumps inside
    cells A u - f would not be F.
    """
    inexact = any(isinstance(node, _NO_POLYNOMIAL) for integral in expanded(F).integrals()
                  for node in unique_pre_traversal(integral.integrand()))  # fmt: skip
    if not inexact:
        return F
    chosen = compute_form_data(
        F, do_apply_function_pullbacks=True, do_apply_integral_scaling=True, do_apply_geometry_lowering=True,
        preserve_geometry_types=(Jacobian,), do_append_everywhere_integrals=False,
    )  # fmt: skip
    degrees: dict[tuple[str, Any], int] = {}
    for group in chosen.integral_data:
        ids = group.subdomain_id if isinstance(group.subdomain_id, tuple) else (group.subdomain_id,)
        for integral in group.integrals:
            if "quadrature_degree" not in integral.metadata():
                degree = int(np.max(integral.metadata()["estimated_polynomial_degree"]))
                degrees |= {(group.integral_type, one): degree for one in ids}

    def ruled(integral: ufl.Integral) -> ufl.Integral:
        one = integral.subdomain_id()
        key = integral.integral_type(), "otherwise" if one == "everywhere" else one
        given = integral.metadata()
        if "quadrature_degree" in given or key not in degrees:
            return integral
        return integral.reconstruct(metadata={**given, "quadrature_degree": degrees[key]})

    return ufl.Form([ruled(integral) for integral in F.integrals()])


def expanded(form: ufl.Form) -> ufl.Form:
    """The form with derivatives carried out, in terms of components; factors of products are in UFL's order."""
    return remove_complex_nodes(apply_derivatives(apply_algebra_lowering(form)))

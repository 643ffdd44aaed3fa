"""Forms to which callers add terms with rules of their own.

FFCx (0.5 to 0.11) computes once what is constant by a rule, and takes it for all rules of a form. By a rule with a
single point u itself is constant: that of u*dot(b, grad(v)) on triangles, or of dx(degree=1). u at the nodes of a
nodal rule was then u at the centre of the cell. Two points beside the centre are a rule of the same degree.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from functools import cached_property
from typing import Any

import ufl
from ufl.algorithms import expand_derivatives
from ufl.algorithms.estimate_degrees import estimate_total_polynomial_degree

from fenicsx_obstacle import releases
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.forms.rules import centre_rule, facet_of


class BesideOthers(ufl.Form):
    """A form by a nodal rule, and what is added to it: no rule in it has a single point."""

    @cached_property
    def _with_several_points(self) -> tuple[Any, ...]:
        return tuple(_without_single_points(self._integrals))

    def integrals(self) -> tuple[Any, ...]:
        return self._with_several_points

    def __add__(self, other: Any) -> Any:
        if isinstance(other, ufl.Form):
            return BesideOthers((*self._integrals, *other._integrals))
        return super().__add__(other)

    def __radd__(self, other: Any) -> Any:
        if isinstance(other, ufl.Form):
            return BesideOthers((*other._integrals, *self._integrals))
        return super().__radd__(other)

    def __neg__(self) -> Any:
        return BesideOthers([-one for one in self._integrals])

    def __rmul__(self, factor: Any) -> Any:
        return BesideOthers([factor * one for one in self._integrals])


def _without_single_points(integrals: Iterable[Any]) -> Iterable[Any]:
    """The same integrals, with their rules of a single point replaced. Those that UFL gives one rule are taken
    together: its degree is that of their sum."""
    together = defaultdict(list)
    for one in integrals:
        together[one.integral_type(), str(one.subdomain_id()), str(one.metadata())].append(one)
    for (kind, _, _), group in together.items():
        cell = releases.called(group[0].ufl_domain().ufl_cell().cellname)
        where = facet_of(cell) if "facet" in kind else cell
        if where == "vertex" or _degree(group, simplex=cell in SIMPLICES) > 1:
            yield from group
        else:
            yield from (one.reconstruct(metadata=centre_rule(where).metadata) for one in group)


def _degree(group: list[Any], *, simplex: bool) -> int:
    """The degree of the default rule of integrals; a large one where they have another rule."""
    how = group[0].metadata()
    if how.get("quadrature_rule", "default") != "default" or "quadrature_points" in how:
        return 99
    degree = how.get("quadrature_degree", -1)
    if degree in (-1, "auto") and not simplex:
        return 99  # scaled by the Jacobian, whose degree is not 0
    if degree in (-1, "auto"):
        expanded = (expand_derivatives(ufl.Form([one])) for one in group)
        return max(estimate_total_polynomial_degree(one.integrand()) for form in expanded for one in form.integrals())
    return int(degree)

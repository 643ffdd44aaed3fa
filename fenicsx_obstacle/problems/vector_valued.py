"""What only vector-valued problems have: weighted measures of facets, and their solution."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.problems.own_form import facets_of
from fenicsx_obstacle.problems.solution import Solution
from fenicsx_obstacle.words import nearest, shown


class VectorSolution(Solution):
    """A converged vector-valued solution."""


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
        if any(one.integrand() != weight for one in integrals) or measure.arguments():
            raise InputError(f"{name}: measure = {shown(measure)}: {wanted}")
        ids = tuple(one.subdomain_id() for one in integrals)
        first = integrals[0]
        measure = ufl.Measure(first.integral_type(), domain=mesh, subdomain_data=first.subdomain_data())(
            "everywhere" if ids == ("everywhere",) else ids
        )
    if not isinstance(measure, ufl.Measure) or measure.integral_type() != "exterior_facet":
        raise InputError(f"{name}: u is vector-valued: measure = {shown(measure)}: {wanted}")
    return facets_of(measure, mesh, name), weight

"""The quadrature rules I of (3.5), with positive weights at the nodes of V_h (3.6).

For each pair (V_h, I) of the paper's Examples 1 and 2 the points of I are the nodes of V_h, so I(q, v) is diagonal
in nodal values and the penalty acts node by node.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import shown

BESIDE = 1e-5  # of a cell's width: FFCx takes values that differ by less than 1e-6 for the same
_VERTICES = {
    "vertex": ((),),
    "interval": ((0.0,), (1.0,)),
    "triangle": ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)),
    "tetrahedron": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}
_VOLUME = {"vertex": 1.0, "interval": 1.0, "triangle": 1 / 2, "tetrahedron": 1 / 6}
_DIMENSION = {"quadrilateral": 2, "hexahedron": 3}
_LINE = {1: ((0.0, 1 / 2), (1.0, 1 / 2)), 2: ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6))}  # trapezoid, Simpson
_FACET = {"interval": "vertex", "triangle": "interval", "tetrahedron": "triangle",
          "quadrilateral": "interval", "hexahedron": "quadrilateral"}  # fmt: skip


@dataclass(frozen=True)
class Rule:
    """Points and weights on the reference cell; the weights are positive and sum to its volume.

    Attributes:
        points: Coordinates in the reference cell.
        weights: One positive weight per point, dimensionless.
    """

    points: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]

    def on(self, measure: Any) -> Any:
        """The same measure, integrated by this rule."""
        return measure(metadata=self.metadata)

    @property
    def metadata(self) -> dict[str, Any]:
        """This rule in UFL."""
        # tuples, not arrays: UFL hashes them
        return {"quadrature_rule": "custom", "quadrature_degree": 1,
                "quadrature_points": self.points, "quadrature_weights": self.weights}  # fmt: skip


def nodal_rule(cell: str, degree: int = 1) -> Rule:
    """The quadrature rule whose points are the Lagrange nodes, which `penalty` uses by default.

    `dI = nodal_rule("triangle").on(ufl.dx)` is a measure with this rule. For example, `p * v * dI` is the form of the
    contact forces at the nodes.

    Args:
        cell: Name of the cell: interval, triangle, tetrahedron, quadrilateral, hexahedron.
        degree: Degree of V_h: 1 (vertex rule, on tensor cells the trapezoid rule), or 2 on intervals, quadrilaterals
            and hexahedra (Simpson's rule).

    Raises:
        InputError: If the weights of the rule are not positive, as equation (3.6) of Kikuchi (1981) requires. The rule
            of P2 on triangles has the weight 0 at the vertices.
    """
    if cell not in (*_VERTICES, *_DIMENSION):
        wanted = f"expected the name of a cell, one of {', '.join(_FACET)}"
        raise InputError(f"nodal_rule: cell = {shown(cell)}: {wanted}")
    if not has_nodal_rule(cell, degree):
        raise InputError(f"nodal_rule: degree {degree} on a {cell}: the nodes have no rule with positive weights (3.6)")
    if cell in _VERTICES and (degree == 1 or cell == "vertex"):
        points = _VERTICES[cell]
        return Rule(points, (_VOLUME[cell] / len(points),) * len(points))
    nodes = list(product(_LINE[degree], repeat=_DIMENSION.get(cell, 1)))
    points = tuple(tuple(x for x, _ in reversed(node)) for node in nodes)
    return Rule(points, tuple(prod(w for _, w in node) for node in nodes))


def has_nodal_rule(cell: str, degree: int) -> bool:
    """Whether the nodes of this degree have a rule with positive weights."""
    return degree == 1 or cell == "vertex" or (degree in _LINE and (cell in _DIMENSION or cell == "interval"))


def midpoint_rule(cell: str) -> Rule:
    """The rule at the midpoints of a triangle's edges, exact for degree 2, or at the centre of a quadrilateral.

    Raises:
        InputError: For other cells.
    """
    if cell == "triangle":
        return Rule(((0.5, 0.5), (0.0, 0.5), (0.5, 0.0)), (1 / 6,) * 3)
    if cell == "quadrilateral":
        return Rule(((0.5, 0.5),), (1.0,))
    raise InputError(f"a {cell} has no midpoint rule here")


def centre_rule(cell: str) -> Rule:
    """A rule for degree 1 with two points, so near the centre of a cell that they are it for smooth functions."""
    dim = _DIMENSION.get(cell, len(_VERTICES.get(cell, ())) - 1)
    first, *others = (0.5 if cell in _DIMENSION else 1 / (dim + 1),) * dim
    return Rule(tuple((first + step, *others) for step in (-BESIDE, BESIDE)), (_VOLUME.get(cell, 1.0) / 2,) * 2)


def facet_of(cell: str) -> str:
    """Name of the facets of a cell."""
    return _FACET[cell]

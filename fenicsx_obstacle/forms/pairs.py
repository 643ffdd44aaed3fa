"""The pairs of the paper's Examples 1-3: a space V_h, a quadrature rule I, and the space Q_h of pressures.

Adding a pair is adding a row: `register(Pair(...))`, also from outside the package.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.rules import Rule, midpoint_rule, nodal_rule

SIMPLICES = ("interval", "triangle", "tetrahedron")
TENSORS = ("quadrilateral", "hexahedron")


@dataclass(frozen=True)
class Pair:
    """V_h, I and Q_h on the cells that they are for.

    Attributes:
        name: On the command line.
        degree: Of the Lagrange space V_h.
        rules: I for each cell, by its name: positive weights (3.6).
        pressure: Family and degree of Q_h, whose nodes are the points of I: then I is diagonal in nodal values.
        voronoi: D_i is the Voronoi area of the node instead of the rule's weights.
        words: What it is, in a few words.
    """

    name: str
    degree: int
    rules: Mapping[str, Rule]
    pressure: tuple[str, int]
    voronoi: bool = False
    words: str = ""

    def rule(self, cell: str) -> Rule:
        """I on a cell.

        Raises:
            InputError: If the pair is not for such cells.
        """
        if cell not in self.rules:
            raise InputError(f"element {self.name} is for {', '.join(self.rules)} cells, not for a {cell}")
        return self.rules[cell]

    @property
    def nests(self) -> bool:
        """Whether V_h on a mesh is part of V_h on the mesh with its edges halved, with nodes at the same places."""
        return self.degree == 1 and all(cell in SIMPLICES for cell in self.rules)

    @property
    def stacks(self) -> bool:
        """Whether V_h holds P1 on the same mesh, with nodes at its vertices and at the middles of its edges."""
        return self.degree == 2 and all(cell in SIMPLICES for cell in self.rules)

    @property
    def nodal(self) -> bool:
        """Whether the points of I are nodes of V_h, so that u may touch the obstacle node by node."""
        return self.pressure[0] != "DG"


_register: dict[str, Pair] = {}


def register(pair: Pair) -> Pair:
    """Scenes may name this pair as their element.

    Raises:
        InputError: If a rule has a weight that is not positive, against (3.6), or the pressures are of another kind
            than those here: nodal, at the midpoints of edges, or constant on quadrilaterals.
    """
    family, others = pair.pressure[0], set(pair.rules) - {"quadrilateral"}
    if family not in ("Lagrange", "CR", "DG") or (family == "DG" and others):
        raise InputError(f"element {pair.name}: pressures {pair.pressure} are not known here")
    for cell, rule in pair.rules.items():
        if not all(weight > 0 for weight in rule.weights):
            raise InputError(f"element {pair.name}: the rule on a {cell} has weights that are not positive (3.6)")
    _register[pair.name] = pair
    return pair


def pairs() -> Mapping[str, Pair]:
    """The pairs by name."""
    return MappingProxyType(_register)


def pair_for(cell: str) -> str:
    """Name of the pair that such cells have by default."""
    return "Q1" if cell in TENSORS else "P1"


P1 = register(Pair("P1", 1, {cell: nodal_rule(cell) for cell in SIMPLICES}, ("Lagrange", 1),
              words="vertex rule, the weights |T|/(dim + 1) at the vertices of each cell T"))  # fmt: skip
register(Pair("Q1", 1, {cell: nodal_rule(cell) for cell in TENSORS}, ("Lagrange", 1),
              words="trapezoid rule, weights detJ(x_i)/2^dim at the vertices of each cell"))  # fmt: skip
register(Pair("Q2", 2, {cell: nodal_rule(cell, 2) for cell in TENSORS}, ("Lagrange", 2),
              words="Simpson's rule in each direction"))  # fmt: skip
register(Pair("P2", 2, {"triangle": midpoint_rule("triangle")}, ("CR", 1),
              words="rule at edge midpoints, obstacle and pressure there"))  # fmt: skip
register(Pair("P1-voronoi", 1, {cell: nodal_rule(cell) for cell in SIMPLICES[1:]}, ("Lagrange", 1), voronoi=True,
              words="vertex rule with Voronoi areas: consistent on any Delaunay mesh"))  # fmt: skip
register(Pair("Q1-gauss", 1, {"quadrilateral": midpoint_rule("quadrilateral")}, ("DG", 0),
              words="one-point Gauss rule: unstable, p_h shows a chessboard"))  # fmt: skip

"""The pairs of the paper's Examples 1-3: a space V_h, a quadrature rule I, and the space Q_h of pressures.

Adding a pair is adding a row, `register(Pair(...))`, and a subclass of Pair where its weights are not those of its
rule; also from outside the package.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import factorial
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.rules import Rule, midpoint_rule, nodal_rule

if TYPE_CHECKING:
    import numpy as np

SIMPLICES = ("interval", "triangle", "tetrahedron")
TENSORS = ("quadrilateral", "hexahedron")


@dataclass(frozen=True)
class Pair:
    """V_h, I and Q_h for some kinds of cells.

    Attributes:
        name: On the command line.
        degree: Of the Lagrange space V_h.
        rules: I for each cell, by its name: positive weights (3.6).
        pressure: Family and degree of Q_h, whose nodes are the points of I: then I is diagonal in nodal values. On
            intervals it is V_h (`pressure_on`).
        words: What it is, in a few words.
    """

    name: str
    degree: int
    rules: Mapping[str, Rule]
    pressure: tuple[str, int]
    words: str = ""

    not_positive: ClassVar[str] = "a weight is not positive"  # what is wrong with a mesh where that is so

    def rule(self, cell: str) -> Rule:
        """I on a cell.

        Raises:
            InputError: If the pair is not for such cells.
        """
        if cell not in self.rules:
            others = " or ".join(name for name, pair in pairs().items() if cell in pair.rules)
            hint = f": take {others}" if others else ""
            raise InputError(f"element {self.name} is for {', '.join(self.rules)} cells, not for a {cell}{hint}")
        return self.rules[cell]

    def pressure_on(self, cell: str) -> tuple[str, int]:
        """Family and degree of Q_h on a cell."""
        return ("Lagrange", self.degree) if cell == "interval" else self.pressure

    def cell_weights(self, corners: np.ndarray) -> np.ndarray:
        """Contributions of each cell to the weights D_i, if D_i is not the sum of the rule's weights; P1 only.

        Args:
            corners: Coordinates of the vertices of cells, shape (cells, vertices, 3).

        Returns:
            Shape (cells, vertices).
        """
        raise NotImplementedError

    @property
    def own_weights(self) -> bool:
        """Whether the pair defines the weights D_i by `cell_weights`."""
        return type(self).cell_weights is not Pair.cell_weights

    @property
    def space(self) -> str:
        """V_h in short: P1, Q2."""
        return f"{'P' if all(cell in SIMPLICES for cell in self.rules) else 'Q'}{self.degree}"

    @property
    def bounded(self) -> bool:
        """Whether there is a bound of the energy error."""
        return self.nested_hierarchy or self.has_p1_coarse_space

    @property
    def nested_hierarchy(self) -> bool:
        """Whether V_h on a mesh is part of V_h on the mesh with its edges halved, with nodes at the same places."""
        return self.degree == 1 and all(cell in SIMPLICES for cell in self.rules)

    @property
    def has_p1_coarse_space(self) -> bool:
        """Whether V_h holds P1 on the same mesh, with nodes at its vertices and at the middles of its edges."""
        return self.degree == 2 and all(cell in SIMPLICES for cell in self.rules)

    @property
    def nodal(self) -> bool:
        """Whether the points of I are nodes of V_h, so that u may touch the obstacle node by node."""
        return self.pressure[0] != "DG"

    @property
    def at_vertices(self) -> bool:
        """Whether the points of I are the vertices, and these all nodes of V_h: terms without gradients of u take I."""
        return self.nodal and self.degree == 1


class Voronoi(Pair):
    """P1 with the Voronoi areas of the nodes: the lumped Laplacian is consistent on any Delaunay mesh.

    -(A I_h w)_i / D_i is to tend to the Laplacian of w: D is chosen so that it is right for w = |x - x_i|^2, whose
    Laplacian is 2 dim, D_i = -(1 / (2 dim)) sum_j A_ij |x_i - x_j|^2, A the Laplacian. In the plane these are the areas
    of the Voronoi cells. The weights |T|/(dim + 1) of the vertex rule are right only where all vertices have as many
    neighbours.
    """

    bounded = False
    not_positive = "the mesh is not Delaunay, so that a Voronoi area is not positive"

    def cell_weights(self, corners: np.ndarray) -> np.ndarray:
        import numpy as np

        x, dim = corners, corners.shape[1] - 1
        edges = x[:, 1:] - x[:, :1]
        gram = edges @ edges.transpose(0, 2, 1)
        volumes = np.sqrt(np.linalg.det(gram)) / factorial(dim)
        inner = np.linalg.solve(gram, edges)  # gradients of all barycentric coordinates but one
        slopes = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
        stiffness = volumes[:, None, None] * (slopes @ slopes.transpose(0, 2, 1))
        squares = ((x[:, :, None] - x[:, None, :]) ** 2).sum(axis=3)
        return -(stiffness * squares).sum(axis=2) / (2 * dim)


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
register(Pair("P2", 2, {"triangle": midpoint_rule("triangle"), "interval": nodal_rule("interval", 2)}, ("CR", 1),
              words="rule at edge midpoints, obstacle and pressure there; on intervals Simpson's rule"))  # fmt: skip
register(Pair("Q2", 2, {cell: nodal_rule(cell, 2) for cell in ("interval", *TENSORS)}, ("Lagrange", 2),
              words="Simpson's rule in each direction"))  # fmt: skip
register(Voronoi("P1-voronoi", 1, {cell: nodal_rule(cell) for cell in SIMPLICES[1:]}, ("Lagrange", 1),
                 words="vertex rule with Voronoi areas: consistent on any Delaunay mesh"))  # fmt: skip
register(Pair("Q1-gauss", 1, {"quadrilateral": midpoint_rule("quadrilateral")}, ("DG", 0),
              words="one-point Gauss rule: unstable, p_h oscillates like a checkerboard"))  # fmt: skip

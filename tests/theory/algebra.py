"""The algebra on one element behind Examples 1-3: (3.6), (3.27), (3.28), (3.32), (3.33), (3.36), (3.38).

A function on an element is given by coefficients q_k of a basis; I(q, q) and ||q||_0^2 are quadratic forms in them,
here divided by the area, so that they can be compared with the printed ones.
"""

from __future__ import annotations

from typing import Any

import basix
import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.forms.pairs import pairs
from fenicsx_obstacle.forms.rules import Rule, nodal_rule
from tests.theory.statement import Curve, Found, Panel, check, constant, statement

TRIANGLE = np.array([[-1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])  # master of (3.27)
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])  # master of (3.32)
KITES = (0.1, 0.2, 0.3, 0.4, 0.49)
ROUND_OFF = 1e-13


def linear(corners: np.ndarray) -> np.ndarray:
    """The basis 1, x, y of a triangle, or 1, x, y, xy of the square: values at its corners, shape (corners, basis)."""
    x, y = corners.T
    return np.column_stack([np.ones(len(x)), x, y, x * y][: len(corners)])


def products(corners: np.ndarray, rule: Rule, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """I(q, q) and ||q||_0^2 on an isoparametric element, as matrices in the coefficients of a basis, over its area.

    Args:
        corners: Of a triangle, or of a quadrilateral in the order of DOLFINx, shape (corners, 2).
        rule: I on the reference element.
        basis: Values at the corners, shape (corners, basis).
    """
    points, weights = basix.make_quadrature(_cell(corners), 5)
    lumped, true = _gram(corners, rule.points, rule.weights, basis), _gram(corners, points, weights, basis)
    area = _gram(corners, points, weights, np.ones((len(corners), 1)))[0, 0]
    return lumped / area, true / area


def ratios(lumped: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Extremal values of I(q, q)/||q||_0^2, ascending."""
    return np.sort(np.linalg.eigvals(np.linalg.solve(true, lumped)).real)


def kite(t: float) -> np.ndarray:
    """Quadrilateral (0,0), (1,0), (0,1), (1-t,1-t): a parallelogram for t = 0, a triangle for t = 1/2."""
    return np.array([[0, 0], [1, 0], [0, 1], [1 - t, 1 - t]])


def _gram(corners: np.ndarray, points: Any, weights: Any, basis: np.ndarray) -> np.ndarray:
    element = basix.create_element(basix.ElementFamily.P, _cell(corners), 1)
    shapes, *slopes = element.tabulate(1, np.array(points))[..., 0]
    (a, b), (c, d) = ((slope @ corners).T for slope in slopes)
    values = shapes @ basis
    return values.T @ ((np.array(weights) * (a * d - b * c))[:, None] * values)


def _cell(corners: np.ndarray) -> basix.CellType:
    return basix.CellType.triangle if len(corners) == 3 else basix.CellType.quadrilateral


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max())


@statement("3.27", "P1 and the vertex rule on one triangle: I - L2 is a sum of squares if q1 is replaced by q2")
def triangle(comm: MPI.Comm) -> Found:
    """(3.27) on the master triangle, as printed and as it must read; (3.28) and (3.21) on any triangle."""
    lumped, true = products(TRIANGLE, pairs()["P1"].rule("triangle"), linear(TRIANGLE))
    first, q0, q1, q2 = np.outer([1, -1, 0], [1, -1, 0]), *(np.diag(row) for row in np.eye(3))
    printed, corrected = (first + 2 * q0 + 2 * q1) / 3, (first + 2 * q0 + 2 * q2) / 3
    l2 = np.array([[1, -1 / 3, 0], [-1 / 3, 1 / 6, 0], [0, 0, 1 / 6]])
    wrong, right = _difference(lumped, printed), _difference(lumped, corrected)
    rows = [
        check("(3.27)", "I - [(q0-q1)^2 + 2q0^2 + 2q1^2] mes/3", "0", wrong, wrong > ROUND_OFF, "misprint"),
        check("(3.27)", "I - [(q0-q1)^2 + 2q0^2 + 2q2^2] mes/3", "0", right, right < ROUND_OFF),
        check("(3.27)", "||q||_0^2 - (q0^2 - 2/3 q0q1 + q1^2/6 + q2^2/6) mes", "0", _difference(true, l2),
              _difference(true, l2) < ROUND_OFF),
        constant("(3.27), (3.28)", "least eigenvalue of I - L2, as printed", ">= 0", -1 / 6,
                 float(np.linalg.eigvalsh(printed - l2)[0]), "misprint"),
        constant("(3.27), (3.28)", "I - L2: coefficient of q1^2", "", 1 / 6, (lumped - true)[1, 1]),
        constant("(3.27), (3.28)", "I - L2: coefficient of q2^2", "", 1 / 2, (lumped - true)[2, 2]),
    ]  # fmt: skip
    skew = np.array([[0.0, 0.0], [3.0, 0.4], [2.2, 1.1]])
    ends = ratios(*products(skew, pairs()["P1"].rule("triangle"), np.eye(3)))
    for value, expected in zip(ends, (1, 4, 4), strict=True):
        rows.append(constant("(3.28), (3.21)", "I(q,q)/||q||_0^2, a triangle of any shape", "[1, C]", expected, value))
    return Found(rows)


@statement("3.32", "Q1 with the trapezoid rule and Q2 with Simpson's rule on one square")
def square(comm: MPI.Comm) -> Found:
    """(3.32) and the ranges of I(q, q)/||q||_0^2 that follow."""
    lumped, true = products(SQUARE, pairs()["Q1"].rule("quadrilateral"), linear(SQUARE))
    rows = [
        constant("(3.32)", f"{name}: coefficient of q{k}^2", text, number, matrix[k, k])
        for name, matrix, values in (("I", lumped, "1 1 1 1"), ("||q||_0^2", true, "1 1/3 1/3 1/9"))
        for k, text in enumerate(values.split())
        for number in [1 / int(text.partition("/")[2] or 1)]
    ]
    mixed = max(_difference(matrix, np.diag(np.diag(matrix))) for matrix in (lumped, true))
    rows.append(check("(3.32)", "coefficients of q_j q_k", "0", mixed, mixed < ROUND_OFF))
    ends = ratios(lumped, true)
    rows += [constant("(3.21), Ex. 3", f"{end} I(q,q)/||q||_0^2, Q1", "", expected, value)
             for end, expected, value in (("least", 1, ends[0]), ("largest", 9, ends[-1]))]  # fmt: skip
    nodes, line = np.array([0, 0.5, 1]), nodal_rule("interval", 2)
    monomials = np.linalg.inv(np.vander(nodes, increasing=True))
    mass = monomials.T @ (1 / (1 + np.add.outer(range(3), range(3)))) @ monomials
    simpson = ratios(np.diag(line.weights), mass) ** 2  # the square is a product of two lines
    rows += [constant("(3.21), Ex. 1", f"{end} I(q,q)/||q||_0^2, Q2", "", expected, value)
             for end, expected, value in (("least", 1, simpson[0]), ("largest", 25 / 4, simpson[-1]))]  # fmt: skip
    return Found(rows)


@statement("3.33", "I(q, q) >= ||q||_0^2 on quadrilaterals: true for parallelograms, false for kites")
def kites(comm: MPI.Comm) -> Found:
    """min I(q, q)/||q||_0^2 on a square that becomes a triangle: no constant but one that depends on the shape."""
    rule = pairs()["Q1"].rule("quadrilateral")

    def least(corners: np.ndarray) -> float:
        return float(ratios(*products(corners, rule, np.eye(4)))[0])

    slanted = np.array([[0, 0], [1, 0.2], [0.7, 0.9], [1.7, 1.1]])
    rows = [constant("(3.33)", "least I(q,q)/||q||_0^2, a parallelogram", ">= 1", 1.0, least(slanted))]
    for t in KITES:
        value = least(kite(t))
        rows.append(check("(3.33)", f"least I(q,q)/||q||_0^2, kite t = {t}", ">= 1", value, value < 1 - ROUND_OFF,
                          "needs hypothesis"))  # fmt: skip
    ts = np.linspace(0.0, 0.495, 34)
    curve = Curve("least I(q,q)/||q||_0^2", list(ts), [least(kite(t)) for t in ts])
    return Found(rows, [Panel("kite (0,0) (1,0) (1-t,1-t) (0,1)", "t", "least ratio", [curve], ("linear", "linear"))])


@statement("3.36", "One-point Gauss on one square: I uses the value at the centre only", "3.38")
def centre(comm: MPI.Comm) -> Found:
    """(3.36), and (3.38) with its constant on a square of side h."""
    lumped, true = products(SQUARE, pairs()["Q1-gauss"].rule("quadrilateral"), linear(SQUARE))
    off = _difference(lumped, np.diag([1, 0, 0, 0]))
    rest = true - lumped
    # |v|_1^2 / mes on a square of side h, in the same coefficients, times h^2
    slopes = 4 * np.diag([0, 1, 1, 2 / 3])
    sharp = float(np.linalg.eigvals(np.linalg.solve(slopes[1:, 1:], rest[1:, 1:])).real.max())
    rows = [check("(3.36)", "I(q,q) - q0^2 mes", "0", off, off < ROUND_OFF)]
    rows += [constant("(3.38)", f"||v||_0^2 - I(v,v): coefficient of q{k}^2", "", expected, rest[k, k])
             for k, expected in ((1, 1 / 3), (2, 1 / 3), (3, 1 / 9))]  # fmt: skip
    rows.append(constant("(3.38)", "largest (||v||_0^2 - I(v,v))/(h^2 |v|_1^2)", "C", 1 / 12, sharp))
    return Found(rows)


@statement("3.6", "Weights of I must be positive, zero is not enough: quadratic triangles")
def positive(comm: MPI.Comm) -> Found:
    """The rule at the six nodes of a quadratic triangle that is exact there: what it weighs, what it does not see."""
    nodes = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.5], [0, 0.5], [0.5, 0]])
    powers = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    moments = [1 / 2, 1 / 6, 1 / 6, 1 / 12, 1 / 24, 1 / 12]
    weights = np.linalg.solve([[x**a * y**b for x, y in nodes] for a, b in powers], moments)
    midpoints = np.array(pairs()["P2"].rule("triangle").weights)
    blind = int((np.abs(weights) < ROUND_OFF).sum())
    return Found([
        constant("(3.6)", "weight of a vertex, nodal rule of P2", ">= 0", 0.0, float(weights[0]), "needs hypothesis"),
        check("(3.6), Thm 3.1", "nodal functions q != 0 with I(q,q) = 0, P2", "0", blind, blind == 3,
              "needs hypothesis"),
        constant("(3.6)", "least weight, rule at edge midpoints", "> 0", 1 / 6, float(midpoints.min())),
    ])  # fmt: skip

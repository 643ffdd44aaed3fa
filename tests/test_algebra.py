"""The element algebra of Examples 1-3 by SymPy, exactly, beside what the package computes; the misprints."""

import numpy as np
import pytest
import sympy as sp

from fenicsx_obstacle.forms.pairs import pairs
from tests.conftest import COMM
from tests.theory import algebra
from tests.theory.algebra import SQUARE, TRIANGLE, kite, linear, products
from tests.theory.statement import find

x, y, t = sp.symbols("x y t", real=True)
q0, q1, q2, q3 = q = sp.symbols("q0:4", real=True)


def form(matrix, count):
    """A quadratic form in q0, q1, ... with coefficients made rational."""
    values = sp.Matrix(q[:count])
    return sp.expand((values.T * sp.Matrix(np.vectorize(sp.nsimplify)(np.round(matrix, 12))) * values)[0])


def on_triangle(f):
    """Integral over the triangle (-1,0), (0,-1), (0,1), whose area is 1."""
    return sp.integrate(f, (y, -1 - x, 1 + x), (x, -1, 0))


def on_square(f):
    """Mean over [-1, 1]^2."""
    return sp.integrate(f, (x, -1, 1), (y, -1, 1)) / 4


def test_3_27_and_its_misprint():
    """(3.27): I has 2 q2^2 where 2 q1^2 is printed; the line of ||q||_0^2 is right; I - L2 = q1^2/6 + q2^2/2."""
    function = q0 + q1 * x + q2 * y
    lumped = sp.expand(sum(function.subs({x: a, y: b}) ** 2 for a, b in TRIANGLE.astype(int).tolist()) / 3)
    true = sp.expand(on_triangle(function**2))
    assert sp.expand(lumped - ((q0 - q1) ** 2 + 2 * q0**2 + 2 * q2**2) / 3) == 0
    assert sp.expand(lumped - ((q0 - q1) ** 2 + 2 * q0**2 + 2 * q1**2) / 3) != 0
    assert sp.expand(true - (q0**2 - sp.Rational(2, 3) * q0 * q1 + q1**2 / 6 + q2**2 / 6)) == 0
    assert sp.expand(lumped - true - q1**2 / 6 - q2**2 / 2) == 0
    ours = products(TRIANGLE, pairs()["P1"].rule("triangle"), linear(TRIANGLE))
    assert [sp.expand(form(m, 3) - exact) for m, exact in zip(ours, (lumped, true), strict=True)] == [0, 0]


def test_3_28_on_any_triangle():
    """(3.28), (3.21): D_e^-1 M_e has the eigenvalues 1, 1/4, 1/4 whatever the triangle, so 1 <= I/L2 <= 4."""
    mass = (sp.ones(3) + sp.eye(3)) / 12
    assert (3 * mass).eigenvals() == {1: 1, sp.Rational(1, 4): 2}


def test_3_32():
    """(3.32): I = q0^2 + q1^2 + q2^2 + q3^2, L2 = q0^2 + q1^2/3 + q2^2/3 + q3^2/9 times mes, so 1 <= I/L2 <= 9."""
    function = q0 + q1 * x + q2 * y + q3 * x * y
    lumped = sp.expand(sum(function.subs({x: a, y: b}) ** 2 for a, b in SQUARE.astype(int).tolist()) / 4)
    true = sp.expand(on_square(function**2))
    assert sp.expand(lumped - q0**2 - q1**2 - q2**2 - q3**2) == 0
    assert sp.expand(true - q0**2 - q1**2 / 3 - q2**2 / 3 - q3**2 / 9) == 0
    ours = products(SQUARE, pairs()["Q1"].rule("quadrilateral"), linear(SQUARE))
    assert [sp.expand(form(m, 4) - exact) for m, exact in zip(ours, (lumped, true), strict=True)] == [0, 0]


def test_simpson():
    """Example 1, Q2: on a line D^-1 M has the eigenvalues 1, 1, 2/5, on a square I/L2 is in [1, 25/4]."""
    s = sp.Symbol("s")
    shapes = [2 * (s - sp.Rational(1, 2)) * (s - 1), 4 * s * (1 - s), 2 * s * (s - sp.Rational(1, 2))]
    mass = sp.Matrix(3, 3, lambda i, j: sp.integrate(shapes[i] * shapes[j], (s, 0, 1)))
    assert (sp.diag(6, sp.Rational(6, 4), 6) * mass).eigenvals() == {1: 2, sp.Rational(2, 5): 1}


def test_3_33_fails_on_kites():
    """(3.33): on the kite (0,0), (1,0), (0,1), (1-t,1-t) I - L2 is not >= 0; the area at the far vertex is 1 - 2t."""
    a, b = sp.symbols("a b")
    shapes = sp.Matrix([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    points = sp.Matrix([[0, 0], [1, 0], [0, 1], [1 - t, 1 - t]])
    position = shapes.T * points
    area = sp.expand(position.jacobian([a, b]).det())
    assert sp.expand(area.subs({a: 1, b: 1}) - (1 - 2 * t)) == 0
    corners = [(0, 0), (1, 0), (0, 1), (1, 1)]
    for value in (sp.Rational(1, 10), sp.Rational(49, 100)):
        here = area.subs(t, value)
        lumped = sp.diag(*(here.subs(dict(zip((a, b), c, strict=True))) / 4 for c in corners))
        true = (here * shapes * shapes.T).applyfunc(lambda f: sp.Poly(f, a, b).integrate(a, b)(1, 1))
        ours = products(kite(float(value)), pairs()["Q1"].rule("quadrilateral"), np.eye(4))
        for m, mine in zip((lumped, true), ours, strict=True):
            assert np.allclose(np.array(m / sum(true), dtype=float), mine, rtol=1e-13, atol=1e-15)
        assert (lumped - true).det() < 0  # one eigenvalue is negative
        assert sum(lumped) == sum(true)  # a constant q has I = L2: the area is linear along each side


def test_3_36_and_3_38():
    """(3.36): I = q0^2 mes. (3.38): ||v||_0^2 - I(v, v) <= (h^2/12) |v|_1^2 on a square of side h, sharp."""
    h = sp.Symbol("h", positive=True)
    function = q0 + q1 * x + q2 * y + q3 * x * y
    rest = sp.expand(on_square(function**2) - function.subs({x: 0, y: 0}) ** 2)
    slopes = on_square(sum((2 / h * sp.diff(function, s)) ** 2 for s in (x, y)))
    assert sp.expand(h**2 / 12 * slopes - rest - q3**2 / 9) == 0
    lumped, _ = products(SQUARE, pairs()["Q1-gauss"].rule("quadrilateral"), linear(SQUARE))
    assert form(lumped, 4) == q0**2


def test_symbols_of_uniform_meshes():
    """alpha_h/h: 1/sqrt(3), sqrt(2/3), 1/sqrt(6), sqrt(3)/4; C of (4.7): sqrt(12 + 8 sqrt(3)), sqrt(24), sqrt(72)."""
    angle = np.linspace(-np.pi, np.pi, 241)
    a, b = np.meshgrid(angle, angle)
    A = 4 - 2 * np.cos(a) - 2 * np.cos(b)
    M = (6 + 2 * np.cos(a) + 2 * np.cos(b) + 2 * np.cos(a + b)) / 12
    assert np.isclose((A * M).max(), 3, rtol=1e-3)
    assert np.isclose((A / M).max(), 12 + 8 * 3**0.5, rtol=1e-3)
    line, mass = 2 - 2 * np.cos(angle), (4 + 2 * np.cos(angle)) / 6
    A, M = np.add.outer(line / mass, line / mass), np.multiply.outer(mass, mass)
    assert np.isclose((A * M * M).max(), 3 / 2, rtol=1e-3)
    assert np.isclose(A.max(), 24, rtol=1e-3)
    s = 4 * np.cos(a / 2) * np.cos(b / 2)  # criss-cross: corners and centres of the squares
    A, M = (np.moveaxis(np.array(m), (0, 1), (-2, -1)) for m in (
        [[4 + 1e-9 + 0 * s, -s], [-s, 4 + 1e-9 + 0 * s]],
        [[1 / 3 + (np.cos(a) + np.cos(b)) / 12, s / 24], [s / 24, 1 / 6 + 0 * s]],
    ))  # fmt: skip
    assert np.isclose(np.linalg.eigvals(np.linalg.solve(M, A)).real.max(), 72, rtol=1e-3)
    for D, limit in (((2 / 3, 1 / 3), 6), ((1 / 2, 1 / 2), 16 / 3)):  # vertex rule, Voronoi areas
        inverse = np.diag(1 / np.array(D))
        assert np.isclose(np.linalg.eigvals(inverse @ M @ inverse @ A).real.max(), limit, rtol=1e-3)


@pytest.mark.parametrize(
    ("number", "misprints"),
    [("3.27", 2), ("3.32", 0), ("3.33", 0), ("3.36", 0), ("3.6", 0), ("3.23", 1), ("3.16", 2), ("2.7", 0),
     ("E_I", 0)],
)  # fmt: skip
def test_statements(number, misprints):
    """Every row of the table of misprints is what it is said to be, and `theory` finds it by its number."""
    verdicts = [finding.verdict for finding in find(number).measure(COMM).findings]
    assert "FAILS" not in verdicts
    assert verdicts.count("misprint") == misprints


def test_kite_table():
    """(3.33): .996 .978 .928 .773 .162 for t = .1 .2 .3 .4 .49."""
    found = [finding.observed for finding in algebra.kites(COMM).findings[1:]]
    assert np.allclose(found, [0.996, 0.978, 0.928, 0.773, 0.162], atol=1e-3)

"""The element algebra of Examples 1-3 by SymPy, exactly, beside what the package computes; the misprints."""

import numpy as np
import pytest

from tests.conftest import COMM
from tests.theory import algebra
from tests.theory.statement import find


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

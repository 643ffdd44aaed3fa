"""The element algebra of Examples 1-3 by SymPy, exactly, beside what the package computes; the misprints."""

import numpy as np
import pytest

from tests.conftest import COMM
from tests.theory import algebra
from tests.theory.statement import find


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

"""The element algebra of Examples 1-3 by SymPy beside the numbers of the paper; test_theory.py has the rest."""

import numpy as np

from tests.conftest import COMM
from tests.theory import algebra


def test_kite_table():
    """(3.33): .996 .978 .928 .773 .162 for t = .1 .2 .3 .4 .49."""
    found = [finding.observed for finding in algebra.kites(COMM).findings[1:]]
    assert np.allclose(found, [0.996, 0.978, 0.928, 0.773, 0.162], atol=1e-3)

"""(3.7)-(3.8): digits of the contact pressure at small eps."""

from tests.conftest import COMM
from tests.theory.digits import EPS, GAP, PLAIN, RESIDUAL, digits


def test_digits():
    """Down to 1e-14 and beyond, p_eps - p_h falls like eps; stored as u, 3 digits are left at 1e-14."""
    found = digits(COMM)
    assert all(finding.verdict != "FAILS" for finding in found.findings)
    errors = {curve.label: dict(zip(EPS, curve.y, strict=True)) for curve in found.panels[0].curves}
    for form in (GAP, RESIDUAL):
        assert 0.99e-7 < errors[form][EPS[10]] / errors[form][EPS[3]] < 1.01e-7
    assert errors[PLAIN][EPS[10]] > 1e6 * errors[GAP][EPS[10]]

"""(2.8)-(2.13) and (3.2)-(3.3): which penalty operators are monotone."""

import pytest

from fenicsx_obstacle.parallel import largest
from tests.conftest import COMM
from tests.theory.monotone import Line, hat, penalties, ramp


@pytest.mark.slow
def test_statement():
    """J((u - g)^+) is not monotone nor J(I - P_K); that one, and the penalty in L2, are monotone."""
    found = penalties(COMM)
    verdicts = [finding.verdict for finding in found.findings]
    assert verdicts == ["needs hypothesis"] * 3 + ["holds"] * 3


def test_counterexample_by_hand():
    """With v <= 0 and a ramp of 1 on the hat it is (u, ramp) - 9 (u, u) in H1: 0.005 - 9 (0.05 + 1/6000)."""
    line = Line(COMM)
    u, v = line.function(hat), line.function(lambda x: 10 * hat(x) - ramp(x))
    value = line.product("H1", line.positive(u), line.combined(1, u, -1, v))
    assert value == pytest.approx(-0.4465, rel=1e-10)


def test_projection_stays_in_the_set_and_is_a_projection():
    """P_K u <= 0, P_K P_K u = P_K u, and u - P_K u is orthogonal to P_K u in H1, K being a cone."""
    line = Line(COMM)
    u = line.random_pairs()[0][0]
    inside = line.projected(u)
    assert largest(COMM, inside.x.array) <= 1e-12
    again = line.combined(1, line.projected(inside), -1, inside)
    assert line.product("H1", again, again) < 1e-18
    size = line.product("H1", u, u)
    assert abs(line.product("H1", line.combined(1, u, -1, inside), inside)) < 1e-9 * size

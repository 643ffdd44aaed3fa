"""Theorems 3.1 and 3.2: the limit eps -> 0 on one mesh, its bounds, and the ends of the hypotheses."""

import numpy as np
import pytest

from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import largest
from tests.conftest import COMM, membrane
from tests.theory.limits import approach, extremes
from tests.theory.samples import sample


def test_ends_of_the_hypotheses():
    """f = 0; g out of reach; contact everywhere; K_h empty."""
    assert [finding.verdict for finding in extremes(COMM)] == ["holds"] * 4 + ["needs hypothesis"]


@pytest.mark.parametrize("name", ["disk", "ball"])
def test_limit(name):
    """u_eps -> u_h and p_eps -> p_h, with order 1 in the end; the nodal bound is sharp."""
    seen = approach(sample(name, 16), COMM, (1e-1, 1e-3, 1e-5, 1e-7, 1e-9))
    assert np.all(np.diff(seen.energy) < 0) and np.all(np.diff(seen.pressure) < 0)
    for errors in (seen.energy, seen.highest, seen.pressure):
        assert errors[-1] / errors[-2] == pytest.approx(1e-2, rel=1e-2)
    assert seen.above[-1] == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize(
    "data",
    [
        {
            "mesh": {"shape": "rectangle", "diagonal": "union-jack", "cells": 16},
            "lower": "0.1 - (x - 0.4)^2 - (y - 0.5)^2",
        },
        {"mesh": {"shape": "box", "cells": 8}, "load": 10, "upper": 0.2},
        {"tension": "where(x < 0.5, 1, 10)", "load": "100*x", "upper": "0.5 + x*y"},
    ],
    ids=["curved, from below", "box", "two tensions"],
)
def test_bounds(data):
    """M-matrix: 0 <= e = u_eps - u_h <= eps max|p_eps|; on any mesh |p_eps|_I <= |p_h|_I, a(e,e) <= eps/4 |p_h|_I^2."""
    scene = membrane(**{"boundary": [{"value": 0}], **data})
    seen = approach(scene, COMM, (1e-1, 1e-3, 1e-6, 1e-9))
    assert min(seen.lowest) >= -1e-12
    assert max(seen.above) <= 1 + 1e-6
    assert max(seen.below) <= 1 + 1e-6
    assert max(seen.rise) <= 1e-12
    assert max(seen.size) <= 1 + 1e-9
    assert max(seen.work) <= 1
    assert np.all(np.diff(seen.energy) < 0) and np.all(np.diff(seen.pressure) < 0)
    assert seen.above[-1] > 0.9


def test_no_force_at_all():
    """f = 0 below g > 0: u = 0 and p = 0 at any eps, and for the inequality itself."""
    for change in ({"solve.eps": 1e-14}, {"solve.method": "successive"}, {"solve.method": "vi"}):
        answer = SolverContext(membrane(load=0, upper=0.1, boundary=[{"value": 0}]).change(change)).answer()
        assert largest(COMM, np.abs(answer.u.x.array)) < 1e-16  # the round-off of g
        assert largest(COMM, np.abs(answer.pressure.x.array)) == 0

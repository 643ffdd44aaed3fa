"""Estimates of the error where nothing is proved: they drive adaptive meshes, and say what is missing."""

import pytest

from fenicsx_obstacle import Scene, solve
from tests.conftest import COMM

SQUARE = {"shape": "rectangle", "cells": 8, "perturb": 0.2}


def scene(**effects):
    """A membrane that is pressed against a plane."""
    return Scene(mesh=SQUARE, load=-2, lower=-0.05, boundary=[{"value": 0}], **effects)


def test_a_power_law_of_exponent_two():
    """With the exponent 2 the operator is linear: the estimate is the bound of the tension."""
    linear, power = (
        solve(scene(**effect), bound=True, eps=1e-4, comm=COMM).bound
        for effect in ({"tension": 3}, {"power_law": {"exponent": 2, "coefficient": 3}})
    )
    for name in ("total", "admissible_total", "discretisation", "penalty"):
        assert getattr(power, name) == pytest.approx(getattr(linear, name), rel=1e-6)
    assert linear.guaranteed and not power.guaranteed and power.energy is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "missing"),
    [
        ({"large_slope": 1}, "no bound, as large_slope is not linear"),
        pytest.param({"power_law": {"exponent": 3}}, "no bound, as power_law is not linear", marks=pytest.mark.slow),
        ({"tension": 0.05, "drift": [3, 1]}, "no bound, as its proof covers tension, load, foundation, flux and "
                                             "spring, not drift"),
    ],
)  # fmt: skip
def test_a_tolerance_is_reached(effects, missing):
    """Refinement where the estimate is large makes it smaller until it is below the tolerance; the words say that it is
    estimated, and why."""
    answer = solve(scene(**effects), tol=0.2, comm=COMM)
    path = [one["total"] for one in answer.record["adaptive"]["path"]]
    assert answer.record["adaptive"]["reached"] and path[-1] < path[0]
    assert answer.bound.words.startswith("an indicator: estimated") and missing in answer.bound.words
    assert not answer.bound.guaranteed

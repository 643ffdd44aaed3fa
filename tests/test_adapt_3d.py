"""Adaptive meshes of tetrahedra: errors fall with the order of the best meshes, tolerances are reached."""

import numpy as np
import pytest

from fenicsx_obstacle import Scene, solve
from tests.conftest import COMM
from tests.random.families.solid_meshes import octants, tetrahedra

BALL = "r^2/6 + 0.6^3/(3*r) - 0.6^2/2"
SIDES = [-1, 1]


def fichera(half):
    """A cube of side 2 without the eighth where all coordinates are positive, `half` cells along each half side."""
    return tetrahedra(COMM, *octants("fichera", half))


def order(path, key="total"):
    """Of decrease with the unknowns, from the last two meshes whose unknowns differ threefold at least."""
    last = path[-1]
    before = next(one for one in reversed(path) if 3 * one["dofs"] <= last["dofs"])
    return np.log(before[key] / last[key]) / np.log(last["dofs"] / before["dofs"])


@pytest.mark.slow
def test_fichera_corner():
    """A ceiling over a domain with an inner corner and three inner edges: the bound falls with N^(-1/3), the order of
    linear elements, whatever the singularities; a uniform mesh of as many unknowns has a larger one."""
    data = {"tension": 1, "load": 1, "upper": 0.12, "boundary": [{"value": 0}]}
    answer = solve(Scene(mesh=fichera(2), **data), tol=0.25)
    path = answer.record["adaptive"]["path"]
    assert answer.record["adaptive"]["reached"] and answer.bound.words == "certified on the polygon of the mesh"
    assert order(path) > 0.3
    uniform = solve(Scene(mesh=fichera(8), **data), bound=True)
    assert uniform.record["dofs"] == 4401
    assert uniform.bound.total > next(one["total"] for one in path if one["dofs"] > 3000)


@pytest.mark.slow
def test_ball_in_a_cube():
    """The true error falls with N^(-1/3), from mesh to mesh no bound is below it, and few Newton steps are needed."""
    scene = Scene(
        mesh={"shape": "box", "x": SIDES, "y": SIDES, "z": SIDES, "cells": 4}, tension=1, load=-1, lower=0,
        define={"exact_u": f"where(r < 0.6, 0, {BALL})"}, boundary=[{"value": "exact_u"}], exact="exact_u",
    )  # fmt: skip
    found = []
    for asked in ({"bound": True}, {"tol": 0.25}):  # the first mesh, and that of a tolerance
        answer = solve(scene, **asked)
        error = answer.record["errors"]["energy"]
        assert error <= answer.bound.total and answer.bound.relative <= asked.get("tol", np.inf)
        found.append({"dofs": answer.record["dofs"], "error": error})
    assert order(found, "error") > 0.3
    assert answer.record["newton_iterations"] <= 12


def test_a_budget_of_unknowns():
    """The best solution that the budget allows is returned, on a mesh with no more unknowns."""
    scene = Scene(mesh={"shape": "box", "cells": 2}, tension=1, load=1, upper=0.03, boundary=[{"value": 0}])
    answer = solve(scene, tol=1e-3, budget="300 unknowns")
    assert answer.record["dofs"] <= 300 and not answer.record["adaptive"]["reached"]
    assert len(answer.record["adaptive"]["path"]) > 1

"""The error bound with a matrix-valued tension."""

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Scene, releases, solve
from tests.conftest import COMM

CERTIFIED = "certified on the polygon of the mesh"


def bound(tension, sides=(1.0, 1.0), cells=8, **data):
    """The bound of a membrane under a load, or of what is given."""
    kind, make = ("triangle", dmesh.create_rectangle) if len(sides) == 2 else ("tetrahedron", dmesh.create_box)
    ends = [np.zeros(len(sides)), np.array(sides)]
    mesh = make(COMM, ends, [cells] * len(sides), getattr(dmesh.CellType, kind), ghost_mode=releases.FACET_GHOSTS)
    data = {"load": -10, "lower": -0.1, **data}
    scene = Scene(mesh=mesh, tension=tension, boundary=[{"value": 0}], **data)
    return solve(scene, bound=True, eps=1e-4).bound


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_affine_maps(dim):
    """On a stretched domain with a tension that undoes it all energies are those of the domain times the determinant:
    the bound does not depend on the coordinates."""
    sides, cells = np.array([2.0, 0.3, 1.0][:dim]), 8 if dim == 2 else 4
    plain = bound(3.0, [1.0] * dim, cells)
    mapped = bound((3.0 * np.diag(sides**2)).tolist(), sides.tolist(), cells)
    for name in ("total", "admissible_total", "discretisation", "penalty"):
        assert getattr(mapped, name) == pytest.approx(np.sqrt(sides.prod()) * getattr(plain, name), rel=1e-6)
    assert plain.words == mapped.words == CERTIFIED
    assert mapped.energy == pytest.approx(np.array(plain.energy) * sides.prod(), rel=1e-9)


@pytest.mark.parametrize("load", [-10, "-10 - 5*sin(9*x)"])
def test_multiples_of_the_identity(load):
    """The matrix that is a number times the identity gives the bound of the number, or less than 3 % more where the
    load varies."""
    number, matrix = bound("2 + x", load=load), bound([["2 + x", 0], [0, "2 + x"]], load=load)
    assert matrix.total == pytest.approx(number.total, rel=0.03)
    assert matrix.total > number.total * (1 - 1e-3)
    assert number.words == matrix.words == CERTIFIED


@pytest.mark.slow
def test_a_jump_inside_cells():
    """Where the axes of the tension jump inside cells the lower bound of the energy does not exceed the energy on a
    mesh that follows the jump, and the upper bound is not below it."""
    turned = [["where(x < 0.47, 100, 2)", "where(x < 0.47, 1, -0.7)"], ["where(x < 0.47, 1, -0.7)", "1"]]
    coarse = bound(turned, cells=12, lower=None)
    shape = {"shape": "rectangle", "cells": 200}
    fine = solve(Scene(mesh=shape, tension=turned, load=-10, boundary=[{"value": 0}]), comm=COMM)
    assert coarse.words == CERTIFIED
    assert coarse.energy[0] <= fine.record["energy"] <= coarse.energy[1]


@pytest.mark.parametrize(
    ("tension", "words"),
    [
        (
            [["where(x < 0.47, 1, 100)", "where(x < 0.47, 0, 99)"], ["where(x < 0.47, 0, 99)", "100"]],
            "positive definite",
        ),
        ([[1, "0.1*x + 0.1"], ["0.1*(x + 1)", 1]], "symmetric"),
        ([["1/(1 + abs(x - 0.47))", 0], [0, "exp(-x)"]], ""),
    ],
)
def test_what_is_certified(tension, words):
    """A matrix that is not known to be symmetric and positive definite inside cells gives an indicator, and the reason
    is said; one that has a kink is certified."""
    found = bound(tension)
    assert words in found.words
    assert (found.words == CERTIFIED) == (words == "")


def test_callables():
    """A callable is known at its samples only."""
    found = bound([[lambda x: 1 + x[0] ** 2, 0], [0, 1]])
    assert found.words == f"{CERTIFIED} for the sampled tension"

"""How stable the pairs are: (3.18), (4.7), Example 3, the dual norm."""

from functools import cache

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import Scene
from fenicsx_obstacle.forms.pairs import pairs
from fenicsx_obstacle.scenes import meshes
from tests.conftest import COMM, ON_SEVERAL_RANKS
from tests.theory.constants import Stability
from tests.theory.stability import CASES, GAUSS
from tests.theory.statement import slope

NAMES = ("P1", "P1 crossed", "P1 perturbed", "Q1", "Q1 perturbed", "Q2", "Q2 perturbed", "P2", "voronoi")
FAMILIES = {**dict(zip(NAMES, CASES, strict=True)), "gauss": GAUSS}


@cache
def stability(family: str, n: int) -> Stability:
    case = FAMILIES[family]
    scene = Scene(mesh={"shape": "rectangle", "cells": n, **case.mesh}, tension=1)
    return Stability(meshes.build(scene, COMM).mesh, pairs()[case.pair])


@pytest.fixture(scope="module", autouse=True)
def _forget():
    yield
    stability.cache_clear()


@pytest.mark.parametrize("family", [name for name, case in FAMILIES.items() if case.alpha is not None])
def test_constants(family):
    """(3.18), (4.7): alpha_h/h and hat alpha_h/h within 5 % of those of the infinite mesh, and of order 1."""
    case, sizes = FAMILIES[family], (4, 8) if family in ("P2", "voronoi") else (4, 8, 16)
    found = [stability(family, n).alpha() for n in sizes]
    assert found[-1] * sizes[-1] == pytest.approx(case.alpha, rel=0.05)
    assert abs(slope([1 / n for n in sizes], found) - 1) < 0.1
    if case.hat is not None:
        assert stability(family, sizes[-1]).alpha_hat() * sizes[-1] == pytest.approx(case.hat, rel=0.05)


@pytest.mark.parametrize("family", ["P1", "P1 crossed", "P1 perturbed", "Q1", "Q2", "P2"])
def test_alpha_is_not_below_alpha_hat(family):
    """(4.7) gives (3.18): alpha_h >= hat alpha_h wherever I(q, q) >= ||q||_0^2, (3.28)."""
    one = stability(family, 8)
    assert one.equivalence()[0] > 1 - 1e-12
    assert one.alpha() >= one.alpha_hat()


@pytest.mark.parametrize("family", ["P1", "P1 crossed", "Q1", "Q2", "P2", "voronoi"])
def test_literal_alpha_is_zero(family):
    """(3.18) to the letter: V_h does not see the nodes on the boundary, so that alpha_h = 0 on all of Q_h."""
    values = stability(family, 4).spectrum()
    assert values[0] < 1e-15
    assert len(values) == stability(family, 4).Q.dofmap.index_map.size_global


@pytest.mark.parametrize("family", ["P1", "P1 perturbed", "Q1", "Q2", "P2"])
def test_equivalence(family):
    """(3.21), (3.28): I(q, q)/||q||_0^2 between 1 and the largest ratio on one element."""
    assert np.allclose(stability(family, 8).equivalence(), (1, FAMILIES[family].most), rtol=1e-10)


def test_equivalence_needs_parallelograms():
    """(3.33): on perturbed quadrilaterals I(q, q) >= ||q||_0^2 fails."""
    assert stability("Q1 perturbed", 8).equivalence()[0] < 0.999


def test_kernel_of_one_point_gauss():
    """Example 3: 2n - 1 pressures are not seen, and the smallest constant beside them is of order 3."""
    sizes = (4, 8, 16)
    found = [stability("gauss", n).kernel() for n in sizes]
    assert [dim for dim, _ in found] == [2 * n - 1 for n in sizes]
    assert abs(slope([1 / n for n in sizes], [value for _, value in found]) - 3) < 0.15


@pytest.mark.parametrize("family", ["P1", "P1 crossed", "P1 perturbed", "Q1", "Q2", "P2"])
def test_dual_norm(family):
    """The constant with ||q||_1* in place of ||q||_0 does not depend on h where I(1, v) = (1, v)."""
    for n in (4, 8) if family in ("Q2", "P2") else (4, 8, 16):
        one = stability(family, n)
        assert one.consistency() < 1e-12
        beta, rich = one.beta(), one.beta(rich=True)
        assert 0.85 < rich <= beta < 1.3


def test_dual_norm_needs_a_rule_exact_on_V():
    """Voronoi areas on criss-cross meshes: I(1, v) is not the integral of v, and beta_h falls like h."""
    ones = [stability("voronoi", n) for n in (4, 8, 16)]
    assert min(one.consistency() for one in ones) > 0.1
    assert slope([1 / 8, 1 / 16], [one.beta() for one in ones[1:]]) > 0.9
    assert stability("Q1 perturbed", 8).consistency() > 0.01


@ON_SEVERAL_RANKS
def test_ranks():
    """1, 2 and 3 ranks find what one rank finds on its own."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 8, "perturb": 0.25}, tension=1)
    alone = Stability(meshes.build(scene, MPI.COMM_SELF).mesh, pairs()["P1"])
    one = stability("P1 perturbed", 8)
    assert one.alpha() == pytest.approx(alone.alpha(), rel=1e-9)
    assert one.beta() == pytest.approx(alone.beta(), rel=1e-9)

"""The successive iteration (3.4)*: nested active sets, their check at run time, cycles and counts."""

import numpy as np
import pytest

from fenicsx_obstacle import solve
from fenicsx_obstacle.algebra.linear import defaults
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes import meshes
from tests.conftest import COMM, membrane
from tests.hard.cases import case
from tests.theory.iteration import entered

SQUARES = {"shape": "rectangle", "cell": "quadrilateral", "cells": 8}


def sheared(by):
    """The mesh of `membrane` with x moved by so many y; its diagonals go up to the right."""
    mesh = meshes.build(membrane(), COMM).mesh
    mesh.geometry.x[:, 0] += by * mesh.geometry.x[:, 1]
    return mesh


@pytest.mark.slow
def test_successive_iteration_is_the_same_loop(disk):
    """(3.4)*: from no contact until the active set is the same; the first step is the unconstrained solution."""
    answer = solve(disk, method="successive", eps=1e-6)
    assert answer.history[0].active == 0
    assert answer.history[-1].changed == 0
    unconstrained = solve(disk.change({"obstacle.upper": 10.0}))
    violated = total(COMM, np.count_nonzero(unconstrained.u.x.array[: unconstrained.level.owned] > 0.3 + 1e-12))
    assert answer.history[1].active == violated
    newton = solve(disk, eps=1e-6)
    assert np.isclose(newton.record["energy"], answer.record["energy"], rtol=1e-10)


@pytest.mark.parametrize(("scene", "holds"), [
    (lambda: membrane(upper=1), True),
    (lambda: membrane(upper=1, mesh={"shape": "rectangle", "y": [0, 50], "diagonal": "crossed", "cells": 8}), True),
    (lambda: membrane(upper=1, mesh=sheared(-0.5)), True),
    (lambda: membrane(upper=1, mesh=sheared(0.5)), False),
    (lambda: membrane(upper=1, mesh={"shape": "box", "cells": 4}), True),
    (lambda: membrane(upper=1, mesh={"shape": "interval"}, tension="1 + 1e6*x"), True),
    (lambda: membrane(upper=1, mesh=SQUARES), True),
    (lambda: membrane(upper=1, mesh=SQUARES).change({"solve.element": "Q2"}), False),
], ids=["right angles", "crossed, stretched", "acute", "obtuse", "box", "interval", "Q1", "Q2"])  # fmt: skip
def test_m_matrix(scene, holds):
    """Off-diagonals of P1 are not positive iff angles opposite to each edge sum to 180 degrees at most."""
    context = SolverContext(scene().change({"boundary": [{"value": 0}]}))
    assert context.problem.m_matrix is holds
    context.answer()
    del context.problem.m_matrix
    assert context.problem.m_matrix is holds  # springs are on the diagonal


@pytest.mark.parametrize("eps", [1e-3, 1e-10])
def test_inexact_systems_are_no_error(disk, eps):
    """Where linear systems are left unsolved, nodes may enter again: the answer is the same."""
    scene = disk.change({"mesh.cells": 32, "solve.method": "successive", "solve.eps": eps})
    with defaults("penalty_", {"ksp_rtol": 0.3, "pc_type": "jacobi"}):
        rough = solve(scene)
    assert entered(rough.history) > 0
    assert np.isclose(rough.record["energy"], solve(scene).record["energy"], rtol=1e-10)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_nodes_without_obstacle():
    """Most nodes of this scene have no obstacle: their distance to it is infinite, before and after a step."""
    answer = solve(case("valves").on(0), method="successive", eps=1e-6)
    assert answer.record["m_matrix"]
    assert len(answer.history) > 2
    assert entered(answer.history) == 0

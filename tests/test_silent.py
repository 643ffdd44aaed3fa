"""No solver keeps silent: what it cannot solve raises the same error on every rank, and returns nothing."""

import pytest

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.algebra.linear import defaults
from fenicsx_obstacle.errors import NotConverged
from tests.conftest import COMM
from tests.hard.unsolvable import Unsolvable, attempt, problems

PROBLEMS = {problem.name: problem for problem in problems()}


@pytest.mark.ranks
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (k % 5 > 0)) for k, name in enumerate(PROBLEMS)]
)
def test_unsolvable(name):
    """All methods, one step; not a number at one place, on one rank; no matrix, no minimum."""
    held, said = attempt(PROBLEMS[name], COMM)
    assert held, said


def test_a_solved_problem_is_found():
    """An answer is not an error."""
    held, said = attempt(Unsolvable("none", lambda comm: None, {}), COMM)
    assert not held
    assert said == "an answer"


def test_not_a_number_ends_at_once():
    """It cannot become one again: no step is taken, where there were a thousand; F is not a number at that node."""
    with pytest.raises(InputError, match=r"F at the start.* is not a finite number: it is nan at") as error:
        PROBLEMS["form, penalty: load not a number at one node of the last rank"].solve(COMM)
    assert isinstance(error.value.__context__, NotConverged) and error.value.__context__.iterations == 0


JUMP = {"tension": "where(x < 1/3, 1, 1e6)", "load": "-exp(-9*(x^2 + y^2))", "boundary": [{"value": 0}]}


def test_a_direct_solver_goes_on():
    """Tensions that jump by 1e6 within cells defeat algebraic multigrid; not if the user's options say how to solve."""
    mesh = {"shape": "rectangle", "cells": 10, "y": [0, 2], "diagonal": "crossed", "perturb": 0.2}
    scene = Scene(mesh=mesh, **JUMP).change({"solve.element": "P2"})
    answer = solve(scene, start="cold")
    assert answer.record["krylov_iterations"] > answer.record["newton_iterations"]  # it was tried
    with defaults("penalty_", {"ksp_max_it": 3}), pytest.raises(NotConverged, match="linear system"):
        solve(scene, start="cold")

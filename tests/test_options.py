"""Options of a solve: checked without a scene, filled from its table [solve], and written back into it."""

from dataclasses import replace

import pytest

from fenicsx_obstacle import InputError
from fenicsx_obstacle.algebra.options import EpsFormula, SolverOptions
from fenicsx_obstacle.algebra.penalty_parameter import penalty_parameter
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.scenes.scene import Scene
from tests.conftest import COMM, membrane

WRONG = {
    r"SolverOptions: eps = 0: must be positive and finite": {"eps": 0},
    r"SolverOptions: eps = -h: must be positive and finite": {"eps": EpsFormula("-h", lambda h: -h)},
    r"SolverOptions: eps = nan: is nan": {"eps": float("nan")},
    r"SolverOptions: eps = 'h\^2': expected a number, an EpsFormula or 'auto'": {"eps": "h^2"},
    r"SolverOptions: eps = None: expected a number, an EpsFormula or 'auto'": {"eps": None},
    r"SolverOptions: method = 'Newton': expected penalty, successive or vi": {"method": "Newton"},
    r"SolverOptions: start = 'warm': expected nested or cold": {"start": "warm"},
}


@pytest.mark.parametrize("message", WRONG)
def test_values_are_checked(message):
    """What fits no key is refused, with the values that do."""
    with pytest.raises(InputError, match=message):
        SolverOptions(**WRONG[message])


def test_eps_of_options():
    """A number is absolute; a formula in h is divided by the largest tension, alike from a scene and without one."""
    scene = membrane(upper=0.1, tension=4, define={"c": 2}).change({"mesh.cells": 8, "solve.eps": "c*h^2"})
    problem = SolverContext(scene, COMM).problem
    h = problem.level.h
    assert penalty_parameter(problem, scene.options) == pytest.approx(2 * h**2 / 4, rel=1e-14)
    own = SolverOptions(eps=EpsFormula("2*h^2", lambda h: 2 * h**2))
    assert penalty_parameter(problem, own) == penalty_parameter(problem, scene.options)
    assert penalty_parameter(problem, SolverOptions()) == penalty_parameter(problem, scene.options_with(eps="h^2/100"))
    assert penalty_parameter(problem, SolverOptions(eps=1e-3)) == 1e-3
    assert penalty_parameter(problem, scene.options_with(eps="c/1000")) == 2e-3


def test_answers_say_their_options():
    """The scene of an answer has the options of the solve in [solve], and gives the same options when read anew."""
    scene = membrane(upper=0.1, load=8, define={"c": 2}).change({"mesh.cells": 8, "solve.element": "P2"})
    context = SolverContext(scene, COMM)
    for options in (
        replace(context.scene.options, eps=1e-4),
        scene.options_with(eps="c*h", method="successive"),
        SolverOptions("vi", start="cold"),
        SolverOptions(),
    ):
        answer = context.answer(options)
        assert answer.scene.options == options and answer.record["method"] == options.method
        assert answer.scene.tables == answer.scene.change({}).tables
        assert answer.scene.change({}).options == options
        assert answer.record["element"] == "P2" == answer.scene.tables.solve.element


def test_a_new_number_checks_no_scene(monkeypatch):
    """Another eps or method makes no scene anew."""
    context = SolverContext(membrane(upper=0.1, load=8).change({"mesh.cells": 8}), COMM)
    monkeypatch.setattr(Scene, "_fill", None)
    for method in ("penalty", "vi"):
        assert context.answer(replace(context.scene.options, method=method, eps=1e-3)).record["converged"]

"""Reading scenes: formulas, conditions, changes, round trips; what is wrong in a file is in test_broken.py."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes import formulas
from fenicsx_obstacle.show.explain import explain
from tests.conftest import COMM, membrane

NUMBERS = st.floats(0.1, 9, allow_nan=False).map(lambda x: (f"{x!r}", x))
OPERATIONS = {"+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b}


def _combined(children):
    binary = st.tuples(children, st.sampled_from(sorted(OPERATIONS)), children).map(
        lambda t: (f"({t[0][0]} {t[1]} {t[2][0]})", OPERATIONS[t[1]](np.float64(t[0][1]), t[2][1]))
    )
    called = children.map(lambda t: (f"sin({t[0]})", np.sin(t[1])))
    chosen = st.tuples(children, children, children).map(
        lambda t: (
            f"where({t[0][0]} < {t[1][0]}, {t[2][0]}, -({t[1][0]})^2)",
            t[2][1] if t[0][1] < t[1][1] else -(t[1][1] ** 2),
        )
    )
    return binary | called | chosen


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.recursive(NUMBERS, _combined, max_leaves=12))
def test_formulas_mean_what_they_say(case):
    text, value = case
    with np.errstate(all="ignore"):
        if not np.isfinite(value):
            return
    if len(text) <= formulas.MAX_LENGTH:
        assert np.isclose(formulas.parse(text, "test").on_arrays({}), value, rtol=1e-12, equal_nan=True)


def test_words_of_formulas():
    x = np.array([0.5, 2.0])
    evaluate = lambda text: formulas.parse(text, "test").on_arrays({"x": x, "pi": math.pi})  # noqa: E731
    assert np.allclose(evaluate("2^3^2"), 512)
    assert np.allclose(evaluate("-x^2"), [-0.25, -4])
    assert np.allclose(evaluate("where(x > 1, sqrt(x - 1), 7)"), [7, 1])  # the branch not chosen is NaN
    assert np.allclose(evaluate("0 < x < 1"), [1, 0])
    assert np.allclose(evaluate("3*(x < 1 or x == 2) + (not x > 1)"), [4, 3])
    assert np.allclose(evaluate("min(x, 1, 0.7) + max(x, 1)"), [1.5, 2.7])
    assert np.allclose(
        evaluate("hypot(x, x) + atan2(x, x) + log10(100) + floor(x) % 2"), np.sqrt(2) * x + np.pi / 4 + 2
    )
    assert np.allclose(evaluate("9^9^1^9"), 9.0**9)


@pytest.mark.parametrize(
    "where",
    ["x >= 1/2 and sqrt(x - 1/2) > 0.2", "not (x < 1/2 or sqrt(x - 1/2) <= 0.2)", "x > 1/2 and inside",
     "where(x < 1/2, 0, sqrt(x - 1/2)) > 0.2", "sqrt(x - 1/2) > 0.2 and x >= 1/2"],
)  # fmt: skip
def test_conditions_that_are_decided(where):
    """A comparison may lack a value where another condition decides, in any order: the part is that of x > 0.54."""
    fixed = []
    for one in (where, "x > 0.54"):
        scene = membrane(define={"inside": "sqrt(x - 1/2) > 0.2"}, boundary=[{"where": one, "value": 0}], lower=-1)
        fixed.append(total(COMM, np.count_nonzero(SolverContext(scene).problem.fixed)))
    assert fixed[0] == fixed[1] > 0


def test_what_stands_at_its_default_is_left_out():
    """No empty tables in scene.toml; no '0.0' and no '1 times' in words."""
    scene = membrane(lower=-1, boundary=[{"where": "x < 1/2", "value": 0}, {"on": "right", "value": 0.5}])
    assert [line for line in scene.toml().splitlines() if line.startswith("[")] == ["[mesh]", "[effects]", "[obstacle]"]
    text = explain(scene)
    assert all(part in text for part in ("16 cells along x\n", "u = 0 where x < 1/2\n", "u >= lower = -1\n"))
    assert repr(scene) == "Scene('scene', source='scene')"


def test_change_and_round_trip(disk, folder):
    """A changed scene is checked like a new one, and survives as TOML."""
    finer = disk.change({"mesh.cells": 7, "define.c": 0.2})
    assert finer.tables.mesh.cells == 7
    path = folder / "again.toml"
    if COMM.rank == 0:
        path.write_text(finer.toml())
    COMM.barrier()
    assert Scene.read(path).tables == finer.tables
    with pytest.raises(InputError, match="expected a whole number"):
        disk.change({"mesh.cells": 1.5})


def test_boundaries_overlap_in_order_and_unlisted_parts_are_free():
    """u = x between left and right: bottom and top are free, so u is linear."""
    scene = membrane(boundary=[{"on": "left", "value": 0}, {"on": ["right"], "value": "1"}], exact="x")
    assert solve(scene).record["errors"]["max"] < 1e-9
    scene = membrane(
        boundary=[{"value": 5}, {"where": "x == 0 or x == 1 or y == 0 or y == 1", "value": "y"}], exact="y"
    )
    assert solve(scene).record["errors"]["max"] < 1e-9

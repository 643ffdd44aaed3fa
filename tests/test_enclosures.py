"""Bounds of formulas on whole cells: no value outside them, and what they decide without sampling."""

from math import factorial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fenicsx_obstacle import Scene, polynomials
from fenicsx_obstacle.scenes.derivative_bounds import ORDER
from fenicsx_obstacle.scenes.formulas import FUNCTIONS
from fenicsx_obstacle.scenes.mean_value_forms import Cells, OnCells
from tests.conftest import membrane

SCENE = membrane(load=1).change({"mesh.cells": 1})
NUMBERS = st.sampled_from(["0", "1", "2", "0.25", "-1.5", "1e-3", "pi"])
LEAVES = st.one_of(NUMBERS, st.sampled_from(["x", "y", "r", "theta"]))


def _larger(inner):
    one = st.sampled_from(["sin", "cos", "tan", "atan", "exp", "ln", "sqrt", "abs", "sign", "floor", "tanh", "cosh"])
    return st.one_of(
        st.tuples(inner, st.sampled_from("+-*/%"), inner).map(lambda p: f"({p[0]} {p[1]} {p[2]})"),
        st.tuples(one, inner).map(lambda p: f"{p[0]}({p[1]})"),
        st.tuples(inner, st.sampled_from(["2", "3", "(-1)", "0.5", "(-0.5)"])).map(lambda p: f"({p[0]})^{p[1]}"),
        st.tuples(st.sampled_from(["min", "max", "hypot", "atan2"]), inner, inner).map(
            lambda p: f"{p[0]}({p[1]}, {p[2]})"
        ),
        st.tuples(inner, st.sampled_from(["<", "<=", "==", "!="]), inner, inner, inner).map(
            lambda p: f"where({p[0]} {p[1]} {p[2]}, {p[3]}, {p[4]})"
        ),
        st.tuples(inner, inner, inner, inner).map(lambda p: f"where({p[0]} > 0 and not {p[1]} > 1, {p[2]}, {p[3]})"),
    )


FORMULAS = st.recursive(LEAVES, _larger, max_leaves=8)
CORNERS = st.lists(st.floats(-2, 2).map(lambda v: round(v, 3)), min_size=6, max_size=6).map(
    lambda values: np.array(values).reshape(3, 2)
)


def on_cells(text, corners, scene=SCENE):
    return OnCells(Cells(scene, np.asarray(corners, dtype=float)), scene.formula(text, "here"))


def enclosed(text, corners, scene=SCENE):
    return on_cells(text, corners, scene).once()


def values_at(text, places):
    """Of a formula at places in the plane, shape (n, 2)."""
    points = np.zeros((3, len(places)))
    points[:2] = places.T
    return SCENE.at_points(SCENE.formula(text, "here"), points)


def area(x):
    return abs(np.linalg.det(np.array([x[1] - x[0], x[2] - x[0]]))) / 2


def check(text, x, seed):
    """Values at random points are within the bounds; a polynomial is what its values at few points say."""
    found = enclosed(text, x[None])
    weights = np.random.default_rng(seed).dirichlet(np.ones(3), 200)
    values = values_at(text, weights @ x)
    low, high = found.lower[0], found.upper[0]
    slack = 1e-9 * (1 + np.nanmax(np.abs(values[np.isfinite(values)]), initial=0.0))
    inside = np.isfinite(values)
    if found.defined[0]:
        assert (values[inside] >= low - slack).all() and (values[inside] <= high + slack).all(), (text, low, high)
        assert np.isfinite(low) + np.isfinite(high) < 2 or inside.all(), text
    degree = int(found.degree[0])
    if found.whole[0] and found.defined[0] and degree <= 6 and inside.all() and np.abs(values).max() < 1e6:
        samples = values_at(text, polynomials.inner_points(3, degree) @ x)
        fitted = polynomials.evaluate(polynomials.coefficients(samples[None], 3, degree), weights, degree)[0]
        assert np.abs(fitted - values).max() <= 1e-7 * (1 + np.abs(values).max()), (text, degree)


@pytest.mark.slow
@pytest.mark.serial
@settings(max_examples=1000, deadline=None, derandomize=True, database=None)
@given(text=FORMULAS, x=CORNERS, seed=st.integers(0, 1000))
def test_any_formula_on_any_triangle(text, x, seed):
    """What is found holds at random points: bounds, degrees, linear functions with kinks and jumps too, and bounds of
    derivatives, on large cells and on small ones."""
    if area(x) > 1e-3:
        check(text, x, seed)
        check_linear(text, x, seed)
        check_linear(text, x[:1] + 0.1 * (x - x[:1]), seed)
        check_slopes(text, x, seed)
        check_slopes(text, x[:1] + 0.05 * (x - x[:1]), seed)


@pytest.mark.parametrize("argument", ["3*(x - 0.4)", "1/(x - 0.4)", "ln(abs(x - 0.4))"])
@pytest.mark.parametrize("name", [name for name, (least, _) in FUNCTIONS.items() if least == 1])
def test_functions_around_an_extremum_and_a_pole(name, argument):
    """An extremum or a kink inside the cell, and an argument without a limit there."""
    for x in (np.array([(-1, -1), (2, -1), (-1, 2)]), np.array([(0.3, 0), (0.6, 0), (0.3, 0.3)])):
        check(f"{name}({argument})", x, 1)
        check_linear(f"{name}({argument})", x, 1)
        check_slopes(f"{name}({argument})", x, 1)


@pytest.mark.parametrize("text", [
    "where(exp(240*x) - 1e3 < 0, 1, 2)", "where(1e13*x^8 - 1 < 0, 1, 2)", "sign(sinh(240*x) - 1e3)",
    "floor((4*x)^40/4 - 1e-13)", "atan2(exp(240*x) - 1e3, -1)", "atan2(min(y - 0.1, 0), -1)",
    "atan2(floor(y - 0.1), -1)", "atan2(where(x < 0.1, -1e-13, 1), -1)",
    "atan2(-0*x, -1)", "hypot(1e-200, 0*x)*1e200", "1e200/hypot(1, 1e200*(x + 1))",
    "atan(1/min(y - 0.1, 0))", "floor(cos(x/1e7))", "floor(0.001^(-2)) + 0*x",
])  # fmt: skip
def test_numbers_that_are_small_in_a_part_of_a_cell(text):
    """A number that is huge somewhere in the cell, or 0 on a part of it, says nothing of its sign elsewhere."""
    check(text, np.array([(0.0, 0.0), (0.25, 0.0), (0.0, 0.25)]), 1)


SQUARE = np.array([[[0.25, 0.25], [0.5, 0.25], [0.5, 0.5]], [[0.5, 0.25], [0.75, 0.25], [0.75, 0.5]]])


@pytest.mark.parametrize(
    ("text", "whole", "degree"),
    [
        ("where(x < 0.5, 2, 1)", True, 0), ("where(x <= 1/2, x, y^2)", True, [1, 2]),
        ("where(x < 0.503, 2, 1)", [True, False], 0), ("sqrt(x)", True, 1000),
        ("floor(4*x)", True, 0), ("(4*x) % 1", True, 1), ("abs(x - 1/2)*y", True, 2), ("sign(x - 0.5)", True, 0),
        ("max(x, 0.5)^2", True, [0, 2]), ("where(y <= x, 1, 2)", True, 0), ("r^2 + r^4", True, 4),
        ("where(r^2 - x^2 - y^2 == 0, 3, 4)", True, 0), ("where(x == 0.3, 1e9, 1)", [False, True], 0),
        ("where(x - y - 0.25 <= 0, 1, x)", True, [0, 1]), ("where(x + y < 0.8, 1, 2)", False, 0),
        ("where((x - 0.5)^2 > 0, 1, 2)", True, 0), ("where((x - 0.4)^2 > 0, 1, 2)", [False, True], 0),
        ("atan(1/(x - 0.4))", [False, True], 1000), ("min(1/(x - 0.4), 1)", [False, True], [0, 0]),
    ],
)  # fmt: skip
def test_what_is_decided(text, whole, degree):
    """Conditions that change on mesh lines only are decided on each cell, others are not; degrees follow."""
    found = enclosed(text, SQUARE)
    whole, degree = np.broadcast_to(whole, 2), np.broadcast_to(degree, 2)
    assert np.array_equal(found.whole, whole) and np.array_equal(found.degree[whole], degree[whole])


def test_definitions_and_poles():
    """Conditions in [define] count; a pole gives an infinite bound, one that a condition keeps away does not."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 1}, tension=1, define={"s": 0.3, "cut": "where(x < s, 0, 1)"})
    assert not enclosed("2*cut", SQUARE, scene).whole[0]
    around = np.array([[[-0.1, -0.1], [0.2, -0.1], [0.05, 0.3]]])
    for text in ("1/r", "ln(r)", "max(r, 1e-12)^(-1.9)", "1/(x^2 + y^2)", "tan(pi/2 + x)", "x/y"):
        found = enclosed(text, around)
        assert not np.abs([found.lower[0], found.upper[0]]).max() < 1e20, text
    for text in ("where(r > 0.05, 1/r, 7)", "where(x^2 + y^2 > 0.01, 1/(x^2 + y^2), 3)", "1/(1.01 + sin(150*x))",
                 "where(r < 0.2, sqrt(0.2^2 - r^2), 0)", "ln(1.01 + r)"):  # fmt: skip
        parts = around
        for _ in range(7):
            parts = polynomials.halved(parts)
        found = enclosed(text, parts)
        assert found.finite.all() and np.abs([found.lower, found.upper]).max() < 1e4, text
    for text in ("sqrt(x)", "sin((0 % 0)^2)"):
        assert not enclosed(text, around).defined[0], text
    found = enclosed("1 % (1e-3 + 0*x)", around)  # 1/1e-3 is 1000 only when rounded
    assert found.lower[0] <= 0 and found.upper[0] >= 1e-3


def check_slopes(text, x, seed):
    """Differences of order k along segments in a cell are at most the bound of the k-th derivative times length^k."""
    found = enclosed(text, x[None])
    if not (found.whole[0] and found.finite[0]) or np.abs([found.lower[0], found.upper[0]]).max() > 1e9:
        return
    ends = np.random.default_rng(seed).dirichlet(np.ones(3), (200, 2)) @ x
    for order in range(1, ORDER + 1):
        bound = found.derivative(order)
        steps = np.arange(order + 1) / order
        places = ends[:, 0, None] + steps[:, None] * (ends[:, 1] - ends[:, 0])[:, None]
        values = values_at(text, places.reshape(-1, 2)).reshape(200, -1)
        difference = np.abs(np.diff(values, order, axis=1)[:, 0])
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / order
        slack = 1e-11 * (np.abs(values).max() + max(abs(found.lower[0]), abs(found.upper[0])))
        assert (difference <= factorial(order) * bound[0] * length**order + slack).all(), (text, order, bound)


SHARP = [
    ("sin(3*x)", (3, 9, 27)), ("x^2 + y^2", (2 * 5**0.5, 2, 0)),
    ("exp(2*x)", (2 * np.exp(4), 4 * np.exp(4), 8 * np.exp(4))), ("r", (1, 2**-0.5, 1.15 / 2)), ("1/x", (1, 2, 6)),
    ("sqrt(x)", (0.5, 0.25, 0.375)), ("theta", (2**-0.5, 0.5, 2**-0.5)),
    ("ln(x)", (1, 1, 2)), ("abs(x)", (1, 0, 0)), ("where(x > 0, 2*x, x)", (2, 0, 0)), ("pi", (0, 0, 0)),
    ("x^3", (12, 12, 6)), ("x*y", (5**0.5, 1, 0)), ("atan2(y, x)", (2**-0.5, 0.5, 2**-0.5)),
]  # fmt: skip


@pytest.mark.parametrize(("text", "bounds"), SHARP, ids=[text for text, _ in SHARP])
def test_slopes_are_sharp(text, bounds):
    """On a cell from (1, 1) to (2, 1): derivatives of simple functions, by hand, are met up to a factor."""
    found = enclosed(text, [[(1, 1), (2, 1), (1, 1.0001)]])
    for order, bound in enumerate(bounds, start=1):
        slope = factorial(order) * found.derivative(order)[0]
        assert bound * (1 - 1e-3) <= slope * (1 + 1e-3) + 1e-300
        assert slope <= 3 * bound


def test_slopes_at_singular_points_are_infinite():
    """A pole, a root of 0, and the tip of a cone have no bounded derivatives."""
    for text in ("1/x", "sqrt(x)", "r", "ln(x)", "theta", "x^1.5"):
        assert np.isinf(enclosed(text, [[(0, 0), (1, 0), (0, 1)]]).derivative(3)[0]), text


def check_linear(text, x, seed):
    """Values at random points are as near to the linear function as its rest says, whatever conditions do, and so is
    the slope of the difference, except where values jump."""
    cells = on_cells(text, x[None])
    if not cells.once().finite[0]:
        return
    at_corners, rest, steep = cells.linear(np.arange(1))
    weights = np.random.default_rng(seed).dirichlet(np.ones(3), 200)
    values = values_at(text, weights @ x)
    if np.isnan(values).any():  # conditions that are undecided guard what they choose from, if they are written to
        assert "where" in text
        return
    size = 1 + np.abs(values).max() + np.abs(at_corners).max()
    slack = 1e-9 * size
    others = np.roll(weights, 1, axis=0)
    changes = []
    for step in (1e-6, 5e-7):
        moved = (1 - step) * weights + step * others
        change = values_at(text, moved @ x) - values - (moved - weights) @ at_corners[0]
        changes.append((np.abs(change), np.linalg.norm((moved - weights) @ x, axis=1)))
    (far, distance), (close, _) = changes
    jumps = (close > 0.9 * far) | (close < 0.1 * far)
    assert (jumps | np.isnan(far) | (far <= steep[0] * distance + 1e-13 * size)).all(), (text, steep)
    assert np.isinf(rest[0]) or np.abs(weights @ at_corners[0] - values).max() <= rest[0] + slack, (text, rest)


def test_what_is_no_number_has_no_finite_bounds():
    """Neither 0 over what is 0 everywhere, up to round-off too, nor the remainder by a logarithm that is no number, nor
    0 times what is infinite, nor a choice by a comparison with no number."""
    for text in (
        "0/atan2(0, 0)", "0/(r - r)", "0 % ln(-1.5)", "0*ln(0)", "0*exp(1e3)", "where(not (-1.5)^0.5 > 1, 0, 0)",
        "where(0 < 1 and sqrt(-1 - r) > 1, 1, 2)", "where(sqrt(x - 0.5) < 9, 1, 1)",
        "where(max(1, sqrt(x - 0.5)) < 9, 1, 1)",
    ):  # fmt: skip
        assert not enclosed(text, [[(0, 0), (0, 1), (1, 0)]]).finite.any(), text


def test_conditions_that_one_comparison_decides_are_defined():
    """A comparison with no number does not matter beside one that fails in `and`, or holds in `or`."""
    for text, value in (("where(0 > 1 and sqrt(-1 - r) > 1, 1, 2)", 2), ("where(0 < 1 or sqrt(x - 0.5) > 1, 1, 2)", 1)):
        found = enclosed(text, [[(0, 0), (0, 1), (1, 0)]])
        assert found.finite.all() and found.whole.all() and found.lower[0] == found.upper[0] == value


@pytest.mark.parametrize("largest", ["max((-1.5)^0.5, 1/x)", "-min((-1.5)^0.5, -1/x)"])
def test_the_largest_of_what_is_no_number_is_above_nothing(largest):
    """A comparison with it fails, however large the other value is."""
    found = enclosed(f"where({largest} > 1, 1, 0)", [[(0.1, 0), (0.1, 1), (0.4, 0)]])
    assert found.lower[0] <= 0


def test_smooth_transitions_cost_second_order():
    """Across a kink the rest falls like h, where branches meet with one slope like h^2, across a jump it stays."""
    for text, rate, size in (
        ("abs(x - 0.01)", 1, 0.1), ("y + max(x - 0.01, 0)^2", 2, 0.1), ("where(x < 0.01, 1, 2)", 0, 0.1),
        ("where(x < 0, exp(x), 1 + x)", 2, 0.1), ("exp(y)*where(x > 0, x^2, 0)", 2, 0.02),
    ):  # fmt: skip
        triangle = np.array([[(-1, -1), (2, -1), (-1, 2)]])
        rests = [on_cells(text, h * triangle).linear(np.arange(1))[1][0] for h in (size, size / 2)]
        assert np.log2(rests[0] / rests[1]) == pytest.approx(rate, abs=0.15), text

"""Data on whole cells without sampling: polynomials on parts of cells, and how far the datum may be from them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fenicsx_obstacle import Scene, polynomials
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of, range_of
from fenicsx_obstacle.scenes.fields import FormulaField
from tests.test_enclosures import CORNERS, FORMULAS, SCENE, area

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def data():
    return SolverContext(Scene(mesh={"shape": "rectangle", "cells": 1}, tension=1, load=1)).problem.data


DIVISION = Division(3)


def pieces(data, text, x, division=DIVISION):
    field = FormulaField(SCENE.formula(text, "here"), SCENE)
    return pieces_of(data, field, np.asarray(x, dtype=float), np.zeros(len(x), dtype=int), division)


@pytest.mark.parametrize("corners", [2, 3, 4])
@pytest.mark.parametrize("degree", [1, 2, 4])
def test_constants_of_the_remainder(corners, degree):
    """Bounds of sum |L_i| |a_i - x|^n, also with gradients: proved on parts of the simplex, and not much larger."""
    points = polynomials.inner_points(corners, degree)
    lagrange = polynomials.coefficients(np.eye(len(points)), corners, degree)

    def sizes(parts):
        """|L_i| is at most the polynomial with the absolute values of its Bernstein coefficients."""
        return np.abs(lagrange @ np.swapaxes(polynomials.to_parts(parts, degree), 1, 2))

    limit = polynomials.REMAINDER[corners][degree]
    assert holds(points, degree, sizes, limit) and not holds(points, degree, sizes, 0.9 * limit)
    if degree == 1:
        return
    along = polynomials.slopes(lagrange, corners, degree)

    def steepness(parts):
        """Gradients of barycentric coordinates add up to 0: any number may be subtracted from the derivatives."""
        there = along @ np.swapaxes(polynomials.to_parts(parts, degree - 1), 1, 2)[:, None]
        middle = np.median(there.mean(axis=3), axis=2)
        return np.abs(there - middle[:, :, None, None]).sum(axis=2)

    limit = polynomials.STEEPNESS[corners][degree]
    assert holds(points, degree, steepness, limit, 1) and not holds(points, degree, steepness, 0.9 * limit, 1)


def holds(points, degree, sizes, limit, less=0):
    """Whether it is proved, on parts of the simplex, that sum s_i |a_i - x|^n is at most the limit.

    The power is convex, so that it is below the linear function with its values at the corners of a part.

    Args:
        points: The a_i.
        degree: n - 1.
        sizes: Bernstein coefficients of bounds of the s_i on parts of the simplex, shape (parts, points, coefficients).
        limit: What is to be proved.
        less: By which the degree of these bounds is less.
    """
    corners, bound_degree = points.shape[1], degree - less
    parts = np.eye(corners)[None]
    times, places = polynomials.exponents(corners, bound_degree), polynomials._raised(corners, bound_degree + 1)
    while 0 < len(parts) < 10_000:
        far = (np.abs(parts[:, :, None] - points).sum(axis=3) / 2) ** (degree + 1)
        products = np.einsum("pim,pvi->pvm", sizes(parts), far)
        found = np.zeros((len(parts), len(polynomials.exponents(corners, bound_degree + 1))))
        for corner in range(corners):
            found[:, places[corner]] += (times[:, corner] + 1) / (bound_degree + 1) * products[:, corner]
        parts = polynomials.halved(parts[found.max(axis=1) > limit])
        if np.ptp(parts, axis=1).max(initial=0.0) < 1e-6:  # of an edge
            break
    return not len(parts)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(FORMULAS, CORNERS, st.integers(0, 99))
def test_polynomials_are_near_on_each_part(data, text, x, seed):
    """At random points the datum is as near to its polynomial as the rest says; the parts fill the cell."""
    if area(x) < 1e-3:
        return
    found = pieces(data, text, x[None])
    if not found.finite.all():
        return
    inside = np.random.default_rng(seed).dirichlet(np.ones(3), 20)
    share = sum(group.share.sum() for group in found.groups)
    assert share == pytest.approx(1, abs=1e-9)
    for group in found.groups:
        places = np.broadcast_to(group.points(inside), (len(group.rows), 20, 3))
        points = np.zeros((3, 20 * len(group.rows)))
        points[:2] = (places @ x).reshape(-1, 2).T
        values = SCENE.at_points(SCENE.formula(text, "here"), points).reshape(-1, 20)
        if np.isnan(values).any():  # conditions that are undecided guard what they choose from, if they are written to
            assert "where" in text
            return
        slack = 1e-9 * (1 + np.abs(values).max())
        assert (np.abs(values - group.values(inside)) <= group.rest[:, None] + slack).all(), text
        assert (values >= group.lower[:, None] - slack).all() and (values <= group.upper[:, None] + slack).all(), text


def test_what_is_constant_on_one_side_of_a_line(data):
    """The floor of min(0, y) is 0 above y = 0, where rounded corners of a part may lie below it."""
    found = pieces(data, "floor(min(0, y))", np.array([[(0.0, 0.0), (0.0, 1.5), (1.0, -2.0)]]))
    middles = [(group, group.points(np.full((1, 3), 1 / 3))[:, 0] @ [0.0, 1.5, -2.0]) for group in found.groups]
    above = [group.upper[y > 0] for group, y in middles]
    assert np.concatenate(above).size and all((upper >= 0).all() for upper in above)


def test_lines_through_a_corner_leave_nothing_empty(data):
    """A condition that changes along a line through a vertex cuts in two parts; none is of measure 0."""
    corners = {
        "where(x > 0, 0, 1)": [(0.0, 0.0), (0.562, 0.0), (-1.5, 1.0)],
        "where(x < y, 0, 1)": [(-2.0, 0.0), (0.0, -0.562), (1.5, 1.5)],  # where the vertex is only nearly on it
    }
    for text, cell in corners.items():
        shares = np.concatenate([group.share for group in pieces(data, text, np.array([cell])).groups])
        assert len(shares) == 2 and shares.min() > 0.2


@pytest.mark.parametrize(
    ("text", "undecided"),
    [
        ("where(x < 0.503, 2, 1)", 1e-9), ("where(x + 0.3*y < 0.6251, 2, x)", 1e-9),
        ("where(r < 0.517, 1e6, 1)", 0.03), ("where(x < 0.2 or y > 0.317, 1, 0)", 1e-9),
        ("where(hypot(x - 0.1, y) < 0.4, exp(x), -1)", 0.03),
    ],
)  # fmt: skip
def test_jumps_are_cut_out(data, text, undecided):
    """Along a line nothing is left between the two sides, along a curve a thin strip."""
    x = np.array([[(0, 0), (1, 0), (0, 1)], [(1, 1), (0, 1), (1, 0)]])
    found = pieces(data, text, x, Division(5))
    assert sum(group.share[group.rest > 1e-3].sum() for group in found.groups) <= 2 * undecided


def test_strips_get_narrow_with_h(data):
    """In a cell cut by a circle the share that is undecided falls like h."""
    shares, middle = [], 0.65 / np.sqrt(2)
    for h in (0.02, 0.01, 0.005):
        x = middle + h * np.array([[(-2 / 3, -2 / 3), (4 / 3, -2 / 3), (-2 / 3, 4 / 3)]])
        found = pieces(data, "where(r < 0.65, 1, 0)", x, Division(1))
        shares.append(sum(group.share[group.rest > 0].sum() for group in found.groups))
    assert shares[0] / shares[2] == pytest.approx(4, rel=0.1)


def test_smooth_data_gain_an_order_with_the_degree(data):
    """The rest of interpolants of degree 2 falls like h^3, of degree 4 like h^5."""
    for degree, rate in ((2, 3), (4, 5)):
        rests = []
        for h in (0.05, 0.025):
            x = np.array([[(0.3, 0.3), (0.3 + h, 0.3), (0.3, 0.3 + h)]])
            found = pieces(data, "exp(x*y) + hypot(x + 1, y)", x, Division(0, 1.0, degree=degree))
            rests.append(found.groups[0].rest[0])
        assert np.log2(rests[0] / rests[1]) == pytest.approx(rate, abs=0.25)


@pytest.mark.parametrize("height", [0.1, 1e-3, 1e-6, 1e-9])
def test_slopes_on_thin_parts(data, height):
    """The bound of the slope of datum minus polynomial holds, and does not grow as a part becomes thin."""
    x = np.array([[(0.3, 0.3), (0.5, 0.3), (0.4, 0.3 + height)]])
    (group,) = pieces(data, "sin(9*x)*exp(3*y)", x, Division(0, slopes=True)).groups
    along = polynomials.slopes(group.coefficients, 3, group.degree)
    edges = x[0, 1:] - x[0, 0]
    inside = np.random.default_rng(0).dirichlet(np.ones(3), 200)
    gradients = np.linalg.solve(edges, polynomials.evaluate((along[:, 1:] - along[:, :1])[0], inside, group.degree - 1))
    a, b = (inside @ x[0]).T
    true = np.stack([9 * np.cos(9 * a) * np.exp(3 * b), 3 * np.sin(9 * a) * np.exp(3 * b)])
    off = np.linalg.norm(gradients - true, axis=0).max()
    assert off <= group.steep[0] + 1e-6
    assert group.steep[0] < 100  # of a gradient of 22 at most


@pytest.mark.parametrize("text", [
    "sin(7*x)*y + where(hypot(x - 0.4, y - 0.3) < 0.25, 2, x)", "sqrt(where(x + y < 0.7, 1, x + y) - 0.2)",
    "max(x^2 - y, 0.1)^2", "abs(x - 0.31)/(0.4 + y)", "1/(hypot(x, y) - 0.05)",
    "floor(3*x) + where(y > x^2, exp(x), y)",
])  # fmt: skip
def test_cells_in_many_blocks_have_the_same_pieces(data, monkeypatch, text):
    """How many cells are looked at together changes no bounds, parts, polynomials or rests."""
    ends = np.linspace(0, 1, 12)
    low, high = (np.stack([a.ravel() for a in np.meshgrid(side, side)], axis=1) for side in (ends[:-1], ends[1:]))
    other = np.stack([high[:, 0], low[:, 1]], axis=1)
    x = np.concatenate([np.stack([low, other, high], axis=1), np.stack([low, high, low + high - other], axis=1)])
    field = FormulaField(SCENE.formula(text, "here"), SCENE)
    expected, bounds = pieces(data, text, x), field.over(x, {}, np.zeros(len(x), dtype=int)).once()
    monkeypatch.setattr("fenicsx_obstacle.estimation.enclosed_data.AT_ONCE", 10)
    found = pieces(data, text, x)
    for one, other in zip(_by_simplex(found, len(x)), _by_simplex(expected, len(x)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
    ranges = range_of(data, field, x, np.zeros(len(x), dtype=int))
    for one, other in ((ranges.lower, bounds.lower), (ranges.upper, bounds.upper)):
        known = bounds.finite
        np.testing.assert_array_equal(one[known], other[known])


def _by_simplex(found, count):
    """Bounds of a datum, and sums over the parts of each simplex: of shares, rests and means of polynomials."""
    yield from (found.lower, found.upper, found.rough)
    for values in (lambda g: g.share, lambda g: g.share * g.rest, lambda g: g.share * g.coefficients.mean(axis=1)):
        yield sum(np.bincount(group.rows, values(group), count) for group in found.groups)

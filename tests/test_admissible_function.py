"""The function v_h of the proof is in K: between two close obstacles, and with boundary values between nodes."""

from types import SimpleNamespace

import numpy as np
import pytest

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.effects.field import ByCells
from fenicsx_obstacle.estimation.clipped import Clipped, _ClippedCells

WAVE = "0.1*sin(16*pi*x)"  # 0 at all nodes of 8 cells, P1 and P2
CLOSE, FAR = 0.101, 0.5  # distance of the obstacles
SHAPES = {"interval": [{"value": CLOSE}], "rectangle": [{"on": ["left", "right"], "value": CLOSE}]}


def between(shape, distance, element="P1", lower=WAVE, **more):
    """The error bound for two obstacles with the same waves, one period in each cell; u_h is constant."""
    parts = [{**part, "value": distance} for part in SHAPES[shape]]
    scene = Scene(mesh={"shape": shape, "cells": 8, **more.pop("mesh", {})}, tension=1, load=0, boundary=parts,
                  lower=lower, upper=f"{distance} + {WAVE}", **more)  # fmt: skip
    return solve(scene.change({"solve.element": element}), bound=True).bound


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "element", "more"), [
    ("interval", "P1", {}),
    ("rectangle", "P1", {}),
    ("rectangle", "P2", {}),
    ("rectangle", "P1", {"axial_symmetry": True, "mesh": {"x": [1, 2]}}),
])  # fmt: skip
def test_close_obstacles(shape, element, more):
    """The upper obstacle lowers v_h below the lower one, which it was above at first: no function in K is found."""
    bound = between(shape, CLOSE, element, **more)
    assert not bound.guaranteed and not bound.certified
    assert "no function between the obstacles is known" in bound.words


@pytest.mark.parametrize("shape", SHAPES)
def test_obstacles_farther_apart_keep_the_certificate(shape):
    """A lower obstacle that v_h stays above leaves the bound as it was."""
    assert between(shape, FAR, lower=-1.0).guaranteed
    assert between(shape, FAR, lower=f"-1 + {WAVE}").guaranteed


def test_two_flat_obstacles_that_touch():
    """Where both obstacles are the same number, v_h is that number, and in K."""
    flat = Scene(mesh={"shape": "interval", "cells": 10}, tension=1, load=3, lower="where(x < 0.5, 0, -x + 0.5)",
                 upper=0, boundary=[{"value": 0, "on": "left"}])  # fmt: skip
    bound = solve(flat, bound=True, eps=1e-3).bound
    assert bound.guaranteed and np.abs(bound.admissible.x.array).max() <= 0.5


@pytest.mark.parametrize("shape", SHAPES)
def test_what_may_be_round_off_has_an_energy(shape):
    """A crease of two equal obstacles in a strip of stiff cells: u_h is beyond them by 1e-10 of its range, no more, but
    the energy of the difference is far above the other terms of the bound."""
    crease, beside = "-5e-9*abs(x - 17/32)", "9*max(abs(x - 17/32) - 1/32, 0)"
    parts = [{"on": side, "value": -1} for side in ("left", "right")]
    mesh = {"shape": shape, "cells": 16} if shape == "interval" else {"shape": shape, "y": [0, 0.25], "cells": 16}
    scene = Scene(mesh=mesh, tension="where(abs(x - 17/32) < 1/32, 1e12, 1)", load=0, lower=f"{crease} - {beside}",
                  upper=f"{crease} + {beside}", boundary=parts)  # fmt: skip
    bound = solve(scene, bound=True, method="vi").bound
    area = 1 / 16 if shape == "interval" else 1 / 64
    assert bound.guaranteed and bound.total >= 5e-9 * np.sqrt(1e12 * area)


TRAPEZOID = [{"on": "top", "value": "min(1, 10*min(x, 1 - x))"}, {"on": ["left", "right", "bottom"], "value": 0}]
KINKS = [  # element, cells, boundary, the energy error of u_h by Fourier series
    ("P1", 8, [{"value": "max(0, 0.06 - abs(x - 0.5625))"}], 0.079722),
    ("P1", 8, [{"value": "0.1*max(0, 1 - abs((8*x) % 1 - 0.6)/0.2)"}], 0.370883),
    ("P2", 8, TRAPEZOID, 0.23790), ("P2", 32, TRAPEZOID, 0.05751),
]  # fmt: skip


@pytest.mark.parametrize(("element", "cells", "boundary", "error"), KINKS)
def test_kinks_between_nodes(element, cells, boundary, error):
    """With P1 boundary values that are 0 at all nodes: u_h = 0, the error is all of u; with P2 corners inside edges."""
    scene = Scene(mesh={"shape": "rectangle", "cells": cells}, tension=1, boundary=boundary,
                  report={"volume": "integral(u)"})  # fmt: skip
    answer = solve(scene, element=element, bound=True)
    assert answer.bound.total >= error
    if element == "P1":
        assert answer.bound.certified and answer.bound.energy is None
        assert answer.bound.total <= 6 * error  # no more than the extension of the boundary values costs
    if boundary == KINKS[0][2]:
        assert answer.record["bound"]["outputs"]["volume"]["error"] >= 0.00240384


def test_kinks_with_axial_symmetry():
    """Against the solution on a mesh eight times as fine, with the kinks at nodes."""

    def scene(cells):
        return Scene(mesh={"shape": "rectangle", "x": [1, 2], "cells": cells}, tension=1, axial_symmetry=True,
                     boundary=[{"value": "max(0, 0.1 - abs(y - 0.5))*(2 - x)"}])  # fmt: skip

    coarse, fine = solve(scene(5), bound=True), solve(scene(40))
    assert coarse.energy == pytest.approx(0.0, abs=1e-14)  # u_h = 0
    true = np.sqrt(2 * fine.energy)
    assert coarse.bound.total >= true > 0.1


def test_kinks_at_nodes_are_in_the_space():
    """Continuous piecewise linear boundary values with kinks at nodes are exact: nothing is added."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 8}, tension=1, load=1,
                  boundary=[{"value": "abs(x - 0.5) + max(0, y - 0.25)"}])  # fmt: skip
    bound = solve(scene, bound=True).bound
    assert bound.guaranteed and bound.data <= 1e-10 and bound.energy is not None


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_slope_of_clipped_obstacles(dim):
    """Where an obstacle is cut off, its difference to a linear function has the slope of that function."""
    rng = np.random.default_rng(0)
    x = rng.random((50, dim + 1, dim)) * np.array([1.0, 0.1, 0.3])[:dim]
    slopes = rng.normal(size=(50, dim))
    at_corners = np.einsum("cix,cx->ci", x, slopes) + 100.0
    obstacle = SimpleNamespace(linear=lambda cells: (at_corners[cells], np.ones(len(cells)), np.zeros(len(cells))))
    cells = _ClippedCells(obstacle, Clipped(ByCells({}, ""), 1.0, 0.0), x)
    np.testing.assert_allclose(cells.linear(np.arange(50))[2], np.linalg.norm(slopes, axis=1), rtol=1e-9)


@pytest.mark.parametrize(("value", "certified"), [("0.1*y + 0.2*z", True), ("0.2*y^2 + 0.1*z^2", False)])
def test_boundary_values_reach_facets_with_obstacles(value, certified):
    """On tetrahedra boundary values between the nodes are continued over the facets beside them: there v_h may then be
    beyond an obstacle that it touches at the nodes."""
    scene = Scene(mesh={"shape": "box", "cells": 2}, tension=1, load=-9,
                  boundary=[{"on": "left", "value": value}, {"on": "top", "lower": f"{value} - x"}])  # fmt: skip
    assert solve(scene, bound=True, eps=1e-8).bound.guaranteed == certified


@pytest.mark.slow
def test_far_apart_values_of_an_obstacle():
    """-1e20 for 'no obstacle' beside values that count: the bound is no smaller than with -1e3 (once 3.9 and 3239)."""
    totals = []
    for far in ("-1e3", "-1e20"):
        scene = Scene(mesh={"shape": "rectangle", "cells": 6}, tension=1, load=-20,
                      lower=f"where(x < 0.53, 0.1*x*(1 - y) - 0.2*x^2, {far})",
                      boundary=[{"where": "x == 1 and y <= 0.5", "value": 0}])  # fmt: skip
        totals.append(solve(scene.change({"solve.element": "P2"}), bound=True, eps=1e-8).bound.total)
    assert totals[1] >= totals[0]

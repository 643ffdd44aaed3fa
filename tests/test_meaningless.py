"""No u without meaning is an answer: supports that hold nothing, imbalance, near-singular operators, limit loads."""

import numpy as np
import pytest
from conftest import COMM

from fenicsx_obstacle import InputError, Scene, releases, solve
from fenicsx_obstacle.parallel import largest, smallest

INTERVAL = {"shape": "interval", "cells": 20}
SQUARE = {"shape": "rectangle", "cells": 12}
CUBE = {"shape": "box", "cells": 4}


def loose(mesh=SQUARE, **given):
    """A membrane whose values are given nowhere."""
    return Scene(**{"mesh": mesh, "boundary": [], **({} if "large_slope" in given else {"tension": 1}), **given})


def extremes(answer):
    """Smallest and largest u."""
    values = answer.u.x.array
    return smallest(COMM, values), largest(COMM, values)


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize(
    ("mesh", "element"), [(INTERVAL, "P1"), (SQUARE, "P1"), (SQUARE, "P2"), (SQUARE, "Q1"), (CUBE, "P1")]
)
def test_a_soft_obstacle_alone_holds(mesh, element, method):
    """A uniform load on a uniform soft obstacle sinks by load/stiffness, with u given nowhere."""
    scene = loose(mesh, load=-1, soft_obstacle={"lower": 3, "stiffness": 100})
    assert extremes(solve(scene, element=element, method=method)) == pytest.approx((2.99, 2.99), abs=1e-9)


SOFT = {
    "upper": ({"load": 2, "soft_obstacle": {"upper": 5, "stiffness": 100}}, 5.02),
    "shifted": ({"load": 2, "soft_obstacle": {"upper": 1e8, "stiffness": 100}}, 1e8 + 0.02),
    "very soft": ({"load": -1, "soft_obstacle": {"lower": 0, "stiffness": 1e-6}}, -1e6),
    "two": ({"load": -1, "soft_obstacle": {"lower": -1, "upper": 1, "stiffness": 100}}, -1.01),
    "beside a hard one": ({"load": -1, "lower": -9, "soft_obstacle": {"lower": -1, "stiffness": 100}}, -1.01),
    "against a hard one": ({"load": -1, "upper": 2, "soft_obstacle": {"lower": -1, "stiffness": 100}}, -1.01),
    "drift": ({"load": -1, "drift": [1, 2], "soft_obstacle": {"lower": 0, "stiffness": 100}}, -0.01),
    "film": ({"load": -1, "large_slope": 1, "soft_obstacle": {"lower": 0, "stiffness": 100}}, -0.01),
    "small forces": ({"tension": 1e-8, "load": -1e-8, "soft_obstacle": {"lower": 0, "stiffness": 1e-6}}, -0.01),
    "large forces": ({"tension": 1e8, "load": -1e8, "soft_obstacle": {"lower": 0, "stiffness": 1e10}}, -0.01),
    "small heights": ({"load": -1e-8, "soft_obstacle": {"lower": 1e-8, "stiffness": 100}}, 0.99e-8),
}


@pytest.mark.parametrize("name", SOFT)
def test_soft_obstacles_in_other_scenes(name):
    """Loads and soft obstacles that are uniform balance at heights known in closed form."""
    data, height = SOFT[name]
    assert extremes(solve(loose(**data))) == pytest.approx((height, height), rel=1e-9)


def test_a_soft_obstacle_holds_with_the_force_of_the_load():
    """Without other supports the soft obstacle carries the whole load, wherever it is stiff."""
    scene = loose(load=-3, soft_obstacle={"lower": "x", "stiffness": "where(x < 0.5, 40, 0)"})
    answer = solve(scene.change({"report": {"force": "integral(where(x < 0.5, 40, 0)*max(x - u, 0))"}}))
    assert answer.report["force"] == pytest.approx(3, rel=0.05)  # by another rule than the nodal one


NOT_PRESSED = "does not press against the lower obstacle"
WEAK = "is below the round-off of the stiffness"
SPRING = [{"on": "left", "spring": 1e-14}]
HELD_BY_NOTHING = {
    "soft, lifted": ({"load": 1, "soft_obstacle": {"lower": 0, "stiffness": 100}}, NOT_PRESSED),
    "soft, no load": ({"load": 0, "soft_obstacle": {"lower": 0, "stiffness": 100}}, NOT_PRESSED),
    "soft, no stiffness": ({"load": -1, "soft_obstacle": {"lower": 0, "stiffness": 0}}, WEAK),
    "soft, stiff between samples": (
        {"load": -1, "soft_obstacle": {"lower": 0, "stiffness": "where((x > 0.001)*(x < 0.002), 1, 0)"}},
        WEAK,
    ),
    "no spring": ({"load": -1, "boundary": [{"on": "left", "spring": 0}]}, WEAK),
    "weak spring": ({"load": -1, "boundary": SPRING}, WEAK),
    "weak spring, load without sum": ({"load": "sin(2*pi*x)", "boundary": SPRING}, WEAK),
    "weak spring, lifted": ({"load": 1, "lower": 0, "boundary": SPRING}, NOT_PRESSED),
    "foundation between samples": ({"load": -1, "foundation": "where((x > 0.001)*(x < 0.002), 1, 0)"}, WEAK),
    "weak foundation": ({"load": -1e-14, "foundation": 1e-15}, WEAK),
    "nothing": ({"load": -1}, "no obstacle holds it"),
    "drift alone, lifted": ({"load": 1, "drift": [1, 2], "lower": 0}, NOT_PRESSED),
    "film, no spring": ({"load": -1, "large_slope": 1, "boundary": [{"on": "left", "spring": 0}]}, WEAK),
}


@pytest.mark.parametrize("name", HELD_BY_NOTHING)
@pytest.mark.parametrize("mesh", [INTERVAL, SQUARE])
def test_supports_that_hold_nothing(name, mesh):
    """A support that does not answer to u = 1, beside round-off, is none: no u is in balance."""
    data, message = HELD_BY_NOTHING[name]
    with pytest.raises(InputError, match=message):
        solve(loose(mesh, **{**data, **({"drift": [1]} if "drift" in data and mesh is INTERVAL else {})}))


@pytest.mark.parametrize("force", [1e-8, 1.0, 1e8])
@pytest.mark.parametrize("mesh", [INTERVAL, SQUARE, CUBE])
def test_weak_supports_that_hold(mesh, force):
    """A spring of 1e-6, a foundation of 1e-6 or on a thin strip: u is the closed form, in any unit of force."""
    length = 1  # of the left side
    spring = loose(mesh, tension=force, load=-force, boundary=[{"on": "left", "spring": 1e-6 * force}])
    low, high = extremes(solve(spring))
    assert (low, high) == pytest.approx((-1e6 / length, -1e6 / length), rel=1e-4)
    bed = loose(mesh, tension=force, load=-force, foundation=1e-6 * force)
    assert extremes(solve(bed)) == pytest.approx((-1e6, -1e6), rel=1e-4)
    tiny = loose(mesh, tension=1e-14 * force, load=-1e-14 * force, foundation=1e-14 * force)
    assert extremes(solve(tiny)) == pytest.approx((-1, -1), rel=1e-9)


def test_a_thin_strip_that_samples_see():
    """A foundation one cell wide carries the load; u is exact at the nodes of a string."""
    scene = loose({"shape": "interval", "cells": 100}, load=-1, foundation="where(x < 0.01, 1000, 0)")
    low, high = extremes(solve(scene))
    # nodal rule: 5 (u0 + u1) = -1 and 5 u0 + (u0 - u1)/h = -h/2; then a parabola that ends without slope
    u0 = -20.005 / 205
    assert high == pytest.approx(u0, rel=1e-9)
    assert low == pytest.approx(-0.2 - u0 - 0.99**2 / 2, rel=1e-9)


def separate(distance):
    """Two squares side by side that share nothing."""
    points = np.array([[x + far, y] for far in (0.0, 1 + distance) for y in range(5) for x in range(5)]) / 4.0
    points[25:, 0] += 1.0
    cells = [
        [first + y * 5 + x + k for k in corner]
        for first in (0, 25) for y in range(4) for x in range(4) for corner in ((0, 1, 6), (0, 6, 5))
    ]  # fmt: skip
    mine = (np.array(cells), points) if COMM.rank == 0 else (np.empty((0, 3), dtype=np.int64), np.empty((0, 2)))
    return releases.create_mesh(COMM, *mine, "triangle")


def test_each_part_of_a_mesh_is_held():
    """Two separate squares, one of them held at its left side: the other one needs a support of its own."""
    mesh = separate(0.5)
    held = {"mesh": mesh, "tension": 1, "load": -1, "boundary": [{"where": "x < 1e-9", "value": 0}]}
    with pytest.raises(InputError, match="nowhere on one of 2 separate parts"):
        solve(Scene(**held))
    low, high = extremes(solve(Scene(**held, lower=-2), method="vi"))
    assert (low, high) == pytest.approx((-2, 0), abs=1e-12)
    soft = {"lower": -3, "stiffness": 10}
    low, high = extremes(solve(Scene(**held, soft_obstacle=soft)))
    assert (low, high) == pytest.approx((-3.1, 0), abs=1e-9)

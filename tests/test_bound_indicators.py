"""Where nothing is proved: estimates of the error say what is missing, data that are inadmissible are rejected."""

from __future__ import annotations

import re

import pytest
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import InputError, Scene, releases, solve
from tests.conftest import COMM, slow_except
from tests.helpers import mesh_of

SQUARE = {"shape": "rectangle", "cells": 8, "perturb": 0.2}


def scene(**effects):
    """A membrane that is pressed against a plane."""
    return Scene(mesh=SQUARE, load=-2, lower=-0.05, boundary=[{"value": 0}], **effects)


def test_a_power_law_of_exponent_two():
    """With the exponent 2 the operator is linear: the estimate is the bound of the tension."""
    linear, power = (
        solve(scene(**effect), bound=True, eps=1e-4, comm=COMM).bound
        for effect in ({"tension": 3}, {"power_law": {"exponent": 2, "coefficient": 3}})
    )
    for name in ("total", "admissible_total", "discretisation", "penalty"):
        assert getattr(power, name) == pytest.approx(getattr(linear, name), rel=1e-6)
    assert linear.guaranteed and not power.guaranteed and power.energy is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "missing"),
    [
        ({"large_slope": 1}, "no bound, as large_slope is not linear"),
        ({"power_law": {"exponent": 3}}, "no bound, as power_law is not linear"),
        ({"tension": 0.05, "drift": [3, 1]}, "no bound, as its proof covers tension, load, foundation, flux and "
                                             "spring, not drift"),
    ],
)  # fmt: skip
def test_a_tolerance_is_reached(effects, missing):
    """Refinement where the estimate is large makes it smaller until it is below the tolerance; the words say that it is
    estimated, and why."""
    answer = solve(scene(**effects), tol=0.2, comm=COMM)
    path = [one["total"] for one in answer.record["adaptive"]["path"]]
    assert answer.record["adaptive"]["reached"] and path[-1] < path[0]
    assert "tolerance 0.2 is reached, by an indicator only, on mesh" in answer.summary()
    assert answer.bound.words.startswith("an indicator: estimated") and missing in answer.bound.words
    assert not answer.bound.guaranteed


LINE = {"shape": "interval", "cells": 8}
PLANE = {"shape": "rectangle", "cells": 8}
NOWHERE = "no function between the obstacles is known"
BUMP = "exp(-((x - 0.4375)/0.02)^2)"
UNPROVED = {
    "an obstacle on a part that ends inside an edge": (
        {"mesh": PLANE, "boundary": [{"on": ["left", "right"], "value": 0},
                                     {"where": "y < 1e-9 and abs(x - 0.5) < 0.19", "lower": 1}]},
        "not made of whole edges"),
    "a part as short as its round-off is long": (
        {"mesh": PLANE, "load": 1, "boundary": [{"where": "x == 0 or (y == 0 and abs(x - 0.5) < 4e-9)", "value": 0}]},
        "not made of whole edges"),
    "an obstacle above what is given beside it": (
        {"mesh": PLANE, "boundary": [{"on": ["left", "bottom", "top"], "value": 0},
                                     {"on": "right", "lower": "y*(1 - y)", "flux": -1}]},
        "or what is given"),
    "u given on the axis": (
        {"mesh": PLANE, "load": 4, "axial_symmetry": True, "boundary": [{"value": 0}]}, "u is given on the axis"),
    "a matrix that varies": (
        {"mesh": PLANE, "load": -10, "tension": [["where(x < 0.47, 1, 100)", "where(x < 0.47, 0, 99)"],
                                                 ["where(x < 0.47, 0, 99)", "100"]]},
        "^certified for the sampled tension$"),
    "a matrix that is not defined between middles": (
        {"mesh": PLANE, "load": 1, "tension": [["1 + sqrt(x - 0.02)", 0], [0, 1]]},
        "^an indicator: the tension may be"),
    "an obstacle without a bounded slope where u is given": (
        {"mesh": {**LINE, "cells": 32}, "lower": "0.3*x^0.501",
         "boundary": [{"on": "left", "value": 0}, {"on": "right", "value": 0.5}]},
        "^certified for the sampled obstacle$"),
    "obstacles that cross between nodes": (
        {"mesh": LINE, "lower": f"1e7 - 1 + 1.009*{BUMP}", "upper": f"1e7 + 0.01*{BUMP}", "boundary": [{"value": 1e7}]},
        NOWHERE),
    "boundary values below an obstacle between nodes": (
        {"mesh": PLANE, "lower": 0, "boundary": [{"on": "bottom", "value": "0.5*cos(16*pi*x)"},
                                                 {"on": "top", "value": 0.5}]},
        NOWHERE),
    "an obstacle above boundary values on a short piece": (
        {"mesh": PLANE, "lower": "-1 + 1.5*exp(-((x - 0.5044)/5e-4)^2 - (y/5e-4)^2)", "boundary": [{"value": 0}]},
        NOWHERE),
    "a spring that is negative between nodes": (
        {"mesh": {**PLANE, "y": [0, 0.1]}, "load": 1,
         "boundary": [{"on": "left", "value": 0}, {"on": "right", "spring": "-588*y*(0.1 - y)"}]},
        "the spring may be negative"),
    "a foundation that is negative between middles, far below a stiff one": (
        {"mesh": {**LINE, "cells": 40}, "load": 1, "boundary": [{"value": 0}],
         "foundation": "where(x < 0.1, 1e11, where(abs((40*x) % 1 - 0.5) < 0.1, 0, -14))"},
        "the foundation may be negative"),
}  # fmt: skip


@pytest.mark.parametrize("name", slow_except(UNPROVED, *list(UNPROVED)[:6]))
def test_what_is_not_proved_is_not_certified(name):
    """Hypotheses of the theorem that no node shows; each of these errors is or may be above the bound."""
    data, words = UNPROVED[name]
    bound = solve(Scene(**{"tension": 1, **data}), bound=True).bound
    assert re.search(words, bound.words) and not bound.guaranteed, bound.words


@pytest.mark.parametrize(("least", "words"), [(1e-9, "the foundation may be negative"), (20.0, "^certified")])
def test_a_foundation_that_is_negative_between_nodes(least, words):
    """It is least at vertices and in the middle of cells: a Function is not searched between its samples."""
    mesh = releases.settle(dmesh.create_unit_square(COMM, 4, 4))
    k = fem.Function(releases.functionspace(mesh, "Lagrange", 4))
    x = releases.called(k.function_space.element.interpolation_points)
    s = x[:, 0] ** 2 + x[:, 1] ** 2 + (1 - x[:, 0] - x[:, 1]) ** 2
    values = least - 60 * (1 - s) * (s - 1 / 3)
    for dofs in releases.cell_dofs(k.function_space):
        k.x.array[dofs] = values
    bound = solve(Scene(mesh=mesh, tension=1, load=1, foundation=k), bound=True).bound
    assert re.search(words, bound.words), bound.words


@pytest.mark.parametrize("offset", [0.0, 1e8])
def test_what_boundary_values_are_between_nodes_counts_at_any_height(offset):
    """u = offset + 2e-5 sin(20 x) cosh(20 y)/cosh(20): values of 1e8 are rounded by 1e-8."""
    value = f"{offset} + 2e-5*sin(20*x)*cosh(20*y)/cosh(20)"
    scene = Scene(mesh={**PLANE, "cells": 16}, tension=1, boundary=[{"value": value}])
    assert solve(scene, bound=True).bound.total > 9e-5


@pytest.mark.serial  # DOLFINx gives a vertex that parts on two ranks share, without a facet, to each of them
@pytest.mark.parametrize("stiff", [1.0, 1e10])
def test_parts_that_meet_in_a_vertex(stiff):
    """P1 couples them there, the solution does not; a third part with large forces is none of their business."""
    corners = [(0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (1, 2), (2, 2), (3, 0), (4, 0), (3, 1), (4, 1)]
    cells = [[a, b, d] for a, b, d in ((0, 1, 3), (0, 2, 3), (3, 4, 6), (3, 5, 6), (7, 8, 10), (7, 9, 10))]
    boundary = [{"where": "x == 0", "value": 0}, {"where": "x == 2", "value": 5}, {"where": "x >= 3", "value": "x"}]
    scene = Scene(mesh=mesh_of(corners, cells), tension=f"where(x > 2.5, {stiff}, 1)", boundary=boundary)
    assert "meet in a vertex only" in solve(scene, bound=True).bound.words


ENCLOSED = {
    "a definition named like two coordinates": (
        {"define": {"xy": "1e5*sin(16*pi*x)*sin(16*pi*y)"}, "mesh": {**PLANE, "cells": 16}, "load": "xy"}, 650),
    "a load in a corner of cells": ({"load": "where(abs(x - 0.5) + abs(y - 0.5) < 1e-8, 1e17, 0)"}, 34),
    "a polynomial that is small in a strip": (
        {"mesh": {**PLANE, "cells": 1}, "load": "where(x^8 < 1e-13, 1e6, 0)"}, 1e4),
    "a steep function that is small in a strip": (
        {"mesh": {**PLANE, "cells": 4}, "load": "where(exp(120*x) < 2, 1e8, 0)"}, 2.5e4),
    "values on an edge alone": (
        {"mesh": {**PLANE, "y": [0.3, 1.3], "cells": 1},
         "boundary": [{"value": "where(y <= 0.3, 5000*x*(x - 0.25)*(x - 0.5)*(x - 0.75)*(1 - x)*(1 + x^2), 0)"}]}, 290),
    "a condition between numbers": (
        {"load": "where(log10(100000) > 5, x, 1000*sin(8*pi*x)*sin(8*pi*y))", "mesh": {**PLANE, "cells": 16}}, 9),
    "an angle whose sine is small": ({"mesh": {**PLANE, "x": [-2, -1]}, "load": "100*atan2(1e-13*(y - 0.4), x)"}, 17),
}  # fmt: skip


@pytest.mark.parametrize("name", slow_except(ENCLOSED, *list(ENCLOSED)[:3]))
def test_data_that_no_sample_shows(name):
    """Their errors, and so their bounds, are larger than these numbers."""
    data, least = ENCLOSED[name]
    assert solve(Scene(**{"mesh": PLANE, "tension": 1, **data}), bound=True).bound.total > least


def test_undefined_behind_a_condition():
    """A condition does not guard a root that has no value on the side where it holds."""
    load = "where(x > 0.255, sqrt(x - 0.27), 1)"
    bound = solve(Scene(mesh={**PLANE, "cells": 4}, tension=1, load=load), bound=True).bound
    assert "the load may be infinite or undefined" in bound.words


SPOT = "hypot(x - 0.503, y - 0.497) < 0.004"
BAD = {
    "matrix": {"tension": [["1", f"where({SPOT}, 2, 0)"], [f"where({SPOT}, 2, 0)", "1"]]},
    "one entry": {"tension": [["1 - 2*exp(-((x - 0.72)^2 + (y - 0.25)^2)/0.0004)", 0], [0, 1]]},
    "tension": {"tension": f"where({SPOT}, -1, 1)"},
    "the other branch": {"tension": f"where(not ({SPOT}), 1, -1)"},
    "defined": {"tension": "1 - 2*spot", "define": {"spot": SPOT}},
    "foundation": {"tension": 1, "foundation": f"where({SPOT}, -1, 1)"},
    "stiffness": {"tension": 1, "soft_obstacle": {"lower": 0, "stiffness": f"where({SPOT}, -1, 1)"}},
    "rate": {"tension": 1, "rate": f"where({SPOT}, -1, 1)", "time": {"end": 1, "steps": 2, "start": 0}},
    "slope": {"large_slope": f"where({SPOT}, -1, 1)"},
    "band": {"tension": "where(x > 0.4999 and x < 0.50001, -2, 1)"},
    "oblique band": {"tension": "1 - 3*(abs(x + y - 0.77) < 0.0003)"},
    "dip": {"tension": "1 - 2*exp(-((x - 0.72)^2 + (y - 0.25)^2)/0.0004)"},
    "lowest of two": {"tension": "max(min(1, 3000*hypot(x - 0.3, y - 0.7) - 2), -1)"},
    "P2": {"tension": f"where({SPOT}, -1, 1)", "mesh": {**PLANE, "cells": 6}},
    "quadrilaterals": {"tension": f"where({SPOT}, -1, 1)", "mesh": {**PLANE, "cells": 6, "cell": "quadrilateral"}},
    "interval": {"tension": "where(abs(x - 0.503) < 1e-4, -1, 1)", "mesh": {**LINE, "cells": 32}},
    "solid": {"tension": "where(hypot(hypot(x - 0.503, y - 0.497), z - 0.33) < 0.01, -1, 1)",
              "mesh": {"shape": "box", "cells": 4}},
    "millimetres": {"tension": "where(hypot(x - 0.503e-3, y - 0.497e-3) < 4e-6, -1, 1)",
                    "mesh": {**PLANE, "x": [0, 1e-3], "y": [0, 1e-3], "cells": 16}},
}  # fmt: skip


def spotted(**more):
    return Scene(**{"mesh": {"shape": "rectangle", "cells": 16}, "load": -1, **more})


@pytest.mark.parametrize("name", BAD)
def test_a_spot_between_the_samples(name):
    """A formula out of bounds in a spot that no cell's midpoint meets is rejected, with a place in the spot,
    whatever the unit of length, the element and the dimension."""
    with pytest.raises(InputError, match=r"must be (positive|at least 0).* at (\(|x = )0\.\d+"):
        solve(spotted(**BAD[name]), **({"element": "P2"} if name == "P2" else {}))


ADMISSIBLE = {
    "a spot": {"tension": f"where({SPOT}, 3, 1)"},
    "outside of the domain": {"tension": "where(x > 1.2, -1, 1)"},
    "zero at a point": {"tension": "r"},
    "zero on the boundary": {"tension": "x*(1 - x)"},
    "a pole": {"tension": "1/hypot(x - 0.5, y - 0.5)"},
    "zero in a part": {"tension": 1, "foundation": "max(x - 0.3, 0)"},
    "the distance": {"tension": "0.1 + distance", "foundation": "where(distance < 0.2, 1, 0)"},
    "axis": {"tension": "x", "axial_symmetry": True},
    "matrix": {"tension": [["2", f"where({SPOT}, 1, 0)"], [f"where({SPOT}, 1, 0)", "1"]]},
}


@pytest.mark.parametrize("name", ADMISSIBLE)
def test_what_is_admissible_is_solved(name):
    """Nothing is rejected for values outside of the domain, zeros, poles and jumps."""
    assert solve(spotted(**ADMISSIBLE[name]), comm=COMM).record["converged"]

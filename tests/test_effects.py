"""Effects beside tension and load: each against a solution that is known, by the penalty and by SNES VI."""

import numpy as np
import pytest
from conftest import COMM, DEMOS, membrane

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.studies.orders import order

# a pressure on a disk of contact: with it in the load any smooth u is the solution above a lower obstacle
PRESSURE = "10*max(1 - hypot(x - 0.5, y - 0.5)^2/0.0625, 0)"
BELOW = "({u}) - 20*max(hypot(x - 0.5, y - 0.5) - 0.25, 0)^2"
METHODS = ["penalty", "vi"]


def above(u, load, **more):
    """A scene on the unit square whose solution is u, where without contact the load would be `load`."""
    scene = {"lower": BELOW.format(u=u), "load": f"({load}) - {PRESSURE}", "exact": u, "boundary": [{"value": u}]}
    return membrane(**{**scene, **more})


def orders(scene, method, cells=(16, 32), **how):
    """Observed orders of the errors between two grids."""
    found = [solve(scene, method=method, cells=n, **how).record for n in cells]
    assert all(row["contact"]["area"] > 0 for row in found)
    rows = [{"h": row["h"], **row["errors"]} for row in found]
    return {key: order(key, rows[1], rows[0], "h") for key in ("l2", "h1")}


def check_orders(scene, method, **how):
    """H1 error of order 1, L2 error of order 2, as for the membrane alone (5.6)."""
    seen = orders(scene, method, **how)
    assert abs(seen["l2"] - 2) < 0.12 and abs(seen["h1"] - 1) < 0.06, seen


SMOOTH = "sin(x)*cosh(y) + x^2"  # -Laplace u = -2


@pytest.mark.parametrize("method", METHODS)
def test_flux_and_springs(method):
    """tension du/dn = flux - spring u, by the name of a side and by a formula: orders of the membrane alone."""
    parts = [
        {"on": ["left", "bottom"], "value": SMOOTH},
        {"on": "right", "flux": "2*(cos(x)*cosh(y) + 2*x)"},
        {"where": "y > 1 - 1e-9", "spring": "1 + x", "flux": f"2*sin(x)*sinh(y) + (1 + x)*({SMOOTH})"},
    ]
    check_orders(above(SMOOTH, "-4", tension=2, boundary=parts), method)


@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "Q2"])
def test_springs_of_all_elements(element):
    """The formula of a side is interpolated, springs take the nodal rule: no element loses its order 2."""
    parts = [{"on": ["left", "bottom", "top"], "value": "exp(x)*cos(y)"},
             {"on": "right", "spring": 3, "flux": "4*exp(x)*cos(y)"}]  # fmt: skip
    scene = membrane(exact="exp(x)*cos(y)", boundary=parts)
    coarse, fine = (solve(scene, element=element, cells=n).record["errors"]["l2"] for n in (8, 16))
    assert coarse / fine > 2**1.9


def test_string_on_a_spring():
    """In one dimension a side is a point: u'' = -1, u(0) = 0, u'(1) = 2 - 3 u(1) is met at all nodes."""
    parts = [{"on": "left", "value": 0}, {"on": "right", "spring": 3, "flux": 2}]
    scene = membrane(mesh={"shape": "interval", "cells": 16}, load=1, boundary=parts, exact="9/8*x - x^2/2")
    assert solve(scene).record["errors"]["max"] < 1e-10


GEO = """SetFactory("Built-in");
Point(1) = {0, 0, 0, 0.2}; Point(2) = {0.5, 0, 0, 0.2}; Point(3) = {1, 0, 0, 0.2};
Point(4) = {1, 1, 0, 0.2}; Point(5) = {0.5, 1, 0, 0.2}; Point(6) = {0, 1, 0, 0.2};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 6}; Line(6) = {6, 1};
Line(7) = {2, 5};
Curve Loop(1) = {1, 7, 5, 6}; Curve Loop(2) = {2, 3, 4, -7};
Plane Surface(1) = {1}; Plane Surface(2) = {2};
Physical Curve("sides") = {3, 6}; Physical Curve("wire") = {7};
Physical Surface("film") = {1, 2};
"""


@pytest.fixture
def wire(folder):
    """A square with a curve inside, along x = 1/2; u = 0 on the left and the right."""
    if COMM.rank == 0:
        (folder / "wire.geo").write_text(GEO)
    COMM.barrier()
    parts = [{"on": "sides", "value": 0}, {"on": "wire", "flux": 2, "spring": 4}]
    raw = {"mesh": {"file": str(folder / "wire.geo"), "refine": 1}, "tension": 1, "boundary": parts}
    return Scene(**raw, exact="where(x < 0.5, x, 1 - x)/2")


@pytest.mark.parametrize("method", METHODS)
def test_load_and_springs_along_a_curve_inside(wire, method):
    """[du/dn] = 2 - 4 u at x = 1/2: u = x/2 up to there, linear, hence exact; and a ceiling that it does not reach."""
    record = solve(wire.change({"obstacle.upper": 1}), method=method).record
    assert record["errors"]["max"] < 1e-9
    assert record["contact"]["area"] == 0


MISTAKES = {
    "value and flux": ([{"value": 0, "flux": 1}], "flux does nothing where u is given by 'value'"),
    "given elsewhere": ([{"value": 0}, {"on": "left", "flux": 1}], r"\(no. 2\) flux does nothing .* given, by no. 1"),
    "sucking spring": ([{"on": "left", "value": 0}, {"on": "right", "spring": "0.5 - y"}], "must be at least 0; it is"),
    "nothing": ([{"on": "left"}], "the key 'value' is missing, or flux, spring"),
    "floating": ([{"on": "left", "flux": 1}], "u is given nowhere"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_parts_that_mean_nothing(name):
    parts, message = MISTAKES[name]
    with pytest.raises(InputError, match=message):
        solve(membrane(boundary=parts))


def test_the_last_of_several_parts_counts():
    """Facets named twice: the later flux, and the spring of another part beside it."""
    left = {"on": "left", "value": 0}
    ours = [left, {"on": ["right", "top"], "flux": 5}, {"on": "right", "flux": 1}, {"on": "right", "spring": 2}]
    plain = [left, {"on": "top", "flux": 5}, {"on": "right", "flux": 1, "spring": 2}]
    first, second = (solve(membrane(boundary=parts, lower=-1)).record for parts in (ours, plain))
    assert np.isclose(first["energy"], second["energy"], rtol=1e-12)


def test_normal_flux_beside_springs():
    """All of it together is minus the integral of the load: 1 = what the left side carries and what the springs do."""
    parts = [{"on": "left", "value": 0}, {"on": "right", "spring": 2}]
    report = {"all": "integral(normal_flux, 'left') - integral(2*u, 'right')"}
    assert np.isclose(solve(membrane(boundary=parts, load=1, report=report)).report["all"], -1, rtol=1e-8)
    with pytest.raises(InputError, match=r"on 'right' the normal_flux is what \[\[boundary\]\] gives"):
        solve(membrane(boundary=parts, report={"F": "integral(normal_flux, 'right')"}))


def test_demo_awning():
    """Cords, wall and table carry the weight."""
    answer = solve(Scene.read(DEMOS / "awning.toml"), cells=32)
    assert abs(answer.report["balance"]) < 1e-6 * answer.report["table"]
    assert answer.report["table"] > 0.1 and answer.report["cords"] < 0

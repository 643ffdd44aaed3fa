"""Effects beside tension and load: each against a solution that is known, by the penalty and by SNES VI."""

import numpy as np
import pytest
from conftest import COMM, DEMOS, membrane

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.parallel import largest, smallest
from fenicsx_obstacle.studies.orders import order

# a pressure on a disk of contact: with it in the load any smooth u is the solution above a lower obstacle
PRESSURE = "10*max(1 - hypot(x - 0.5, y - 0.5)^2/0.0625, 0)"
BELOW = "({u}) - 20*max(hypot(x - 0.5, y - 0.5) - 0.25, 0)^2"
METHODS = ["penalty", "vi"]


def above(u, load, **more):
    """A scene on the unit square whose solution is u, where without contact the load would be `load`."""
    scene = {"lower": BELOW.format(u=u), "load": f"({load}) - {PRESSURE}", "exact": u, "boundary": [{"value": u}]}
    return membrane(**{**scene, **more})


def orders(scene, method, cells=(32, 64), **how):
    """Observed orders of the errors between two grids."""
    found = [solve(scene, method=method, cells=n, **how).record for n in cells]
    assert all(row["contact"]["area"] > 0 for row in found)
    rows = [{"h": row["h"], **row["errors"]} for row in found]
    return {key: order(key, rows[1], rows[0], "h") for key in ("l2", "h1")}


def check_orders(scene, method, **how):
    """H1 error of order 1, L2 error of order 2, as for the membrane alone (5.6)."""
    seen = orders(scene, method, **how)
    assert abs(seen["l2"] - 2) < 0.06 and abs(seen["h1"] - 1) < 0.02, seen


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


@pytest.mark.parametrize("method", METHODS)
def test_foundation(method):
    """-div(tension grad u) + k u = load + p, k a formula: orders of the membrane alone."""
    check_orders(above(SMOOTH, f"-2 + (1 + 9*x)*({SMOOTH})", tension=1, foundation="1 + 9*x"), method)


def test_foundation_keeps_the_maximum_principle():
    """k h^2 = 4: with the consistent mass u would swing below 0; lumped, the matrix stays an M-matrix."""
    scene = membrane(foundation=1024, load="where(x < 0.5, 1024, 0)", lower=-1)
    answer = solve(scene, method="successive", eps=1e-6)
    assert answer.record["m_matrix"]
    assert smallest(COMM, answer.u.x.array) >= 0 and largest(COMM, answer.u.x.array) <= 1


STIFF, SINKS = 50, 0.6  # k, and where the string meets the soft ground
_S = f"(1/sqrt({STIFF}))"
SOFT = (
    f"where(abs(x) < {SINKS}, -(1 - cosh(x/{_S})/cosh({SINKS}/{_S}))/{STIFF},"
    f" (abs(x) - {SINKS})^2/2 + {_S}*tanh({SINKS}/{_S})*(abs(x) - {SINKS}))"
)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("hard", [-1, -0.015])
def test_string_on_soft_ground(method, hard):
    """-u'' + k u^- = -1 in closed form: order 2; eps does not enter, and hard ground below it is another matter."""
    scene = membrane(
        mesh={"shape": "interval", "x": [-1, 1]}, load=-1, soft_obstacle={"lower": 0, "stiffness": STIFF}, lower=hard,
        boundary=[{"value": SOFT}], exact=SOFT, report={"middle": "at(p, 0)"},
    )  # fmt: skip
    coarse, fine = (solve(scene, method=method, cells=n).record for n in (40, 80))
    if hard == -1:
        assert coarse["contact"]["area"] == 0
        assert abs(np.log2(coarse["errors"]["l2"] / fine["errors"]["l2"]) - 2) < 0.1
    else:  # in contact the ground carries the load less what the soft obstacle takes: 1 - 50*0.015
        assert np.isclose(fine["report"]["middle"], 1 + STIFF * hard, rtol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_soft_obstacle(method):
    """In two dimensions, its height and stiffness formulas: orders of the membrane alone."""
    soft = {"upper": "x", "stiffness": "5 + y"}
    check_orders(above(SMOOTH, f"-2 + (5 + y)*max({SMOOTH} - x, 0)", soft_obstacle=soft), method)


def test_tables_of_effects_are_checked():
    for soft, message in (
        (1, "expected a table of stiffness, lower, upper"),
        ({"stiffness": 1}, "needs lower or upper"),
        ({"lower": 1}, "the key 'stiffness' is missing"),
        ({"stiffness": 1, "lover": 1}, "unknown key 'lover'"),
        ({"stiffness": 1, "lower": "q"}, "unknown name 'q'"),
    ):
        with pytest.raises(InputError, match=message):
            membrane(soft_obstacle=soft)
    with pytest.raises(InputError, match="must be at least 0"):
        solve(membrane(foundation="x - 0.5"))
    with pytest.raises(InputError, match="P1-voronoi is for tension and load, not for foundation"):
        solve(membrane(foundation=1), element="P1-voronoi")


def test_demos_of_support():
    """Bed and stamp: the bed's force is the stamp's and the wall's. Foam: the closed form of the string."""
    report = solve(Scene.read(DEMOS / "stamp.toml"), cells=32).report
    assert abs(report["balance"]) < 0.01 * report["stamp"] and report["stamp"] > 0
    assert solve(Scene.read(DEMOS / "foam.toml")).record["errors"]["l2"] < 1e-5


CLOTH = [["2 + x", 0.5], [0.5, 1]]
BENT = "-((2 + x)*(2 - sin(x)*cosh(y)) + cos(x)*cosh(y) + 2*x + cos(x)*sinh(y) + sin(x)*cosh(y))"


@pytest.mark.parametrize("method", METHODS)
def test_anisotropic_tension(method):
    """-div(A grad u) with a matrix that varies: orders of the membrane alone, in the few steps of multigrid."""
    scene = above(SMOOTH, BENT, tension=CLOTH)
    check_orders(scene, method)
    record = solve(scene, method=method, cells=64).record
    assert record["newton_iterations"] <= 6 and record["krylov_iterations"] <= 20


def test_matrix_of_one_number_is_that_number():
    """2 times the unit matrix: the same answer, eps included; in three dimensions too."""
    for mesh, matrix in (({"shape": "rectangle", "cells": 16}, [[2, 0], [0, 2]]),
                         ({"shape": "box", "cells": 4}, [[2, 0, 0], [0, 2, 0], [0, 0, 2]])):  # fmt: skip
        ours, plain = (solve(membrane(mesh=mesh, tension=mu, load=-9, lower=-0.1)).record for mu in (matrix, 2))
        assert ours["eps"] == plain["eps"]
        assert np.isclose(ours["energy"], plain["energy"], rtol=1e-9)


def test_matrices_that_are_no_tension():
    for matrix, message in (
        ([[1, 0.5], [0.4, 1]], r"tension: is not symmetric; entries differ by 0.1"),
        ([[1, "2*x"], ["2*x", 1]], "must be positive definite; its least eigenvalue is -0"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], "a matrix of 3 rows, but points have 2 coordinates"),
        ([[1, 0], [0]], "expected 2 rows of 2"),
        ([[1, "q"], ["q", 1]], "unknown name 'q'"),
    ):
        with pytest.raises(InputError, match=message):
            solve(membrane(tension=matrix))
    with pytest.raises(InputError, match="alike in all directions"):
        solve(membrane(tension=CLOTH), bound=True)
    with pytest.raises(InputError, match="flux needs a tension alike in all directions"):
        solve(membrane(tension=CLOTH, report={"F": "integral(normal_flux, 'left')"}))


def test_demo_cloth():
    """Tight threads leave the ball at once: its contact is an oval, long across them."""
    report = solve(Scene.read(DEMOS / "cloth.toml"), cells=64).report
    assert report["across"] > 2 * report["along"]


@pytest.mark.parametrize("method", METHODS)
def test_point_load_on_a_string(method):
    """u = F min(x, 1 - x)/2 with F at 1/2, exact at vertices wherever the point is; a ceiling takes F - 4 c of it."""
    mesh = {"shape": "interval", "cells": 10}
    for at, exact in ((0.5, "2*min(x, 1 - x)"), (0.23, "4*where(x < 0.23, 0.77*x, 0.23*(1 - x))")):
        scene = membrane(mesh=mesh, point_load=[{"at": at, "force": 4}], exact=exact)
        assert solve(scene, method=method).record["errors"]["max"] < 1e-9
    scene = membrane(mesh=mesh, point_load=[{"at": [0.5], "force": "4*pi/pi"}], upper=0.6)
    assert np.isclose(solve(scene, method=method, eps=1e-10).record["contact"]["upper"]["force"], 4 - 4 * 0.6)


@pytest.mark.parametrize("method", METHODS)
def test_point_load_on_a_membrane(method):
    """Green's function on top of a smooth solution with contact elsewhere: L2 error of order 1."""
    u = f"{SMOOTH} - 2*ln(hypot(x - 1/6, y - 1/6))/(2*pi)"
    scene = above(u, -2, point_load=[{"at": ["1/6", "1/6"], "force": 1.5}, {"at": ["1/6", "1/6"], "force": 0.5}])
    assert abs(orders(scene, method)["l2"] - 1) < 0.05


def test_point_loads_that_mean_nothing():
    for given, message in (
        ([{"at": [2, 2], "force": 1}], r"the point \(2, 2\) is outside the mesh"),
        ([{"at": [0.5], "force": 1}], "a point needs 2 coordinates here, not 1"),
        ([{"at": [0.5, 0.5]}], "the key 'force' is missing"),
        (3, "expected a list such as"),
        ([{"at": [0.5, "x"], "force": 1}], "unknown name 'x'"),
    ):
        with pytest.raises(InputError, match=message):
            solve(membrane(point_load=given))
    load = [{"at": [0.5, 0.5], "force": 1}]
    with pytest.raises(InputError, match="is for element P1"):
        solve(membrane(point_load=load), element="P2")
    with pytest.raises(InputError, match="energy of a point load is infinite"):
        solve(membrane(point_load=load), bound=True)


def test_demo_tent():
    """Two poles hold up a sheet that sags to the ground; poles, ground and pegs balance."""
    report = solve(Scene.read(DEMOS / "tent.toml"), cells=32).report
    assert abs(report["balance"]) < 1e-6 and report["ground"] > 0

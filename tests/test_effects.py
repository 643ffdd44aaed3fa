"""Effects beside tension and load: each against a solution that is known, by the penalty and by SNES VI."""

from dataclasses import dataclass

import numpy as np
import pytest

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.effects.effect import Effect, _register, register
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.effects.plugin import load_plugin
from fenicsx_obstacle.parallel import largest, smallest
from fenicsx_obstacle.studies.orders import order
from tests.conftest import COMM, DEMOS, membrane, slow_except
from tests.helpers import WIRE

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


SMOOTH = "sin(x)*cosh(y) + x^2"  # -Laplace u = -2


@pytest.mark.parametrize("element", slow_except(["P1", "P2", "Q1", "Q2"], "P2"))
def test_springs_of_all_elements(element):
    """Fluxes and springs take the nodal rule of the side: no element loses its order 2. The spring is 0 in a corner,
    or less by round-off."""
    parts = [{"on": ["left", "bottom", "top"], "value": "exp(x)*cos(y)"},
             {"on": "right", "spring": "3*y", "flux": "(1 + 3*y)*exp(x)*cos(y)"}]  # fmt: skip
    scene = membrane(exact="exp(x)*cos(y)", boundary=parts)
    coarse, fine = (solve(scene, element=element, cells=n).record["errors"]["l2"] for n in (8, 16))
    assert coarse / fine > 2**1.9


def test_springs_that_jump_within_a_side():
    """Springs of 1e4 beside a soft tension, which end inside an edge: order 1 in energy, and in L2 within 1 % of the
    error without them."""
    spring, u = "1e4*where(y < 0.613, 1, 0)", "x^2 + y^2"
    rest = {"on": ["left", "bottom", "top"], "value": u}
    soft, stiff = ([rest, {"on": "right", "flux": f"2*x + {k}*({u})", "spring": k}] for k in ("0", spring))
    errors = [solve(membrane(exact=u, load=-4, boundary=parts), cells=n).errors for parts, n in (
        (stiff, 8), (stiff, 16), (soft, 16))]  # fmt: skip
    assert errors[0].energy / errors[1].energy > 2**0.95 and errors[1].energy < 1.01 * errors[2].energy
    assert errors[1].l2 < 1.01 * errors[2].l2


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


def test_foundation_keeps_the_maximum_principle():
    """k h^2 = 4: with the consistent mass u would swing below 0; lumped, the matrix stays an M-matrix."""
    scene = membrane(foundation=1024, load="where(x < 0.5, 1024, 0)", lower=-1)
    answer = solve(scene, method="successive", eps=1e-6)
    assert answer.record["m_matrix"]
    assert smallest(COMM, answer.u.x.array) >= 0 and largest(COMM, answer.u.x.array) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
def test_hard_ground_below_soft_ground(method):
    """In contact it carries the load less what the soft obstacle takes: p = 1 - 50 (0.015 + eps p). The demo foam has
    no hard ground."""
    scene = membrane(mesh={"shape": "interval", "x": [-2, 2]}, load=-1, soft_obstacle={"lower": 0, "stiffness": 50},
                     lower=-0.015, boundary=[{"value": 0.1}], report={"middle": "at(p, 0)"})  # fmt: skip
    answer = solve(scene, method=method)
    assert np.isclose(answer.report["middle"] * (1 + 50 * (answer.eps or 0)), 1 - 50 * 0.015, rtol=1e-8)


CLOTH = [["2 + x", 0.5], [0.5, 1]]


def test_matrix_of_one_number_is_that_number():
    """2 times the unit matrix: the same answer, eps included; in three dimensions too."""
    for mesh, matrix in (({"shape": "rectangle", "cells": 16}, [[2, 0], [0, 2]]),
                         ({"shape": "box", "cells": 4}, [[2, 0, 0], [0, 2, 0], [0, 0, 2]])):  # fmt: skip
        ours, plain = (solve(membrane(mesh=mesh, tension=mu, load=-9, lower=-0.1)).record for mu in (matrix, 2))
        assert ours["eps"] == plain["eps"]
        assert np.isclose(ours["energy"], plain["energy"], rtol=1e-9)


@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
def test_point_load_on_a_string(method):
    """u = F min(x, 1 - x)/2 with F at 1/2, exact at vertices wherever the point is; a ceiling takes F - 4 c of it."""
    mesh = {"shape": "interval", "cells": 10}
    for at, exact in ((0.5, "2*min(x, 1 - x)"), (0.23, "4*where(x < 0.23, 0.77*x, 0.23*(1 - x))")):
        scene = membrane(mesh=mesh, point_load=[{"at": at, "force": 4}], exact=exact)
        assert solve(scene, method=method).record["errors"]["max"] < 1e-9
    scene = membrane(mesh=mesh, point_load=[{"at": [0.5], "force": "4*pi/pi"}], upper=0.6)
    assert np.isclose(solve(scene, method=method, eps=1e-10).record["contact"]["upper"]["force"], 4 - 4 * 0.6)


# on the side x = 1 u touches where |y - 1/2| < 1/4, with a force per length p; the flux takes both into account
WALL_P = "3*max(1 - 16*(y - 0.5)^2, 0)"
WALL = {"on": "right", "lower": f"{SMOOTH} - 20*max(abs(y - 0.5) - 0.25, 0)^2",
        "flux": f"cos(x)*cosh(y) + 2*x - {WALL_P}"}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
def test_obstacle_on_the_boundary(method):
    """Signorini's problem, tension du/dn = flux + p with u >= lower on one side: orders of the membrane alone."""
    parts = [{"on": ["left", "bottom", "top"], "value": SMOOTH}, WALL]
    scene = membrane(load=-2, boundary=parts, exact=SMOOTH, report={"force": "integral(p, 'right')"})
    seen = orders(scene, method)
    assert abs(seen["l2"] - 2) < 0.1 and abs(seen["h1"] - 1) < 0.02, seen
    record = solve(scene, method=method, cells=64).record
    assert record["newton_iterations"] <= 6 and record["krylov_iterations"] <= 20
    force = record["contact"]["lower"]["force"]
    assert np.isclose(force, 3 * 0.5 * 2 / 3, rtol=2e-3)
    assert np.isclose(record["report"]["force"], force, rtol=1e-9)
    assert np.isclose(record["contact"]["area"], 0.5, atol=0.04)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_node_of_two_obstacles_has_the_nearer_one(sign):
    """In whatever order the tables stand; of two tables for the same facets the later one counts."""
    side = "lower" if sign > 0 else "upper"
    left, bottom = {"on": "left", side: -0.1 * sign}, {"on": "bottom", side: -5 * sign}
    held = {"on": ["right", "top"], "value": 0}
    orders = [(left, bottom), (bottom, left), ({"on": "left", side: -0.05 * sign}, bottom, left)]
    u = [solve(membrane(load=-4 * sign, boundary=[held, *parts])).at([[0.0, 0.0], [0.0, 0.5]]) for parts in orders]
    assert np.allclose(sign * u[0], -0.1, atol=1e-3)
    assert np.allclose(u[1], u[0], atol=1e-12) and np.allclose(u[2], u[0], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
def test_wire_below_a_membrane(method):
    """A thin obstacle along a curve inside: u = x^2/2 - 0.35 x up to it, its force 0.3 per length."""
    scene = Scene(mesh={"file": WIRE, "refine": 2}, tension=1, load=-1,
                  boundary=[{"on": "sides", "value": 0}, {"on": "wire", "lower": -0.05}],
                  exact="min(x, 1 - x)^2/2 - 0.35*min(x, 1 - x)")  # fmt: skip
    record = solve(scene, method=method).record
    assert record["errors"]["max"] < 2e-3
    assert np.isclose(record["contact"]["lower"]["force"], 0.3, rtol=5e-3)
    assert np.isclose(record["contact"]["area"], 1)


@pytest.mark.slow
def test_obstacle_on_a_face():
    """Three dimensions, and quadrilaterals: the wall of the square, drawn out along z; both paths of assembly."""
    box = {"shape": "box", "cells": 8}
    parts = [{"on": ["left", "bottom", "top"], "value": SMOOTH}, WALL]
    square = {"shape": "rectangle", "cells": 8}
    flat, solid = (solve(membrane(mesh=mesh, load=-2, boundary=parts)).record for mesh in (square, box))
    assert np.isclose(solid["contact"]["lower"]["force"], flat["contact"]["lower"]["force"], rtol=0.03)
    quadrilaterals = solve(membrane(load=-2, boundary=parts), element="Q1").record
    assert np.isclose(quadrilaterals["contact"]["lower"]["force"], 1, rtol=0.02)
    soft = {"upper": 9, "stiffness": 1}  # not reached, but not affine
    forms = solve(membrane(load=-2, boundary=parts, soft_obstacle=soft)).record
    assert np.isclose(forms["energy"], solve(membrane(load=-2, boundary=parts)).record["energy"], rtol=1e-8)


RADIAL = {"mesh": {"shape": "interval"}, "axial_symmetry": True, "boundary": [{"on": "right", "value": 0}]}


WIND = ["7 + 5*y", "-5*x"]


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
def test_drift_alone_almost(method):
    """Pe > 10: drift, load and foundation lean alike, so that order 2 stays where nothing is touched."""
    load = f"-2e-3 + {CARRIED} + {SMOOTH}"
    scene = membrane(tension=1e-3, drift=WIND, foundation=1, load=load, lower=-9, exact=SMOOTH,
                     boundary=[{"value": SMOOTH}])  # fmt: skip
    found = [solve(scene, method=method, cells=n).record for n in (32, 64)]
    assert found[1]["peclet"] > 10
    rows = [{"h": row["h"], **row["errors"]} for row in found]
    assert order("l2", rows[1], rows[0], "h") > 1.9


@pytest.mark.parametrize("speed", [10, 1e3, 1e6])
def test_layers_have_no_wiggles(speed):
    """-u'' + b u' = 0 between 0 and 1: monotone whatever Pe, where Pe < 1 with order 2, and where Pe > 1 the upwind
    difference, u_i = u_(i-1) before the last node."""
    ends = [{"on": "left", "value": 0}, {"on": "right", "value": 1}]
    string = {"mesh": {"shape": "interval", "cells": 20}, "boundary": ends}
    answer = solve(membrane(**string, drift=[speed]))
    own = answer.level.owned
    points, u = answer.level.points[0, :own], answer.u.x.array[:own]
    order_ = np.argsort(points)
    assert np.all(np.diff(u[order_]) >= -1e-12) and smallest(COMM, u) >= -1e-12 and largest(COMM, u) <= 1 + 1e-12
    if speed == 10:
        exact = "(exp(10*x) - 1)/(exp(10) - 1)"
        errors = [solve(membrane(**string, drift=[10], exact=exact), cells=n).record["errors"]["l2"] for n in (20, 40)]
        assert abs(np.log2(errors[0] / errors[1]) - 2) < 0.06
    else:
        assert largest(COMM, u[points < 1 - 1e-9]) <= 1e-12


def without_tension(scene, **effects):
    """The scene with another elastic effect in place of tension."""
    rest = {key: value for key, value in scene.tables.effects.items() if key != "tension"}
    return scene.change({"effects": {**effects, **rest}})


CATENOID = "ln(hypot(x + 1, y + 1) + sqrt(hypot(x + 1, y + 1)^2 - 1))"  # r = cosh u, its axis at (-1, -1)
CARRIED = "(7 + 5*y)*(cos(x)*cosh(y) + 2*x) - 5*x*sin(x)*sinh(y)"  # (7 + 5 y, -5 x) . grad of SMOOTH
BENT = "-((2 + x)*(2 - sin(x)*cosh(y)) + cos(x)*cosh(y) + 2*x + cos(x)*sinh(y) + sin(x)*cosh(y))"


def power_law(exponent):
    """u = (n-1)/n (f/2)^(1/(n-1)) (1 - r^(n/(n-1))) for -div(|grad u|^(n-2) grad u) = f = 4, with contact."""
    conjugate = exponent / (exponent - 1)
    u = f"(1 - r^{conjugate})/{conjugate}*2^(1/{exponent - 1})"
    return without_tension(above(u, 4), power_law={"exponent": exponent})


MANUFACTURED = {
    "foundation": above(SMOOTH, f"-2 + (1 + 9*x)*({SMOOTH})", tension=1, foundation="1 + 9*x"),
    "soft obstacle": above(SMOOTH, f"-2 + (5 + y)*max({SMOOTH} - x, 0)",
                           soft_obstacle={"upper": "x", "stiffness": "5 + y"}),
    "matrix": above(SMOOTH, BENT, tension=CLOTH),
    "drift, Pe < 1": above(SMOOTH, f"-2 + {CARRIED} + {SMOOTH}", drift=WIND, foundation=1),
    "large slopes": without_tension(above(CATENOID, 0), large_slope=1),
    "power law, n = 3": power_law(3),
    "power law, n = 1.5": power_law(1.5),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
@pytest.mark.parametrize("name", slow_except(MANUFACTURED, *list(MANUFACTURED)[:-1]))
def test_manufactured_solutions(name, method):
    """With contact: orders of the membrane alone, with large slopes 2 from above in L2, in few steps."""
    scene = MANUFACTURED[name]
    seen = orders(scene, method)
    assert 1.94 < seen["l2"] < 2.2 if name == "large slopes" else abs(seen["l2"] - 2) < 0.06, seen
    assert abs(seen["h1"] - 1) < 0.02, seen
    record = solve(scene, method=method, cells=64).record
    if name in ("matrix", "large slopes"):
        assert record["newton_iterations"] <= 6
    assert record["krylov_iterations"] <= 20 or name != "matrix"
    assert 0 < record.get("peclet", 0.5) < 1


@pytest.mark.slow
def test_demo_soap():
    """A film between a ring and a round plate is a catenoid r = a cosh(...): it pulls on the plate with 2 pi a.

    In two dimensions nodes follow the rim up to h; by the radius the rim is a node.
    """
    scene = Scene.read(DEMOS / "soap.toml")
    report = solve(scene).report
    assert np.isclose(report["pull"], 2 * np.pi * 0.4, rtol=0.01)
    assert np.isclose(report["area"], report["exact_area"], rtol=0.01)
    changes = {"mesh": {"shape": "interval", "cells": 128}, "effects.axial_symmetry": True}
    radius = scene.change({**changes, "boundary": [{"on": "right", "value": 0}], "report": {}})
    assert np.isclose(solve(radius).record["contact"]["lower"]["force"], 0.4, rtol=1e-3)


def example(key):
    """An effect of docs/effects.md."""
    return (DEMOS.parent / "docs" / "effects.md").read_text().partition(f"# {key}.py\n")[2].partition("```")[0]


def test_what_is_no_effect_from_outside(tmp_path):
    """A file that is not there, that fails, or that takes the name of another effect."""
    (tmp_path / "wrong.py").write_text("1/0")
    (tmp_path / "taken.py").write_text(example("hardening").replace('"hardening"', '"load"'))
    for name, message in (("none", "no such Python file"), ("wrong", "ZeroDivisionError"), ("taken", "is taken")):
        with pytest.raises(InputError, match=message):
            load_plugin(tmp_path / f"{name}.py")


def test_what_others_ask_is_the_role():
    """A term like `foundation` under another name: with its role the error bound knows it."""

    class Bed(Effect):
        key = "bed"

        def terms(self, u, v, data):
            return data.cellwise(self.value, least=0.0) * u * v * data.dI

        def energy(self, u, data):
            return 0.5 * data.cellwise(self.value, least=0.0) * u**2 * data.dI

    scene = {"load": "x - 1", "boundary": []}
    known = solve(membrane(**scene, foundation=2), bound=True).record["bound"]
    try:
        register(Bed)
        assert not solve(membrane(**scene, bed=2), bound=True).bound.guaranteed
        Bed.role = "reaction"
        assert solve(membrane(**scene, bed=2), bound=True).record["bound"] == known
    finally:
        del _register["bed"]


def test_a_role_says_that_the_term_has_one_datum():
    """A bound that ignored the settlement of a foundation was 1e-14, and the error 5.5."""

    @dataclass(frozen=True)
    class Settled(Effect):
        key, role = "settled", "reaction"
        settlement: Field

        @classmethod
        def read(cls, raw, place, reader, **more):
            return cls(*(reader.value(raw[key], place) for key in ("value", "settlement")))

        def terms(self, u, v, data):
            return data.cellwise(self.value) * (u + data.cellwise(self.settlement)) * v * data.dI

    scene = {"boundary": [], "lower": -50, "settled": {"value": 10, "settlement": "20*sin(8*pi*x)"}}
    try:
        register(Settled)
        with pytest.raises(InputError, match="'settled' has several data, but its role 'reaction'"):
            solve(membrane(**scene), bound=True)
        Settled.role = ""  # it holds u all the same
        assert not solve(membrane(**scene), bound=True).bound.guaranteed
    finally:
        del _register["settled"]


LEFT, POINT = {"on": "left", "value": 0}, [{"at": [0.5, 0.5], "force": 1}]
FREE = {"on": "left", "lower": 0}
MISTAKES = [
    ({"boundary": [{"value": 0, "flux": 1}]}, "flux has no effect where u is given by 'value'"),
    ({"boundary": [{"value": 0}, {"on": "left", "flux": 1}]}, r"\(no. 2\) flux has no effect .* given, by no. 1"),
    ({"boundary": [LEFT, {"on": "right", "spring": "0.5 - y"}]}, "must be at least 0; it is"),
    ({"boundary": [{"on": "left"}]}, "the key 'value' is missing, or flux, spring"),
    ({"soft_obstacle": 1}, "expected a table of stiffness, lower, upper"),
    ({"soft_obstacle": {"stiffness": 1}}, "needs lower or upper"),
    ({"foundation": "x - 0.5"}, "must be at least 0"),
    ({"foundation": 1, "element": "P1-voronoi"}, "P1-voronoi is for tension and load, not for foundation"),
    ({"tension": [[1, 0.5], [0.4, 1]]}, r"tension: is not symmetric; entries differ by 0.1"),
    ({"tension": [[1, "2*x"], ["2*x", 1]]}, "must be positive definite; its least eigenvalue is -0"),
    ({"tension": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "a matrix of 3 rows, but points have 2 coordinates"),
    ({"tension": [[1, 0], [0]]}, "expected 2 rows of 2"),
    ({"tension": CLOTH, "element": "P2", "bound": True}, "isotropic tension"),
    ({"tension": CLOTH, "report": {"F": "integral(normal_flux, 'left')"}}, "flux needs an isotropic tension"),
    ({"point_load": [{"at": [2, 2], "force": 1}]}, r"the point \(2, 2\) is outside the mesh"),
    ({"point_load": [{"at": [0.5], "force": 1}]}, "a point needs 2 coordinates here, not 1"),
    ({"point_load": 3}, "expected a list such as"),
    ({"point_load": POINT, "element": "P2"}, "is for element P1"),
    ({"point_load": POINT, "bound": True}, "does not cover point loads, whose energy is infinite"),
    ({"lower": -1, "boundary": [FREE]}, "these exclude each other"),
    ({"boundary": [{"value": 0}, FREE]}, "lower has no effect where u is given, by no. 1"),
    ({"boundary": [{**FREE, "upper": -1}]}, "lower is above upper: by 1"),
    ({"boundary": [{"on": "right", "value": -1}, {"on": ["left", "top"], "lower": 0}]}, "lies below the lower"),
    ({"boundary": [FREE], "element": "P2"}, "obstacles on the boundary are for elements P1 and Q1"),
    ({**RADIAL, "axial_symmetry": 1}, "expected true"),
    ({**RADIAL, "mesh": {"shape": "interval", "x": [-1, 1]}}, "axial_symmetry, radius = x: must be positive"),
    ({**RADIAL, "mesh": {"shape": "box", "cells": 2}, "boundary": [{"value": 0}]}, "is for intervals and plane meshes"),
    ({**RADIAL, "point_load": [{"at": 0.5, "force": 1}]}, "with axial_symmetry a point is a circle"),
    ({**RADIAL, "report": {"F": "integral(normal_flux, 'right')"}}, "not for axial symmetry"),
    ({"drift": 1}, "expected a list of one number or formula per coordinate"),
    ({"boundary": [{"value": [0, 0]}]}, r"value = \[0, 0\]: a list is for elastic bodies"),
    ({"boundary": [{"value": 0}, {"on": "left", "pressure": 1}]}, "pressure: is for elastic bodies"),
    ({"boundary": [{"on": "left", "spring": [1, 2]}]}, "spring: is for elastic bodies"),
    ({"load": [0, -1]}, r"load = \[0, -1\]: is for elastic bodies"),
    ({"drift": [1]}, "has 1 components, but points have 2 coordinates"),
    ({"large_slope": 1}, "names tension and large_slope: only one of them is allowed"),
    ({"large_slope": 1, "drift": [1, 0], "tension": None}, "drift can only be combined with tension, not with large_s"),
    ({"power_law": {"exponent": 4}, "tension": None}, "must be between 1 and 4, which are excluded: .*ObstacleProblem"),
    ({"power_law": {"exponent": 3, "regularisation": 0}, "tension": None}, "must be positive"),
    ({"large_slope": 1, "tension": None, "element": "P2", "bound": True}, "the error bound needs the effect 'tension'"),
]


@pytest.mark.parametrize(("given", "message"), MISTAKES)
def test_what_means_nothing(given, message):
    """Data of effects that are none, that contradict each other, or that an element or the error bound does not know:
    the effect, and what is expected."""
    how = {key: given[key] for key in ("element", "bound") if key in given}
    data = {"mesh": {"shape": "rectangle", "cells": 4}, "tension": 1, **given}
    with pytest.raises(InputError, match=message):
        solve(Scene(**{key: value for key, value in data.items() if key not in how and value is not None}), **how)

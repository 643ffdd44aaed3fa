"""No u without meaning is an answer: supports that hold nothing, imbalance, near-singular operators, limit loads."""

import itertools

import numpy as np
import pytest
import ufl
from dolfinx import fem

from fenicsx_obstacle import InputError, NotConverged, Scene, solve
from fenicsx_obstacle.algebra.linear_solvers import defaults
from fenicsx_obstacle.discrete import residence_time as drift_checks
from fenicsx_obstacle.parallel import largest, smallest
from tests.conftest import COMM, membrane, slow_except
from tests.hard.unsolvable import attempt, problems
from tests.helpers import Membrane
from tests.test_components import APART, union

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


SOFT = {
    "square": ({"load": -1, "soft_obstacle": {"lower": 3, "stiffness": 100}}, 2.99),
    "cube": ({"mesh": CUBE, "load": -1, "soft_obstacle": {"lower": 3, "stiffness": 100}}, 2.99),
    "shifted": ({"load": 2, "soft_obstacle": {"upper": 1e8, "stiffness": 100}}, 1e8 + 0.02),
    "two": ({"load": -1, "soft_obstacle": {"lower": -1, "upper": 1, "stiffness": 100}}, -1.01),
    "beside a hard one": ({"load": -1, "lower": -9, "soft_obstacle": {"lower": -1, "stiffness": 100}}, -1.01),
    "drift": ({"load": -1, "drift": [1, 2], "soft_obstacle": {"lower": 0, "stiffness": 100}}, -0.01),
    "film": ({"load": -1, "large_slope": 1, "soft_obstacle": {"lower": 0, "stiffness": 100}}, -0.01),
    "small forces": ({"tension": 1e-8, "load": -1e-8, "soft_obstacle": {"lower": 0, "stiffness": 1e-6}}, -0.01),
    "large forces": ({"tension": 1e8, "load": -1e8, "soft_obstacle": {"lower": 0, "stiffness": 1e10}}, -0.01),
}


SOFT_CASES = [*((name, "P1", "penalty") for name in SOFT), *((name, "P1", "vi") for name in list(SOFT)[:3]),
              *(("square", element, method) for element in ("P2", "Q1") for method in ("penalty", "vi"))]  # fmt: skip


@pytest.mark.parametrize(("name", "element", "method"), slow_except(SOFT_CASES, *SOFT_CASES[:6], *SOFT_CASES[-7:]))
def test_a_soft_obstacle_alone_holds(name, element, method):
    """A uniform load on a uniform soft obstacle sinks by load/stiffness, with u given nowhere."""
    data, height = SOFT[name]
    found = extremes(solve(loose(**data), element=element, method=method))
    assert found == pytest.approx((height, height), rel=1e-9)


NOT_PRESSED = "does not press against the lower obstacle"
WEAK = "is below the round-off of the tension"
SPRING = [{"on": "left", "spring": 1e-14}]
THIN = "where((x > 0.001)*(x < 0.002), 1, 0)"
HELD_BY_NOTHING = {
    "soft, lifted": ({"load": 1, "soft_obstacle": {"lower": 0, "stiffness": 100}}, NOT_PRESSED),
    "soft, no load": ({"load": 0, "soft_obstacle": {"lower": 0, "stiffness": 100}}, NOT_PRESSED),
    "soft, no stiffness": ({"load": -1, "soft_obstacle": {"lower": 0, "stiffness": 0}}, WEAK),
    "soft, stiff between samples": ({"load": -1, "soft_obstacle": {"lower": 0, "stiffness": THIN}}, WEAK),
    "weak spring": ({"load": -1, "boundary": SPRING}, WEAK),
    "weak spring, load without sum": ({"load": "sin(2*pi*x)", "boundary": SPRING}, WEAK),
    "weak spring, lifted": ({"load": 1, "lower": 0, "boundary": SPRING}, NOT_PRESSED),
    "foundation between samples": ({"load": -1, "foundation": THIN}, WEAK),
    "weak foundation": ({"load": -1e-14, "foundation": 1e-15}, WEAK),
    "nothing": ({"load": -1}, "no obstacle supports it"),
    "drift alone, lifted": ({"load": 1, "drift": [1, 2], "lower": 0}, NOT_PRESSED),
    "film, no spring": ({"load": -1, "large_slope": 1, "boundary": [{"on": "left", "spring": 0}]}, WEAK),
}


@pytest.mark.parametrize("name", slow_except(HELD_BY_NOTHING, *list(HELD_BY_NOTHING)[:4]))
@pytest.mark.parametrize("mesh", slow_except([INTERVAL, SQUARE], SQUARE))
def test_supports_that_hold_nothing(name, mesh):
    """A support that does not answer to u = 1, beside round-off, is none: no u is in balance."""
    data, message = HELD_BY_NOTHING[name]
    with pytest.raises(InputError, match=message):
        solve(loose(mesh, **{**data, **({"drift": [1]} if "drift" in data and mesh is INTERVAL else {})}))


def test_each_part_of_a_mesh_is_held():
    """Two separate squares, one of them held at its left side: the other one needs a support of its own."""
    held = {"mesh": union(*APART["a gap"]), "tension": 1, "load": -1, "boundary": [{"where": "x < 1e-9", "value": 0}]}
    with pytest.raises(InputError, match="nowhere on one of 2 separate parts"):
        solve(Scene(**held))
    low, high = extremes(solve(Scene(**held, lower=-2), method="vi"))
    assert (low, high) == pytest.approx((-2, 0), abs=1e-12)
    soft = {"lower": -3, "stiffness": 10}
    low, high = extremes(solve(Scene(**held, soft_obstacle=soft)))
    assert (low, high) == pytest.approx((-3.1, 0), abs=1e-9)


NO_FORCE = "no contact force acts, so that u is determined only up to a constant"


@pytest.mark.slow
@pytest.mark.parametrize("method", ["vi", "penalty"])
@pytest.mark.parametrize("load", ["0", "where(x < 0.5, -1, 1)"])
def test_a_load_without_sum_needs_contact_forces(load, method):
    """Obstacles that let u move leave it undetermined; obstacles that deform u, or that do not let it move, do not."""
    for mesh, how in ((SQUARE, {"method": method}), ({**SQUARE, "cell": "quadrilateral"}, {"element": "Q1-gauss"})):
        with pytest.raises(NotConverged, match=NO_FORCE):
            solve(loose(mesh, load=load, lower=-9, upper=9), **how)
    with pytest.raises(InputError, match=r"0 in all, does not press .* u is determined only up to a constant"):
        solve(loose(load=load, lower=-9), method=method)
    answer = solve(loose(load=load, lower="x - 0.3", upper="x - 0.2"), method=method, eps=1e-8)
    assert answer.force.lower == pytest.approx(answer.force.upper, rel=1e-6) and answer.force.lower > 0.1
    fixed = solve(loose(load=load, lower=0.2, upper=0.2), method=method, eps=1e-8)
    assert extremes(fixed) == pytest.approx((0.2, 0.2), abs=1e-7)


@pytest.mark.parametrize("method", ["vi", "penalty"])
def test_drift_needs_contact_forces(method):
    """Drift does not answer to u = 1: without contact forces any constant may be added to u."""
    drift = {"drift": [1, 0], "load": 0}
    with pytest.raises(NotConverged, match=NO_FORCE):
        solve(loose(**drift, lower=-9, upper=9), method=method)
    assert solve(loose(**drift, lower="0.3*x", upper="0.3*x + 0.1"), method=method, eps=1e-8).force.lower > 0.01


def far_above(load, method, foundation=0.0, start=1.0):
    """A form on a square without boundary values, a start above the obstacle at 0, and a load."""
    own = Membrane(cells=8, load=load)
    k = fem.Constant(own.mesh, float(foundation))
    own.u.x.array[:] = start
    own.F += k * own.u * own.v * ufl.dx
    energy = own.energy + 0.5 * k * own.u**2 * ufl.dx if method == "energy" else None
    problem = own.problem(bcs=[], lower=0, energy=energy)
    return problem.solve(eps=1e-8, method="vi" if method == "vi" else "penalty")


@pytest.mark.parametrize("method", ["vi", "penalty", "energy"])
@pytest.mark.parametrize(
    ("load", "foundation", "start"),
    slow_except([(-0.2, 0, 1), (-0.2, 1e-14, 0), (-3e-8, 0, 1e3), (-1e8, 0, 1)], (-0.2, 0, 1)),
)
def test_a_form_without_boundary_values_begins_in_contact(method, load, foundation, start):
    """Nothing but the obstacle holds u: its force is the whole load, from any start."""
    answer = far_above(load, method, foundation, start)
    assert answer.force.lower == pytest.approx(-load, rel=1e-8)
    assert largest(COMM, np.abs(answer.u.x.array)) <= 2e-8 * abs(load)


UNDETERMINED = "round-off (determines|changes) u"


@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_a_far_obstacle_beside_a_spring(method):
    """Contact at -1e20 is where the iteration begins, not where it ends: a spring of 1e-6 holds u at -1e6."""
    scene = loose(load=-1, lower=-1e20, boundary=[{"on": "left", "spring": 1e-6}])
    assert extremes(solve(scene, method=method)) == pytest.approx((-1e6, -1e6), rel=1e-4)


@pytest.mark.parametrize("cells", slow_except([8, 12, 20], 12))
@pytest.mark.parametrize("lower", [-1e16, -1e20, -1e24])
def test_a_support_below_round_off_over_an_obstacle_far_off(lower, cells):
    """A spring of 1e-14 would hold u at -1e14, which round-off hides: no answer, whatever the obstacle far below."""
    for method in ("penalty", "vi"):
        with pytest.raises(InputError, match="below the round-off of the tension"):
            solve(loose({"shape": "rectangle", "cells": cells}, load=-1, lower=lower, boundary=SPRING), method=method)


@pytest.mark.parametrize("shift", [1e8, 1e12])
def test_shifted_heights_are_accepted(shift):
    """Round-off of heights that are data is no reason to reject: forces on the obstacle stay, as do held membranes."""
    scene = Scene(mesh=SQUARE, tension=1, load=-10, lower=-0.1)
    moved = Scene(mesh=SQUARE, tension=1, load=-10, lower=f"{shift} - 0.1", boundary=[{"value": shift}])
    force, there = (solve(one).record["contact"]["lower"]["force"] for one in (scene, moved))
    assert there == pytest.approx(force, rel=10 * shift * 2.3e-16 / 0.1 + 1e-6)
    low, high = extremes(solve(Scene(mesh=SQUARE, tension=1, load=-1, boundary=[{"value": shift}])))
    assert shift - 0.1 <= low <= high <= shift


def string_in_a_trap(eps, load=1, n=1000, **more):
    """-eps u'' + 20 (x - 1/2) u' = load: the flow draws all to the middle."""
    return Scene(mesh={"shape": "interval", "cells": n}, tension=eps, load=load, drift=["20*(x - 0.5)"], **more)


@pytest.mark.parametrize("eps", slow_except([0.05, 0.06, 0.08], 0.05))
@pytest.mark.parametrize("n", slow_except([50, 400, 401, 777, 1000], 50, 401))
def test_nearly_singular_drift_is_found_where_u_is_small(n, eps):
    """The exact u is small, yet round-off adds the nearly singular part; how much changes with every cell and rank."""
    with pytest.raises(NotConverged, match=UNDETERMINED):
        solve(string_in_a_trap(eps, "sin(2*pi*x)", n))


@pytest.mark.slow
def test_contact_makes_a_nearly_singular_operator_regular():
    """Held by an obstacle u is well determined, whatever the operator is without it."""
    scene = string_in_a_trap(0.05, upper=1)
    penalty, vi = (solve(scene, method=method) for method in ("penalty", "vi"))
    force = [answer.record["contact"]["upper"]["force"] for answer in (penalty, vi)]
    assert force[0] == pytest.approx(force[1], rel=1e-4)
    assert extremes(vi) == pytest.approx((0, 1), abs=1e-9)


TRAPPED = "the drift flows away from some places on all sides"
CENTRE = ["20*(x - 0.5)", "20*(y - 0.5)"]
SQUARES = {"shape": "rectangle", "cells": 16}
RING = [f"where(hypot(x - 0.5, y - 0.5) > 0.3 and hypot(x - 0.5, y - 0.5) < 0.45, 53*({axis} - 0.5)/"
        f"max(hypot(x - 0.5, y - 0.5), 0.01), 0)" for axis in "xy"]  # fmt: skip
OUTWARDS = ["200*(x - 0.5)", "200*(y - 0.5)"]
EIGHT = {**SQUARES, "cells": 8}
# at the centre u = t while a particle there has not left; on coarse cells u stops growing after a time h/drift
IN_TIME = {"rate": 1, "time": {"end": 100, "steps": 50, "start": 0}}
COARSE = {
    "P1": (SQUARES, CENTRE, 0.2, "P1"),
    "P2": (SQUARES, CENTRE, 0.2, "P2"),
    "Q1": ({**SQUARES, "cell": "quadrilateral"}, CENTRE, 0.2, "Q1"),
    "box": ({"shape": "box", "cells": 6}, [*CENTRE, "20*(z - 0.5)"], 0.01, "P1"),
    "circles": (SQUARES, ["y - 0.5", "0.5 - x"], 1e-5, "P1"),
    "P2 coarse": (EIGHT, OUTWARDS, 1, "P2"),
    "calm inside": (EIGHT, RING, 1, "P1"),
    "a soft obstacle far off": (EIGHT, OUTWARDS, 1, "P1", {"soft_obstacle": {"upper": 1e9, "stiffness": 1}}),
    "an obstacle in reach": (EIGHT, OUTWARDS, 1, "P2", {"upper": 1}),
    "in time": (EIGHT, OUTWARDS, 1, "P1", IN_TIME),
    "later": (EIGHT, ["800*(t - 0.6)*(x - 0.5)", "800*(t - 0.6)*(y - 0.5)"], 1, "P1", {"time": {"end": 1, "steps": 4}}),
}


@pytest.mark.parametrize("case", slow_except(COARSE, "P2", "an obstacle in reach", "in time", "later"))
def test_drift_without_a_way_out_needs_fine_cells(case):
    """u grows by the exponential of a work that cells with Pe > 1 do not resolve: it would be wrong by any factor."""
    mesh, drift, tension, element, *more = COARSE[case]
    error, words = InputError if more[:1] == [IN_TIME] else NotConverged, ".*at t = 0.75" if case == "later" else ""
    with pytest.raises(error, match=TRAPPED + words):
        solve(Scene(mesh=mesh, tension=tension, load=1, drift=drift, **dict(*more)), element=element)


def test_drift_in_circles_in_time():
    """A cone that turns round is transported: its diffusion is no sign of a trap."""
    scene = Scene(mesh=SQUARES, tension=1e-4, rate=1, drift=["0.5 - y", "x - 0.5"],
                  time={"end": "2*pi", "steps": 40, "start": "max(1 - 5*hypot(x - 0.7, y - 0.5), 0)"})  # fmt: skip
    _, high = extremes(solve(scene))
    assert 0.1 < high <= 1.05


@pytest.mark.parametrize("value", [None, 0])
def test_drift_from_a_free_side_needs_fine_cells(value):
    """Nothing leaves by a side without boundary value: there u grows as exp(drift/tension)."""
    sides = [{"on": "right", "value": 0}] + ([] if value is None else [{"on": "left", "value": value}])
    scene = Scene(mesh={"shape": "interval", "cells": 16}, tension=0.02, load=1, drift=[1], boundary=sides)
    if value is None:
        with pytest.raises(NotConverged, match=UNDETERMINED + "|" + TRAPPED):
            solve(scene)
    else:
        assert extremes(solve(scene)) == pytest.approx((0, 1), abs=0.1)


@pytest.mark.parametrize("drift", [["10*x", 0], [0, "10*x"], ["-20*(x - 0.5)", "-20*(y - 0.5)"], ["7 + 5*y", "-5*x"]])
def test_drift_with_a_way_out_is_solved_on_coarse_cells(drift):
    """Where all flow comes from the boundary u is no larger than the time in which it crosses the domain."""
    low, high = extremes(solve(Scene(mesh=SQUARES, tension=1e-5, load=1, drift=drift)))
    assert -1e-9 <= low <= high <= 2


@pytest.fixture
def residence_times(monkeypatch):
    """Calls of the system for the residence time."""
    calls, compute = [], drift_checks.residence_time
    monkeypatch.setattr(drift_checks, "residence_time", lambda *given: calls.append(1) or compute(*given))
    return calls


def test_one_residence_time_for_each_contact_set(residence_times):
    """Another eps with the same contact set takes no other residence time; another contact set does."""
    scene = Scene(mesh=SQUARES, tension=0.02, load="-0.1 - x", lower=-0.1, drift=[1, 0.5])
    problem, sets = scene.problem(), []
    for eps in (1e-4, 1e-5, 1e-6, 10.0, 1e-5, 1e-5):
        sets.append(problem.solve(eps=eps).contact.x.array.copy())
    changes = sum(largest(COMM, np.abs(a - b)) > 0 for a, b in itertools.pairwise(sets))
    assert 0 < changes < len(sets) - 1
    assert len(residence_times) == 1 + changes


ROUND = {"mesh": {"shape": "interval", "cells": 64}, "axial_symmetry": True, "boundary": [{"on": "right", "value": 0}]}


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize("unit", slow_except([1e-8, 1.0, 1e8], 1.0))
@pytest.mark.parametrize("load", slow_except([2.05, 2.3, 2.5, -2.05], 2.05))
def test_no_film_beyond_its_limit_load(load, unit, method):
    """A round film of radius 1 carries the load 2 s at most: beyond it no solution exists."""
    scene = Scene(**ROUND, large_slope=unit, load=load * unit)
    with pytest.raises(InputError, match="no solution exists: the load"):
        solve(scene, method=method)


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize(("load", "far"), slow_except([(4.5, 1e9), (5, 1e9), (5, 100), (20, 30)], (5, 1e9)))
def test_no_film_reaches_a_far_obstacle(load, far, method):
    """Beyond the limit load a film is torn from its edge before it touches: no state is returned."""
    with pytest.raises(NotConverged):
        solve(Scene(mesh=SQUARE, large_slope=1, load=-load, lower=-far), method=method)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize(
    "mesh", [ROUND, {"mesh": {"shape": "disk"}, "boundary": [{"value": 0}]}], ids=["axial", "disk"]
)
@pytest.mark.parametrize(("load", "cells"), slow_except([(2.2, 64), (2.2, 128), (3, 32), (3, 64), (3, 128)], (3, 64)))
def test_no_film_falls_so_far(load, cells, mesh, method):
    """A film falls by the integral of q/(1 - q^2)^(1/2), q = (r - a^2/r) load/2: with q < 1, less than 0.9."""
    scene = Scene(**mesh, large_slope=1, load=-load, lower=-0.9)
    with pytest.raises(NotConverged, match="no solution has these boundary values"):
        solve(scene, cells=cells, method=method)
    low, _ = extremes(solve(scene.change({"obstacle.lower": -0.3}), cells=cells, method=method))
    assert low == pytest.approx(-0.3, abs=1e-3)


@pytest.mark.slow
def test_films_that_obstacles_hold():
    """Near obstacles carry what the film does not; concentrated forces draw a string to any depth."""
    low, _ = extremes(solve(Scene(mesh=SQUARE, large_slope=1, load=-5, lower=-0.1), method="vi"))
    assert low == pytest.approx(-0.1, abs=1e-12)
    string = {"mesh": {"shape": "interval", "cells": 64}, "large_slope": 1}
    for force, depth in ((1.99, 0.5 * 1.99 / np.sqrt(4 - 1.99**2)), (2.5, 20)):
        scene = Scene(**string, point_load=[{"at": 0.5, "force": -force}], lower=-20)
        assert extremes(solve(scene, method="vi"))[0] == pytest.approx(-depth, rel=1e-9)


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize("net", slow_except([1e-6, 1e-10, 1e-12], 1e-10))
@pytest.mark.parametrize("cells", slow_except([31, 32, 64], 32))
def test_contact_bears_the_small_rest_of_a_load(cells, net, method):
    """A free string on the ground: contact bears what is left of a load of both signs; without contact u was 4e8."""
    scene = Scene(mesh={"shape": "interval", "cells": cells}, tension=1, load=f"x - 1/2 - {net}", lower=0, boundary=[],
                  report={"force": "integral(p)", "end": "at(u, 1)"})  # fmt: skip
    answer = solve(scene, method=method)
    assert answer.report["force"] == pytest.approx(net, rel=0.01)
    assert answer.report["end"] == pytest.approx(1 / 12, rel=1 / cells)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_contact_bears_the_load_of_the_estimator(element):
    """With a bound the load is that of the estimator, which resolves a jump inside cells."""
    scene = loose({**SQUARE, "cells": 5}, load="where(x < 0.3123, -5, 1)", lower=-0.2, report={"force": "integral(p)"})
    answer = solve(scene, element=element, bound=True)
    assert answer.report["force"] == pytest.approx(5 * 0.3123 - 0.6877, rel=1e-6)


PROBLEMS = {problem.name: problem for problem in problems()}


@pytest.mark.ranks
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (k % 5 > 0)) for k, name in enumerate(PROBLEMS)]
)
def test_unsolvable(name):
    """All methods, one step; not a number at one place, on one rank; no matrix, no minimum."""
    held, said = attempt(PROBLEMS[name], COMM)
    assert held, said


def test_not_a_number_ends_at_once():
    """It cannot become one again: no step is taken, where there were a thousand; F is not a number at that node."""
    with pytest.raises(InputError, match=r"F at the start.* is not a finite number: it is nan at") as error:
        PROBLEMS["form, penalty: load not a number at one node of the last rank"].solve(COMM)
    assert isinstance(error.value.__context__, NotConverged) and error.value.__context__.iterations == 0


JUMP = {"tension": "where(x < 1/3, 1, 1e6)", "load": "-exp(-9*(x^2 + y^2))", "boundary": [{"value": 0}]}


def test_a_direct_solver_goes_on():
    """Tensions that jump by 1e6 within cells defeat algebraic multigrid; not if the user's options say how to solve."""
    mesh = {"shape": "rectangle", "cells": 10, "y": [0, 2], "diagonal": "crossed", "perturb": 0.2}
    scene = Scene(mesh=mesh, **JUMP).change({"solve.element": "P2"})
    answer = solve(scene, start="cold")
    assert answer.record["krylov_iterations"] > answer.record["newton_iterations"]  # it was tried
    with defaults("penalty_", {"ksp_max_it": 3}), pytest.raises(NotConverged, match="linear system"):
        solve(scene, start="cold")


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize(("k", "lower"), [(1e-9, -0.09), (1e-10, -0.09), (1e-11, -1.0), (1e-11, None)])
def test_weak_supports_determine_u(k, lower, method):
    """A load whose sum is zero on a foundation that is 1e9 times weaker than the tension: the mean of u is 0.

    Forces were in balance to 1e-10 at the start, a u that touches the obstacle: its mean was wrong by up to 5 ranges.
    """
    scene = membrane(load="sin(2*pi*x)", foundation=k, boundary=[], **({} if lower is None else {"lower": lower}))
    answer = solve(scene, method=method, cells=8)
    own = answer.u.x.array[: answer.level.owned]
    low, high = smallest(COMM, own), largest(COMM, own)
    assert abs(low + high) < 5e-3 * (high - low) and high - low == pytest.approx(0.165085, rel=1e-5)

"""What the word 'certified' stands for: alone where no datum is sampled, with the sampled data or the polygon named."""

import re
from contextlib import closing

import numpy as np
import pytest
from dolfinx import mesh as dmesh
from mpi4py import MPI
from scipy.special import j0

from fenicsx_obstacle import InputError, Scene, polynomials, releases, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.norms import Distance
from tests.conftest import BENCHMARKS, COMM, ON_SEVERAL_RANKS, membrane, slow_except

SQUARE = {"shape": "rectangle", "cells": 8}
AROUND = {"shape": "rectangle", "x": [-1, 1], "y": [-1, 1], "cells": 8}
DISK = {"shape": "disk", "cells": 8}
SIDES = ({"on": "left", "value": 0}, {"on": "right", "value": 1})


def bounded(element="P1", **data):
    scene = Scene(**{"mesh": SQUARE, "tension": 1, **data})
    return solve(scene.change({"solve.element": element}), bound=True)


def distance_from_finer(coarse, cells=64):
    """Energy norm of the difference to the solution on a finer mesh, on one rank: the error but for that mesh's own."""
    scene = coarse.scene.change({"mesh.cells": cells, "solve.element": "P1"})
    with closing(SolverContext(scene, MPI.COMM_SELF)) as fine:
        u, problem = fine.answer().u.x.array, fine.problem
        return Distance(problem).energy(u - coarse.at(problem.level.points.T))


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_an_oscillating_obstacle(element):
    """The cosines of benchmarks/bessel.toml are the Bessel functions that it claims; its bound holds."""
    scene = Scene.read(BENCHMARKS / "bessel.toml")
    x = np.random.default_rng(0).random((3, 100))
    expected = (j0(20 * x[0]) + 1) * (j0(20 * x[1]) + 1)
    assert np.abs(scene.model.upper.at(x, {}) - expected).max() < 1e-12
    answer = solve(scene, element=element, cells=8, bound=True)
    assert answer.bound.words == "certified"
    assert distance_from_finer(answer, 32) <= answer.bound.total


EXACT = [
    {"load": 1}, {"load": "where(y < x, 5, -1)"}, {"tension": "1 + 4*x*(1 - x)*y", "load": 1},
    {"tension": "where(x < 0.503, 1e6, 1)", "boundary": SIDES}, {"tension": "1/(1.01 + sin(150*x))", "boundary": SIDES},
    {"tension": "1 + max(x, y)/9 + r", "boundary": SIDES}, {"load": "x^4*y^4*100"}, {"load": "floor(4*x) % 2"},
    {"load": "r^2", "mesh": AROUND}, {"load": 1, "mesh": {**AROUND, "shape": "l-shape"}},
    {"load": 1, "boundary": [{"where": "x == 0 and y <= 0.5", "value": 0}]},
    {"boundary": [{"value": "x^5 - 10*x^3*y^2 + 5*x*y^4"}]}, {"boundary": [{"value": "ln(hypot(x + 0.1, y))"}]},
    {"load": "200*(x - 1/2)", "lower": "-0.3 - x*(1 - x)", "upper": "0.3 + y^2"},
    {"load": -10, "lower": "-0.1 - abs(x - 0.47)/3 - max(r - 0.7, 0)^2"},
    {"load": 20, "upper": "0.2*(1 + sin(3*x))*y"},  # it touches beside the boundary
    {"load": -10, "lower": "-0.1 - floor(4*x)/20"},
    {"load": -10, "lower": "where(r < 0.7, -0.1, 0.6 - r)"},
]  # fmt: skip


@pytest.mark.parametrize("element", slow_except(["P1", "P2"], "P1"))
@pytest.mark.parametrize("data", slow_except(EXACT, *EXACT[:3]))
def test_exact_data_are_certified(element, data):
    """Formulas and their conditions, inside cells too: certified alone, and the summary says so.

    Random scenes with data of these kinds compare the bound with the true error (test_random.py).
    """
    answer = bounded(element, **data)
    assert answer.bound.guaranteed and answer.bound.words == "certified"
    assert re.search(r"energy error at most .*certified", answer.summary())


def test_an_obstacle_that_jumps_beside_the_boundary():
    """With P2 what the state lacks there is no function of finite energy: the obstacle counts as sampled."""
    data = {"load": -10, "lower": "where(x <= 0.53, -0.1, -0.3)", "boundary": [{"on": "bottom", "value": -0.1}]}
    assert bounded("P2", **data).bound.words == "certified for the sampled obstacle"


@pytest.mark.parametrize("element", slow_except(["P1", "P2"], "P1"))
@pytest.mark.parametrize(("data", "reason"), [
    ({"load": "-0.01*r^(-1.9)", "mesh": AROUND}, "the load may be infinite"),
    ({"load": "1/(x - 0.503)"}, "the load may be infinite"),
    ({"load": 1, "tension": "abs(x - 0.503)"}, "the tension may be 0"),
    ({"load": 1, "tension": "1/(y - 0.503)^2"}, "the tension may be 0, negative, infinite"),
    ({"boundary": [{"where": "x == 0 and y < 0.311", "value": 0}]}, r"near \(0, 0.2812|near \(0, 0.3125"),
    ({"boundary": [{"where": "x == 0 and y < 0.375", "value": 0}]}, "not made of whole edges"),
    ({"boundary": [{"where": "x > 0.3", "value": 0}], "mesh": DISK}, "not made of whole edges"),
    ({"boundary": [{"where": "x == 0 or abs(y - 0.503) < 1e-3", "value": 0}]}, "not made of whole edges"),
])  # fmt: skip
def test_indicators(element, data, reason):
    """Poles, and parts of the boundary that end inside an edge: an indicator that says where."""
    bound = bounded(element, **{"load": -1, **data}).bound
    assert bound.words.startswith("an indicator: ") and not bound.guaranteed
    assert re.search(reason, bound.words), bound.words


def test_polygons():
    """Curved domains: for the polygon."""
    exact = solve(Scene(mesh=DISK, tension=1, load=4, exact="1 - r^2"), bound=True)
    assert exact.bound.words == "certified on the polygon of the mesh" and not exact.bound.guaranteed
    assert bounded(mesh=DISK, load="exp(x)").bound.words == "certified on the polygon of the mesh"


JUMPS = {
    "where(x < 0.503, 0, 1)": "(0.503, ", "where(x < 0.5, 0, 1)": "(0.5, ", "sign(x - 0.3)": "(0.3, ",
    "(x + y) % 0.7": "", "where(abs(x - 0.503) < 1e-7, 1, 0)": "(0.503, ",
    "1/(x - 0.503)": "(0.503, ", "1000 + where(x < 0.61, 0, 1)": "(0.61, ", "where(x == 0.5, 5, 0)": "(0.5, ",
    "where(x > .2, where(y < .4, 0, where(x < .7, 1, 2)), 0)": "", "where(r < 1.1, 0, 1)": "", "2*s": "(0.61, ",
    "theta*(x - 3)": "", "1e8 + where(x < 0.53, x, x + 0.005)": "", "atan(1/(x - 0.503))": "", "atan(tan(3*x))": "",
}  # fmt: skip
CONTINUOUS = (
    "where(sin(x) + cos(x) < 1.47, x, 0)",  # always, which halves of an edge show and the whole edge does not
    "where(x < 0.5, x, 1 - x)", "where(x < 0.503, x, 1.006 - x)", "abs((3*x) % 1 - 0.5)", "sqrt(abs(x - 0.503))",
    "x^0.1", "tanh(1e5*(x - 0.503))", "where(x < 0.503, x, x + 1e-12)", "max(r - 1.1, 0)", "c", "distance",
    "abs(y)^0.3",
)  # fmt: skip
DEFINED = {"s": "where(x < 0.61, 0, 5)", "c": "where(x < 0.61, 0, x - 0.61)"}


@pytest.mark.parametrize("value", slow_except(JUMPS, *list(JUMPS)[:3]))
def test_boundary_values_that_jump_are_rejected(value):
    """Inside an edge, at a vertex, in definitions: solved with a warning, and with a bound or a tolerance rejected."""
    mesh = AROUND if "theta" in value else SQUARE
    scene = Scene(mesh=mesh, tension=1, define=DEFINED, boundary=[{"value": value}])
    answer = solve(scene)
    assert f"jump at {JUMPS[value]}" in answer.record["boundary_jump"]
    assert f"warning: {answer.record['boundary_jump']}" in answer.summary()
    message = rf"\(no. 1\) value = .*: the boundary values jump at {re.escape(JUMPS[value])}.*, from"
    for options in ({"bound": True}, {"tol": 0.1}, {"bound": True, "element": "P2"}):
        with pytest.raises(InputError, match=message):
            solve(scene, **options)


@pytest.mark.parametrize("value", slow_except(CONTINUOUS, *CONTINUOUS[:4]))
def test_continuous_boundary_values_pass(value):
    """Kinks, roots, steep slopes and differences of round-off are no jumps."""
    answer = bounded(define=DEFINED, boundary=[{"value": value}])
    assert answer.bound.words.startswith("certified")
    assert "boundary_jump" not in answer.record


@pytest.mark.slow
def test_parts_that_meet():
    """Two parts with different values at their common node: rejected; with the same, or apart: not."""
    for other, jumps in (("0", False), ("x*(1 - x)", False), ("1", True), ("1 + x", True)):
        scene = membrane(load=1, boundary=[{"value": 0}, {"on": "top", "value": other}])
        if jumps:
            with pytest.raises(InputError, match=r"jump at \([01], 1\), from 0 to"):
                solve(scene, bound=True)
        else:
            assert solve(scene, bound=True).bound.guaranteed
    assert bounded(boundary=SIDES).bound.guaranteed


@ON_SEVERAL_RANKS
@pytest.mark.slow
def test_words_are_the_same_on_any_number_of_ranks():
    """All ranks say the same, and the same as one."""
    for data in ({"load": "where(x < 0.51, 1, 2)"}, {"load": "1/(x - 0.503)"}, {"load": "exp(x)", "mesh": DISK}):
        scene = Scene(**{"mesh": SQUARE, "tension": 1, **data})
        together, alone = (solve(scene, comm=comm, bound=True).bound for comm in (COMM, MPI.COMM_SELF))
        assert set(COMM.allgather(together.words)) == {together.words}
        assert together.words.partition(" near")[0] == alone.words.partition(" near")[0]


def test_jumps_on_a_mesh_of_the_callers_own():
    """Ranks tell each other of a jump in words: a mesh cannot be sent."""
    mesh = releases.settle(dmesh.create_unit_square(COMM, 8, 8))
    scene = Scene(mesh=mesh, tension=1, load=-1, boundary=[{"value": "where(x > 0.3, 1, 0)"}])
    assert "jump at (0.3" in solve(scene).record["boundary_jump"]
    with pytest.raises(InputError, match=r"jump at \(0\.3"):
        solve(scene, bound=True)


@pytest.mark.parametrize(
    "given",
    [
        {"load": 10, "foundation": 1, "upper": 0.5, "boundary": []},  # the load is borne where it acts
        {"load": 0, "boundary": [{"on": "bottom", "value": "4*x*(1 - x)"}]},  # on 2 cells a side the flux is 0
    ],
)
@pytest.mark.parametrize("cells", [2, 8])
def test_a_flux_of_round_off_alone_is_no_sign_of_overlapping_cells(given, cells):
    """Where the equilibrated flux is 0, what patches leave over is round-off of the forces."""
    scene = Scene(mesh={"shape": "rectangle", "cells": cells}, tension=1, **given)
    assert solve(scene, bound=True).bound.words == "certified"


def test_the_cones_of_two_edges_add_up():
    """The bound of what boundary values are between the nodes, in a corner whose two edges have the same sign."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 1}, tension=1, load=0,
                  boundary=[{"value": "min(1, 20*x*(1 - x) + 20*y*(1 - y))"}])  # fmt: skip
    with closing(SolverContext(scene)) as context:
        data = context.estimator.element.dirichlet
        cells = np.arange(len(data.deviation))
        points = polynomials.inner_points(3, 8)
        assert np.all(np.abs(data.values(cells, points)).max(axis=1) <= data.deviation)

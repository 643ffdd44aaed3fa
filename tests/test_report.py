"""[report]: figures of the solution with known values; values at points, distance."""

import json
import math

import numpy as np
import pytest

from fenicsx_obstacle import Answer, InputError, Scene, solve
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.mesh.boundary_distance import distance_to_simplices
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.scenes import meshes
from tests.conftest import COMM, DEMOS, membrane, slow_except
from tests.test_own_mesh import Own

# on the unit interval, square or cube with u = 3*x and tension 2, for any mesh
FIGURES = {
    "mean": ("integral(u)/integral(1)", 1.5),
    "spread": ("integral((u - mean)^2)", 0.75),
    "nested": ("integral((u - integral(u))^2) - spread", 0),
    "sixth": ("integral(x^6)", 1 / 7),
    "side": ("integral(u + x, 'right')", 4),
    "slopes": ("integral(slope)", 3),
    "through": ("integral(flux, 'left')", 6),
    "leftwards": ("integral(normal_flux, 'left')", -6),
    "rightwards": ("integral(normal_flux*x^2, 'right')", 6),
    "top": ("sup(u*where(x < 0.9, 1, 2))", 6),
    "bottom": ("inf(u - 7)", -7),
    "free": ("integral(p)^2 + integral(contact)", 0),
    "sum_": ("2*mean + pi + k", 3 + math.pi + 5),
}
POINTS = {"interval": "0.3", "rectangle": "0.3, 1/k", "box": "0.3, 0.2, sqrt(0.25)"}


CELLS = {"P1": None, "P2": "triangle", "Q1": "quadrilateral", "Q2": "quadrilateral"}
ELEMENTS = [*((shape, "P1") for shape in POINTS), ("rectangle", "P2"),
            *((shape, element) for element in ("Q1", "Q2") for shape in ("rectangle", "box"))]  # fmt: skip


@pytest.mark.parametrize(("shape", "element"), ELEMENTS)
def test_known_values(shape, element):
    """Polynomials up to degree 6 are integrated exactly; entries use earlier ones; nothing depends on the ranks."""
    entries = {name: text for name, (text, _) in FIGURES.items()}
    entries |= {"here": f"at(u, {POINTS[shape]})", "steep": f"at(flux, {POINTS[shape]})"}
    cell = "hexahedron" if shape == "box" and element != "P1" else CELLS[element]
    mesh = {"shape": shape, "cells": 5 if element == "P1" else 3, **({} if cell is None else {"cell": cell})}
    scene = Scene(mesh=mesh, tension=2, define={"k": 5}, report=entries,
                  boundary=[{"on": "left", "value": 0}, {"on": "right", "value": 3}])  # fmt: skip
    answer = solve(scene, element=element)
    expected = {**{name: value for name, (_, value) in FIGURES.items()}, "here": 0.9, "steep": 6}
    assert list(answer.report) == list(expected)
    for name, value in expected.items():
        assert np.isclose(answer.report[name], value, rtol=1e-9, atol=1e-9), name
    assert "mean = 1.5" in answer.summary()
    json.dumps(dict(answer.record))


def test_contact_figures():
    """The force is the integral of a P1 function; `contact` is 1 at nodes that press: its integral exceeds the area."""
    report = {"area": "integral(contact)", "force": "-integral(p)", "deep": "sup(u - c)", "none": "ln(-area)",
              "high": "max(1/u)", "low": "min(ln(u))"}  # fmt: skip
    answer = solve(membrane(load=8, upper="c", define={"c": 0.2}, report=report), eps=1e-6)
    contact = answer.record["contact"]
    assert 1.02 * contact["area"] < answer.report["area"] < 1.3 * contact["area"]
    assert np.isclose(answer.report["force"], contact["upper"]["force"], rtol=1e-12)
    assert np.isclose(answer.report["deep"], answer.record["penetration"], rtol=1e-9)
    assert all(answer.report[name] is None for name in ("none", "high", "low"))  # JSON knows no not-a-number
    assert "none = not finite" in answer.summary()


def test_the_area_of_contact_ends_with_the_obstacle():
    """A stop from -0.51 to 0.51, with no obstacle beside it: its last nodes bear the largest forces."""
    stop = {"load": -10, "lower": "where(abs(x) < 0.51, -0.1, -1e20)"}
    for cells in (16, 64):
        mesh = {"shape": "interval", "x": [-1, 1], "cells": cells}
        assert solve(membrane(mesh=mesh, **stop, boundary=[{"value": 0}])).area == pytest.approx(1.02, abs=2 / cells)


def test_slope_on_an_edge_is_the_mean_of_both_sides():
    """u = |x - 1/2| on the middle of the interval has slopes 1 and 1, x^2 there 0.9 and 1.1."""
    scene = Scene(mesh={"shape": "interval", "cells": 10}, tension=1, load=-2,
                  report={"s": "at(slope, 1/2)", "v": "at(u, 1/2)"},
                  boundary=[{"on": "left", "value": 0}, {"on": "right", "value": 1}])  # fmt: skip
    assert np.isclose(solve(scene).report["s"], 1.0)
    assert np.isclose(solve(scene).report["v"], 0.25)


BALANCES = {
    "square": ({"shape": "rectangle", "cells": 9}, ("left", "right", "bottom", "top"), {"load": "1 + x"}),
    "disk": ({"shape": "disk", "cells": 12}, ("circle",), {"load": 1}),
    "box": ({"shape": "box", "cells": 5}, ("left", "right", "bottom", "top", "back", "front"), {"load": 1}),
    "interval": ({"shape": "interval", "cells": 7}, ("left", "right"), {"load": 1, "tension": "1 + x"}),
    "contact": ({"shape": "l-shape", "cells": 12}, ("outer", "notch"), {"load": -9, "lower": -0.03}),
    **{
        element: ({"shape": "rectangle", "x": [0, 1.5], "cells": 8, "cell": CELLS[element], "perturb": 0.1},
                  ("left", "right", "bottom", "top"), {"tension": "1 + x", "load": -8, "lower": -0.1})
        for element in ("P2", "Q1", "Q2")
    },
}  # fmt: skip


@pytest.mark.parametrize("method", slow_except(["penalty", "vi"], "penalty"))
@pytest.mark.parametrize("name", BALANCES)
def test_normal_flux_balances_load_and_contact(name, method):
    """int tension du/dn is -int (load + p), to the solver's accuracy; a report says where its extremes are."""
    mesh, parts, data = BALANCES[name]
    entries = {f"out_{part}": f'integral(normal_flux, "{part}")' for part in parts}
    report = {**entries, "force": "integral(p)", "load": f"integral({data['load']})", "deepest": "inf(u)"}
    scene = membrane(mesh=mesh, report=report, **{"tension": 2, **data, "upper": 9})
    answer = solve(scene, method=method, **({"element": name} if name in CELLS else {}))
    found = answer.report
    assert np.isclose(sum(found[name] for name in entries), -found["load"] - found["force"], rtol=1e-8)
    assert np.isclose(answer.at(answer.record["report_places"]["deepest"]), found["deepest"], atol=1e-12)
    if "lower" in data:
        assert found["force"] > 1 and np.isclose(found["force"], answer.force.lower, rtol=1e-9)


def test_a_free_end_between_given_sides():
    """It has no flux, also where its only facet ends at both sides: u = y (h - y)/2 has the flux -h/2 there."""
    report = {name: f'integral(normal_flux, "{name}")' for name in ("left", "bottom", "top")}
    strip = {"shape": "rectangle", "y": [0, 0.125], "cells": 8}
    found = solve(membrane(mesh=strip, load=1, boundary=[{"on": ["bottom", "top"], "value": 0}], report=report)).report
    assert found["left"] == 0 and np.isclose(found["bottom"] + found["top"], -0.125)


def test_contact_on_a_part_is_not_integrated_over_cells():
    """The pressure is there a force per length."""
    wall = [{"on": "left", "value": 0}, {"on": "right", "upper": -0.1}]
    with pytest.raises(InputError, match=r'on a part of the boundary: integral\(p, "name of the part"\)'):
        solve(membrane(load=1, boundary=wall, report={"force": "2*integral(u*p)"}))
    report = {"force": "integral(p, 'right')", "out": "integral(u + 0*integral(contact, 'right'))"}
    answer = solve(membrane(load=1, boundary=wall, report=report))
    assert np.isclose(answer.report["force"], -answer.force.upper, rtol=1e-9)


def test_answer_at(folder):
    """The same values on all ranks, not-a-number outside, also of an answer read back."""
    scene = membrane(boundary=[{"value": "x + 2*y"}])
    answer = solve(scene)
    points = np.array([[0.1, 0.2], [1, 1], [0.5, 0.5], [1.1, 0.5], [0, 0]])
    answer.save(folder / "answer")
    for one in (answer, Answer.read(folder / "answer")):
        values = one.at(points)
        assert np.allclose(values, [0.5, 3, 1.5, np.nan, 0], equal_nan=True, atol=1e-9)
        assert len({text.tobytes() for text in COMM.allgather(values)}) == 1
    assert answer.at(np.empty((0, 2))).shape == (0,)
    # three coordinates, as in DOLFINx, and one point instead of a list
    assert np.allclose(answer.at(np.pad(points, ((0, 0), (0, 1)))), answer.at(points), equal_nan=True)
    for point in ([0.1, 0.2], (0.1, 0.2, 0.0)):
        assert answer.at(point).shape == ()
        assert np.isclose(float(answer.at(point)), 0.5)
    assert answer.at(points.reshape(1, 5, 2)).shape == (1, 5)
    for wrong in (0.1, [0.1], np.zeros((2, 4))):
        with pytest.raises(InputError, match=r"shape \(n, 2\), or one point, shape \(2,\), not"):
            answer.at(wrong)
    string = solve(membrane(mesh={"shape": "interval", "cells": 4}, boundary=[{"value": "x"}]))
    assert np.isclose(string.at([0.3]), 0.3)
    assert string.at([[0.3], [0.4]]).shape == (2,)
    with pytest.raises(InputError, match="coordinates beyond these must be 0"):  # three points on a line, it seems
        string.at([0.1, 0.2, 0.3])


def nodal_distance(mesh, element="P1"):
    scene = Scene(mesh=mesh, tension=1).change({"solve.element": element})
    level = meshes.build(scene, COMM)
    distance = Data(scene.model, level).distance
    return distance.x.array, level.V.tabulate_dof_coordinates().T


DISTANCES = {
    "interval": ({"shape": "interval", "cells": 40}, lambda x: np.minimum(x[0], 1 - x[0])),
    "rectangle": ({"shape": "rectangle", "x": [0, 3], "cells": 60},
                  lambda x: np.min([x[0], 3 - x[0], x[1], 1 - x[1]], axis=0)),
    "box": ({"shape": "box", "cells": 8}, lambda x: np.min([x, 1 - x], axis=(0, 1))),
    "l-shape": ({"shape": "l-shape", "x": [-1, 1], "y": [-1, 1], "cells": 20, "refine": 1},
                lambda x: np.min([x[0] + 1, 1 - x[0], x[1] + 1, 1 - x[1],
                                  np.hypot(np.maximum(-x[0], 0), np.maximum(x[1], 0))], axis=0)),
    "disk": ({"shape": "disk", "cells": 40}, lambda x: 1 - np.hypot(x[0], x[1]), 0.05**2 / 4),
}  # fmt: skip


@pytest.mark.parametrize("name", DISTANCES)
def test_distance(name):
    """Exact for polygons, whatever the ranks; about 160 facets ask for several rounds of candidates. In the middle of a
    disk all facets are equally near; the polygon lies h^2/8 inside the circle."""
    mesh, exact, *tolerance = DISTANCES[name]
    for element in ("P1", "Q1") if name in ("rectangle", "box") else ("P1",):
        found, x = nodal_distance(mesh, element)
        assert np.allclose(found, exact(x), atol=max(tolerance, default=1e-12)), element


def test_distance_to_a_triangle():
    """Against a fine sampling of the triangle."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, 0.1], [0.3, 0.9, -0.2]])
    points = np.random.default_rng(1).uniform(-1, 2, (300, 3))
    s, t = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, 101), np.linspace(0, 1, 101)))
    samples = np.column_stack([1 - s - t, s, t])[s + t <= 1 + 1e-12] @ corners
    sampled = np.linalg.norm(points[:, None] - samples, axis=2).min(axis=1)
    exact = distance_to_simplices(points, np.broadcast_to(corners, (300, 3, 3)))
    assert np.all(exact <= sampled + 1e-12)
    assert np.allclose(exact, sampled, atol=0.01)


def test_distance_where_formulas_stand():
    """In an obstacle, a boundary value, an effect by midpoints, a definition and the report."""
    scene = membrane(
        define={"d": "2*distance"}, tension="1 + d", load=8, upper="d", boundary=[{"value": "distance"}],
        report={"volume": "integral(distance)", "stiff": "inf(where(slope > 0, flux/slope, 9))", "most": "sup(d)"},
    )  # fmt: skip
    report = solve(scene).report
    assert np.isclose(report["volume"], 1 / 6, rtol=0.01)
    assert np.isclose(report["stiff"], 1 + 2 / 16 / 3)  # midpoints of triangles with a side on the boundary
    assert np.isclose(report["most"], 1)


@pytest.mark.slow
def test_distance_needs_a_boundary_in_the_same_space(folder):
    scene, words = Scene.read(DEMOS / "bearing.toml"), "'distance' to the boundary is not available on curves"
    for change, key in (
        ({"obstacle.lower": "-distance"}, r"\[obstacle\] lower = -distance"),
        ({"report": {"d": "integral(distance*u)"}}, r"\[report\] d"),
    ):
        with pytest.raises(InputError, match=f"{key}: {words}"):
            solve(scene.change(change))


def test_places_of_extremes():
    """max, min, sup and inf of one argument say where they are, of equal ones the first by coordinates."""
    scene = membrane(boundary=[{"value": "x - 2*y"}], report={"top": "max(u)", "low": "min(u)", "slope_": "sup(slope)"})
    with pytest.raises(InputError, match=r"in \[report\] max of one argument is over the whole domain"):
        membrane(load="max(x)")
    answer = solve(scene)
    places = answer.record["report_places"]
    assert np.allclose(places["top"], [1, 0]) and np.allclose(places["low"], [0, 1])
    assert np.allclose(places["slope_"], [0, 0])
    assert "top = 1 at (1, 0), low = -2 at (0, 1)" in answer.summary()


@pytest.mark.slow
@pytest.mark.parametrize("element", ("P1", "P2"))
def test_flux_through_a_curve_inside(element):
    """From one side, and its jump: 0 where tensions 1 and 3 are in series, the load per length along the curve else."""
    report = {"leaving": "integral(normal_flux, 'middle', 'soft')", "jump_": "integral(jump, 'middle')",
              "entering": "integral(normal_flux, 'middle', 'hard')"}  # fmt: skip
    own, tension = Own(8), {"soft": 1, "hard": 3}
    ends = [{"on": "rim", "value": 0}, {"on": "far", "value": 1}]
    given = {"load": 0, "lower": None, "tension": tension, "facet_names": {"rim": 1, "far": 2, "middle": 3}}
    scene = own.scene(**given, report=report, boundary=ends)
    found = solve(scene, element=element).report
    assert np.isclose(found["leaving"], 1.5) and np.isclose(found["entering"], -1.5) and abs(found["jump_"]) < 1e-10
    # slopes a and b left and right of a load of 2 per length: a - 3 b = 2, a/2 + b/2 = 1
    loaded = own.scene(**given, report=report, boundary=[*ends, {"on": "middle", "flux": 2}])
    found, slopes = solve(loaded, element=element).report, np.linalg.solve([[1, -3], [0.5, 0.5]], [2, 1])
    assert np.isclose(found["leaving"], slopes[0]) and np.isclose(found["entering"], -3 * slopes[1])
    assert np.isclose(found["jump_"], 2)
    with pytest.raises(InputError, match=r"what .*boundary.* gives"):
        solve(loaded.change({"report": {"q": "integral(normal_flux, 'middle')"}}))
    for text, message in (
        ("integral(normal_flux, 'middle', 'rim')", "no material named 'rim'"),
        ("integral(normal_flux, 'middle')", "from one side it is integral"),
        ("integral(jump)", "jump is defined on a curve inside"),
        ("integral(normal_flux, 'rim', 'hard')", "'hard' is not next to 'rim'"),
    ):
        with pytest.raises(InputError, match=message):
            solve(own.scene(**{**given, "tension": 1}, report={"q": text}))


def test_the_flux_is_that_of_the_solver():
    """Of a tension that jumps inside a cell: in one dimension it is the same number everywhere."""
    scene = membrane(mesh={"shape": "interval", "cells": 8}, tension="where(x < 0.32, 1, 1000)",
                     boundary=[{"on": "left", "value": 0}, {"on": "right", "value": 1}],
                     report={"most": "max(flux)", "least": "min(flux)"})  # fmt: skip
    answer = solve(scene)
    assert np.allclose(list(answer.record["report"].values()), answer.at([0.35], "flux"), rtol=1e-9)


def test_extremes_of_the_pressure_are_at_its_nodes():
    """With P2 these are midpoints of edges; its values at vertices are extrapolated."""
    scene = membrane(load=-8, lower=-0.1, report={"most": "max(p)"})
    answer = solve(scene, element="P2", cells=16)
    assert np.isclose(answer.record["report"]["most"], largest(COMM, answer.pressure.x.array), rtol=1e-9)

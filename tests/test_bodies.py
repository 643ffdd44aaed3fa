"""Scenes with elastic bodies: patch tests, Hertz, forces that are given, what is rejected."""

import csv
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fenicsx_obstacle import (
    Answer,
    InputError,
    Scene,
    Table,
    find,
    solve,
    study,
)
from fenicsx_obstacle.answers.bodies import _nodes_across
from fenicsx_obstacle.answers.profiles import profiles_of
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.scenes.rigid_surfaces import facets_gap
from fenicsx_obstacle.show.bodies import contact_facets, eye_of
from fenicsx_obstacle.show.render import axes_of_view
from fenicsx_obstacle.show.report import report_answer
from tests.conftest import CLEAN, COMM, DEMOS, slow_except

LAW = {"young": 1, "poisson": 0.3, "plane": "strain"}
ROLLERS = [{"on": "left", "value": [0, "free"]}, {"on": "bottom", "value": ["free", 0]}]
ABOVE = {"on": "top", "obstacle": {"cylinder": 2, "centre": [0, 2.99]}}
CUBE = {"mesh": {"shape": "box", "cells": 3}, "elasticity": {"young": 1, "poisson": 0.3}}
CORNER = [{"on": "left", "value": [0, "free", "free"]}, {"on": "bottom", "value": ["free", 0, "free"]}]


def block(cells=8, boundary=(*ROLLERS, ABOVE), law=LAW, **more):
    """A square on rollers below a cylinder."""
    given = {"mesh": {"shape": "rectangle", "cells": cells}, "elasticity": law, "boundary": list(boundary), **more}
    return Scene(**given)


PATCHES = [("P1", "strain"), ("Q2", "strain"), ("P2", "axial"), ("Q1", "axial"), ("P1", "stress"), ("Q2", "stress")]


@pytest.mark.parametrize(("element", "kind"), slow_except(PATCHES, ("P1", "strain"), ("P2", "axial")))
def test_patch_in_the_plane(element, kind):
    """A uniform pressure or traction on the bottom, contact with a half-space above: p is that pressure, to 1e-10."""
    q, axial = 0.01, kind == "axial"
    law = {"young": 1, "poisson": 0.3, **({} if axial else {"plane": kind})}
    load = {"traction": [0, q]} if element in ("P1", "Q2") else {"pressure": q}
    parts = [ROLLERS[0], {"on": "bottom", **load}, {"on": "top", "obstacle": {"plane": [0, -2], "at": [5, 1.001]}}]
    scene = block(3, parts, law, **({"axial_symmetry": True} if axial else {}))
    scene = scene.change({"mesh.cell": "triangle" if element[0] == "P" else "quadrilateral", "solve.element": element})
    nodes = solve(scene).nodes
    assert np.allclose(nodes.pressure, q, rtol=1e-10)
    assert np.allclose(nodes.resultant, [0, -q / 2 if axial else -q], atol=1e-10 * q)
    assert np.allclose(nodes.normals, [0, -1])


@pytest.mark.parametrize(
    ("element", "cell"),
    slow_except([("P1", "tetrahedron"), ("P2", "tetrahedron"), ("Q1", "hexahedron")], ("P1", "tetrahedron")),
)
def test_patch_in_space(element, cell):
    """Weight alone presses a cube on a plane: the resultant is its weight, and contact alone holds the body upright."""
    parts = [*CORNER, {"on": "back", "obstacle": {"plane": [0, 0, 1], "at": [0, 0, 0]}}]
    scene = Scene(**CUBE, load=[0, 0, -0.01], boundary=parts)
    answer = solve(scene.change({"mesh.cell": cell, "solve.element": element}))
    assert np.allclose(answer.nodes.resultant, [0, 0, 0.01], atol=1e-11)
    assert np.allclose(answer.nodes.moment([0.5, 0.5, 0]), 0, atol=1e-3)


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["hertz_cylinder", "hertz_sphere", "hertz_solid"])
def test_hertz(name):
    """Force given, a/R = .05, body 40 a: half-width and peak within 1 % of Hertz, the approach of the sphere 2 %; also
    in space."""
    scene = Scene.read(DEMOS / f"{name}.toml")
    report = solve(scene).report
    wanted = scene.number("P" if name == "hertz_cylinder" else "F", "test")
    assert np.isclose(report["force"], wanted, rtol=1e-7)
    assert np.isclose(report["half_width_exact"], 1, rtol=1e-7)
    assert abs(report["half_width_error"]) < 1e-2 and abs(report["peak_error"]) < 1e-2
    assert abs(report.get("approach_error", 0.0)) < 2e-2


@pytest.mark.slow
def test_a_force_that_is_given():
    """The cylinder moves until it presses with its force, on a body that another plane supports; from the place that
    was found the same force follows."""
    obstacle = {"cylinder": 2, "centre": [0, 3.2], "force": 0.004, "moves": [0, -1]}
    floor = {"on": "bottom", "obstacle": {"plane": [0, 1], "at": [0, 0]}}
    boundary = [ROLLERS[0], {"on": "right", "value": ["free", 0]}, floor, {"on": "top", "obstacle": obstacle}]
    scene = block(boundary=boundary, report={"approach": "approach"})
    answer = solve(scene)
    top = answer.nodes.points[:, 1] > 0.5
    assert np.isclose(-answer.nodes.forces[top, 1].sum(), 0.004, rtol=1e-7)
    approach = answer.report["approach"]
    assert 0.2 < approach < 0.25
    obstacle = {"cylinder": 2, "centre": [0, 3.2 - approach]}
    again = solve(block(boundary=[*boundary[:3], {"on": "top", "obstacle": obstacle}]))
    assert np.allclose(again.nodes.forces, answer.nodes.forces, atol=1e-9)
    assert "approach" in answer.summary()


@pytest.mark.parametrize("at", [1, 1.1])
def test_a_force_on_a_body_that_is_lifted(at):
    """Given displacements lift the body, so that the obstacle stops before it reaches the body at rest: it has moved by
    gap - lift + F/E + eps F."""
    lift, force, eps = 0.05, 0.01, 1e-6
    stamp = {"plane": [0, -1], "at": [0, at], "force": force, "moves": [0, -1]}
    parts = [ROLLERS[0], {"on": "bottom", "value": ["free", lift]}, {"on": "top", "obstacle": stamp}]
    answer = solve(block(2, parts, {**LAW, "poisson": 0}, report={"approach": "approach"}), eps=eps)
    assert np.isclose(answer.report["approach"], at - 1 - lift + force * (1 + eps), atol=1e-9)


@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "Q2"])
@pytest.mark.parametrize("spring", [5, [5, 0]])
def test_a_rod_on_a_spring(element, spring):
    """A rod pulled by q on springs k: u_x = q/k + q x/E, u_y = -nu q y/E, to 1e-10; springs hold it."""
    q, far = 0.01, {"plane": [0, -1], "at": [0, 1.5]}
    parts = [{"on": "left", "spring": spring}, ROLLERS[1], {"on": "right", "traction": [q, 0]},
             {"on": "top", "obstacle": far}]  # fmt: skip
    scene = block(3, parts, {"young": 2, "poisson": 0.3, "plane": "stress"})
    scene = scene.change({"mesh.cell": "triangle" if element[0] == "P" else "quadrilateral", "solve.element": element})
    x = np.array([[0.0, 0.0], [0.4, 0.7], [1.0, 1.0]])
    exact = np.column_stack([q / 5 + q * x[:, 0] / 2, -0.3 * q * x[:, 1] / 2])
    assert np.allclose(solve(scene).at(x), exact, atol=1e-10 * q)


def resultant(kind, obstacle, **more):
    """Of the contact forces on a square, or on a cube, below an obstacle."""
    if kind == "plane":
        return solve(block(8, [*ROLLERS, {"on": "top", "obstacle": obstacle}], **more)).nodes.resultant
    parts = [*CORNER, {"on": "back", "value": ["free", "free", 0]}, {"on": "front", "obstacle": obstacle}]
    return solve(Scene(**CUBE, boundary=parts, **more)).nodes.resultant


@pytest.mark.slow
@pytest.mark.parametrize("kind", slow_except(["plane", "space"], "plane"))
def test_boxes(kind):
    """A wide box is a half-space, a narrow one the gap of its face alone, and it moves until its force is reached."""
    down, up, no = ([0, -1], 2, 1) if kind == "plane" else ([0, 0, -1], 3, 2)
    place = [0] * no + [1.49]
    half_space = resultant(kind, {"plane": down, "at": [0] * no + [0.99]})
    assert np.allclose(resultant(kind, {"box": [4] * no + [1], "centre": place}), half_space, rtol=1e-9)
    narrow = "where(x <= 0.7, where(y <= 2, -0.01, 1), 1)"
    stamp = {"box": [1.4, *[4] * (up - 2), 1], "centre": place}
    force = resultant(kind, stamp)
    assert np.allclose(force, resultant(kind, {"gap": narrow}), rtol=1e-9) and 0 < -force[-1] < -half_space[-1]
    if kind == "plane":
        pressed = resultant(kind, {**stamp, "centre": [0, 1.6], "moves": down, "force": -force[-1]})
        assert np.allclose(pressed, force, atol=1e-7 * abs(force[-1]))


def test_a_node_of_two_obstacles_has_the_nearer_one():
    """In whatever order the tables stand, and as one obstacle with both gaps; a body pushed by one of them moves it."""
    inner = {"where": "y > 1 - 1e-9 and x < 0.5 + 1e-9", "obstacle": {"plane": [0, -1], "at": [0, 1]}}
    outer = {"where": "y > 1 - 1e-9 and x > 0.5 - 1e-9", "obstacle": {"plane": [0, -1], "at": [0, 1.1]}}
    both = {"on": "top", "obstacle": {"gap": "where(x <= 0.5, 0, 0.1)", "along": [0, 1]}}
    cases = ((inner, outer), (outer, inner), (both,))
    found = [solve(block(8, [*ROLLERS, *parts], load=[0, 0.1])).force.lower for parts in cases]
    assert np.allclose(found, found[0], rtol=1e-9)
    inner["obstacle"] = {**inner["obstacle"], "force": 0.01, "moves": [0, -1]}
    outer["obstacle"]["at"] = [0, 0.9995]
    assert np.isclose(solve(block(8, [*ROLLERS, inner, outer])).force.lower, 0.01, rtol=1e-6)


def test_a_cylinder_that_has_moved_obliquely():
    """Half-width and peak are measured from where it is."""
    there = {"cylinder": 5, "centre": [0.5, 5.97]}
    path = {"cylinder": 5, "centre": [-2.5, 9.0], "travel": f"{np.hypot(3, 3.03)}*t", "moves": [3, -3.03]}
    report = {"width": "half_width", "most": "peak"}
    still, moved = (
        solve(block(32, [{"on": "bottom", "value": [0, 0]}, {"on": "top", "obstacle": one}], report=report, **more))
        for one, more in ((there, {}), (path, {"time": {"end": 1, "steps": 1}}))
    )
    for key in report:
        assert np.isclose(moved.report[key], still.report[key], rtol=1e-8)


@pytest.mark.slow
def test_nodes_without_an_obstacle(folder):
    """Beside a box gaps are infinite: at nodes, along the boundary, and in a saved answer."""
    answer = solve(block(8, [*ROLLERS, {"on": "top", "obstacle": {"box": [1, 1], "centre": [0, 1.49]}}]))
    beside = answer.nodes.points[:, 0] > 0.51
    assert np.isinf(answer.nodes.gap[beside]).all() and np.isfinite(answer.nodes.gap[~beside]).all()
    answer.save(folder)
    for one in (answer, Answer.read(folder)):
        assert np.isinf(one.at([0.8, 1.0], "gap")) and abs(one.at([0.25, 1.0], "gap")) < 1e-4
        assert np.isnan(one.at([0.5, 0.5], "gap"))


@pytest.mark.slow
@pytest.mark.parametrize("along", [[], [0.1, 1]])
def test_a_table_of_heights(along, folder):
    """A cylinder as a table: its force, exactly if the data are at the nodes, else up to the distance of the data."""
    given, x = {"along": along} if along else {}, np.linspace(-0.5, 1.5, 2001 if along else 17)
    z = 2.99 - np.sqrt(4 - x**2)
    exact = resultant("plane", {"cylinder": 2, "centre": [0, 2.99], **given})
    found = resultant("plane", {"table": Table(x=x, z=z), **given})
    assert np.allclose(found, exact, atol=(1e-4 if along else 1e-8) * abs(exact[1]))
    if COMM.rank == 0:
        folder.mkdir(exist_ok=True)
        np.savetxt(folder / "cylinder.csv", np.column_stack([x, z]))
    COMM.Barrier()
    of_file = {"file": str(folder / "cylinder.csv"), "shift": [0, 0.1]}
    moved = resultant("plane", {"table": of_file, "moves": [0, -1], "force": -found[1], **given})
    assert np.allclose(moved, found, atol=1e-6 * abs(found[1]))


def test_a_table_in_other_units():
    """Lengths of 1e-9 multiply the forces per thickness by 1e-9, also where the gap is not vertical."""
    x, forces = np.array([-2.0, 3.0]), []
    for size in (1.0, 1e-9):
        above = {"table": Table(x=size * x, z=size * (1.06 - 0.1 * x)), "along": [1, 1]}
        mesh = {"shape": "rectangle", "x": [0, size], "y": [0, size], "cells": 4}
        scene = block(boundary=[*ROLLERS, {"on": "top", "obstacle": above}], mesh=mesh)
        forces.append(solve(scene).force.resultant / size)
    assert np.allclose(forces[1], forces[0], rtol=1e-6) and forces[0][1] < -1e-3


def stl(path, low, high):
    """A box as a text file of facets whose normals point outwards."""
    corners = np.array(np.meshgrid(*zip(low, high, strict=True), indexing="ij")).reshape(3, 2, 2, 2)
    facets = []
    for k in range(3):
        for end in (0, 1):
            face = np.moveaxis(np.take(corners, end, axis=k + 1), 0, -1)
            face = face if (end == 1) == (k != 1) else face.transpose(1, 0, 2)
            facets += [face[[0, 1, 1], [0, 0, 1]], face[[0, 1, 0], [0, 1, 1]]]
    lines = [f"outer loop {' '.join('vertex ' + ' '.join(map(str, x)) for x in one)} endloop" for one in facets]
    path.write_text("solid a\n" + "\n".join(f"facet normal 0 0 0\n{one}\nendfacet" for one in lines) + "\nendsolid a\n")


@pytest.mark.slow
def test_a_surface_of_facets(folder):
    """A box as an STL surface is the box, also scaled, shifted and moved; a body behind it is told so."""
    if COMM.rank == 0:
        folder.mkdir(exist_ok=True)
        stl(folder / "box.stl", [-1.0, -1.0, 0.99], [0.7, 3.0, 2.0])
        stl(folder / "inside_out.stl", [0.7, 3.0, 2.0], [-1.0, -1.0, 0.99])
    COMM.Barrier()
    file = str(folder / "box.stl")
    exact = resultant("space", {"box": [1.7, 4, 1.01], "centre": [-0.15, 1, 1.495]})
    assert np.allclose(resultant("space", {"stl": {"file": file}}), exact, rtol=1e-7)
    moved = {"stl": {"file": file, "scale": 2, "shift": [0, 0, "-0.99 + 0.1"]}, "moves": [0, 0, -1]}
    wide = resultant("space", {"plane": [0, 0, -1], "at": [0, 0, 0.99]})
    assert np.allclose(resultant("space", {**moved, "force": -wide[2]}), wide, atol=1e-6 * abs(wide[2]))
    with pytest.raises(InputError, match="normals of an STL surface must point out of the obstacle"):
        resultant("space", {"stl": {"file": str(folder / "inside_out.stl")}})


def test_facets_far_from_the_origin():
    """Round-off of coordinates does not decide whether the normals of a closed surface point outwards."""
    corners = np.array([[1.1, 1.3, 1.7], [-1.2, -1.1, 1.6], [-1.3, 1.2, -1.4], [1.4, -1.5, -1.2]])
    outwards, found = corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]], []
    for place in np.linspace(1e6, 2e6, 9):
        body = np.array([[place, place / 3, -5.0 + place / 7]])
        for facets in (outwards, outwards[:, ::-1]):
            surface = SimpleNamespace(facets=facets + body + [0, 0, 5], source="tip.stl")
            try:
                found.append(facets_gap(surface, COMM, body, np.array([[0.0, 0.0, 1.0]]))(np.zeros(3))[0])
            except InputError:
                found.append(np.nan)
    assert np.allclose(found[::2], found[0], rtol=1e-6) and 3 < found[0] < 5 and np.isnan(found[1::2]).all()


@pytest.mark.slow
def test_equilibria_in_time(folder):
    """Poisson's ratio 0: under a plane that moves by d(t), beside a pull q(t) at the side and a value v(t), each row is
    the exact equilibrium p = E (d + v)/(1 + eps E), u_x = q/E; it is saved and read."""
    law, eps = {"young": 2, "poisson": 0, "plane": "strain"}, 1e-6
    stamp = {"plane": [0, -1], "at": [0, 1], "moves": [0, -1], "travel": "0.02*t"}
    parts = [ROLLERS[0], {"on": "bottom", "value": ["free", "0.01*t^2"]}, {"on": "right", "traction": ["0.1*t", 0]},
             {"on": "top", "obstacle": stamp}]  # fmt: skip
    report = {"pull": "at(u_x, 1, 0.5)", "approach": "approach"}
    scene = block(3, parts, law, time={"end": 2, "steps": 4}, report=report)
    answer = solve(scene, eps=eps)
    answer.save(folder)
    for history in (answer.time_history, Answer.read(folder).time_history):
        t, peak = history.column("t"), history.column("peak")
        assert np.allclose(t, [0, 0.5, 1, 1.5, 2]) and np.allclose(history.column("approach"), 0.02 * t)
        assert np.allclose(peak, (0.02 * t + 0.01 * t**2) / (1 / 2 + eps), rtol=1e-8, atol=1e-12)
        assert np.allclose(-history.column("force_y"), peak, rtol=1e-8, atol=1e-12)
        assert np.allclose(history.column("pull"), 0.1 * t / 2, rtol=1e-8, atol=1e-12)
    with pytest.raises(InputError, match=r"one equilibrium; solve\(\) takes \[time\]"):
        scene.problem(COMM)
    assert len(answer.time_history.frames) == 5 and "4 steps to t = 2, equilibria" in answer.summary()
    rows = list(csv.DictReader((folder / "history.csv").open()))
    assert len(rows) == 5 and np.isclose(float(rows[-1]["approach"]), 0.04)


@pytest.mark.slow
@pytest.mark.parametrize(("element", "steps", "frames", "kept"), [("P2", 4, 1, [0, 1, 2]), ("P1", 4, 0, [1])])
@pytest.mark.usefixtures("matplotlib_draws")
def test_pictures_show_the_largest_load(element, steps, frames, kept, folder):
    """A plane presses the body, most at t = 1, and leaves it at t = 2. The fields of t = 1 are saved, whatever else
    is; pictures and profiles show them, also of the folder, on any number of ranks: p = E d/(1 + eps E)."""
    law, eps, most = {"young": 2, "poisson": 0, "plane": "strain"}, 1e-6, 0.02 / (1 / 2 + 1e-6)
    stamp = {"plane": [0, -1], "at": [0, 1], "moves": [0, -1], "travel": "0.02*t*(2 - t)"}
    line = {"from": [0.5, 0.2], "to": [0.5, 1], "n": 3}
    scene = block(3, [*ROLLERS, {"on": "top", "obstacle": stamp}], law, profile={"up": line}, title="Pressed",
                  time={"end": 2, "steps": steps, "frames": frames})  # fmt: skip
    answer = solve(scene, eps=eps, element=element)
    answer.save(folder)
    assert np.allclose(answer.nodes.pressure, 0, atol=1e-12) and answer.record["time"]["largest"] == 1
    report_answer(answer, folder, picture=False)
    assert "t = 1, the moment of the largest contact force" in (folder / "report.html").read_text()
    for one in (answer, Answer.read(folder)):
        shown = one.shown
        assert np.allclose([frame.t for frame in one.time_history.frames], kept)
        assert shown.title == "Pressed, t = 1" and one.title == "Pressed"
        assert np.allclose(shown.nodes.pressure, most, rtol=1e-6) and len(shown.nodes.points) == len(one.nodes.points)
        assert np.allclose(shown.nodes.gap, -eps * most, rtol=1e-5)
        assert np.allclose(shown.at([0.3, 0.6]), [0, -0.6 * most / 2], rtol=1e-6, atol=1e-8)
        assert np.allclose(shown.at([[0.3, 0.6], [0.9, 0.2]], "von_mises"), most, rtol=1e-6)
        assert np.allclose(profiles_of(one)["up"].u[:, 1], -most / 2 * np.array([0.2, 0.6, 1]), rtol=1e-6)
        page = one.plot().page
        if COMM.rank == 0:
            labels = " ".join(axis.get_ylabel() for axis in page.axes)
            assert page._suptitle.get_text() == "Pressed, t = 1"
            assert "von Mises stress" in labels and "contact pressure" in labels


def test_the_last_moment_is_shown_as_it_is():
    """Where the load grows, or stays, pictures show the solution at the end with its element and its precision."""
    stamp = {"plane": [0, -1], "at": [0, 1], "moves": [0, -1], "travel": "0.02*min(t, 1)"}
    scene = block(3, [*ROLLERS, {"on": "top", "obstacle": stamp}], time={"end": 2, "steps": 4, "frames": 0})
    answer = solve(scene, element="P2")
    assert answer.record["time"]["largest"] == 2 and not answer.time_history.frames
    assert answer.shown.u is answer.u and answer.shown.title.endswith(", t = 2")


def test_a_load_that_decays_slowly():
    """Steps that each lose less than the force may differ by add up: the moment that is shown is near the largest."""
    stamp = {"plane": [0, -1], "at": [0, 1], "moves": [0, -1], "travel": "0.01*(1 - 4e-7*t)"}
    answer = solve(block(2, [*ROLLERS, {"on": "top", "obstacle": stamp}], time={"end": 6, "steps": 6}))
    assert answer.record["time"]["largest"] == 2


@pytest.mark.slow
def test_saved_and_read(folder):
    """A saved answer has its scene, its report and its values when it is read; nodes.csv has the contact nodes."""
    scene = block(4, report={"pushed": "integral(p, 'top')", "up": "min(u_y)", "most": "max(von_mises)"})
    answer = solve(scene, element="P2")
    answer.save(folder / "result")
    again = Answer.read(folder / "result")
    assert again.report == answer.report and again.scene.tables == answer.scene.tables
    assert np.isclose(answer.report["pushed"], -answer.nodes.resultant[1], rtol=1e-9)
    assert answer.report["up"] < 0 < answer.report["most"]
    for of in ("u", "pressure", "von_mises"):
        assert np.allclose(*(one.at([[0.3, 0.9], [0.0, 1.0]], of) for one in (again, answer)), rtol=1e-12)
    rows = list(csv.DictReader((folder / "result" / "nodes.csv").open()))
    assert np.allclose([float(row["p"]) for row in rows], answer.nodes.pressure, rtol=1e-10)


@pytest.mark.slow
def test_studies_and_searches():
    """A study over a number of [define], and the value of it for which a quantity reaches its target."""
    obstacle = {"cylinder": 2, "centre": [0, "3 - depth"]}
    scene = block(4, (*ROLLERS, {"on": "top", "obstacle": obstacle}), define={"depth": 0.01})
    forces = [row["contact.lower.force"] for row in study(scene, {"define.depth": [0.01, 0.02]})]
    assert 0 < forces[0] < forces[1]
    target = sum(forces) / 2
    rows = find(scene, {"define.depth": (0.01, 0.02)}, f"force = {target}")
    assert np.isclose(rows[-1]["contact.lower.force"], target, rtol=1e-3)


def obstacle(**keys):
    """The block below another obstacle; what is no key of it belongs to the scene."""
    more = {key: keys.pop(key) for key in ("time",) if key in keys}
    return {"boundary": [*ROLLERS, {"on": "top", "obstacle": keys}], **more}


def part(**keys):
    """The block with another part."""
    return {"boundary": [*ROLLERS, ABOVE, {"on": "right", **keys}]}


DOWN, AWAY = {"plane": [0, -1], "at": [0, 1]}, {"plane": [-1, 0], "at": [1.1, 0]}
HELD = {"on": "left", "value": [0, 0]}
MISTAKES = [
    ({"law": {"young": 1, "poisson": 0.3}}, "elasticity: plane = None: a plane body needs"),
    ({"law": {**LAW, "plane": "strian"}}, "elasticity.plane = 'strian': .* did you mean 'strain'"),
    ({"law": {**LAW, "young": -1}}, "elasticity.young.* must be positive"),
    ({"law": {**LAW, "poisson": 0.6}}, "elasticity: poisson = 0.6: must be above -1"),
    ({"axial_symmetry": True}, "with axial_symmetry there is no plane"),
    ({"load": -1}, "load = -1: is for scalar u, not for elastic bodies; give a list"),
    ({"foundation": 1}, "foundation: is for scalar u, not for elastic bodies"),
    (part(value=0), r'value = 0: u has several components: give a list, such as \[0, "free"\]'),
    (part(lower=0), "lower: bounds a scalar u; of an elastic body take 'obstacle'"),
    ({"lower": 0}, r"\[obstacle\] with elasticity: bounds a scalar u"),
    ({"time": {"end": 1, "steps": 2, "start": 0}}, r"\[time\] start: without rate or inertia an equilibrium"),
    (obstacle(cylinder=1, centre=[0, 2], moves=[0, -1], travel="x"), "must be the same everywhere"),
    (obstacle(cylinder=1, centre=[0, 2], moves=[0, -1], travel=1, force=1), "'force' and 'travel' exclude each other"),
    (obstacle(cylinder=2, centre=[0, 3], moves=[0, -1], travel="t", time={"end": 1, "steps": 2}),
     "displacements with slopes up to .* at t = 0.5"),
    (part(traction=[1]), "traction = .*: expected a list of two or three"),
    ({"boundary": ROLLERS}, "an elastic body without contact"),
    (part(), "the key 'value' is missing, or obstacle, pressure, spring, traction"),
    (part(spring=[1, 2, 3]), "spring: has 3 components, but u has 2 components"),
    (part(spring=[1, -1]), r"\(no. 4\) spring\[1\] = -1: must be at least 0"),
    (obstacle(centre=[0, 2]), "needs sphere or cylinder or box or plane or table or stl or gap"),
    (obstacle(box=[1, 0], centre=[0, 2]), r"box = \[1, 0\]: lengths along the axes must be positive"),
    (obstacle(box=[1, 1], centre=[3, 2]), "no line along n from a node of its part meets it"),
    (obstacle(table="x^2"), r"table = x\^2: expected {file = ...} of measured data"),
    (obstacle(table=Table(x=[0, 0.5], z=[1.1, 1.2])), "in one point; the data reach over x = 0 .. 0.5"),
    (obstacle(table=Table(x=[-5, 5], z=[-49, 51]), along=[1, 0.5]), "or 'along' for a steeper n"),
    (obstacle(stl=Table(x=[0, 1], z=[1, 1])), r"stl = .*: expected {file = \"surface.stl\"}"),
    (obstacle(cylinder=1), "cylinder needs the key 'centre'"),
    (obstacle(**DOWN, centre=[0, 1]), "'centre' does not belong to a plane"),
    (obstacle(cylinder=-1, centre=[0, 0]), "cylinder = -1: must be positive"),
    (obstacle(sphere=1, centre=[0, 2]), "in the plane take a cylinder"),
    (obstacle(cylinder=1, centre=[0, 2, 0]), "has 3 components, but points have 2 coordinates"),
    (obstacle(plane=[0, 0], at=[0, 1]), "has no direction"),
    (obstacle(cylinder=1, centre=[0, 2], force=1), "'force' or 'travel' and 'moves', .* go together"),
    (obstacle(cylinder=1, centre=[0, 2.1], force=1e-3, moves=[0, 1]), "moves = .*: away from the body"),
    ({"boundary": [*ROLLERS, {"on": ["top", "right"], "obstacle": {"gap": 0.1}}]}, "has an edge at"),
    (part(obstacle=AWAY), "meets another part with an obstacle"),
    (obstacle(cylinder=2, centre=[0, 2.7]),
     r"slopes up to .*, at \(.*\): elasticity is for small ones.* loads up to about 0\.\d+ times these"),
    ({"report": {"peak": "2*peak"}}, "'peak' has a meaning already"),
    ({"define": {"peak": 1}}, r"\[define\] peak: has a meaning of elastic bodies"),
    ({"boundary": [ABOVE]}, "the body is not supported"),
    ({"boundary": [{"on": "top", "obstacle": DOWN}, ROLLERS[0], {"on": "top", "value": ["free", "-0.001*x"]}]},
     r"\(no. 1\) obstacle has no effect where u is given along its direction, by no. 3; .* 'free'"),
    ({"boundary": [HELD, {"on": "top", "obstacle": {**DOWN, "at": [0, 0.9]}}]},
     r"\(no. 1\) value and the obstacle of \[\[boundary\]\] \(no. 2\) exclude each other: the given u is beyond "
     r"the obstacle by 0.1 at \(0, 1\); change one, or leave"),
    ({"boundary": [HELD, {"on": "top", "obstacle": {**DOWN, "moves": [0, -1], "travel": "t"}}],
      "time": {"end": 0.1, "steps": 2}},
     r"\(no. 2\), moved by 0.05, exclude each other: .* by 0.05 at \(0, 1\); .*, at t = 0.05"),
]  # fmt: skip


@pytest.mark.ranks
@pytest.mark.parametrize(("given", "words"), MISTAKES)
def test_what_is_rejected(given, words):
    """One message with the place and the remedy."""
    with pytest.raises(InputError, match=words):
        solve(block(4, **given))


@pytest.mark.parametrize("asked", [{"bound": True}, {"tol": 0.1}, {"uncertainty": True}, {"yardstick": True}])
def test_what_bodies_do_not_have(asked):
    """One sentence for each."""
    with pytest.raises(InputError, match=f"{next(iter(asked))}: for scalar u only, not for elastic bodies"):
        solve(block(4), **asked)


def test_a_remark_before_locking():
    """Poisson's ratio above 0.45 with P1: the output says that elements begin to lock."""
    words = "warning: poisson = 0.47 with elements of degree 1: they begin to lock"
    assert words in solve(block(4, law={**LAW, "poisson": 0.47})).summary()


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize(("name", "words"), [("hertz", "half-width"), ("raw_penalty", "ObstacleProblem")])
def test_scripts(name, words, tmp_path):
    """The scripts beside the scenes run; a half-width of the cylinder within 1 % of Hertz."""
    command = [sys.executable, str(DEMOS / f"{name}.py")]
    done = subprocess.run(command, capture_output=True, text=True, env=CLEAN, cwd=tmp_path, timeout=190, check=False)
    assert done.returncode == 0, done.stderr
    assert words in done.stdout
    if name == "hertz":
        numbers = [float(word.rstrip(",")) for word in done.stdout.splitlines()[1].split() if word[0].isdigit()]
        assert np.isclose(*numbers, rtol=1e-2)


@pytest.mark.slow
def test_contact_narrower_than_the_cells(folder):
    """Fewer than three nodes in contact: half-width and peak are null, with a remark; finer meshes have them."""
    pressed = {"on": "top", "obstacle": {"cylinder": 2, "centre": [0.53, 3.1], "force": 0.005, "moves": [0, -1]}}
    scene = block(6, [*ROLLERS, pressed], report={"a": "half_width", "f": "force_y"})
    answer = solve(scene)
    contact = answer.record["contact"]
    assert np.count_nonzero(answer.nodes.pressure > 0) < 3
    assert contact["half_width"] is contact["peak"] is answer.report["a"] is None
    assert np.isclose(answer.report["f"], -0.005) and np.isfinite(contact["approach"])
    summary = answer.summary()
    assert "fewer than 3 nodes across: it is narrower than the cells" in summary and "[mesh] cells" in summary
    assert not any(word in summary for word in ("; half-width", "; peak"))
    answer.save(folder)
    assert Answer.read(folder).record["contact"]["half_width"] is None
    fine = solve(scene.change({"mesh.cells": 24})).record
    hertz = np.sqrt(4 * 0.005 * 2 * (1 - 0.3**2) / np.pi)
    assert np.isclose(fine["contact"]["half_width"], hertz, rtol=0.2) and "remarks" not in fine


@pytest.mark.serial
@pytest.mark.parametrize(
    ("count", "places"),
    [
        (1, [(0.0,)]), (2, [(0.2,), (0.2 + 1e-9,)]), (2, [(-0.1,), (0.2,)]), (3, [(-0.1,), (0.0,), (0.1,)]),
        (3, [(0.0,), (0.1,)]), (4, [(0.05,), (0.15,)]), (2, [(0.2,)]),
        (3, [(0, 0), (0.1, 0), (-0.1, 0), (0, 0.1), (0, -0.1)]), (1, [(0, 0), (0.1, 0), (-0.1, 0)]),
        (3, [(0, 0), (0.1, 0), (0, 0.1)]),
    ],
)  # fmt: skip
def test_nodes_across_a_contact(count, places):
    """In the direction where they are fewest; those of one half or one quarter with their mirror images."""
    places = np.array(places, dtype=float)
    arms = np.insert(places, places.shape[1], 0.0, axis=1)
    assert _nodes_across(arms, np.full(len(arms), 0.01), places.shape[1]) == count


@pytest.mark.slow
@pytest.mark.parametrize(("element", "method"), [("P1", "penalty"), ("P2", "vi"), ("Q2", "penalty")])
def test_separate_contacts(element, method):
    """Two stamps on one side and one on another: each patch has the forces and the peak of its nodes, whatever the
    ranks; areas add up to the contact area."""
    parts = [
        {"on": "bottom", "value": [0, 0]},
        {"on": "top", "obstacle": {"gap": "where(abs(x - 0.5) > 0.3, -0.002 - 0.001*x, 1)"}},
        {"where": "abs(x - 1) + max(max(0.3 - y, y - 0.7), 0) < 1e-9", "obstacle": {"gap": "-0.003"}},
    ]
    cell = "quadrilateral" if element[0] == "Q" else "triangle"
    scene = block(10, parts).change({"mesh.cell": cell, "solve.element": element, "solve.method": method})
    answer = solve(scene)
    nodes, found = answer.nodes, answer.record["contact"]["patches"]
    x, y = nodes.points.T
    touches = nodes.pressure > 1e-10 * nodes.pressure.max()
    where = [touches & (y > 0.99) & (x < 0.5), touches & (y > 0.99) & (x > 0.5), touches & (x > 0.9) & (y < 0.9)]
    assert len(found) == 3
    for one, there in zip(found, where, strict=True):
        assert np.allclose(one["force"], nodes.forces[there].sum(axis=0), rtol=1e-12, atol=1e-15)
        assert one["peak"] == nodes.pressure[there].max() > 0
        size = (nodes.pressure * nodes.areas)[there]
        assert np.allclose(one["at"], size @ nodes.points[there] / size.sum())
    assert np.isclose(sum(one["area"] for one in found), answer.area, rtol=1e-12)
    assert answer.summary().count("  contact at (") == 3


def test_no_contact_has_no_patches():
    """Where nothing touches the list is empty, and the text names no contact."""
    answer = solve(block(4, [*ROLLERS, {"on": "top", "obstacle": {"gap": 1}}]))
    assert answer.record["contact"]["patches"] == [] and "  contact at" not in answer.summary()


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize(("places", "name"), [(["x == 0", "x == 1"], "parts"), (["y == 1", "x == 1"], "parts"),
                                              (["y == 1 and x < 0.3", "y == 1 and x > 0.7"], "x")])  # fmt: skip
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_no_line_joins_separate_contacts(places, name, element):
    """A line for each part of the contact boundary, each node after its neighbour; no part is drawn over another."""
    parts = [{"where": f"{place} and y > 0.2 and y < 0.8" if place[0] == "x" else place, "obstacle": {"gap": -0.002}}
             for place in places]  # fmt: skip
    answer = solve(block(10, [{"on": "bottom", "value": [0, 0]}, *parts]), element=element)
    page = answer.plot().page
    pressure, gap = page.axes[1:3]
    lines = [line.get_xydata() for line in pressure.lines if line.get_marker() == "."]
    assert len(lines) == 2 and sum(map(len, lines)) == len(answer.nodes.points)
    h = 0.05 if element == "P2" else 0.1
    assert all(np.allclose(np.abs(np.diff(line[:, 0])), h) for line in lines)
    spans = sorted((line[:, 0].min(), line[:, 0].max()) for line in lines)
    assert spans[0][1] < spans[1][0]
    label = gap.get_xlabel().replace("\n", " ")
    assert label == name or (name == "parts" and "its parts one after the other" in label)


FACES = ["left", "right", "bottom", "top", "back", "front"]


@pytest.mark.parametrize(("face", "element", "cell"), slow_except(
    [("top", "P1", "tetrahedron"), ("left", "P2", "tetrahedron"), ("bottom", "P1", "tetrahedron"),
     ("back", "Q1", "hexahedron"), ("front", "Q2", "hexahedron")],
    ("top", "P1", "tetrahedron"), ("left", "P2", "tetrahedron"),
))  # fmt: skip
def test_the_pressure_is_seen_on_its_facets(face, element, cell):
    """A plane presses a cube at one face; the opposite one and two others are held along their normals. The eye is on
    the side of the contact; all facets of the pressed face have its pressure, and no others."""
    axis, sign = FACES.index(face) // 2, 1 if FACES.index(face) % 2 else -1
    faces = [FACES[2 * k + (sign < 0 if k == axis else 0)] for k in range(3)]
    parts = [{"on": one, "value": [0 if k == held else "free" for k in range(3)]} for held, one in enumerate(faces)]
    inwards = [-sign if k == axis else 0 for k in range(3)]
    place = [(sign > 0) - sign * 0.01 if k == axis else 0 for k in range(3)]
    parts.append({"on": face, "obstacle": {"plane": inwards, "at": place}})
    scene = Scene(**CUBE, boundary=parts).change({"mesh.cells": 2, "mesh.cell": cell})
    answer = solve(scene, element=element)
    arrays = gather(answer.fields)
    if COMM.rank > 0:
        return
    side = 1.0 if "upper" in answer.record["contact"] else -1.0
    assert sign * axes_of_view(eye_of(answer.nodes, [side]))[2, axis] > 0.4
    facets = contact_facets(arrays, answer.nodes)
    corners = arrays["points"][facets]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert np.allclose(corners[..., axis], sign > 0) and np.isclose(areas.sum(), 1)
    assert np.allclose(np.abs(arrays["pressure"][facets]), 0.01, rtol=1e-3)

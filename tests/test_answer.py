"""Answers: figures, the saved folder, pictures."""

import json
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import ufl
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Scene, compare, solve, study
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import on_root, total
from tests.conftest import COMM, DEMOS, membrane


def test_record_has_every_figure(ball):
    """The contract of answer.json."""
    record = solve(ball, yardstick=True).record
    assert {"scene", "method", "element", "ranks", "cells", "cells_total", "dofs", "h", "h_max", "eps", "converged",
            "reason", "newton_iterations", "krylov_iterations", "newton_total", "krylov_total", "poisson_seconds",
            "memory_mb", "energy", "penetration", "contact", "versions", "command"} <= set(record)  # fmt: skip
    assert record["poisson_units"] > 0
    assert set(record["seconds"]) == {"total", "mesh", "solve"}
    assert set(record["errors"]) == {"energy", "l2", "h1", "max", "pressure_l2"}
    json.dumps(dict(record))


def test_contact_of_the_ball(ball):
    """Contact area and force tend to pi a^2 and to the flux -2 pi r u' = 2 pi A = 4.2742 through any circle."""
    record = solve(ball, cells=128, method="vi").record
    assert np.isclose(record["contact"]["area"], np.pi * 0.697965148223374**2, rtol=0.1)
    assert np.isclose(record["contact"]["lower"]["force"], 2 * np.pi * 0.680259411891719, rtol=2e-3)


def test_force_balance(disk):
    """Load = contact force + support reactions, to the accuracy of the solver."""
    context = SolverContext(disk)
    record = context.answer().record
    problem = context.problem
    support = total(COMM, problem.elastic.array[problem.fixed])
    load = 4 * 2  # f times the area of the square
    # rows of fixed dofs hold a(u, phi) - f(phi), free rows the contact force: all rows sum to -load
    assert np.isclose(support - record["contact"]["upper"]["force"], -load, rtol=1e-9)


def test_supports_are_no_contact():
    """Where u is given it may lie on the obstacle: its support bears that node's load, h^2 of 1, not the obstacle."""
    found = solve(membrane(load=-1, lower=0), method="vi")
    assert found.force.lower == pytest.approx(15**2 / 16**2, rel=1e-9)


def test_paraview_file_names_every_field(disk, folder):
    solve(disk, cells=8).save(folder / "answer")
    tree = ElementTree.parse(folder / "answer" / "fields.xdmf")
    names = {attribute.get("Name") for attribute in tree.iter("Attribute")}
    assert names == {"u", "pressure", "contact", "upper", "gap", "error"}


@pytest.mark.slow
def test_pyvista_reads_what_is_at_rest(disk, folder):
    """Its reader asks each file for a time."""
    pyvista = pytest.importorskip("pyvista", reason="pyvista is of the extra 'plot'")
    answer = solve(disk, cells=8)
    answer.save(folder / "answer")
    read = on_root(COMM, lambda: pyvista.read(folder / "answer" / "fields.xdmf").n_points)
    assert read == answer.dofs


@pytest.mark.slow
def test_rows_are_flat_dicts(disk):
    """study() gives what pandas takes, for a grid of any keys."""
    rows = study(disk, {"method": ["penalty", "vi"], "cells": [4, 8]})
    assert [row["vary.cells"] for row in rows] == [4, 8, 4, 8]
    assert all(row["poisson_units"] > 0 and row["memory_mb"] > 0 and row["errors.pressure_dual"] > 0 for row in rows)
    string = Scene.read(DEMOS / "string.toml")
    forces = [row["contact.upper.force"] for row in study(string, {"define.c": [0.1, 0.2, 0.3]}, cells=8)]
    assert forces == sorted(forces, reverse=True)


def test_fluxes_at_a_vertex_are_means_of_the_cells():
    """Each of the four quadrilaterals around it counts once, however they are cut for pictures."""
    mesh = {"shape": "rectangle", "cells": 4, "cell": "quadrilateral"}
    answer = solve(membrane(mesh=mesh, load="8 + 30*x - 9*y", tension="1 + 3*x"), element="Q1")
    beside = [[0.5 + dx, 0.25 + dy] for dx in (-1e-7, 1e-7) for dy in (-1e-7, 1e-7)]
    assert answer.at([0.5, 0.25], "flux") == pytest.approx(answer.at(beside, "flux").mean(axis=0), rel=1e-5)


def test_compare_on_one_mesh():
    """penalty against VI: the distances of the eps-study, sets that differ by a layer."""
    scene = Scene.read(DEMOS / "disk.toml").change({"solve.eps": 1e-4, "mesh.cells": 32})
    context = SolverContext(scene)
    penalty, vi = context.answer(), context.answer(scene.options_with(method="vi"))
    found = compare(penalty, vi)
    assert np.isclose(found["u"]["max"], 4e-4, rtol=1e-3)
    assert 0 < found["u"]["l2"] < found["u"]["h1"]
    assert np.isclose(found["u"]["energy"] ** 2 + found["u"]["l2"] ** 2, found["u"]["h1"] ** 2)
    assert 0.9 < found["contact"]["jaccard"] <= 1
    assert found["contact"]["hausdorff"] <= 2 * vi.level.h
    assert found["outside"] == 0
    assert compare(vi, vi)["u"]["max"] < 1e-15
    assert compare(vi, vi)["contact"] == {"jaccard": 1.0, "hausdorff": 0.0, "area": [vi.record["contact"]["area"]] * 2}


@pytest.mark.slow
def test_the_common_contact_of_disks_and_of_parts_of_an_edge():
    """Disks about an axis have areas a^2, and parts of an edge their lengths, whatever the cells beside it are."""
    disks = [
        solve(Scene(mesh={"shape": "interval", "cells": 200}, tension=1, load=load, axial_symmetry=True, lower=-0.3,
                    boundary=[{"on": "right", "value": 0}]))
        for load in (-4, -6)
    ]  # fmt: skip
    mesh = dmesh.create_rectangle(COMM, [np.zeros(2), np.ones(2)], [160, 12])
    x = mesh.geometry.x
    x[:, 0] = x[:, 0] ** 2
    x[:, 1] = x[:, 1] ** (1 + 3 * x[:, 0])
    parts = [{"where": "y > 1 - 1e-9", "value": 0}, {"where": "y < 1e-9", "lower": "-0.2 - 0.8*x"}]
    edges = [solve(Scene(mesh=mesh, tension=1, load=load, boundary=parts)) for load in (-1, -1.5)]
    for (small, large), apart in ((disks, 0.02), (edges, 0.03)):
        found = compare(small, large)["contact"]["jaccard"]
        assert found == pytest.approx(small.area / large.area, abs=apart)


def test_contact_at_single_points_has_nothing_in_common():
    """Two different points of an edge, and a point on the axis beside no contact."""
    edges = [solve(membrane(load=0, boundary=[{"on": "top", "value": 0}, {"on": "bottom", "lower": lower}]))
             for lower in ("0.1 - 5*abs(x - 0.25)", "0.1 - 5*abs(x - 0.75)")]  # fmt: skip
    assert all(one.contact.x.array.max(initial=0) <= 1 for one in edges)
    assert compare(*edges)["contact"]["jaccard"] == 0
    assert compare(edges[0], edges[0])["contact"]["jaccard"] == 1


def test_compare_with_a_tension_that_moves_or_is_in_ufl():
    """The energy norm of the difference has the tension at the end, and that of the expression."""
    square = dmesh.create_unit_square(COMM, 4, 4)
    for more in ({"tension": "1 + t", "time": {"end": 1, "steps": 1}, "mesh": {"shape": "rectangle", "cells": 4}},
                 {"tension": 2 + 0 * ufl.SpatialCoordinate(square)[0], "mesh": square}):  # fmt: skip
        found = compare(*(solve(Scene(**more, load=load, boundary=[{"value": 0}])) for load in (1, 2)))["u"]
        assert np.isclose(found["energy"] ** 2, 2 * (found["h1"] ** 2 - found["l2"] ** 2))


def test_compare_on_two_meshes():
    """A coarse answer against a finer one: about the coarse error, in both orders of the arguments."""
    scene = Scene.read(DEMOS / "ball.toml")
    coarse, fine = solve(scene, cells=32, method="vi"), solve(scene, cells=64, method="vi")
    found = compare(coarse, fine)
    assert found["u"] == compare(fine, coarse)["u"]
    assert 0.5 < found["u"]["l2"] / coarse.record["errors"]["l2"] < 1.2
    assert 0.7 < found["contact"]["jaccard"] < 1
    assert found["contact"]["hausdorff"] < 2 * coarse.level.h

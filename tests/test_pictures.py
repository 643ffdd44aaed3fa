"""Pictures, of Newton's method too: what is drawn, by whom, and that nobody's crash takes a study along."""

import os
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.show import render
from fenicsx_obstacle.show.figures import blank, figure
from fenicsx_obstacle.show.free_boundary import LEVELS, Patch, free_boundary, patch_of, rim, zero
from fenicsx_obstacle.show.maps import OUT_OF_CONTACT, draw_map, pressures
from fenicsx_obstacle.show.newton import animate_newton, iterates
from fenicsx_obstacle.show.space import draw_views
from tests.conftest import COMM, DEMOS, membrane, slow_except
from tests.helpers import grid, mesh_of


def measure(patch):
    """Sum of the lengths or areas of a patch."""
    edges = patch.points[patch.cells][:, 1:] - patch.points[patch.cells][:, :1]
    if edges.shape[1] == 1:
        return np.linalg.norm(edges[:, 0], axis=1).sum()
    return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2


def on_rank_0(answer):
    arrays = gather(answer.fields)
    return patch_of(arrays) if COMM.rank == 0 else None


def pixels(path):
    from matplotlib.image import imread

    return imread(path)[..., :3]


def test_cuts_of_a_linear_function_are_exact():
    """A plane cuts the unit square and cube in the right place, with the right area; fields are interpolated."""
    square = on_rank_0(solve(membrane(mesh={"shape": "rectangle", "cells": 5}, upper=1)))
    cube = on_rank_0(solve(membrane(mesh={"shape": "box", "cells": 3}, upper=1)))
    if COMM.rank != 0:
        return
    x = square.points[:, 0]
    square = Patch(square.points, square.cells, {"x": x})
    assert np.isclose(measure(zero(square, x - 0.3)), 1)
    assert np.allclose(zero(square, x - 0.3).fields["x"], 0.3)
    for normal, area in (((0, 0, 1), 1), ((1, 0, 1), np.sqrt(2))):
        plane = cube.points @ np.array(normal) - 0.37 * sum(normal)
        expected = area if sum(normal) == 1 else np.sqrt(2) * 0.74
        assert np.isclose(measure(zero(cube, plane)), expected)


def test_no_pressure_without_an_obstacle():
    """A string that touches nothing is drawn alone, with no axes for a contact pressure."""
    picture = solve(Scene(mesh={"shape": "interval", "cells": 8}, tension=1, load=1)).plot()
    assert COMM.rank > 0 or len(picture.page.axes) == 1


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize(("name", "radius"), [("ball", 0.697965148223374), ("disk", 0.5777150035509266)])
def test_free_boundary_is_a_smooth_closed_line(name, radius, element, request):
    """Within a cell of the exact circle, much rounder than the staircase of the nodes, which it still separates."""
    answer = solve(request.getfixturevalue(name), element=element)
    patch = on_rank_0(answer)
    if COMM.rank != 0:
        return
    (line,) = free_boundary(patch)
    r, h = np.linalg.norm(line.points, axis=1), answer.record["h"]
    assert np.abs(r - radius).max() < h
    assert r.std() < 0.1 * h
    assert np.all(np.bincount(line.cells.ravel()) == 2)
    (level,) = (patch.fields[name] for name in LEVELS.values() if name in patch.fields)
    assert np.all(level[patch.fields["contact"] == 1] < 0)
    assert np.all(level[patch.fields["contact"] == 0] > 0)


def with_a_hole(n=12):
    """The unit square without its middle third."""
    points, cells = grid(n, n)
    hole = np.all(np.abs(points[cells].mean(axis=1) - 0.5) < 1 / 6, axis=1)
    used, cells = np.unique(cells[~hole], return_inverse=True)
    return mesh_of(points[used], cells.reshape(-1, 3))


def test_a_hole_is_outlined_and_stays_white():
    """Both boundaries of the domain are lines; within it zero pressure has a colour, outside nothing has."""
    patch = on_rank_0(solve(Scene(mesh=with_a_hole(), tension=1, load=-1, lower=-5)))
    if COMM.rank != 0:
        return
    assert np.isclose(measure(Patch(patch.points, rim(patch.cells), {})), 4 + 4 / 3)
    _, pixel = drawn_map(patch)
    from matplotlib.colors import to_rgb

    assert np.allclose(pixel(0.5, 0.5), 1)
    assert np.allclose(pixel(0.31, 0.02), to_rgb(OUT_OF_CONTACT), atol=0.01)
    near = np.linspace(1 / 3 - 0.02, 1 / 3 + 0.02, 81)
    assert min(pixel(x, 0.5).max() for x in near) < 0.5  # a dark line


def drawn_map(patch):
    """Axes of the view from above, and the colour of its pixel at a point."""
    page, axis = figure(6, 5)
    draw_map(axis, patch, pressures(patch.fields["pressure"]), "u")
    page.canvas.draw()
    picture = np.asarray(page.canvas.buffer_rgba())[..., :3] / 255.0

    def pixel(x, y):
        across, up = axis.transData.transform((x, y))
        return picture[picture.shape[0] - 1 - int(up), int(across)]

    return axis, pixel


@pytest.mark.parametrize(
    ("element", "words"), [("P1", "at nodes, linear"), ("P2", "midpoints"), ("Q1-gauss", "centres of cells")]
)
@pytest.mark.usefixtures("matplotlib_draws")
def test_the_pressure_is_the_one_that_was_computed(element, words):
    """At each node its value, 0 at those out of contact; the page says where it was computed, and what was done."""
    cell = {"cell": "quadrilateral"} if element.startswith("Q") else {}
    answer = solve(membrane(mesh={"shape": "rectangle", "cells": 8} | cell, load=-8, lower=-0.05), element=element)
    arrays = gather(answer.fields)
    page = answer.plot().page
    if COMM.rank != 0:
        return
    axis, scale = page.axes
    drawn = [mesh for mesh in axis.collections if np.shape(mesh.get_array()) == arrays["pressure"].shape]
    assert any(np.array_equal(mesh.get_array(), arrays["pressure"]) for mesh in drawn)
    label = scale.get_ylabel().replace("\n", " ")
    assert words in label
    assert label.endswith("cut at the free boundary")
    if element == "P1":
        assert np.all(arrays["pressure"][arrays["contact"] == 0] == 0)


def test_obstacles_on_the_boundary_are_pressed_there():
    """A wide line along the boundary, where there is contact, has the colours of the pressure; inside there is none."""
    patch = on_rank_0(solve(Scene.read(DEMOS / "wall.toml"), cells=8))
    if COMM.rank != 0:
        return
    axis, pixel = drawn_map(patch)
    edges = rim(patch.cells)
    edges = edges[patch.fields["contact"][edges].all(axis=1)]
    lines = [line.get_array() for line in axis.collections if line.get_array() is not None]
    mean = patch.fields["pressure"][edges].mean(axis=1)
    assert 0 < len(mean) < 32 and mean.max() < 0 and any(np.array_equal(line, mean) for line in lines)
    assert np.all(pixel(0.95, 0.95) > 0.8)


class Seen:
    """What a plotter of pyvista is asked to draw."""

    def __init__(self):
        self.meshes = []

    def add_mesh(self, mesh, **look):
        self.meshes.append((mesh, look))

    def with_look(self, **look):
        """Meshes with these words, in the units of the view."""
        return [mesh for mesh, given in self.meshes if look.items() <= given.items()]


def seen(patch, kind, shown, monkeypatch):
    """What pyvista draws of a patch, and its view."""
    found = []
    monkeypatch.setattr(render, "rendered", lambda *given: found.append(given) or ([], "nobody"))
    page = blank(6, 5)
    scale = pressures(patch.fields[shown])
    draw_views(page, list(page.add_gridspec(1, 1)), patch, {shown: scale}, kind, "u")
    ((arrays, (view,)),) = found
    plotter = Seen()
    render._add(plotter, render._grid(arrays, view), view)
    return plotter, view


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_contact_is_drawn_on_the_obstacle(side, monkeypatch):
    """However deep a large eps lets u sink in, the contact is not hidden under the surface of the obstacle."""
    pytest.importorskip("pyvista")
    sign = 1 if side == "lower" else -1
    answer = solve(membrane(load=-8 * sign, **{side: f"{-sign}*(0.1 + 0.2*(x - 1/2)^2)"}), eps=0.1)
    assert answer.record["penetration"] > 0.02
    patch = on_rank_0(answer)
    if COMM.rank != 0:
        return
    plotter, view = seen(patch, "graph", "pressure", monkeypatch)
    (contact,) = plotter.with_look(scalars="pressure")
    points = contact.points / view.scale
    obstacle = -sign * (0.1 + 0.2 * (points[:, 0] - 0.5) ** 2)
    assert len(points) > 50
    assert np.min(sign * (points[:, 2] - obstacle)) > -0.02 * (view.upper[2] - view.lower[2])
    # both parts together are the domain
    (free,) = plotter.with_look(color=render.FREE)
    for part in (contact, free):
        part.points[:, 2] = 0
    assert np.isclose(contact.area + free.area, 1, rtol=1e-5)


@pytest.mark.variant
@pytest.mark.slow
def test_an_obstacle_outside_the_picture_is_not_drawn(monkeypatch):
    """Of two obstacles the far one is outside the box around u: the other one is drawn, and the contact."""
    pytest.importorskip("pyvista")
    patch = on_rank_0(solve(membrane(load=8, lower=-5, upper=0.1, mesh={"shape": "rectangle", "cells": 8})))
    if COMM.rank != 0:
        return
    plotter, view = seen(patch, "graph", "pressure", monkeypatch)
    (obstacle,) = plotter.with_look(color=render.OBSTACLE)
    assert np.allclose(obstacle.points[:, 2] / view.scale[2], 0.1, atol=0.01)
    assert len(plotter.with_look(scalars="pressure")) == 1


@pytest.mark.variant
@pytest.mark.slow
def test_a_solid_is_cut_open_without_slivers(monkeypatch):
    """A cut through a whole layer of nodes: none of its triangles is without area, and together they are the cut."""
    pytest.importorskip("pyvista")
    patch = on_rank_0(solve(membrane(mesh={"shape": "box", "cells": 4}, load=30, upper=0.1)))
    if COMM.rank != 0:
        return
    plotter, view = seen(patch, "solid", "u", monkeypatch)
    cut = [mesh for mesh in plotter.with_look(scalars="u") if mesh.n_cells]
    assert len(cut) == 2  # in contact, and out of it
    assert np.isclose(sum(mesh.area for mesh in cut), 1 + 1 + 4 * 0.5, rtol=1e-3)
    sizes = np.concatenate([mesh.extract_surface().compute_cell_sizes()["Area"] for mesh in cut])
    assert np.median(sizes) > 1e-3
    assert np.mean(sizes < 1e-9) < 0.01
    assert view.lower[1] == 0.5


@pytest.mark.serial
@pytest.mark.parametrize("half", [False, True])
def test_a_body_has_its_pressure_on_the_pressed_face(half, monkeypatch):
    """A cube pressed at x = 1: the pressure is on that face alone, towards the eye; of a smaller box a part."""
    pytest.importorskip("pyvista")
    held = [{"on": on, "value": [0 if k == axis else "free" for k in range(3)]}
            for axis, on in enumerate(("left", "bottom", "back"))]  # fmt: skip
    stamp = {"on": "right", "obstacle": {"plane": [-1, 0, 0], "at": [0.98, 0, 0]}}
    scene = Scene(mesh={"shape": "box", "cells": 2}, elasticity={"young": 1, "poisson": 0}, boundary=[*held, stamp])
    found = []
    monkeypatch.setattr(render, "rendered", lambda *given: found.append(given) or ([], "nobody"))
    solve(scene).plot()
    ((arrays, (_, view)),) = found
    if half:
        view = replace(view, lower=np.array([0.5, 0.25, 0.0]))
    plotter = Seen()
    render._add(plotter, render._grid(arrays, view), view)
    (pressure,), (body,) = plotter.with_look(scalars="pressure"), plotter.with_look(color=render.FREE)
    face, size = (0.75, 0.48 * 0.75 * 2 + 0.48 * 2 + 1.5) if half else (1.0, 2 + 4 * 0.98)
    assert np.isclose(pressure.area, face, rtol=1e-3) and np.isclose(body.area, size, rtol=1e-3)
    shift = render.ABOVE_BODY * render.axes_of_view(view.eye)[2]
    assert shift[0] > 0 and np.allclose(pressure.points[:, 0], 0.98 + shift[0])


@pytest.mark.serial
def test_heights_have_a_unit_of_their_own(monkeypatch):
    """The box of a graph is the same in tiny and huge units of u, and in the plane it is the domain."""
    views = []
    monkeypatch.setattr(render, "rendered", lambda arrays, given: (views.extend(given), ([], "not asked"))[1])
    for size in (1e-9, 1.0, 1e9):
        solve(membrane(load=-8 * size, lower=-0.3 * size)).plot()
        assert np.allclose((views[-1].upper - views[-1].lower) / (1, 1, size), (1, 1, 0.372), rtol=1e-3)


def test_an_obstacle_that_is_far_in_a_part_moves_no_line():
    """Nodes beside the contact set are not in contact, however far the obstacle is elsewhere."""
    scenes = [membrane(load=-8, lower=f"where(x < 0.7, -0.3, {far})") for far in ("-1e3", "-1e9")]
    near, far = (on_rank_0(solve(scene)) for scene in scenes)
    if COMM.rank == 0:
        assert measure(free_boundary(near)[0]) == pytest.approx(measure(free_boundary(far)[0]), rel=0.01)


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.usefixtures("matplotlib_draws")
def test_a_surface_in_space_has_a_picture(folder):
    solve(Scene.read(DEMOS / "bearing.toml")).plot(folder / "bearing.png")
    picture = pixels(folder / "bearing.png")
    # deep red: the contact pressure
    assert np.count_nonzero((picture[..., 0] > 0.4) & (picture[..., 1] < 0.2) & (picture[..., 2] < 0.3)) > 1000


OUR_MPI = "' '.join(k for k in os.environ if k.startswith(('OMPI_', 'PMIX_'))) or 'clean'"
TROUBLE = {
    "pyvista is not installed": None,
    "pyvista failed (ImportError: no libGL)": "raise ImportError('no libGL')",
    "pyvista took more than 1 s": "import time; time.sleep(60)",
    "pyvista failed (exit status 0)": "",
    "pyvista crashed (SIGSEGV)": "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
    "pyvista failed (clean)": f"import os, sys; sys.exit({OUR_MPI})",  # VTK's process is none of our ranks
}


@pytest.mark.slow
@pytest.mark.parametrize("why", slow_except(TROUBLE, "pyvista is not installed"))
def test_trouble_with_pyvista_is_named(why, disk, folder, monkeypatch):
    code = TROUBLE[why]
    monkeypatch.setattr(render, "find_spec", lambda name: code if code is None else True)
    monkeypatch.setattr(render, "_WORKER", [sys.executable, "-c", code or ""])
    monkeypatch.setattr(render, "PATIENCE", 1.0 if "took" in why else 60.0)
    said = solve(disk, cells=4).plot(folder / "disk.png").said
    assert said.endswith(f"drawn by matplotlib, without views in space: {why}")
    picture = pixels(folder / "disk.png")
    assert np.count_nonzero((picture[..., 0] > 0.3) & (picture[..., 1] < 0.2)) > 5000  # contact in dark red


@pytest.mark.slow
def test_pyvista_has_a_display_where_xvfb_is(disk, folder, monkeypatch):
    """Of a stand-in for xvfb-run, the first on PATH."""
    stand_in = folder / "xvfb-run"
    stand_in.write_text('#!/bin/sh\nshift\nDISPLAY=:77 exec "$@"\n')
    stand_in.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(render, "find_spec", lambda name: True)
    monkeypatch.setattr(render, "_WORKER", [sys.executable, "-c", "import os, sys; sys.exit(os.environ['DISPLAY'])"])
    assert "pyvista failed (:77)" in solve(disk, cells=8).plot(folder / "disk.png").said


@pytest.mark.slow
def test_pyvista_draws_where_it_is(ball, folder):
    pytest.importorskip("pyvista")
    said = solve(ball, cells=16).plot(folder / "ball.png").said
    assert said.endswith("drawn by pyvista")


@pytest.mark.usefixtures("matplotlib_draws")
def test_a_notebook_shows_a_picture(disk, folder):
    """Jupyter looks for `_repr_png_`; rank 0 draws, the others have words. All say that a file cannot be written."""
    answer = solve(disk, cells=4)
    for picture in (answer.plot(), answer.plot(folder / "disk.png")):
        data = picture._repr_png_()
        assert "drawn by matplotlib" in repr(picture)
        assert data.startswith(b"\x89PNG") if COMM.rank == 0 else data is None
    with pytest.raises(InputError):
        answer.plot("/proc/nowhere/answer.png")


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("height", [0.0, 0.3])
def test_a_plane_mesh_with_three_coordinates(height, folder, recwarn):
    """It has the picture of a plane mesh, without warnings."""
    points, cells = grid(8, 8)
    x = points[:, 0]
    patch = patch_of({"points": np.column_stack([points, 0 * x + height]), "cells": cells, "u": x, "lower": 0 * x - 1,
                      "pressure": 0 * x, "contact": 0 * x})  # fmt: skip
    page = blank(6, 4)
    draw_views(page, list(page.add_gridspec(1, 1)), patch, {"u": pressures(x)}, "surface", "z")
    page.savefig(folder / "flat.png")
    assert not [one for one in recwarn if issubclass(one.category, UserWarning | RuntimeWarning)]


@pytest.mark.serial
@pytest.mark.parametrize(
    ("mesh", "element"),
    [({"shape": "rectangle", "diagonal": "left"}, "P1"), ({"shape": "rectangle"}, "P2"), ({"shape": "box"}, "P1")],
)
def test_corners_in_contact_have_the_pressure_beside_them(mesh, element):
    """Of contact up to the boundary all has pressure, and no free boundary; a part beside free nodes has none."""
    patch = on_rank_0(solve(membrane(mesh={**mesh, "cells": 4}, load=-3, lower=0), element=element))
    pressure = patch.fields["pressure"]
    assert pressure.min() > 1 and (element == "P2" or np.allclose(pressure, 3, rtol=0.05)) and not free_boundary(patch)
    scene = membrane(mesh={**mesh, "cells": 8}, load="where(x < 0.3, -30, 3)", lower=0)
    patch = on_rank_0(solve(scene, element=element))
    x, p = patch.points[:, 0], patch.fields["pressure"]
    assert p[x == 0].min() > 1 and np.all(p[x > 0.5] == 0)


STIFF = {"cells": 16, "eps": 1e-6}


def sets(steps):
    """Sizes and changes of active sets: the last digits of forces differ between two solves on several ranks."""
    return [(step.active, step.changed) for step in steps]


@pytest.mark.slow
@pytest.mark.parametrize("element", ["P1", "P2", "Q1-gauss"])
def test_active_sets_are_those_of_the_solve(element, disk):
    """One for the start and one for each step, with as many points in contact as the history says."""
    cell = {"mesh.cell": "quadrilateral"} if element.startswith("Q") else {}
    answer = solve(disk.change(cell), method="successive", element=element, **STIFF)
    found = iterates(answer.scene, answer.level)
    assert sets(one.step for one in found) == sets(answer.history)
    assert [one.number for one in found] == list(range(answer.record["newton_iterations"] + 1))
    if COMM.rank != 0 or element != "P1":
        return
    assert [np.count_nonzero(one.contact) for one in found] == [step.active for step in answer.history]
    for before, after in pairwise(found):
        assert np.count_nonzero(before.contact != after.contact) == after.step.changed


def test_all_levels_are_seen(ball):
    """From the coarsest level to the finest; all steps together are those that the answer reports."""
    answer = solve(ball, cells=64, eps=1e-6)
    found = iterates(answer.scene, answer.level)
    sizes = [one.dofs for one in found]
    last = [one.number for one, after in zip(found, [*sizes[1:], 0], strict=True) if one.dofs != after]
    assert sizes == sorted(sizes)
    assert len(last) > 2
    assert sum(last) == answer.record["newton_total"]
    assert sets(one.step for one in found if one.dofs == answer.record["dofs"]) == sets(answer.history)


@pytest.mark.parametrize("cell", ["right", "crossed"])
def test_no_contact_where_u_is_given_beyond_the_obstacle(cell):
    """P2, contact at midpoints of edges: the vertices of the boundary were in contact, a mean over edges inside."""
    scene = membrane(load=-40, lower=-0.05).change({"mesh.cells": 8, "mesh.diagonal": cell, "solve.element": "P2"})
    arrays = gather(solve(scene).fields)
    if arrays:
        x, y, _ = arrays["points"].T
        rim = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y)) < 1e-9
        assert not arrays["contact"][rim].any() and not arrays["pressure"][rim].any()
        assert arrays["contact"][~rim].mean() > 0.8


@pytest.mark.slow
def test_an_animation_has_a_frame_for_each_step(ball, folder):
    """And one for the start; the shorter course rests at its end."""
    answer = solve(ball, cells=32, eps=1e-6)
    said = animate_newton(answer, folder / "newton.gif")
    courses = [
        iterates(answer.scene.change({"solve.method": name}), answer.level) for name in ("successive", "penalty")
    ]
    assert f"(3.4)*, from no contact: {courses[0][-1].number} steps" in said
    assert f"from 1 coarser level: {courses[1][-1].number} steps" in said
    if COMM.rank == 0:
        with Image.open(folder / "newton.gif") as picture:
            assert picture.n_frames == max(len(time_history) for time_history in courses)
        assert [path.name for path in folder.iterdir()] == ["newton.gif"]


def test_what_is_not_flat_is_not_drawn(folder):
    """Contact sets of intervals, solids and scenes without obstacles are no pictures."""
    shapes = [{"mesh": {"shape": "interval", "cells": 8}, "load": -1, "lower": -0.1}, {"load": 1}]
    for given in shapes:
        assert animate_newton(solve(membrane(**given)), folder / "newton.gif").endswith("not drawn")
    assert not list(folder.iterdir())

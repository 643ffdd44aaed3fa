"""Measured heights as data: files and arrays of one surface, bounds over cells, saved results, mistakes."""

import numpy as np
import pytest

from fenicsx_obstacle import Answer, InputError, Scene, Table, solve
from fenicsx_obstacle.parallel import on_root
from tests.conftest import COMM, membrane
from tests.helpers import Membrane

SIZE = 33  # points along a side of the measured square
FILES = {
    "csv": {"file": "rough.csv"},
    "npy": {"file": "rough.npy"},
    "npz": {"file": "rough.npz"},
    "png": {"file": "rough.png", "x": [0, 1], "y": [0, 1], "range": [-0.1, 0.1]},
    "stl": {"file": "rough.stl"},
    "scattered": {"file": "scattered.csv"},
}


def surface(x, y):
    return 0.06 * np.sin(9 * x + 2 * y) * np.cos(7 * y - x) + 0.02 * np.sin(20 * x * y)


def write(folder, surface=surface, size=SIZE):
    """The same surface in files of all kinds (one rank)."""
    from PIL import Image

    axis = np.linspace(0, 1, size)
    x, y = np.meshgrid(axis, axis)
    z = surface(x, y)
    columns = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    np.savetxt(folder / "rough.csv", columns, delimiter=",", header="x,y,z", comments="")
    np.save(folder / "rough.npy", columns)
    np.savez(folder / "rough.npz", x=axis, y=axis, z=z)
    shades = np.round((z[::-1] + 0.1) / 0.2 * 65535).astype(np.uint16)
    Image.fromarray(shades).save(folder / "rough.png")
    at = np.arange(size * size).reshape(size, size)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    corners = columns[np.concatenate([np.column_stack([a, b, d]), np.column_stack([a, d, c])])]
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = corners
    (folder / "rough.stl").write_bytes(bytes(80) + len(facets).to_bytes(4, "little") + facets.tobytes())
    inner = np.random.default_rng(0).random((3 * size * size, 2))
    rim = np.concatenate([np.column_stack([axis, 0 * axis]), np.column_stack([axis, 0 * axis + 1])])
    points = np.unique(np.concatenate([inner, rim, rim[:, ::-1]]), axis=0)
    heights = surface(*points.T)
    np.savetxt(folder / "scattered.csv", np.column_stack([points, heights]), delimiter=" ")


def scene_text(table):
    keys = ", ".join(f"{key} = {value!r}".replace("'", '"') for key, value in table.items())
    return f"""
[define]
depth = 0.15
[mesh]
shape = "rectangle"
cells = 24
[effects]
tension = 1
load = -4
[obstacle]
lower = {{{keys}, shift = [0, 0, "-depth"]}}
[[boundary]]
value = 0
[report]
held = "integral(normal_flux, 'left') + integral(normal_flux, 'right')"
ends = "integral(normal_flux, 'bottom') + integral(normal_flux, 'top')"
pushed = "integral(p)"
"""


@pytest.fixture
def files(folder):
    on_root(COMM, write, folder)
    return folder


def in_file(folder, text, name="scene.toml"):
    on_root(COMM, (folder / name).write_text, text)
    return folder / name


@pytest.mark.slow
def test_one_surface_from_every_kind_of_file(files):
    """Contact force and u agree to the error of interpolation; force balances load; bounds over grids are certified."""
    found = {}
    for kind, table in FILES.items():
        answer = solve(Scene.read(in_file(files, scene_text(table), f"{kind}.toml")), bound=True)
        report = answer.report
        assert abs(report["held"] + report["ends"] + report["pushed"] - 4) < 1e-10, kind
        sampled = " for the sampled obstacle" if kind in ("stl", "scattered") else ""
        assert answer.bound.words == f"certified{sampled}", kind
        found[kind] = answer
    u = found["npz"].u.x.array
    h, curvature = 1 / (SIZE - 1), 14.0
    for kind, answer in found.items():
        error = h**2 / 4 * curvature  # of bilinear and linear interpolants; scattered points are as near on average
        assert np.abs(answer.u.x.array - u).max(initial=0.0) < error, kind
        assert answer.force.lower == pytest.approx(found["npz"].force.lower, rel=2e-2), kind
    for kind in ("csv", "npy"):
        assert found[kind].force.lower == pytest.approx(found["npz"].force.lower, rel=1e-12)


@pytest.mark.slow
def test_bound_is_above_the_error(files):
    """On a mesh that is coarser than the data, against a mesh that resolves them."""
    scene = Scene.read(in_file(files, scene_text(FILES["npz"])))
    coarse, fine = solve(scene, bound=True, cells=16), solve(scene, cells=128, bound=True)
    from fenicsx_obstacle import compare

    error = compare(coarse, fine)["u"]["energy"]
    assert error - fine.bound.total <= coarse.bound.total <= 12 * error
    assert any("data" in remark for remark in coarse.record["mesh_remarks"]) and "mesh_remarks" not in fine.record


def random_simplices(rng, corners, size, low, high):
    ends = (1 - size) * (np.array(high) - low)
    return low + rng.random((300, 1, 2)) * ends + rng.random((300, corners, 2)) * size * (np.array(high) - low)


def fields():
    rng = np.random.default_rng(1)
    x, y = np.linspace(0, 1, 11), np.sort(np.concatenate([[0, 2], 2 * rng.random(19)]))
    z = rng.standard_normal((21, 11))
    return {
        "grid": Table(x=x, y=y, z=z).on("grid"),
        "one axis": Table(x=x, z=rng.standard_normal(11)).on("one axis"),
        "turned": Table(x=3 * x - 1, y=2 * y - 1, z=z, rotate=30, shift=[0.5, -0.5, 3], scale=[1, 1, 0.1]).on("turned"),
    }


@pytest.mark.serial
@pytest.mark.parametrize("kind", fields())
@pytest.mark.parametrize("corners", (2, 3))
def test_enclosures(kind, corners):
    """Bounds of heights, and of their distance to a linear function, hold in cells of all sizes."""
    field, rng = fields()[kind], np.random.default_rng(2)
    ends = ([0, 0], [0.5, 0.5]) if kind == "turned" else ([0, 0], [1, 2])
    for size in (1, 0.3, 0.05, 0.003):
        cells = random_simplices(rng, corners, size, *ends)
        known = field.over(cells, {}, np.zeros(len(cells), int))
        bounds = known.once()
        weights = rng.dirichlet(np.ones(corners), 60)
        x = np.zeros((3, 300 * 60))
        x[:2] = (weights @ cells).reshape(-1, 2).T
        values = field.at(x, {}).reshape(300, 60)
        assert bounds.defined.all()
        assert np.all((values >= bounds.lower[:, None]) & (values <= bounds.upper[:, None]))
        linear, rest, _ = known.linear(np.arange(300))
        assert np.all(np.abs(values - linear @ weights.T) <= rest[:, None] + 1e-12)
        assert bounds.whole.mean() > 0.8 or size > 0.003


@pytest.mark.serial
def test_values():
    """Bilinear on a grid, linear along one axis; moved: scaled, turned, shifted; smoothed without a bias."""
    axis = np.linspace(0, 1, 5)
    plane = Table(x=axis, y=axis, z=1 + 2 * axis[None, :] - axis[:, None], smooth=0.0).on("plane")
    x = np.random.default_rng(0).random((3, 50))
    assert np.allclose(plane.at(x, {}), 1 + 2 * x[0] - x[1], atol=1e-14)
    assert np.isnan(plane.at(np.array([[1.1], [0.5], [0]]), {})).all()
    moved = Table(x=axis, y=axis, z=plane.table.z, scale=[2, 2, 3], rotate=90, shift=[2, 0, 1]).on("moved")
    assert np.allclose(moved.at(2 * x, {}), 1 + 3 * (1 + 2 * x[1] - (1 - x[0])), atol=1e-13)
    along = Table(x=axis[::-1], z=axis[::-1] ** 2, shift=[0.5, 1]).on("along")
    assert np.allclose(along.at(np.array([[0.5, 0.75, 0.625], [7, 8, 9], [0, 0, 0]]), {}), [1, 1.0625, 1.03125])
    rough = np.random.default_rng(0).standard_normal((40, 40))
    smooth = Table(x=[0, 1], y=[0, 1], z=rough, smooth=0.1).on("smooth")
    assert np.std(smooth.surface.z) < 0.15 * np.std(rough)


@pytest.mark.serial
def test_highest_facet_counts(tmp_path):
    """A closed body in an STL file: its top; bounds name it as sampled."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0.0, 0.5)])
    quads = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5)]
    facets = [(a, b, c) for a, b, c, d in quads] + [(a, c, d) for a, b, c, d in quads]
    lines = [f"facet normal 0 0 0\nouter loop\n{_vertices(corners[list(one)])}endloop\nendfacet" for one in facets]
    (tmp_path / "box.stl").write_text("solid box\n" + "\n".join(lines) + "\nendsolid box\n")
    field = Table(tmp_path / "box.stl").on("box")
    assert np.allclose(field.at(np.random.default_rng(0).random((3, 20)), {}), 0.5)
    assert field.over(np.zeros((1, 3, 2)), {}, np.zeros(1, int)) is None


@pytest.mark.serial
def test_walls_alone_are_no_heights(tmp_path):
    wall = _vertices(np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1.0]]))
    text = f"solid wall\nfacet normal 0 0 0\nouter loop\n{wall}endloop\nendfacet\nendsolid wall\n"
    (tmp_path / "wall.stl").write_text(text)
    with pytest.raises(InputError, match=r"wall.stl: 1 facet, all of them vertical"):
        Table(tmp_path / "wall.stl").on("wall").at(np.zeros((3, 1)), {})


def _vertices(corners):
    return "".join("vertex " + " ".join(f"{x:g}" for x in one) + "\n" for one in corners)


@pytest.mark.slow
def test_saved_result_is_solved_again_elsewhere(files):
    """The file is copied beside the scene; arrays are kept in an archive."""
    first = solve(Scene.read(in_file(files, scene_text(FILES["png"]))))
    first.save(files / "result")
    on_root(COMM, (files / "rough.png").unlink)
    again = solve(Answer.read(files / "result").scene)
    assert again.force.lower == pytest.approx(first.force.lower, rel=1e-12)
    axis = np.linspace(0, 1, SIZE)
    z = surface(*np.meshgrid(axis, axis)) - 0.15
    given = solve(membrane(load=-4, lower=Table(x=axis, y=axis, z=z, shift=[0, 0, 0.01])))
    given.save(files / "given")
    again = solve(Answer.read(files / "given").scene)
    assert again.force.lower == pytest.approx(given.force.lower, rel=1e-12) and given.force.lower > 0.1


def test_wherever_a_datum_stands(files):
    """Obstacles, loads, tensions by material, boundary values; in TOML, in Python and on a mesh of the user's own."""
    table = Table(files / "rough.npz", shift=[0, 0, 1])
    scene = membrane(tension=table, load=Table(files / "rough.csv", scale=[1, 1, 60], shift=[0, 0, -4]), lower=-0.05,
                     boundary=[{"value": Table(x=[0, 1], z=[0, 0.1])}])  # fmt: skip
    assert solve(scene).force.lower > 0
    lower = Table(files / "rough.npz", shift=[0, 0, -0.15])
    problem = Membrane(load=-4.0).problem(lower=lower)
    same = solve(membrane(load=-4, lower=lower))
    assert problem.solve().force.lower == pytest.approx(same.force.lower, rel=1e-3)


def test_masked_heights():
    """What a mask hides is no height."""
    axis = np.linspace(0, 1, 4)
    heights = np.ma.masked_greater(axis[:, None] + axis, 1.9)
    with pytest.raises(InputError, match="1 of 16 values are not finite numbers: at row 4, column 4"):
        solve(membrane(lower=Table(x=axis, y=axis, z=heights)))


def test_an_image_needs_extents_and_range(files):
    for key, given in (("extents", {}), ("range", {"x": [0, 1], "y": [0, 1]})):
        place = in_file(files, scene_text({"file": "rough.png", **given}), f"{key}.toml")
        with pytest.raises(InputError, match=f"an image: give {key}"):
            Scene.read(place)
    with pytest.raises(InputError, match=r"rough.csv = |obstacle.*0 .. 1"):
        solve(membrane(mesh={"shape": "rectangle", "x": [0, 2], "cells": 8}, lower=Table(files / "rough.csv")))

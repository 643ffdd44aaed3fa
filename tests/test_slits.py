"""Meshes that are no manifolds, or meet themselves: slits, whose sides have nodes at one place, and junctions."""

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Answer, InputError, Scene, compare, releases, solve
from fenicsx_obstacle.parallel import total
from tests.conftest import COMM, by_hand

CELLS = 16
RIDGE = {"rate": 1, "tension": 1, "load": "where(y > 0, 5, -5)", "lower": -0.3}


def slit_square():
    """The square from -1 to 1, cut open along y = 0 where |x| < 1/2."""
    i, j = np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij")
    first = (i * (CELLS + 1) + j).ravel()
    squares = np.column_stack([first, first + CELLS + 1, first + CELLS + 2, first + 1])
    x = np.linspace(-1, 1, CELLS + 1)
    points = np.array([(a, b) for a in x for b in x])
    lips = np.flatnonzero((np.abs(points[:, 1]) < 1e-9) & (np.abs(points[:, 0]) < 0.49))
    above = j.ravel() >= CELLS // 2
    other = np.arange(len(points))
    other[lips] = len(points) + np.arange(len(lips))
    squares[above] = other[squares[above]]
    return by_hand(np.vstack([points, points[lips]]), np.vstack([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]]))


def until(end, element, mesh):
    scene = Scene(mesh=mesh, **RIDGE, time={"end": end, "steps": round(10 * end), "start": 0})
    return {"scene": scene, "element": element}


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_both_sides_of_a_slit_keep_their_values(element, folder):
    """A run that is continued, one that is saved and read, and a comparison: each side of the slit has its own u."""
    mesh = slit_square()
    whole = solve(**until(0.4, element, mesh))
    solve(**until(0.2, element, mesh), keep=folder / "half")
    continued = solve(**until(0.4, element, mesh), restart=folder / "half")
    whole.save(folder / "whole")
    read = Answer.read(folder / "whole")
    for other in (whole, continued, read):
        found = compare(whole, other)
        assert found["u"]["max"] < 1e-11 and found["pressure"]["max"] < 1e-9 and found["contact"]["jaccard"] == 1
        frames = other.time_history.frames
        assert len(frames) == len(whole.time_history.frames) == 5
        assert all(sorted(one.fields) == sorted(frames[-1].fields) for one in frames)
    if COMM.rank == 0:
        for one, other in zip(whole.time_history.frames, continued.time_history.frames, strict=True):
            assert max(np.abs(one.fields[name] - other.fields[name]).max() for name in one.fields) < 1e-12
        last = read.time_history.frames[-1].fields["u"]
        assert np.ptp(last) > 0.5  # both sides of the slit are there
    assert abs(compare(whole, solve(**until(0.2, element, mesh)))["u"]["max"]) > 1e-3


def star(wires):
    """Wires of length 1 from one vertex, in ten intervals each; u = 0 at their ends."""
    angles = 2 * np.pi * np.arange(wires) / wires
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.vstack([np.zeros((1, 2)), *(way * np.linspace(0.1, 1, 10)[:, None] for way in ways)])
    starts = 1 + 10 * np.arange(wires)
    cells = np.vstack([np.column_stack([[0, *range(k, k + 9)], range(k, k + 10)]) for k in starts])
    mine = slice(None) if COMM.rank == COMM.size - 1 else slice(0)
    mesh = releases.create_mesh(COMM, cells[mine], points[mine], "interval")
    middle = dmesh.locate_entities(mesh, 0, lambda x: np.hypot(x[0], x[1]) < 1e-9)
    ends = dmesh.locate_entities(mesh, 0, lambda x: np.hypot(x[0], x[1]) > 1 - 1e-9)
    found = np.concatenate([middle, ends])
    order = np.argsort(found)
    marks = np.repeat([1, 2], [len(middle), len(ends)]).astype(np.int32)
    return dmesh.meshtags(mesh, 0, found[order].astype(np.int32), marks[order]), mesh


@pytest.mark.parametrize("wires", [2, 3, 4])
def test_a_part_where_wires_branch(wires):
    """What integrals over the junction leave out is rejected; a given u acts, and the junction counts once."""
    tags, mesh = star(wires)

    def scene(**at_the_middle):
        parts = [{"on": "ends", "value": 0}, {"on": "mid", **at_the_middle}]
        report = {"points": "integral(1, 'mid')", "height": "integral(u, 'mid')"}
        return Scene(mesh=mesh, tension=1, load=-1, boundary=parts, facet_tags=tags,
                     facet_names={"mid": 1, "ends": 2}, report=report)  # fmt: skip

    record = solve(scene(value=-0.1)).record
    assert record["report"] == pytest.approx({"points": 1.0, "height": -0.1}, abs=1e-12)
    for acting in ({"flux": -1}, {"spring": 2}, {"lower": -0.1}):
        if wires > 2:
            with pytest.raises(InputError, match=f"{wires} cells meet at a facet there; a flux, a spring"):
                solve(scene(**acting))
    if wires == 2:  # u'' = 1 on both sides, and 2 (-u(0) - 1/2) = 1
        assert solve(scene(flux=-1)).record["report"]["height"] == pytest.approx(-1.0)
    assert total(COMM, len(tags.find(1))) >= 1


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_sheets_that_share_an_edge(element, folder):
    """Three squares of a book: a load of 24 in all is carried by the back, the rim and the obstacle, on any ranks."""
    first = np.array([(i * 5 + j) for i in range(4) for j in range(4)])
    squares = np.column_stack([first, first + 5, first + 6, first + 1])
    i, j = (axis.ravel() / 4 for axis in np.meshgrid(np.arange(5), np.arange(5), indexing="ij"))
    pages = [np.outer(i, way) + np.outer(j, [0, 1, 0]) for way in ([1, 0, 0], [-1, 0, 0.5], [-0.5, 0, -1])]
    points, which = np.unique(np.vstack(pages).round(9), axis=0, return_inverse=True)
    cells = np.vstack(
        [which.ravel()[squares + 25 * k][:, corners] for k in range(3) for corners in ([0, 1, 2], [0, 2, 3])]
    )
    mine = slice(None) if COMM.rank == COMM.size - 1 else slice(0)
    mesh = releases.create_mesh(COMM, cells[mine], points[mine], "triangle")
    assert mesh.topology.index_map(0).size_global == len(points) == 3 * 20 + 5
    scene = Scene(mesh=mesh, tension=1, load=-8, lower=-0.3, boundary=[{"value": 0}])
    answer = solve(scene, element=element)
    answer.save(folder / "book")
    read = Answer.read(folder / "book")
    assert read.force.lower == pytest.approx(answer.force.lower, rel=1e-12)
    assert compare(answer, read)["u"]["max"] < 1e-12
    for wrong in ([], [0.1, 0.2], None, [[[0.1, 0.2, 0.0]]]):  # no consecutive points in space
        with pytest.raises(InputError, match=r"takes points, shape \(n, 3\)"):
            answer.on(wrong)
    assert answer.plain.level.dofs == (len(points) if element == "P1" else 225)
    assert 7 < answer.force.lower < 13 and answer.verify()

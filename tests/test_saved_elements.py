"""Saved answers keep their element: the functions that are read are those that were computed."""

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import Answer, InputError, Scene, compare, releases, solve
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.forms.pairs import Pair, _register, nodal_rule, register
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.launcher import mpirun
from fenicsx_obstacle.parallel import largest, on_root, total
from tests.conftest import CLEAN, COMM, as_version_02, membrane

SQUARE = {"shape": "rectangle", "cells": 5}
QUADS = {**SQUARE, "cell": "quadrilateral"}
BOX = {"shape": "box", "cells": 3}
BRICKS = {**BOX, "cell": "hexahedron"}
CASES = [("P1", SQUARE), ("P1", BOX), ("P1", {"shape": "interval", "cells": 7}), ("P1-voronoi", SQUARE), ("P2", SQUARE),
         ("P2", {"shape": "disk", "cells": 4}), ("Q1", {**QUADS, "perturb": 0.2}), ("Q2", QUADS), ("Q1-gauss", QUADS),
         ("Q1", BRICKS), ("Q2", BRICKS)]  # fmt: skip


def scene_of(element, mesh=SQUARE, **more):
    """Two obstacles, both touched, and a made-up exact solution, so that every field is there."""
    data = {"load": "30*(x - 0.4)", "lower": "-0.1 - 0.2*x", "upper": "0.15", "exact": "0.1*x", **more}
    return membrane(mesh=mesh, **data).change({"solve.element": element})


def table(answer):
    """Each field as rows (place of the node, value) of owned cells, on all ranks together, sorted by cell and node."""
    found = {}
    for name, function in answer.functions().items():
        V = function.function_space
        nodes = V.tabulate_dof_coordinates() if name != "u" else answer.level.points.T
        dofs = releases.cell_dofs(V)[: own_cells(answer.level.mesh)]
        centres = nodes[dofs].mean(axis=1, keepdims=True) + 0 * nodes[dofs]
        rows = np.concatenate([centres, nodes[dofs], function.x.array[dofs][..., None]], axis=2).reshape(-1, 7)
        rows = np.vstack(answer.level.comm.allgather(rows))
        found[name] = rows[np.lexsort(np.round(rows[:, :6], 9).T)]
    return found


def assert_same(read, saved):
    """Spaces, nodes and values."""
    assert read.level.pair is saved.level.pair
    assert read.functions().keys() == saved.functions().keys()
    ours, theirs = table(read), table(saved)
    for name in theirs:
        assert ours[name].shape == theirs[name].shape, name
        assert np.allclose(ours[name], theirs[name], rtol=0, atol=1e-14), name
        spaces = [a.functions()[name].function_space for a in (read, saved)]
        assert spaces[0].ufl_element() == spaces[1].ufl_element()


def energy(answer):
    u = answer.u
    return total(answer.level.comm, fem.assemble_scalar(releases.form(ufl.inner(ufl.grad(u), ufl.grad(u)) * ufl.dx)))


@pytest.mark.slow
@pytest.mark.parametrize("element, mesh", CASES)
def test_every_element_is_read_as_it_was_saved(element, mesh, folder):
    """u, pressure, contact, obstacles and error: the same degree and the same values at the same nodes."""
    scene = scene_of(element, mesh, lower="-0.05", load="30*(x - 0.4)")
    saved = solve(scene, eps=1e-6)
    saved.save(folder)
    read = Answer.read(folder)
    assert len(saved.functions()) == 6
    assert_same(read, saved)
    assert np.isclose(energy(read), energy(saved), rtol=1e-13)
    assert read.level.dofs == saved.record["dofs"] and read.record == json.loads(json.dumps(dict(saved.record)))
    inside = np.random.default_rng(3).random((20, saved.level.mesh.geometry.dim)) / 2
    assert np.allclose(read.at(inside), saved.at(inside), rtol=0, atol=1e-14)
    assert compare(saved, read)["u"]["h1"] < 1e-12
    read.save(folder / "again")
    assert_same(Answer.read(folder / "again"), saved)


@pytest.mark.slow
def test_an_adaptive_p2_answer_keeps_its_error(folder):
    """After --element P2 --tol the field that is read has the error that answer.json states."""
    saved = solve(Scene.read(Path(__file__).parent.parent / "demos" / "ball.toml"), element="P2", tol=0.1)
    saved.save(folder)
    read = Answer.read(folder)
    assert_same(read, saved)
    V, exact = read.level.V, saved.scene.tables.exact
    assert exact is not None and read.bound.relative < 0.1 and read.bound.record == saved.bound.record
    squared = []
    for answer in (read, saved):
        e = answer.error.x.array[: answer.level.owned]
        squared.append(total(COMM, e**2))
    assert np.isclose(*squared, rtol=1e-12) and releases.called(V.ufl_element().degree) == 2
    assert np.isclose(energy(read), energy(saved), rtol=1e-13)


@pytest.mark.parametrize("element", ["P2", "Q2"])
def test_values_at_points_are_those_of_the_element(element):
    """`at` gives u_h itself: a parabola is met to round-off between the nodes, too."""
    mesh = {**(SQUARE if element == "P2" else QUADS), "perturb": 0.1 if element == "P2" else 0.0}
    parabola = "x^2 + 2*y^2 + x*y"
    scene = membrane(mesh=mesh, load=-6, upper=9, boundary=[{"value": parabola}]).change({"solve.element": element})
    x = np.random.default_rng(1).random((30, 2))
    assert np.allclose(solve(scene).at(x), x[:, 0] ** 2 + 2 * x[:, 1] ** 2 + x[:, 0] * x[:, 1], atol=1e-9)


@pytest.mark.slow
def test_comparison_takes_the_elements_own_values():
    """The distance of a coarse P2 answer to a fine one is its error, not that of its linear interpolant."""
    scene = membrane(mesh={**SQUARE, "cells": 4}, load=1, upper=9)
    fine = solve(scene, cells=64)
    found, linear = (compare(solve(scene, element=element), fine)["u"]["l2"] for element in ("P2", "P1"))
    assert found < linear / 10


def test_pair_of_ones_own_is_read(folder):
    """A registered pair that P1 simplices do not hold."""
    register(Pair("mine", 2, {"quadrilateral": nodal_rule("quadrilateral", 2)}, ("Lagrange", 2)))
    try:
        saved = solve(scene_of("mine", QUADS))
        saved.save(folder)
        assert_same(Answer.read(folder), saved)
    finally:
        _register.pop("mine")
    with pytest.raises(InputError, match="'mine' is not known"):
        Answer.read(folder)


@pytest.mark.slow
def test_own_mesh_with_p2_is_solved_again(folder):
    """The scene of the folder names the mesh of the caller, not the cut cells that ParaView shows."""
    mesh = dmesh.create_unit_square(COMM, 5, 4)
    scene = Scene(mesh=mesh, tension=1, load=8, upper=0.3).change({"solve.element": "P2"})
    saved = solve(scene)
    saved.save(folder)
    read = Answer.read(folder)
    assert_same(read, saved)
    again = solve(read.scene)
    assert again.record["cells_total"] == 40 and again.record["dofs"] == saved.record["dofs"]
    assert np.isclose(again.record["energy"], saved.record["energy"], rtol=1e-10)
    solve(membrane(load=8, upper=0.3)).save(folder)
    COMM.barrier()
    assert not (folder / "element.xdmf").exists()


@pytest.mark.parametrize("element", ["P2", "Q1"])
def test_frames_of_a_scene_with_time(element, folder):
    """The moments that were kept belong to the nodes of what is drawn, after reading, too."""
    scene = scene_of(element, SQUARE if element == "P2" else QUADS, load="60*t*(x - 0.4)", exact=None,
                     time={"end": 1, "steps": 3})  # fmt: skip
    saved = solve(scene)
    saved.save(folder)
    read = Answer.read(folder)
    assert_same(read, saved)
    drawn = [gather(a.fields) for a in (saved, read)]
    if COMM.rank == 0:
        orders = [np.lexsort(np.round(arrays["points"], 9).T) for arrays in drawn]
        for one, other in zip(saved.time_history.frames, read.time_history.frames, strict=True):
            assert np.array_equal(one.fields["u"][orders[0]], other.fields["u"][orders[1]])


def test_nothing_is_stored_twice_for_p1(folder):
    """fields.h5 of P1 holds what it held in version 0.1; its answer and that of P1-voronoi have no group `element`."""
    for element in ("P1", "P1-voronoi"):
        solve(scene_of(element)).save(folder)

        def look():
            with h5py.File(folder / "fields.h5") as file:
                return sorted(file)

        names = ["cells", "contact", "error", "gap", "gdim", "lower", "points", "pressure", "u", "upper"]
        assert on_root(COMM, look) == names


def test_folders_of_version_01_are_refused(folder):
    """Without the group `element` there are nodal values on cut cells, which are none of the element's."""
    solve(scene_of("P2")).save(folder)

    def strip():
        as_version_02(folder)
        with h5py.File(folder / "fields.h5", "a") as file:
            del file["element"]

    on_root(COMM, strip)
    with pytest.raises(InputError, match=r"saved by version 0\.1"):
        Answer.read(folder)


def test_damage_is_told(folder):
    """A table of nodes that is missing, or that is of another element, is named; a file is no folder."""
    solve(scene_of("P2")).save(folder)
    on_root(COMM, as_version_02, folder)

    def change(edit):
        with h5py.File(folder / "fields.h5", "a") as file:
            edit(file["element"])

    on_root(COMM, change, lambda group: group.move("pressure", "kept"))
    with pytest.raises(InputError, match=r"damaged: fields.h5: 'pressure' has 6 values in a cell, and P2 3"):
        Answer.read(folder)
    on_root(COMM, change, lambda group: group.move("cells", "away"))
    with pytest.raises(InputError, match=r"fields\.h5 has no element/cells"):
        Answer.read(folder)
    with pytest.raises(InputError, match="a file, not the folder"):
        Answer.read(folder / "answer.json")


def test_a_part_of_the_ranks_reads(folder):
    """Each rank alone reads what all wrote."""
    saved = solve(scene_of("P2"))
    saved.save(folder)
    alone = Answer.read(folder, MPI.COMM_SELF)
    assert alone.level.comm.size == 1 and alone.level.dofs == saved.level.dofs
    theirs = table(saved)
    for name, rows in table(alone).items():
        assert np.allclose(rows, theirs[name], rtol=0, atol=1e-14)
    assert largest(COMM, abs(energy(alone) - energy(saved))) < 1e-12


SEVERAL = """
import sys
import numpy as np
from tests.conftest import COMM
from tests.test_saved_elements import table
from fenicsx_obstacle import Answer, Scene, solve
folder = sys.argv[1]
saved = solve(Scene.read(folder + "/scene.toml"), eps=1e-6)
saved.save(folder + "/several")
fields = table(saved)
if COMM.rank == 0:
    np.savez(folder + "/fields.npz", **fields)
Answer.read(folder + "/one").save(folder + "/through")
"""


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("ranks, element, mesh", [(2, "P2", SQUARE), (2, "Q1-gauss", QUADS), (3, "Q2", QUADS)])
def test_other_numbers_of_ranks(ranks, element, mesh, folder):
    """Written on several ranks and read on one; written on one, read and written again on several, read on one."""
    scene = scene_of(element, mesh)
    (folder / "scene.toml").write_text(scene.toml())
    here = solve(scene, eps=1e-6)
    here.save(folder / "one")
    command = [*mpirun(ranks), sys.executable, "-c", SEVERAL, str(folder)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=150, env=CLEAN, cwd=Path(__file__).parent.parent, check=False
    )
    assert done.returncode == 0, done.stderr
    found = table(Answer.read(folder / "several"))
    with np.load(folder / "fields.npz") as expected:
        assert set(expected) == set(found)
        for name, rows in found.items():
            assert np.allclose(rows, expected[name], rtol=0, atol=1e-14), name
    assert_same(Answer.read(folder / "through"), here)

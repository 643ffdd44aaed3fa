"""Saved answers: read as they were saved, on any ranks, which share the work; damaged folders are refused."""

import errno
import json
import os
import pickle
import shutil
import sys

import h5py
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle import Answer, InputError, ObstacleProblem, Scene, Solution, compare, releases, solve
from fenicsx_obstacle.forms.pairs import Pair, _register, nodal_rule, register
from fenicsx_obstacle.io import folder as folder_module
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.parallel import gathered, on_root, total
from fenicsx_obstacle.show.free_boundary import free_boundary, patch_of
from fenicsx_obstacle.show.report import near_free_boundary, write_free_boundary
from tests.conftest import COMM, DEMOS, as_version_02, membrane, slow_except
from tests.helpers import inside, run_python

ELEMENTS = ["P1", "P2", "Q1", "Q1-gauss"]


def solved(element="P1", load=-8, **more):
    """A small result."""
    cell = "quadrilateral" if element[0] == "Q" else "triangle"
    scene = membrane(mesh={"shape": "rectangle", "cells": 4, "cell": cell}, load=load, lower=-0.1, **more)
    return solve(scene, element=element)


def with_time(load=-8):
    return solved(load=f"{load}*t", time={"end": 1, "steps": 2})


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A function that copies the result with an element, which is solved and saved once, into a folder."""
    once, elements = COMM.bcast(tmp_path_factory.mktemp("saved") if COMM.rank == 0 else None), set()

    def copy(folder, element="P1"):
        if element not in elements:
            solved(element).save(once / element)
            elements.add(element)
        on_root(COMM, lambda: shutil.copytree(once / element, folder, dirs_exist_ok=True) and None)

    return copy


@pytest.mark.parametrize("make", [solved, with_time])
def test_a_file_of_another_result_is_refused(make, folder):
    """Each file of a folder, taken from another result of the same scene; one that is missing; one that is too many."""
    make().save(folder / "one")
    make(load=-9).save(folder / "other")
    Answer.read(folder / "one")
    names = on_root(COMM, lambda: sorted(file.name for file in (folder / "one").iterdir()))
    assert {"fields.h5", "scene.toml", "history.csv"} <= set(names)
    same = on_root(
        COMM, lambda: [(folder / "one" / n).read_bytes() == (folder / "other" / n).read_bytes() for n in names]
    )
    assert sum(same) <= 2  # what ParaView needs to know of them
    for name in (name for name, one in zip(names, same, strict=True) if not one):
        on_root(COMM, lambda name=name: shutil.copytree(folder / "one", folder / name) and None)
        on_root(COMM, lambda name=name: shutil.copy(folder / "other" / name, folder / name) and None)
        with pytest.raises(InputError, match="is not the file that was saved with"):
            Answer.read(folder / name)
        on_root(COMM, (folder / name / name).unlink)
        with pytest.raises(InputError, match="is missing"):
            Answer.read(folder / name)


def test_a_frame_too_many_is_refused(saved, folder):
    """Frames that an interrupted `save` has left belong to no steady result."""
    with_time().save(folder / "moving")
    saved(folder / "still")
    on_root(COMM, lambda: shutil.copy(folder / "moving" / "frames.h5", folder / "still") and None)
    with pytest.raises(InputError, match=r"frames\.h5 is not the file"):
        Answer.read(folder / "still")


KILLED = """
import os, sys
from pathlib import Path
from tests.test_saved import solved, with_time
answer, replace = {make}(load=-9), Path.replace
for folder in sys.argv[1:]:
    left = [int(Path(folder).name)]
    def killed(self, target):
        if left[0] == 0:
            os._exit(9)
        left[0] -= 1
        return replace(self, target)
    if os.fork() == 0:
        Path.replace = killed
        answer.save(folder)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.wait()[1]))
"""


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("old", [False, True], ids=["", "version 0.2"])
@pytest.mark.parametrize("make", [solved, with_time])
def test_killed_between_two_renames(make, old, tmp_path):
    """What is read then is one of the two results, whole, or nothing."""
    answers = [make(load=load) for load in (-8, -9)]
    energies, read = {answer.energy for answer in answers}, 0
    answers[0].save(tmp_path / "before")
    if old:
        as_version_02(tmp_path / "before")
    files = os.listdir(tmp_path / "before")
    folders = [tmp_path / str(count) for count in range(len(files) + 1)]
    for folder in folders:
        shutil.copytree(tmp_path / "before", folder)
    done = run_python(KILLED.format(make=make.__name__), *folders, timeout=60)
    assert done.stdout.split() == ["9"] * len(files) + ["0"], done.stderr
    for folder in folders:
        try:
            answer = Answer.read(folder)
        except InputError as error:
            assert "damaged" in str(error) or "missing" in str(error)
            continue
        assert answer.energy in energies and answer.scene.tables.effects["load"] in (-8, -9, "-8*t", "-9*t")
        assert (answer.energy == max(energies)) == (answer.scene.tables.effects["load"] in (-8, "-8*t"))
        read += 1
    assert read == 2  # before the first rename and after the last


FLIPPED = """
import sys, random
from pathlib import Path
from fenicsx_obstacle import Answer, InputError
folder, seed = Path(sys.argv[1]), int(sys.argv[2])
file, draw = folder / "fields.h5", random.Random(seed)
whole = file.read_bytes()
for _ in range(60):
    changed = bytearray(whole)
    for _ in range(draw.choice((1, 2, 8))):
        changed[draw.randrange(len(whole))] ^= 1 << draw.randrange(8)
    file.write_bytes(changed)
    try:
        Answer.read(folder)
        print("read", flush=True)
    except InputError as error:
        print("refused", len(str(error).splitlines()), flush=True)
file.write_bytes(whole)
"""


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("old", [False, True], ids=["", "version 0.2"])
@pytest.mark.parametrize("element", ELEMENTS)
def test_bit_flips(element, old, saved, tmp_path):
    """A changed byte is noticed; without contents to compare with, the numbers may differ, but nothing hangs."""
    saved(tmp_path, element)
    if old:
        as_version_02(tmp_path)
    done = run_python(FLIPPED, tmp_path, 3)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 60 and set(lines) <= {"read", "refused 1"}
    assert old or "read" not in lines


def edited(name, change, file="fields.h5"):
    """A function that changes the values of a dataset in a folder."""

    def edit(folder):
        with h5py.File(folder / file, "a") as whole:
            values = whole[name][()]
            del whole[name]
            whole[name] = change(values)

    return edit


ELSEWHERE = ("data in another file", "virtual data", "a link", "a claim")


def moved(kind, name, file="fields.h5"):
    """A function after which a dataset in a folder is in another file, or claims to be larger than that."""

    def edit(folder):
        with h5py.File(folder / file, "a") as whole, h5py.File(folder / "other.h5", "w") as other:
            values = whole[name][()]
            other["x"] = values
            del whole[name]
            if kind == "data in another file":
                (folder / "raw").write_bytes(values.tobytes())
                external = [(str(folder / "raw"), 0, h5py.h5f.UNLIMITED)]
                whole.create_dataset(name, values.shape, values.dtype, external=external)
            elif kind == "virtual data":
                layout = h5py.VirtualLayout(values.shape, values.dtype)
                layout[:] = h5py.VirtualSource("other.h5", "x", values.shape)
                whole.create_virtual_dataset(name, layout)
            elif kind == "a link":
                whole[name] = h5py.ExternalLink("other.h5", "x")
            else:
                size = values.shape[1:]
                whole.create_dataset(name, (10**12, *size), "f8", chunks=(10**5, *size))

    return edit


def gone(name):
    """A function that takes a dataset or a group out of a folder."""

    def edit(folder):
        with h5py.File(folder / "fields.h5", "a") as whole:
            del whole[name]

    return edit


def _circle(folder):
    with h5py.File(folder / "fields.h5", "a") as file:
        file.create_group("a")["b"] = file["/"]


def _pickled(folder):
    with h5py.File(folder / "fields.h5", "a") as file:
        file["further"] = np.array(["a", "b"], dtype=object)


def _nan(values):
    return np.where(np.arange(values.size).reshape(values.shape) == 3, np.nan, values)


DAMAGE = {
    "NaN": edited("u", _nan),
    "too few": edited("u", lambda v: v[:-1]),
    "too many": edited("contact", lambda v: np.append(v, 0.0)),
    "whole numbers": edited("u", lambda v: v.astype(int)),
    "a matrix": edited("pressure", lambda v: np.column_stack([v, v])),
    "points of a plane": edited("points", lambda v: v[:, :2]),
    "a cell out of range": edited("cells", lambda v: v + 5),
    "a cell below 0": edited("cells", lambda v: v - 1),
    "cells with five vertices": edited("cells", lambda v: np.column_stack([v, v, v])[:, :5]),
    "a cell that is a line": edited("cells", lambda v: np.column_stack([v[:, :2], v[:, :1]])),
    "numbers with a point": edited("cells", lambda v: v.astype(float)),
    "gdim": edited("gdim", lambda v: 7),
    "gdim 1": edited("gdim", lambda v: 1),
    **{kind: moved(kind, "u") for kind in ELSEWHERE},
    "a circle of groups": _circle,
    "objects": _pickled,
}
FORGED = {
    "no pressure": gone("element/pressure"),
    "no cells": gone("element/cells"),
    "version 0.1": gone("element"),
    "a name of cells": edited("element/cell", lambda v: np.array(b"hexahedron")),
    "cells of another element": edited("element/cells", lambda v: v[:, :-1]),
    "too many nodes": edited("element/cells", lambda v: np.column_stack([v, v])),
    "two nodes": edited("element/cells", lambda v: v[:, :2]),
    "a node out of range": edited("element/cells", lambda v: v + 5),
    "a vertex twice": edited("element/cells", lambda v: np.where(np.arange(v.shape[1]) == 1, v[:, :1], v)),
    "half the cells": edited("element/cells", lambda v: v[: len(v) // 2]),
    "NaN in an element": edited("element/pressure", _nan),
}
WORDS = {
    "no pressure": r"damaged: fields.h5: 'pressure' has \d values in a cell, and",
    "no cells": r"fields\.h5 has no element/cells",
    "version 0.1": r"saved by version 0\.1",
}
FORGERIES = [*((what, "P1") for what in DAMAGE),
             *((what, element) for what in FORGED for element in ("P2", "Q1-gauss"))]  # fmt: skip


@pytest.mark.ranks
@pytest.mark.parametrize(("what", "element"), slow_except(FORGERIES, *FORGERIES[:5], *FORGERIES[-2:]))
def test_forged_fields_are_refused(what, element, saved, folder):
    """Without contents to compare with: one message on all ranks, no hang, nothing from other files."""
    saved(folder, element)
    on_root(COMM, as_version_02, folder)
    Answer.read(folder)
    on_root(COMM, (DAMAGE | FORGED)[what], folder)
    with pytest.raises(InputError, match=WORDS.get(what, "damaged")) as caught:
        Answer.read(folder)
    assert len(str(caught.value).splitlines()) == 1


FIELDS = {
    "a list": lambda r: [r],
    "no contact": lambda r: {**r, "contact": 3},
    "a force that is a text": lambda r: {**r, "contact": {**r["contact"], "lower": {"force": "much"}}},
    "h = 0": lambda r: {**r, "h": 0.0},
    "no dofs": lambda r: {key: value for key, value in r.items() if key != "dofs"},
    "report": lambda r: {**r, "report": {"force": [1]}},
    "a bound": lambda r: {**r, "bound": {"total": 1}},
    "a bound that is a text": lambda r: {**r, "bound": "small"},
    "meshes": lambda r: {**r, "adaptive": {"tolerance": 1}},
    "files": lambda r: {**r, "files": ["fields.h5"]},
    "no files": lambda r: {**r, "files": {}},
    "a text that nests": lambda r: "[" * 100000,
    "a file elsewhere": lambda r: {**r, "files": {**r["files"], "../one": "0"}},
}


@pytest.mark.parametrize("what", slow_except(FIELDS, *list(FIELDS)[:4]))
def test_wrong_fields_of_answer_json(what, saved, folder):
    saved(folder)

    def change():
        record = json.loads((folder / "answer.json").read_text())
        found = FIELDS[what](record)
        (folder / "answer.json").write_text(found if isinstance(found, str) else json.dumps(found))

    on_root(COMM, change)
    with pytest.raises(InputError, match=r"damaged|missing"):
        Answer.read(folder)


@pytest.mark.slow
@pytest.mark.serial
def test_the_command_solve_keeps_the_contents(tmp_path):
    """answer.json is written anew with the seconds of the command: what it says of the files stays right."""
    done = inside("solve", DEMOS / "disk.toml", "--cells", 4, "--output", tmp_path / "out", "--plot")
    assert done.returncode == 0, done.stderr
    assert "files" not in Answer.read(tmp_path / "out").record
    assert "files" in json.loads((tmp_path / "out" / "answer.json").read_text())


def test_a_problem_of_ones_own(folder):
    """Solution.read checks the same."""
    problem = Scene.read(DEMOS / "disk.toml").change({"mesh.cells": 4}).problem(COMM)
    assert isinstance(problem, ObstacleProblem)
    found = problem.solve()
    found.save(folder)
    back = Solution.read(folder)
    assert back.force == found.force and back.history == found.history and back.eps == found.eps
    line, again = (one.along((-0.5, 0), (0.5, 0), n=33) for one in (found, back))
    for name in ("u", "pressure", "gap", "slope"):
        assert np.allclose(getattr(line, name), getattr(again, name), atol=1e-12), name
    on_root(COMM, lambda: (folder / "history.csv").open("a").write("\n") and None)
    with pytest.raises(InputError, match=r"history\.csv is not the file"):
        Solution.read(folder)


CHECKPOINT = {
    "no rows": ("rows", lambda v: np.array(b"[1]")),
    "rows without t": ("rows", lambda v: np.array(b'[{"step": 1}]')),
    "rows that nest": ("rows", lambda v: np.array(b"[" * 10**5)),
    "no times": ("times", lambda v: v[:0]),
    "times that are not numbers": ("times", lambda v: v * np.nan),
    "a matrix of times": ("times", lambda v: v[:, None]),
    "u0 is too short": ("u0", lambda v: v[:-1]),
    "u0 is NaN": ("u0", _nan),
    "u0 in letters": ("u0", lambda v: v.astype("S3")),
    "points of a plane": ("points", lambda v: v[:, :2]),
    "frames that are too short": ("frames/0000/u", lambda v: v[:-1]),
    "a frame that is NaN": ("frames/0000/u", _nan),
    "a frame without a moment": ("frames/0000/t", lambda v: np.arange(2.0)),
    "a velocity": ("velocity", lambda v: np.arange(3.0)),
}


GROWING = {"mesh": {"shape": "rectangle", "cells": 4}, "load": "-8*t", "lower": -0.1, "rate": 1}


@pytest.fixture(scope="module")
def half_way(tmp_path_factory):
    """The folder with the state of a scene at t = 1."""
    folder = COMM.bcast(tmp_path_factory.mktemp("half_way") if COMM.rank == 0 else None)
    solve(membrane(time={"end": 1, "steps": 2, "start": 0}, **GROWING), keep=folder)
    return folder


@pytest.mark.parametrize("what", slow_except(CHECKPOINT, *list(CHECKPOINT)[:4]))
def test_a_damaged_checkpoint(what, half_way, folder):
    """A state to continue from is checked like a result."""

    def change():
        shutil.copytree(half_way, folder, dirs_exist_ok=True)
        name, edit = CHECKPOINT[what]
        with h5py.File(folder / "checkpoint.h5", "a") as file:
            values = file[name][()] if name in file else None
            if name in file:
                del file[name]
            file[name] = edit(values)

    on_root(COMM, change)
    with pytest.raises(InputError, match=r"checkpoint\.h5: is damaged") as caught:
        solve(membrane(time={"end": 2, "steps": 4, "start": 0}, **GROWING), restart=folder)
    assert len(str(caught.value).splitlines()) == 1


SQUARE = {"shape": "rectangle", "cells": 5}
QUADS = {**SQUARE, "cell": "quadrilateral"}
BOX = {"shape": "box", "cells": 3}
BRICKS = {**BOX, "cell": "hexahedron"}
CASES = [("P1", SQUARE), ("P1", BOX), ("P1", {"shape": "interval", "cells": 7}), ("P1-voronoi", SQUARE), ("P2", SQUARE),
         ("P2", {"shape": "disk", "cells": 4}), ("P2", {"shape": "interval", "cells": 7}), ("Q2", QUADS),
         ("Q2", BRICKS), ("Q1", {**QUADS, "perturb": 0.2}), ("Q1-gauss", QUADS), ("Q1", BRICKS)]  # fmt: skip


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


@pytest.mark.parametrize(
    "element, mesh", [pytest.param(*case, marks=[pytest.mark.slow] * (k > 0)) for k, case in enumerate(CASES)]
)
def test_every_element_is_read_as_it_was_saved(element, mesh, folder):
    """u, pressure, contact, obstacles and error: the same degree and the same values at the same nodes."""
    scene = scene_of(element, mesh, lower="-0.05", load="30*(x - 0.4)")
    saved = solve(scene, eps=1e-6)
    saved.save(folder)
    read = Answer.read(folder)
    assert len(saved.functions()) == 6
    assert_same(read, saved)
    assert_same(Answer.read(folder, MPI.COMM_SELF), saved)  # each rank alone
    assert np.isclose(energy(read), energy(saved), rtol=1e-13)
    assert read.level.dofs == saved.record["dofs"] and read.record == json.loads(json.dumps(dict(saved.record)))
    assert read.history == saved.history and read.scene.tables == saved.scene.tables
    inside = np.random.default_rng(3).random((20, saved.level.mesh.geometry.dim)) / 2
    assert np.allclose(read.at(inside), saved.at(inside), rtol=0, atol=1e-14)
    assert compare(saved, read)["u"]["h1"] < 1e-12
    read.save(folder / "again")
    assert_same(Answer.read(folder / "again"), saved)


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


@pytest.mark.slow
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


SEVERAL = """
import sys
import numpy as np
from tests.conftest import COMM
from tests.test_saved import table
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
    done = run_python(SEVERAL, folder, ranks=ranks)
    assert done.returncode == 0, done.stderr
    found = table(Answer.read(folder / "several"))
    with np.load(folder / "fields.npz") as expected:
        assert set(expected) == set(found)
        for name, rows in found.items():
            assert np.allclose(rows, expected[name], rtol=0, atol=1e-14), name
    assert_same(Answer.read(folder / "through"), here)


@pytest.mark.parametrize("name, changes", [
    ("ball", {"mesh.cells": 96}),
    ("ball", {"mesh.cells": 24, "solve.element": "P2"}),
    ("two_sided", {}),
    ("string", {}),
])  # fmt: skip
def test_the_free_boundary_needs_only_the_cells_near_it(name, changes):
    """The same pieces with the same coordinates, to the last digit, as from the whole mesh on rank 0."""
    answer = solve(Scene.read(DEMOS / f"{name}.toml").change(changes))
    near, whole = near_free_boundary(answer.fields), gather(answer.fields)
    if COMM.rank != 0:
        assert near is None
        return
    assert near is not None and (changes.get("mesh.cells") != 96 or len(near.cells) < 0.4 * len(whole["cells"]))
    ours, theirs = free_boundary(near), free_boundary(patch_of(whole))
    assert len(ours) == len(theirs) > 0
    for a, b in zip(ours, theirs, strict=True):
        assert np.array_equal(a.points[a.cells], b.points[b.cells])


@pytest.mark.slow
def test_rank_0_holds_nothing_of_the_size_of_the_mesh(folder, monkeypatch):
    """Bytes gathered on rank 0 to save, report and read grow like the free boundary, not like the mesh."""
    sent = []

    def counted(comm, values):
        found = gathered(comm, values)
        sent.append(0 if found is None else found.nbytes)
        return found

    def told(comm, action, *arguments):
        found = on_root(comm, action, *arguments)
        sent.append(len(pickle.dumps(found)))
        return found

    for module in [one for name, one in sys.modules.items() if name.startswith("fenicsx_obstacle.")]:
        for name, replacement in (("gathered", counted), ("on_root", told)):
            if module.__name__ != "fenicsx_obstacle.parallel" and hasattr(module, name):
                monkeypatch.setattr(module, name, replacement)
    bytes_sent = []
    for cells in (64, 128):
        answer = solve("ball", cells=cells)
        sent.clear()
        answer.save(folder / str(cells))
        write_free_boundary(answer.fields, folder / str(cells) / "free_boundary.csv")
        read = Answer.read(folder / str(cells))
        assert read.level.dofs == answer.level.dofs
        bytes_sent.append(COMM.bcast(sum(sent)))
    assert 0 < bytes_sent[1] < 2.5 * bytes_sent[0]
    assert bytes_sent[1] < 0.2 * (folder / "128" / "fields.h5").stat().st_size


@pytest.mark.parametrize("element", ["P1", "P1-voronoi"])
def test_the_file_of_all_ranks_is_plain_hdf5(element, folder, ball):
    """Every array stands in it once, as rank 0 would have gathered it, without gaps or compression."""
    answer = solve(ball, cells=16, element=element)
    answer.save(folder)
    arrays = gather(answer.fields)
    with h5py.File(folder / "fields.h5") as file:
        assert set(file) == {"points", "cells", "gdim", "u", "pressure", "contact", "lower", "gap", "error"}
        for name, values in arrays.items():
            assert file[name].dtype == values.dtype and np.array_equal(file[name][()], values), name


def test_a_rank_that_cannot_write_is_told_on_all(folder, ball, monkeypatch):
    """As if the disk of the last rank were full: an earlier result stays whole."""
    answer = solve(ball, cells=8)
    answer.save(folder)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}

    def full(*_):
        if COMM.rank == COMM.size - 1:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folder_module, "fill", full)
    with pytest.raises(InputError, match="cannot be written: No space left on device; the old content stays"):
        answer.save(folder)
    COMM.barrier()
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before

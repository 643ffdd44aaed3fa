"""What comes from others runs no code: not the current folder, not a scene, not a mesh, not a saved result."""

import io
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import zipfile
import zlib

import numpy as np
import pytest

from fenicsx_obstacle import InputError, Scene
from fenicsx_obstacle.__main__ import OUT_OF_MEMORY
from fenicsx_obstacle.console import _PrintableText
from fenicsx_obstacle.data.measured.read import read
from fenicsx_obstacle.effects import plugin
from fenicsx_obstacle.mesh import meshing
from fenicsx_obstacle.safe_writing import replaced, write_text
from fenicsx_obstacle.show import render
from tests.conftest import CLEAN, slow_except
from tests.helpers import LAUNCHER, run, run_python
from tests.processes import launch
from tests.test_saved import ELSEWHERE, edited, moved

pytestmark = pytest.mark.serial

MODULES = ("click", "signal", "threading", "gmsh", "numpy", "json", "typing", "pip", "site", "fenicsx_obstacle")
SCENE = """
mesh = {file = "a.geo"}
effects = {tension = 1, load = -1}
obstacle = {lower = -0.05}
boundary = [{value = 0}]
"""


@pytest.fixture
def stranger(tmp_path):
    """A folder with modules, PETSc's options and options of compilers, each of which would leave a trace."""
    for name in MODULES:
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'trace')!r}, 'w')\n")
    for name in (".petscrc", "petscrc"):
        (tmp_path / name).write_text(f"-log_view :{tmp_path / 'trace'}\n-options_left\n")
    wrong = {"cffi_extra_compile_args": [f"-o{tmp_path / 'trace'}"], "cffi_libraries": ["none"], "scalar_type": "none"}
    for name in ("dolfinx_jit_parameters", "dolfinx_jit_options", "ffcx_parameters", "ffcx_options"):
        (tmp_path / f"{name}.json").write_text(json.dumps(wrong))
    (tmp_path / "a.geo").write_text('SetFactory("OpenCASCADE"); Rectangle(1) = {0, 0, 0, 1, 1};\n')
    (tmp_path / "a.toml").write_text(SCENE)
    return tmp_path


@pytest.mark.skipif(not (LAUNCHER.parent / ".venv" / "complete").exists(), reason="needs ./obstacle")
@pytest.mark.parametrize("ranks", slow_except([1, 2], 1))
def test_the_current_folder_is_not_run(ranks, stranger):
    """With a cache of forms that is empty, so that the compiler runs."""
    command = [LAUNCHER, *(["--ranks", "2"] if ranks > 1 else []), "solve", "a.toml", "--output", "out"]
    env = {**CLEAN, "XDG_CACHE_HOME": str(stranger / "cache"), "PYTHONPATH": "::"}
    done = subprocess.run(command, cwd=stranger, env=env, capture_output=True, text=True, timeout=250, check=False)
    assert done.returncode == 0, done.stderr
    assert not (stranger / "trace").exists()
    assert [line for line in done.stderr.splitlines() if "not taken" in line] == done.stderr.splitlines() != []


@pytest.mark.slow
def test_processes_do_not_look_into_the_current_folder(stranger, monkeypatch):
    monkeypatch.chdir(stranger)
    assert len(meshing.load(stranger / "a.geo").cells) > 0
    for command in (launch(1, "-c", "import click"), [*render._WORKER[:2], "-c", "import click"]):
        assert subprocess.run(command, check=False).returncode == 0
    assert not (stranger / "trace").exists()


CONTROL, ESCAPED = "\x1b[2J\x07a\rb\x9b1m\u202e", "\\x1b[2J\\x07a\\x0db\\x9b1m\\u202e"


@pytest.mark.slow
def test_control_characters_are_escaped(tmp_path):
    """In the titles, names and messages of each command, and in errors in Python."""
    text = CONTROL
    quoted = json.dumps(text)
    right = f"title = {quoted}\n" + SCENE.replace('file = "a.geo"', 'shape = "rectangle", cells = 4')
    wrong = right.replace("value = 0", f"value = 0, on = {quoted}")
    for name, scene in (
        ("right", right),
        ("wrong", wrong),
        ("key", f"{right}[effects.{quoted}]\n"),
        (f"x{text}", right),
    ):
        (tmp_path / f"{name}.toml").write_text(scene)
    for command in (["solve", "right.toml"], ["solve", "wrong.toml"], ["solve", "key.toml"], ["explain", "right.toml"],
                    ["solve", f"x{text}.toml", "--log", "INFO"], ["solve", f"none{text}.toml"]):  # fmt: skip
        done = run(*command, cwd=tmp_path)
        said = done.stdout + done.stderr
        assert said and not any(one in said for one in ("\x1b", "\x07", "\r", "\x9b", "\u202e")), said
    with pytest.raises(InputError) as caught:
        Scene.read(tmp_path / f"none{text}.toml")
    assert ESCAPED in str(caught.value)


def test_the_stream_of_a_progress_bar():
    """It may go to the start of its line; what it shows may not."""
    out = io.BytesIO()
    text = _PrintableText(out, encoding="utf-8")
    assert text.write("\r50 % \x1b[1m\r\n") == len("\r50 % \x1b[1m\r\n")
    text.flush()
    assert out.getvalue() == b"\r50 % \\x1b[1m\\x0d\n"


def test_files_are_written_through_no_link(tmp_path):
    """Scratch files have names that cannot be known; a link at the place itself is replaced."""
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "table").symlink_to(tmp_path / "mine")
    names = set()
    for _ in range(2):
        with replaced(tmp_path / "picture.png") as scratch:
            names.add(scratch.name)
            assert scratch.suffix == ".png" and scratch.stat().st_mode & 0o777 == 0o666 & ~_umask()
    assert len(names) == 2
    write_text(tmp_path / "table", "ours")
    assert (tmp_path / "mine").read_text() == "mine" and (tmp_path / "table").read_text() == "ours"
    assert sorted(os.listdir(tmp_path)) == ["mine", "picture.png", "table"]


def _umask():
    found = os.umask(0)
    os.umask(found)
    return found


def _xdmf(folder, quadrilaterals):
    from dolfinx import io as dio
    from dolfinx import mesh
    from mpi4py import MPI

    cell = mesh.CellType.quadrilateral if quadrilaterals else mesh.CellType.triangle
    found = mesh.create_unit_square(MPI.COMM_SELF, 2, 2, cell)
    with dio.XDMFFile(MPI.COMM_SELF, str(folder / "a.xdmf"), "w") as file:
        file.write_mesh(found)


SOLVE = """
import sys
from fenicsx_obstacle import InputError, Scene, solve
for kind in sys.argv[2:]:
    try:
        solve(Scene(mesh={"file": kind + "/a.xdmf"}, tension=1, load=1), element=sys.argv[1])
        print("solved")
    except InputError:
        print("rejected")
"""
DAMAGE = {
    **{kind: moved(kind, "Mesh/mesh/geometry", "a.h5") for kind in ELSEWHERE},
    "a vertex": edited("Mesh/mesh/topology", lambda values: values + 3, "a.h5"),
    "a vertex below 0": edited("Mesh/mesh/topology", lambda values: values - 1, "a.h5"),
    "NaN": edited("Mesh/mesh/geometry", lambda values: values * np.nan, "a.h5"),
}


@pytest.mark.parametrize("quadrilaterals", slow_except([False, True], False))
def test_meshes_in_hdf5_are_checked(quadrilaterals, tmp_path):
    """DOLFINx would follow links, and wait for ever for vertices that are not there."""
    for kind in ("none", *DAMAGE):
        (tmp_path / kind).mkdir()
        _xdmf(tmp_path / kind, quadrilaterals)
        if kind != "none":
            DAMAGE[kind](tmp_path / kind)
    command = ["timeout", "60", sys.executable, "-c", SOLVE, "Q1" if quadrilaterals else "P1", "none", *DAMAGE]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["solved"] + ["rejected"] * len(DAMAGE), done.stderr


def _npy(shape, kind="<f8"):
    head = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + b"0" * 64


def _npz(content, member="z.npy"):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(member, content)
    return out.getvalue()


def _png(width, height):
    def chunk(kind, data):
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 0, 0, 0, 0])
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"0")) + chunk(b"IEND", b"")


CLAIMS = {
    "a.npy": _npy((4 * 10**9, 3)),
    "b.npy": _npy((2**62, 2**62)),
    "c.npy": _npy((8,), "|O"),
    "d.npy": _npy((5, 3)),
    "e.npy": b"\x93NUMPY\x01\x00\x10\x00" + b"(" * 16,
    "a.npz": _npz(_npy((4 * 10**9, 3))),
    "b.npz": lambda: _npz(bytes(3 * 10**8)),  # made where it is used: it takes a second and its memory
    "c.npz": _npz(_npy((8,), "|O")),
    "d.npz": _npz(b"text"),
    "e.npz": b"PK\x03\x04" + bytes(40),
    "a.png": _png(10**5, 10**5),
    "b.png": _png(2**31 - 1, 2**31 - 1),
    "c.png": _png(4, 4),
}


@pytest.mark.parametrize("name", CLAIMS)
def test_data_that_claim_too_much(name, tmp_path):
    """One message, and no more memory than the file has."""
    content = CLAIMS[name]
    (tmp_path / name).write_bytes(content() if callable(content) else content)
    del content
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=re.escape(name)):
        read(tmp_path / name)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + 10**6  # kB


def test_data_are_known_by_their_content(tmp_path):
    """Not by their date and size."""
    file, found = tmp_path / "a.csv", []
    for text in ("0,0\n1,1\n", "0,0\n1,2\n"):
        file.write_text(text)
        os.utime(file, ns=(10**18, 10**18))
        found.append(read(file).columns[1, 1])
    assert found == [1, 2]


def test_a_plugin_is_known_by_its_content(tmp_path, monkeypatch):
    """Not by its date and size, as Python knows what it has compiled; modules that it imports are part of it."""
    monkeypatch.setattr(plugin, "contents", [])
    monkeypatch.syspath_prepend(tmp_path)
    for number in (1, 2):
        (tmp_path / "mine.py").write_text(f"import aside{number}\nVALUE = {number}\n")
        (tmp_path / f"aside{number}.py").write_text(f"# {number}\n")
        os.utime(tmp_path / "mine.py", ns=(10**18, 10**18))
        plugin.load_plugin(tmp_path / "mine.py")
        assert number == sys.modules["fenicsx_obstacle_plugin_mine"].VALUE
    assert len(set(plugin.contents)) == 4
    assert not list(tmp_path.rglob("mine*.pyc"))


@pytest.mark.slow
def test_out_of_memory_blames_no_options(tmp_path):
    limited = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({2 * 10**9}, {2 * 10**9}))\n"
    limited += "import runpy, sys; sys.argv[1:] = 'solve disk_flat --cells 2000'.split()\n"
    limited += "import fenicsx_obstacle.mesh.memory as m; m.check_memory = lambda *a: None\n"
    limited += "import fenicsx_obstacle.scenes.meshes as m; m.check_memory = lambda *a: None\n"
    limited += "runpy.run_module('fenicsx_obstacle', run_name='__main__', alter_sys=True)\n"
    done = run_python(limited, cwd=tmp_path, timeout=100)
    assert done.returncode == 2, done.stderr
    assert done.stderr.strip() == OUT_OF_MEMORY


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_home_that_cannot_be_written(ranks, tmp_path):
    env = {key: value for key, value in CLEAN.items() if key != "XDG_CACHE_HOME"} | {"HOME": "/proc"}
    done = run("solve", "disk_flat", "--cells", 4, "--output", tmp_path / "out", env=env, ranks=ranks)
    assert done.returncode == 2 and "XDG_CACHE_HOME" in done.stderr and "Traceback" not in done.stderr, done.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can start a process of another user")
def test_a_clone_of_another_user(tmp_path):
    """One that is not set up says who can do it."""
    for name in ("obstacle", "debian-packages.txt", "pyproject.toml"):
        shutil.copy(LAUNCHER.parent / name, tmp_path / name)
    for folder in (tmp_path, *tmp_path.parents):
        if not os.stat(folder).st_mode & 0o005 and folder != folder.parent:
            folder.chmod(0o755)
    command = ["setpriv", "--reuid", "65534", "--clear-groups", str(tmp_path / "obstacle"), "scenes"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1, done.stderr
    assert "belongs to root and is not set up" in done.stderr

"""What comes from others runs no code: not the current folder, not a scene, not a mesh, not a saved result."""

import io
import json
import os
import subprocess

import pytest
from conftest import DEMOS
from test_cli import CLEAN, run

from fenicsx_obstacle import InputError, Scene
from fenicsx_obstacle.console import _PrintableText
from fenicsx_obstacle.discrete import meshing
from fenicsx_obstacle.parallel import replaced, write_text
from fenicsx_obstacle.show import render
from fenicsx_obstacle.verification.processes import launch

pytestmark = pytest.mark.serial

LAUNCHER = DEMOS.parent / "obstacle"
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
@pytest.mark.parametrize("ranks", [1, 2])
def test_the_current_folder_is_not_run(ranks, stranger):
    """With a cache of forms that is empty, so that the compiler runs."""
    command = [LAUNCHER, *(["--ranks", "2"] if ranks > 1 else []), "solve", "a.toml", "--output", "out"]
    env = {**CLEAN, "XDG_CACHE_HOME": str(stranger / "cache")}
    done = subprocess.run(command, cwd=stranger, env=env, capture_output=True, text=True, timeout=250, check=False)
    assert done.returncode == 0, done.stderr
    assert not (stranger / "trace").exists()
    assert [line for line in done.stderr.splitlines() if "not taken" in line] == done.stderr.splitlines() != []


def test_processes_do_not_look_into_the_current_folder(stranger, monkeypatch):
    monkeypatch.chdir(stranger)
    assert len(meshing.load(stranger / "a.geo").cells) > 0
    for command in (launch(1, "-c", "import click"), [*render._WORKER[:2], "-c", "import click"]):
        assert subprocess.run(command, check=False).returncode == 0
    assert not (stranger / "trace").exists()


CONTROL = {"\x1b[2J": "\\x1b[2J", "\x07": "\\x07", "a\rb": "a\\x0db", "\x9b1m": "\\x9b1m", "\u202e": "\\u202e"}


@pytest.mark.parametrize("text", CONTROL)
def test_control_characters_are_escaped(text, tmp_path):
    """In the titles, names and messages of each command, and in errors in Python."""
    quoted = json.dumps(text).replace("\\u2028", "")
    scene = f"""
title = {quoted}
mesh = {{shape = "rectangle", cells = 4}}
effects = {{tension = 1, load = -1}}
obstacle = {{lower = -0.05}}
report = {{force = "integral(p)"}}
"""
    (tmp_path / "right.toml").write_text(scene + "boundary = [{value = 0}]\n")
    (tmp_path / "wrong.toml").write_text(scene + f"boundary = [{{value = 0, on = {quoted}}}]\n")
    (tmp_path / "key.toml").write_text(scene + f"[effects.{quoted}]\n")
    name = tmp_path / f"x{text}.toml"
    name.write_text(scene + "boundary = [{value = 0}]\n")
    for command in (["solve", "right.toml"], ["solve", "wrong.toml"], ["solve", "key.toml"], ["explain", "right.toml"],
                    ["solve", name.name, "--log", "INFO"], ["solve", f"none{text}.toml"]):  # fmt: skip
        done = run(*command, cwd=tmp_path)
        said = done.stdout + done.stderr
        assert said and not any(one in said for one in ("\x1b", "\x07", "\r", "\x9b", "\u202e")), said
    with pytest.raises(InputError) as caught:
        Scene.read(tmp_path / f"none{text}.toml")
    assert CONTROL[text] in str(caught.value)


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


def test_no_pickles():
    """NumPy reads none; nothing else does."""
    for file in (DEMOS.parent / "fenicsx_obstacle").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        loads = text.count("np.load(")
        assert loads == text.count("allow_pickle=False"), file
        assert "pickle.load" not in text, file

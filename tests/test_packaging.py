"""The package as it is installed, what it says where libraries are missing, and what is imported only if asked for."""

import re
import subprocess
import sys
import zipfile
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pytest

import fenicsx_obstacle
from fenicsx_obstacle import releases
from tests.conftest import CLEAN
from tests.hard.cases import case
from tests.helpers import run_python

pytestmark = pytest.mark.serial

ROOT = Path(__file__).parent.parent


def run(*command, **more):
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, env=CLEAN, timeout=150, **more)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_wheel_and_sdist_solve_in_an_environment_of_their_own(tmp_path):
    """The sdist makes the wheel; scenes, types and licence are in it; the command solves away from the clone."""
    pytest.importorskip("build", reason="build is of the extra 'test', which the container has not")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", tmp_path, ROOT)
    (wheel,) = tmp_path.glob("*.whl")
    (sdist,) = tmp_path.glob("*.tar.gz")
    names = zipfile.ZipFile(wheel).namelist()
    for name in ("py.typed", "catalogue/ball.toml", "show/templates/answer.html"):
        assert f"fenicsx_obstacle/{name}" in names
    assert any(name.endswith("LICENSE") for name in names)
    listed = run("tar", "-tzf", sdist)
    assert "CITATION.cff" in listed and "docs/start.md" in listed and "tests/conftest.py" in listed
    # what pip would fetch besides is here already: the environment sees this one's packages, and the system's
    place = tmp_path / "venv"
    run("/usr/bin/python3", "-m", "venv", "--system-site-packages", "--without-pip", place)
    (found,) = (place / "lib").glob("python3*/site-packages")
    run(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", found, wheel)
    here = [path for path in sys.path if path.startswith(sys.prefix) and path.endswith("site-packages")]
    (found / "libraries.pth").write_text("\n".join(here))
    code = "import fenicsx_obstacle as f; print(f.__file__, flush=1); import fenicsx_obstacle.__main__ as m; m.main()"
    said = run(place / "bin" / "python", "-c", code, "solve", "ball", "--cells", "16", cwd=tmp_path)
    assert said.startswith(str(found)) and "contact area" in said
    assert (tmp_path / "out" / "ball" / "answer.json").exists()
    assert not any("test" in Path(name).parts[0] for name in names)
    for command in (("theory",), ("theory", "3.27"), ("hard", "torsion_3"), ("hard", "--random", "2"), ("demo",)):
        words = [place / "bin" / "python", "-c", code, *command]
        done = subprocess.run(words, capture_output=True, text=True, env=CLEAN, cwd=tmp_path, check=False)
        assert done.returncode == 2, done.stderr
        sentence = (
            f"Error: {command[0]} runs in a clone of the project, where demos/ and tests/ are; call ./obstacle there"
        )
        assert done.stderr.splitlines() == [sentence]


def test_missing_libraries_are_named():
    """Without dolfinx the import says what to install instead of failing somewhere inside."""
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import fenicsx_obstacle"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "does not find dolfinx, ufl, petsc4py, mpi4py" in done.stderr
    assert "apt-get install python3-dolfinx" in done.stderr


@pytest.mark.slow
def test_an_unknown_release_of_dolfinx_is_a_warning(tmp_path):
    """One that was not tried, with the spellings of one that was: the answer comes, and a line before it."""
    other = {(0, 5): "0.6.0", (0, 9): "0.8.0"}.get(releases.VERSION, "0.12.0.dev0")
    code = (
        f"from mpi4py import MPI; import dolfinx; dolfinx.__version__ = {other!r}\n"
        "from fenicsx_obstacle.__main__ import main; main()"
    )
    command = [sys.executable, "-c", code, "solve", "ball", "--cells", "16"]
    done = subprocess.run(command, capture_output=True, text=True, env=CLEAN, cwd=tmp_path, timeout=150, check=False)
    assert done.returncode == 0, done.stderr
    assert "contact area" in done.stdout
    assert done.stderr.count(f"was tried with dolfinx 0.5, 0.9, 0.11, not with {other}") == 1


def test_one_version():
    """pyproject.toml has the version, and the changelog begins with it; all public names are there."""
    assert fenicsx_obstacle.__version__ == version("fenicsx_obstacle")
    assert all(hasattr(fenicsx_obstacle, name) for name in fenicsx_obstacle.__all__)
    text = (ROOT / "pyproject.toml").read_text()
    assert f'version = "{fenicsx_obstacle.__version__}"' in text
    first = re.search(r"^## ([\d.]+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert first and first[1] == fenicsx_obstacle.__version__


SCENE = """
[mesh]
shape = "rectangle"
cells = 4
[obstacle]
lower = -1
[[boundary]]
on = "left"
value = 0
[effects]
tension = 1
"""
SUPPORTS = """foundation = 1
[[boundary]]
on = "right"
spring = 1
"""
COMMANDS = """
import sys
from fenicsx_obstacle.__main__ import main
for line in sys.stdin:
    sys.argv = ["obstacle", *line.split()]
    try:
        main()
    except SystemExit as end:
        assert not end.code, line
    print(*sorted(sys.modules), file=sys.stderr)
"""


def modules_after(*commands, folder):
    """All modules that a process has imported after each of these commands of the command line."""
    done = run_python(COMMANDS, input="\n".join(commands), cwd=folder)
    assert done.returncode == 0, done.stderr
    return [set(line.split()) for line in done.stderr.splitlines()]


def test_help_imports_nothing_heavy(tmp_path):
    heavy = {"dolfinx", "petsc4py", "mpi4py", "numpy", "ufl", "matplotlib", "tests"}
    if find_spec("dolfinx_solver") is not None:  # DOLFINx as pip installs it must find MPI loaded
        heavy.remove("mpi4py")
    assert not heavy & modules_after("--help", folder=tmp_path)[0]


def package(folder, *names):
    """Modules of a folder of the package."""
    return {f"fenicsx_obstacle.{folder}.{name}" for name in names}


HEAVY = {"matplotlib", "pyvista", "gmsh", "PIL", "tests"}
EFFECTS = package("effects", "domain", "domain.tension", "effect", "field", "plugin")
OF_SUPPORTS = package("effects", "boundary", "boundary.spring", "domain.foundation")


def effects(loaded):
    return {name for name in loaded if name.startswith("fenicsx_obstacle.effects.")}


@pytest.mark.slow
def test_commands_import_what_they_need(tmp_path):
    """In one process after another, no command but `plot` imports a library that is heavy, or the suites."""
    (tmp_path / "plain.toml").write_text(SCENE)
    (tmp_path / "supported.toml").write_text(SCENE + SUPPORTS)
    seam = case("seam").base.folder / "seam.toml"
    plain, supported, *more, last = modules_after(
        "solve plain.toml", "solve supported.toml", "explain plain.toml", "scenes", "compare out/plain out/plain",
        f"solve {seam} --output out/seam", "plot out/plain --output u.svg", folder=tmp_path,
    )  # fmt: skip
    assert effects(plain) == EFFECTS and not {"scipy", "tqdm"} & plain
    # effects of the scene, with the parts of the boundary that they act on, and no others
    assert effects(supported) == EFFECTS | OF_SUPPORTS and "fenicsx_obstacle.data.measures" in supported
    for loaded in (plain, supported, *more):
        assert not HEAVY & loaded
    assert "matplotlib" in last and not {"pyvista", "gmsh", "tests"} & last

"""What a command or a scene does not ask for is not imported: pictures, meshing, time, reports, effects, suites."""

from importlib.util import find_spec

import pytest

from tests.hard.cases import case
from tests.helpers import run_python

pytestmark = pytest.mark.serial

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
UNWANTED = {
    "time": package("answers", "time_stepper", "steps") | package("answers", "data_within_steps"),
    "reports": package("scenes", "functionals") | package("mesh", "boundary_distance"),
    "Newton at work": package("show", "newton"),
    "bodies": package("answers", "bodies") | package("scenes", "bodies") | package("forms", "elasticity")
    | package("discrete", "contact_nodes", "rigid_motions", "vector_levels", "vector_problem")
    | package("problems", "vector_valued") | package("fields", "vector", "contact_table"),
    "drift and parts of the boundary": package("discrete", "drift") | package("data", "measures"),
}  # fmt: skip
EFFECTS = package("effects", "domain", "domain.tension", "effect", "field", "plugin")
OF_SUPPORTS = package("effects", "boundary", "boundary.spring", "domain.foundation")


def effects(loaded):
    return {name for name in loaded if name.startswith("fenicsx_obstacle.effects.")}


@pytest.mark.slow
def test_commands_import_what_they_need(tmp_path):
    """A solve is saved and summarised in about a second: drawing libraries alone take longer to load. In one process
    after another, no command but `plot` imports a library that is heavy, or the suites."""
    (tmp_path / "plain.toml").write_text(SCENE)
    seam = case("seam").base.folder / "seam.toml"
    plain, *more, last = modules_after(
        "solve plain.toml", "explain plain.toml", "scenes", "compare out/plain out/plain",
        f"solve {seam} --output out/seam", "plot out/plain --output u.svg", folder=tmp_path,
    )  # fmt: skip
    for names in UNWANTED.values():
        assert all(find_spec(name) for name in names)  # a module that was renamed is none that is missing
        assert not names & plain
    assert effects(plain) == EFFECTS and not {"scipy", "tqdm"} & plain
    for loaded in (plain, *more):
        assert not HEAVY & loaded
    assert "matplotlib" in last and not {"pyvista", "gmsh", "tests"} & last


@pytest.mark.slow
def test_effects_that_are_named_are_imported(tmp_path):
    """Those of the scene, with the parts of the boundary that they act on, and no others."""
    (tmp_path / "supported.toml").write_text(SCENE + SUPPORTS)
    (loaded,) = modules_after("solve supported.toml", folder=tmp_path)
    assert effects(loaded) == EFFECTS | OF_SUPPORTS and "fenicsx_obstacle.data.measures" in loaded


@pytest.mark.slow
def test_the_library_loads_no_suites():
    """All public names, and a solve from Python, without the suites that only `theory` and `hard` need, and without
    what pictures and pages need."""
    code = (
        "import sys, fenicsx_obstacle as f\n"
        "assert all(hasattr(f, name) for name in f.__all__)\n"
        "answer = f.solve('ball', cells=8)\n"
        "assert 'report' not in answer.record and answer.report == {}\n"
        "assert 'fenicsx_obstacle.problems.solution' in sys.modules\n"
        "assert not {'tests', 'matplotlib', 'jinja2'} & set(sys.modules)"
    )
    done = run_python(code)
    assert done.returncode == 0, done.stderr

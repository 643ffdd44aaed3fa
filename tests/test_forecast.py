"""What a tolerance will take, told from the first meshes: within a factor of 2 of what then happens."""

import time
from contextlib import closing

import pytest

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.answers.adapt import Adaptation, Work
from fenicsx_obstacle.answers.solve import adaptation
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import forget_peak_memory
from fenicsx_obstacle.scenes import catalogue
from fenicsx_obstacle.show.explain import forecast_in_words, forecast_text
from fenicsx_obstacle.studies import forecast as module
from fenicsx_obstacle.studies.forecast import BEYOND, closest, continued, forecast
from tests.conftest import COMM, DEMOS, membrane, slow_except
from tests.helpers import run as command
from tests.random.families.solid_meshes import octants, tetrahedra

BALL = "r^2/6 + 0.6^3/(3*r) - 0.6^2/2"
CEILING = {"tension": 1, "load": 1, "upper": 0.12, "boundary": [{"value": 0}], "report": {"volume": "integral(u)"}}


def scene_of(name):
    """A scene of the catalogue, or one on tetrahedra, on a coarse mesh."""
    if name == "ball in a cube":
        sides = {axis: [-1, 1] for axis in "xyz"}
        return Scene(mesh={"shape": "box", **sides, "cells": 4}, tension=1, load=-1, lower=0,
                     define={"given": f"where(r < 0.6, 0, {BALL})"}, boundary=[{"value": "given"}])  # fmt: skip
    if name == "prism":
        return Scene(mesh=tetrahedra(COMM, *octants("prism", 2)), **CEILING)
    scene = catalogue.scene(name).change({"exact": None, "report": {"volume": "integral(u)"}})
    return scene if scene.tables.mesh.shape == "interval" else scene.change({"mesh.cells": 16})


def path_of(scene, goal, unknowns):
    """A refinement with so many unknowns at most."""
    forget_peak_memory(COMM)
    run = adaptation(scene, 1e-12, goal=goal, comm=COMM)
    with closing(run.meshes(unknowns=unknowns)) as meshes:
        for _ in meshes:
            pass
    return run


CASES = [
    ("disk_flat", "P1", None, 15000), ("nsv", "P2", None, 60000), ("torsion_disk", "P1", None, 15000),
    ("ball in a cube", "P1", None, 25000), ("prism", "P1", None, 14000), ("string_parabola", "P1", None, 20000),
    ("disk_flat", "P1", "force", 8000),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("name", "element", "goal", "unknowns"), slow_except(CASES, CASES[5]))
def test_unknowns_and_memory(name, element, goal, unknowns):
    """A refinement is cut at a sixth of its unknowns, in space and with P2 at a third, and continued to a tolerance
    between the last two errors; clocks of a busy machine are left to benchmarks/forecasts.py."""
    run = path_of(scene_of(name).change({"solve.element": element}), goal, unknowns)
    path, work, last = run.path, run.work, run.path[-1]
    dim = {"string_parabola": 1, "ball in a cube": 3, "prism": 3}.get(name, 2)
    part = 3 if dim == 3 or element == "P2" else 6  # meshes grow by larger factors there
    known = sum(part * step["dofs"] <= last["dofs"] for step in path)
    run.path, run.work = path[:known], work[:known]
    run.tolerance = last["relative"] ** 0.75 * path[-2]["relative"] ** 0.25
    larger = next(k for k, step in enumerate(path) if step["dofs"] >= 3 * path[known - 1]["dofs"])
    found = continued(run, dim, [work[larger]] * 2)
    assert found.stopped is None and known >= 3
    assert 1 / 2 < found.dofs / last["dofs"] < 2
    assert 1 / 2 < found.memory_mb / work[-1].memory_mb < 2
    assert abs(found.meshes - len(path)) <= 3


def run_with(unknowns, tol=1e-3, solves=None):
    """A refinement of a string: error = unknowns^-1, 0.1 s for each mesh and 10 microseconds for each unknown."""
    run = adaptation(catalogue.scene("string_parabola"), tol, comm=COMM)
    memory = 100.0
    for dofs, count in zip(unknowns, solves or [1] * len(unknowns), strict=True):
        run.path.append({"dofs": dofs, "relative": 1 / dofs, "total": 1 / dofs})
        run.work.append(work(dofs, solves=count, memory=memory + 1e-3 * dofs))
        memory += 1e-3 * dofs
    return run


def work(unknowns, *, solves=1, memory=0.0, slower=1.0, elapsed=1.0):
    seconds = slower * (0.1 + 1e-5 * unknowns * solves)
    return Work(unknowns, solves, seconds, elapsed * seconds, memory)


def test_time_and_memory_of_a_path_that_continues_as_it_began():
    """Unknowns double, 12 meshes; then the same with two solves on each mesh."""
    unknowns = [1000 * 2**k for k in range(12)]
    for solves in (1, 2):
        run = run_with(unknowns, 2 ** BEYOND[True] / unknowns[-1], [solves] * 12)
        whole = list(run.work)
        run.path, run.work = run.path[:6], run.work[:6]
        below = run.work[-1].memory_mb
        larger = work(4 * unknowns[5], solves=solves, memory=below + 1e-3 * 4 * unknowns[5])
        found = continued(run, 1, [larger, larger])
        assert found.order == pytest.approx(1.0) and found.meshes == 12 and found.agrees
        assert found.dofs == pytest.approx(unknowns[-1], rel=1e-6)
        assert found.seconds == pytest.approx(sum(one.seconds for one in whole), rel=0.02)
        assert found.memory_mb == pytest.approx(whole[-1].memory_mb, rel=1e-6)
        assert found.calibration == pytest.approx(sum(one.seconds for one in [*run.work, larger, larger]))
        assert not continued(run, 1, [larger, larger], free=found.memory_mb - below - 1).fits


def test_two_measurements_agree_or_the_words_say_so(monkeypatch):
    """The larger mesh is solved again until two times agree, three times at most; the smaller one of the two counts."""
    slower = [1.0, 1.6, 1.1]
    assert closest([work(4000, slower=factor) for factor in slower]) == pytest.approx((1.1, work(4000).rate))
    run = run_with([1000, 2000, 4000])
    times = iter([1.0, 1.6, 2.4])
    monkeypatch.setattr(Adaptation, "work_of", lambda self, context, cells: work(16000, slower=next(times), elapsed=3))
    context = SolverContext(catalogue.scene("string_parabola"), COMM)
    found = continued(run, 1, module._larger(run, context, 1))
    assert next(times, None) is None and not found.agrees and found.spread == pytest.approx(1.5)
    assert found.busy == pytest.approx(3.0)
    words = forecast_in_words(found, "bound", 2)
    assert "unknowns and memory within a factor of 2" in words
    assert "measured times per unknown differ by a factor of 1.5" in words
    assert "elapsed time is 3.0 times processor time" in words


def test_what_other_programs_take_is_not_counted(monkeypatch):
    """A sleep is elapsed time, and no processor time."""
    run, answer = adaptation(catalogue.scene("string_parabola"), 0.2, comm=COMM), SolverContext.answer

    def slow(*given, **options):
        time.sleep(0.5)
        return answer(*given, **options)

    monkeypatch.setattr(SolverContext, "answer", slow)
    with closing(run.meshes()) as meshes:
        next(meshes)
    assert run.work[0].elapsed > 0.5 and run.work[0].elapsed - run.work[0].seconds > 0.4


@pytest.mark.slow
def test_what_is_reached_on_the_way():
    """A tolerance within the calibration is reported as it was, on the mesh of `solve`; mistakes are rejected as there;
    an eps that is too large for the tolerance is the reason."""
    disk = catalogue.scene("disk_flat").change({"exact": None})
    for goal, tol in ((None, 0.1), ("force", 0.01)):
        found, answer = forecast(adaptation(disk, tol, goal=goal)), solve(disk, tol=tol, goal=goal, comm=COMM)
        assert found.stopped == "" and found.dofs == answer.dofs
        assert found.meshes == len(answer.record["adaptive"]["path"])
    stiff = adaptation(disk.change({"solve.eps": 0.1}), 0.01)
    assert "cannot be reached: eps = 0.1 alone contributes" in forecast_text(stiff)
    for options, match in (
        ({"tol": 0.0}, "must be positive"), ({"tol": 0.1, "goal": "forces"}, "no quantity 'forces'"),
        ({"tol": 0.1, "tol_absolute": 0.1}, "two tolerances"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=match):
            adaptation(disk, **options)
    flat = membrane(load="-1 - x", lower=0).change({"solve.method": "vi"})
    with pytest.raises(InputError, match="energy norm of u is 0; give --tol-absolute"):
        forecast(adaptation(flat, 0.1))
    with pytest.raises(InputError, match="not for scenes with"):
        adaptation(Scene.read(DEMOS / "put.toml"), 0.1)


@pytest.mark.serial
def test_command():
    """`explain` takes the tolerance and the quantity as `solve` does."""
    done = command("explain", "disk_flat", "--tol", "0.05", "--of", "force")
    assert done.returncode == 0, done.stderr
    assert "--tol         0.05 --of force: expect about " in done.stdout and "has reached the tolerance" in done.stdout
    wrong = command("explain", "disk_flat", "--of", "force")
    assert wrong.returncode == 2 and "--of needs a tolerance: add --tol" in wrong.stderr

"""What a tolerance will take, told from the first meshes: within a factor of 2 of what then happens."""

from contextlib import closing

import pytest
from conftest import COMM, membrane

from fenicsx_obstacle import InputError
from fenicsx_obstacle.answers.adapt import Refinement
from fenicsx_obstacle.scenes import catalogue
from fenicsx_obstacle.studies.forecast import continued, forecast


def path_of(scene, unknowns):
    refinement = Refinement(scene, COMM)
    with closing(refinement.meshes(unknowns=unknowns)) as meshes:
        for _ in meshes:
            pass
    return refinement.path


@pytest.mark.slow
@pytest.mark.parametrize(("name", "element"), [("disk_flat", "P1"), ("nsv", "P2"), ("torsion_disk", "P1")])
def test_unknowns_and_memory(name, element):
    """A refinement is cut at a sixth of its unknowns and continued to the bound that it reached; clocks of a busy
    machine are left to benchmarks/forecasts.py."""
    scene = catalogue.scene(name).change({"solve.element": element, "mesh.cells": 16, "exact": None})
    path = path_of(scene, 15000 if element == "P1" else 60000)
    last = path[-1]
    known = [step for step in path if step["dofs"] < last["dofs"] / 6]
    next_ = path[len(known)]
    probe = {**next_, "seconds": next_["seconds"] - known[-1]["seconds"]}
    found = continued(known, last["relative"], 1 if element == "P1" else 2, probe)
    assert not found.reached and len(known) >= 3
    assert 1 / 2 < found.dofs / last["dofs"] < 2
    assert 1 / 2 < found.memory_mb / last["memory_mb"] < 2
    assert abs(found.meshes - len(path)) <= 3


def test_time_of_a_path_that_goes_on_as_it_began():
    """Bound ~ 1/sqrt(unknowns), doubling; a mesh takes 0.1 s and 10 microseconds for each unknown."""
    path, seconds = [], 0.0
    for k in range(12):
        dofs = 1000 * 2**k
        seconds += 0.1 + 1e-5 * dofs
        path.append({"dofs": dofs, "relative": dofs**-0.5, "seconds": seconds, "memory_mb": 100 + 1e-3 * 2 * dofs})
    found = continued(path[:6], path[-1]["relative"], 1, {"dofs": 64000, "seconds": 0.74, "memory_mb": 228})
    assert found.order == pytest.approx(0.5) and found.meshes == 12
    assert found.dofs == pytest.approx(path[-1]["dofs"], rel=1e-6)
    assert found.seconds == pytest.approx(path[-1]["seconds"], rel=1e-3)
    assert found.memory_mb == pytest.approx(path[-1]["memory_mb"], rel=0.1)


def test_what_is_reached_on_the_way():
    """A tolerance within the calibration is told as what it was; mistakes are refused."""
    found = forecast(catalogue.scene("disk_flat"), 0.1)
    assert found.reached and found.dofs < 3000
    with pytest.raises(InputError, match="must be positive"):
        forecast(catalogue.scene("disk_flat"), 0.0)
    with pytest.raises(InputError, match="u is 0 so far"):
        forecast(membrane(load="-1 - x", lower=0).change({"solve.method": "vi"}), 0.1)

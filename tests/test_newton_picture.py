"""Newton at work, drawn: the active sets are those of the solve, and nothing is done where nobody asks."""

from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from fenicsx_obstacle import solve
from fenicsx_obstacle.show.newton import animate_newton, iterates
from tests.conftest import COMM, membrane

STIFF = {"cells": 16, "eps": 1e-6}


def sets(steps):
    """Sizes and changes of active sets: the last digits of forces differ between two solves on several ranks."""
    return [(step.active, step.changed) for step in steps]


@pytest.mark.slow
@pytest.mark.parametrize("element", ["P1", "P2", "Q1-gauss"])
def test_active_sets_are_those_of_the_solve(element, disk):
    """One for the start and one for each step, with as many points in contact as the history says."""
    cell = {"mesh.cell": "quadrilateral"} if element.startswith("Q") else {}
    answer = solve(disk.change(cell), method="successive", element=element, **STIFF)
    found = iterates(answer.scene, answer.level)
    assert sets(one.step for one in found) == sets(answer.history)
    assert [one.number for one in found] == list(range(answer.record["newton_iterations"] + 1))
    if COMM.rank != 0 or element != "P1":
        return
    assert [np.count_nonzero(one.contact) for one in found] == [step.active for step in answer.history]
    for before, after in pairwise(found):
        assert np.count_nonzero(before.contact != after.contact) == after.step.changed


def test_sets_shrink(ball):
    """(3.4)* on an M-matrix: from the second set on, each is part of the one before."""
    answer = solve(ball, method="successive", **STIFF)
    found = iterates(answer.scene, answer.level)
    assert len(found) > 4
    assert all(not np.any(after.contact & ~before.contact) for before, after in pairwise(found[1:]))


def test_all_levels_are_seen(ball):
    """From the coarsest level to the finest; all steps together are those that the answer reports."""
    answer = solve(ball, cells=64, eps=1e-6)
    found = iterates(answer.scene, answer.level)
    sizes = [one.dofs for one in found]
    last = [one.number for one, after in zip(found, [*sizes[1:], 0], strict=True) if one.dofs != after]
    assert sizes == sorted(sizes)
    assert len(last) > 2
    assert sum(last) == answer.record["newton_total"]
    assert sets(one.step for one in found if one.dofs == answer.record["dofs"]) == sets(answer.history)


@pytest.mark.slow
def test_an_animation_has_a_frame_for_each_step(ball, folder):
    """And one for the start; the shorter course rests at its end."""
    answer = solve(ball, cells=32, eps=1e-6)
    said = animate_newton(answer, folder / "newton.gif")
    courses = [
        iterates(answer.scene.change({"solve.method": name}), answer.level) for name in ("successive", "penalty")
    ]
    assert f"(3.4)*, from no contact: {courses[0][-1].number} steps" in said
    assert f"from 1 coarser level: {courses[1][-1].number} steps" in said
    if COMM.rank == 0:
        with Image.open(folder / "newton.gif") as picture:
            assert picture.n_frames == max(len(time_history) for time_history in courses)
        assert [path.name for path in folder.iterdir()] == ["newton.gif"]


def test_what_is_not_flat_is_not_drawn(folder):
    """Contact sets of intervals, solids and scenes without obstacles are no pictures."""
    shapes = [{"mesh": {"shape": "interval", "cells": 8}, "load": -1, "lower": -0.1}, {"load": 1}]
    for given in shapes:
        assert animate_newton(solve(membrane(**given)), folder / "newton.gif").endswith("not drawn")
    assert not list(folder.iterdir())

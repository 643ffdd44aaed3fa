"""`find`: the value of a key for which a quantity reaches a target, and starts from the last solution."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import InputError, Scene, find, solve, study
from tests.helpers import inside

COMM = MPI.COMM_WORLD


def string(**changes):
    """A parabola over a floor: -u'' = -1, u = 1 at both ends, contact where the ends are far apart."""
    tables = {"mesh": {"shape": "interval", "x": [0, 4], "cells": 64}, "tension": 1, "load": "-q",
              "define": {"q": 1, "base": 0}, "lower": "base", "boundary": [{"value": 1}]}  # fmt: skip
    return Scene(**{**tables, **changes})


def test_known_value():
    """A floor 1 below a string under the load q carries 4 q - 2 sqrt(2 q), which is 2 at q = (3 + 5^.5)/4."""
    exact = (3 + np.sqrt(5)) / 4
    assert abs(4 * exact - 2 * np.sqrt(2 * exact) - 2) < 1e-12
    rows = find(string(), {"define.q": [0.7, 3]}, "force = 2", within=1e-6, cells=256)
    assert abs(rows[-1]["vary.define.q"] - exact) < 1e-4
    assert rows == sorted(rows, key=lambda row: row is rows[-1])


@pytest.mark.parametrize(("key", "values", "cells"), [
    ("define.q", [1.0, 1.01, 1.02, 1.021], 512),
    ("effects.load", [lambda x: -1.0 - 0 * x[0], lambda x: -2.0 - 0 * x[0]], 64),  # whatever a callable is called
])  # fmt: skip
def test_same_solution_from_the_last(key, values, cells):
    """Rows of a study that begins each solve from the last equal single solves, and take no more Newton steps."""
    rows = study(string(), {key: values}, cells=cells)
    for value, row in zip(values, rows, strict=True):
        alone = solve(string().change({key: value}), cells=cells)
        assert abs(row["energy"] - alone.energy) < 1e-9 * abs(alone.energy)
        assert abs(row["contact.lower.force"] - alone.force.lower) < 1e-9
        assert row["dofs"] == cells + 1
    assert rows[-1]["newton_iterations"] <= alone.iterations
    assert abs(rows[-1]["energy"] - rows[0]["energy"]) > 1e-3 * abs(rows[0]["energy"])


@pytest.mark.parametrize(
    ("vary", "target", "message"),
    [
        ({"define.q": (1, 2)}, "force = 30", "at define.q = 1 and 3.99[0-9]* at define.q = 2, both below"),
        ({"define.q": (1, 1)}, "force = 1", "expected two numbers"),
        ({"define.q": (1, 2), "define.base": (0, 0.5)}, "force = 1", "one key varies"),
        ({"define.q": (1, 2)}, "force 30", "expected NAME = VALUE"),
        ({"define.q": (1, 2)}, "forse = 30", "did you mean 'force'"),
        ({"define.q": (1, 2)}, "force = x", "x"),
        ({"define.q": (1, 2)}, "force = 1 + q/2", "depends on define.q"),
        ({"define.p": (1, 2)}, "force = 1", "define"),
    ],
)
def test_mistakes(vary, target, message):
    """A search that cannot succeed is one message; of a target that is not bracketed with the values at both ends."""
    with pytest.raises(InputError, match=message):
        find(string(), vary, target)


@pytest.mark.slow
def test_jumps():
    """A count of nodes changes by two nodes at once, 2.5 % of its range, and reaches nothing between; the area does."""
    scene = string(report={"counted": "integral(contact)"})
    pattern = r"counted jumps over 1.25 at define.q = 1\.[0-9]*: it is 1.21875 at 1\.[0-9]* and 1.28125 at .* this mesh"
    with pytest.raises(InputError, match=pattern):
        find(scene, {"define.q": (0.7, 3)}, "counted = 1.25", cells=128)
    rows = find(scene, {"define.q": (0.7, 3)}, "area = 1.22", cells=128)
    assert abs(rows[-1]["contact.area"] - 1.22) < 1e-3 and len(rows) <= 10


@pytest.mark.slow
@pytest.mark.serial
def test_command(tmp_path):
    """A line of JSON for each solve, the found one last; nothing is computed twice; a wrong interval keeps its rows."""
    (tmp_path / "s.toml").write_text(string().toml())
    command = ["find", "s.toml", "--vary", "define.q=0.7..3", "--target", "force = 2", "--output", "f"]
    done = inside(*command, "--json", "-", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert abs(rows[-1]["contact"]["lower"]["force"] - 2) < 1e-3
    assert len((tmp_path / "f" / "rows.jsonl").read_text().splitlines()) == len(rows)
    page = (tmp_path / "f" / "report.html").read_text()
    last = page[: page.index("</tbody>")].rpartition("<tr><td>")[2]
    assert last.startswith(f"{rows[-1]['vary']['define.q']:.6g}")
    assert (tmp_path / "f" / "last" / "answer.json").exists()
    again = inside(*command, "--json", "-", cwd=tmp_path)
    assert [json.loads(line)["key"] for line in again.stdout.splitlines()] == [row["key"] for row in rows]
    assert len((tmp_path / "f" / "rows.jsonl").read_text().splitlines()) == len(rows)
    wrong = ["--vary", "define.q=0.7..1", "--target", "force = 30", "--output", "g"]
    done = inside("find", "s.toml", *wrong, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "both below the target" in done.stderr
    assert len((tmp_path / "g" / "rows.jsonl").read_text().splitlines()) == 2

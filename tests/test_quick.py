"""What runs without --all: every effect, every statement of the theory and every command at least once."""

import re
import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest
from click.testing import CliRunner

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.effects.effect import known
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.show import demo as demo_module
from fenicsx_obstacle.show.report import report_study
from tests.conftest import CLEAN, COMM, DEMOS
from tests.theory.statement import statements

ROOT = DEMOS.parent


def scene_with(key):
    """The first demo that names the effect, on few cells and with few steps."""
    for file in sorted(DEMOS.glob("*.toml")):
        scene = Scene.read(file)
        if scene.tables.mesh.file is None and key in {effect.key for effect in scene.effects}:
            return scene.change({"mesh.cells": 9, **({} if scene.time is None else {"time.steps": 10})})
    raise AssertionError(f"no demo has the effect {key}")


@pytest.mark.parametrize("key", sorted(known() | known("boundary")))
def test_every_effect(key):
    """Each effect of the register is solved: the solver converges to finite values that are not all 0."""
    answer = solve(scene_with(key))
    assert 0 < largest(COMM, np.abs(answer.u.x.array)) < np.inf


def is_quick(function):
    """Whether a test, or a case of it, runs without --all."""
    marks = getattr(function, "pytestmark", [])
    cases = [mark.args[1] for mark in marks if mark.name == "parametrize"]
    return all(mark.name != "slow" for mark in marks) and all(
        any(all(mark.name != "slow" for mark in getattr(case, "marks", ())) for case in values) for values in cases
    )


@pytest.mark.serial
def test_every_statement():
    """Each statement of the register has a row in docs/theory.md, and a test named in the row runs without --all."""
    files, functions = set(), set()
    for file in (ROOT / "tests").glob("test_*.py"):
        tests = vars(import_module(f"tests.{file.stem}")).items()
        quick = {name for name, value in tests if name.startswith("test_") and is_quick(value)}
        files.update([f"tests/{file.name}"] if quick else [])
        functions |= quick
    assert functions
    table = (ROOT / "docs" / "theory.md").read_text().partition("## Statements, functions")[2].partition("\n## ")[0]
    rows = [line.split("|") for line in table.splitlines() if "`theory" in line]
    tested = set()
    for row in rows:
        tests = re.findall(r"`(tests/\w+\.py|test_\w+)`", row[3])
        assert tests, row
        if any(test in files | functions for test in tests):
            tested.update(re.findall(r'`(?:theory )?"?([^`"]+)"?`', row[4]))
    for one in statements():
        assert {one.number, *one.also} & tested, one.number


BALL = ["ball", "--cells", "8", "--output", "result"]
COMMANDS = {  # in this order: compare and plot take what solve has written
    "solve": BALL,
    "explain": ["ball"],
    "study": ["string_parabola", "--vary", "cells=8,16", "--output", "study"],
    "find": ["string_parabola", "--vary", "define.f=4..12", "--target", "force = 3", "--output", "find"],
    "cost": ["string_parabola", "--budget", "10 unknowns", "--output", "cost"],
    "compare": ["result", "result"],
    "plot": ["result", "--output", "result.svg"],
    "scenes": [],
    "theory": ["3.27", "--output", "theory"],
    "hard": ["flying", "--output", "hard"],
}


@pytest.mark.serial
def test_every_command(tmp_path, monkeypatch):
    """Each command of the register, on one rank, ends with status 0 and says something; 'demo' has its own test."""
    assert {*COMMANDS, "demo"} == set(commands.commands)
    monkeypatch.chdir(tmp_path)
    for name, arguments in COMMANDS.items():
        done = CliRunner().invoke(commands, [name, *arguments], catch_exceptions=False)
        assert done.exit_code == 0, (name, done.output)
        assert done.stdout, name
    assert (tmp_path / "result.svg").exists()


@pytest.mark.serial
def test_demo_on_few_cells(tmp_path, monkeypatch):
    """The command 'demo' with coarse meshes and short studies: four answers and three studies are saved."""
    monkeypatch.setattr(demo_module, "solve", lambda scene: solve(scene, cells=8))
    monkeypatch.setattr(demo_module, "report_answer", lambda answer, folder, picture: f"no picture in {folder}")

    def short_study(scene, vary, options, folder, say):
        values = {key: given[:2] for key, given in vary.items()}
        return report_study(scene, values, {**options, **({} if "cells" in vary else {"cells": 8})}, folder, say)

    monkeypatch.setattr(demo_module, "report_study", short_study)
    done = CliRunner().invoke(commands, ["demo", "--output", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    assert len(list(tmp_path.rglob("answer.json"))) >= 4
    assert len(list(tmp_path.rglob("rows.jsonl"))) == 3


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.timeout(600)
def test_demo(tmp_path):
    """The command 'demo' as it is."""
    command = [sys.executable, "-m", "fenicsx_obstacle", "demo", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=CLEAN, timeout=550, check=False)
    assert done.returncode == 0, done.stderr
    assert {path.parent.name for path in tmp_path.glob("*/answer.json")} == {"string", "disk", "ball", "two_sided"}
    assert len(list(tmp_path.rglob("rows.jsonl"))) == 3

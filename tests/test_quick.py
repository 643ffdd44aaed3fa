"""What runs without --all: every effect and every command at least once."""

import numpy as np
import pytest
from click.testing import CliRunner

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.effects.effect import known
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.studies.convergence import Study
from tests.conftest import COMM, DEMOS

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
@pytest.mark.usefixtures("matplotlib_draws")
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
@pytest.mark.usefixtures("matplotlib_draws")
def test_demo_on_few_cells(tmp_path, monkeypatch):
    """The command 'demo' with coarse meshes and short studies: four answers and three studies are saved."""
    monkeypatch.setattr("fenicsx_obstacle.answers.solve.solve", lambda file: solve(file, cells=8))
    no_picture = lambda answer, *_, **__: (answer, "no picture")  # noqa: E731
    monkeypatch.setattr("fenicsx_obstacle.show.report.report_answer", no_picture)

    def short_study(scene, vary, options):
        values = {key: given[:2] for key, given in vary.items()}
        return Study(scene, values, {**options, **({} if "cells" in vary else {"cells": 8})})

    monkeypatch.setattr("fenicsx_obstacle.studies.convergence.Study", short_study)
    done = CliRunner().invoke(commands, ["demo", "--output", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    assert len(list(tmp_path.rglob("answer.json"))) >= 4
    assert len(list(tmp_path.rglob("rows.jsonl"))) == 3

"""The main job on the scenes of demos/: answers with pictures, an eps-study and two h-studies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fenicsx_obstacle.answers.solve import solve
from fenicsx_obstacle.checkout import DEMOS, require
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show.report import report_answer
from fenicsx_obstacle.show.study import Say, report_study
from fenicsx_obstacle.studies.convergence import Study
from fenicsx_obstacle.text import title_of


def run_demo(folder: Path, say: Say) -> None:
    """Solve the scenes of demos/, then the eps-study and the h-studies (collective).

    Raises:
        InputError: In an installed wheel.
    """
    require("demo")
    for name in ("string", "disk", "ball", "two_sided"):
        answer = solve(Scene.read(DEMOS / f"{name}.toml"))
        answer.save(folder / name)
        _, drawn = report_answer(answer, folder / name, picture=True)
        say(f"{answer.summary()}\n  {drawn}\n")
    studies: list[tuple[str, str, dict[str, Any], dict[str, Any]]] = [
        ("disk", "h fixed: u_eps tends to the solution of the variational inequality with order eps",
         {"eps": [10.0**-k for k in range(1, 11)]}, {"cells": 64}),
        ("disk", "eps = h^2: order 1 in H1, and at least 1 for the pressure in the dual norm",
         {"cells": [16, 32, 64, 128]}, {"eps": "h^2"}),
        ("ball", "eps = h^2 again, on Bueler's ball", {"cells": [16, 32, 64, 128]}, {"eps": "h^2"}),
    ]  # fmt: skip
    for name, headline, vary, options in studies:
        scene = Scene.read(DEMOS / f"{name}.toml")
        say(f"{title_of(scene.tables.title, scene.name)}. {headline}")
        report_study(Study(scene, vary, options), folder / name / "-".join(vary), say)
        say("")

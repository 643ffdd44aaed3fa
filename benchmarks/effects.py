"""What each effect costs: a membrane over an obstacle, then the same with one more effect at a time.

    .venv/bin/python benchmarks/effects.py [--cells 256] [--repeat 3] [--json FILE]

Each line is a process of its own, for the sake of its memory. A unit is one linear Poisson solve on the same mesh in
the same process. 'assembly' is everything before the first step: spaces, prolongations, data, matrices of all levels.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

MATRIX = [[2, 0.5], [0.5, 1]]
LEFT = {"on": "left", "value": 0}
PLATEAU = "min(0.1, x, 1 - x, y, 1 - y)"  # with inertia the start agrees with the boundary value
REST = {"on": ["bottom", "top"], "value": 0}
# what is changed of a membrane over a paraboloid, held along its whole boundary; None takes a key away
CHANGES: dict[str, dict[str, Any]] = {
    "membrane": {},
    "no obstacle": {"obstacle": {}, "effects.load": -1},
    "load": {"effects.load": -1},
    "two obstacles": {"obstacle.upper": "0.2 + (x - 0.5)^2"},
    "tension, a matrix": {"effects.tension": MATRIX},
    "foundation": {"effects.foundation": 10},
    "point load": {"effects.point_load": [{"at": [0.3, 0.3], "force": -0.05}]},
    "spring": {"boundary": [LEFT, REST, {"on": "right", "spring": 5}]},
    "flux": {"boundary": [LEFT, REST, {"on": "right", "flux": -0.1}]},
    "axial symmetry": {"effects.axial_symmetry": True},
    "obstacle on the boundary": {
        "obstacle": {}, "effects.load": -1, "boundary": [LEFT, REST, {"on": "right", "lower": "-0.05*y"}]},
    "rate, one step": {"effects.rate": 1, "time": {"end": 0.01, "steps": 1, "start": 0.1}},
    "rate, ten steps": {"effects.rate": 1, "time": {"end": 0.1, "steps": 10, "start": 0.1}},
    "inertia, one step": {"effects.inertia": 1, "time": {"end": 0.01, "steps": 1, "start": PLATEAU}},
    "inertia, ten steps": {"effects.inertia": 1, "time": {"end": 0.1, "steps": 10, "start": PLATEAU}},
    "drift": {"effects.drift": [5, 3]},
    "soft obstacle": {"effects.soft_obstacle": {"upper": 0.05, "stiffness": 100}},
    "large slope": {"effects": {"large_slope": 1}},
    "power law": {"effects": {"power_law": {"exponent": 1.8, "regularisation": 1e-3}}},
}  # fmt: skip
HEADS = ("effect", "unknowns", "integrals", "steps", "linear steps", "assembly, s", "solve, s", "in all, units",
         "MB more than the mesh")  # fmt: skip


def main() -> None:
    """One process after another, and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=256)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--one", choices=CHANGES, help="this one, as a JSON line")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.one, options.cells, options.repeat)))
        return
    print(f"| {' | '.join(HEADS)} |\n| {' | '.join('---' for _ in HEADS)} |")
    for name in CHANGES:
        command = [sys.executable, __file__, "--one", name, "--cells", str(options.cells)]
        command += ["--repeat", str(options.repeat)]
        row = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        print(f"| {' | '.join(cells(row))} |", flush=True)
        if options.json is not None:
            with options.json.open("a") as file:
                file.write(json.dumps(row) + "\n")


def measure(name: str, count: int, repeat: int) -> dict[str, Any]:
    """The fastest of several solves in this process, after a small one that compiles."""
    from mpi4py import MPI

    from fenicsx_obstacle import Scene
    from fenicsx_obstacle.answers.poisson_baseline import poisson_seconds
    from fenicsx_obstacle.answers.solver_context import SolverContext
    from fenicsx_obstacle.parallel import peak_memory_mb
    from fenicsx_obstacle.scenes import meshes
    from fenicsx_obstacle.show.explain import integrals

    base = Scene(mesh={"shape": "rectangle", "cells": 32}, tension=1, lower="0.1 - (x - 0.5)^2 - (y - 0.5)^2")
    scene = base.change(CHANGES[name])
    with closing(SolverContext(scene)) as small:
        small.answer()
    scene = scene.change({"mesh.cells": count})
    level = meshes.build(scene, MPI.COMM_WORLD)
    mesh = peak_memory_mb(MPI.COMM_WORLD)
    with closing(SolverContext(scene, level=level)) as context:  # first: what comes later may reuse memory
        record = context.answer().record
        memory = record["memory_mb"] - mesh
    found = []
    for _ in range(repeat):
        with closing(SolverContext(scene)) as context:
            record = context.answer().record
            found.append((record["seconds"]["solve"], context.setup_seconds))
    solve, setup = min(found)
    unit = poisson_seconds(meshes.build(scene, MPI.COMM_WORLD))
    return {
        "effect": name, "dofs": record["dofs"], "integrals": integrals(scene), "newton": record["newton_iterations"],
        "krylov": record["krylov_iterations"], "assembly": setup, "solve": solve - setup, "poisson_seconds": unit,
        "units": solve / unit, "memory_mb": memory,
    }  # fmt: skip


def cells(row: dict[str, Any]) -> list[str]:
    """One line of the table."""
    counts = [str(row[key]) for key in ("dofs", "integrals", "newton", "krylov")]
    times = [f"{row[key]:.2f}" for key in ("assembly", "solve", "units")]
    return [row["effect"], *counts, *times, f"{row['memory_mb']:.0f}"]


if __name__ == "__main__":
    main()

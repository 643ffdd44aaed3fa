"""Forecasts of `explain --tol` compared with what `solve --tol` then takes, each in a process of its own.

    .venv/bin/python -m benchmarks.forecasts
    .venv/bin/python -m benchmarks.forecasts ball:P2:1e-3 nsv:P1:0.01 nsv:P1:1e-3:volume

Cases are SCENE:ELEMENT:TOLERANCE, and :NAME for the tolerance of a quantity. Ratios are forecast over fact. Seconds are
processor times. A row ends with the time of the forecast, and with elapsed over processor time of both processes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import asdict
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.answers.solve import adaptation
from fenicsx_obstacle.scenes import catalogue
from fenicsx_obstacle.studies.forecast import forecast
from tests.random.families.solid_meshes import octants, tetrahedra

CASES = (
    "ball:P1:0.012 nsv:P1:0.01 torsion_disk:P1:0.005 disk_flat:P1:0.01 smooth_square:P1:0.006 halfplane:P1:0.005 "
    "cone:P1:0.015 ball:P2:5e-4 nsv:P2:3e-4 disk_flat:P2:2e-4 two_obstacle_square:P2:1e-3 biactive:P2:1e-3 "
    "string_parabola:P1:2e-5 ball_in_a_cube:P1:0.06 prism:P1:0.09 nsv:P1:5e-4:volume disk_flat:P1:1e-4:force "
    "prism:P1:0.04:volume"
)


def main() -> None:
    """Print a line for each case."""
    if sys.argv[1:2] == ["one"]:
        print(json.dumps(one(*sys.argv[2:])))
        return
    print(
        f"{'case':30} {'unknowns':>19} {'ratio':>5} {'seconds':>13} {'ratio':>5} {'MB':>11} {'ratio':>5}  calibration"
    )
    for case in sys.argv[1:] or CASES.split():
        guess, fact = (json.loads(output(how, case)) for how in ("guess", "fact"))
        parts = [
            f"{guess[key]:{width}.{digits}f}/{fact[key]:<{width}.{digits}f} {guess[key] / fact[key]:5.2f}"
            for key, width, digits in (("dofs", 9, 0), ("seconds", 6, 1), ("memory_mb", 5, 0))
        ]
        busy = " ".join(f"{one['elapsed'] / one['processor']:.2f}" for one in (guess, fact))
        print(f"{case:30} {' '.join(parts)}  {guess['calibration']:.1f} s, {guess['spread']:.2f}, {busy}", flush=True)


def output(how: str, case: str) -> str:
    """The last line that another process prints."""
    command = [sys.executable, __file__, "one", how, *case.split(":")]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1]


def scene_of(name: str) -> Scene:
    """A scene of the catalogue, or one on tetrahedra."""
    if name == "ball_in_a_cube":
        sides = {axis: [-1, 1] for axis in "xyz"}
        outside = "r^2/6 + 0.6^3/(3*r) - 0.6^2/2"
        return Scene(mesh={"shape": "box", **sides, "cells": 4}, tension=1, load=-1, lower=0,
                     define={"given": f"where(r < 0.6, 0, {outside})"}, boundary=[{"value": "given"}])  # fmt: skip
    report = {"volume": "integral(u)"}
    if name == "prism":
        mesh = tetrahedra(MPI.COMM_WORLD, *octants("prism", 2))
        return Scene(mesh=mesh, tension=1, load=1, upper=0.12, boundary=[{"value": 0}], report=report)
    return catalogue.scene(name).change({"exact": None, "report": report})


def one(how: str, name: str, element: str, tol: str, goal: str | None = None) -> dict[str, Any]:
    """A forecast, or what happens."""
    scene = scene_of(name).change({"solve.element": element})
    elapsed, processor = time.perf_counter(), time.thread_time()
    if how == "guess":
        found = asdict(forecast(adaptation(scene, float(tol), goal=goal)))
    else:
        record = solve(scene, tol=float(tol), goal=goal).record
        found = {"dofs": record["dofs"], "memory_mb": record["memory_mb"], "seconds": time.thread_time() - processor}
    return {**found, "elapsed": time.perf_counter() - elapsed, "processor": time.thread_time() - processor}


if __name__ == "__main__":
    main()

"""Forecasts of `explain --tol` compared with what `solve --tol` then takes, each in a process of its own.

    .venv/bin/python benchmarks/forecasts.py
    .venv/bin/python benchmarks/forecasts.py ball:P2:1e-3 nsv:P1:0.01

Cases are SCENE:ELEMENT:TOLERANCE. Ratios are forecast over fact; the calibration has seconds enough for a part of each.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from typing import Any

CASES = (
    "ball:P1:0.012 nsv:P1:0.01 torsion_disk:P1:0.005 disk_flat:P1:0.01 smooth_square:P1:0.006 halfplane:P1:0.005 "
    "cone:P1:0.015 ball:P2:5e-4 nsv:P2:3e-4 disk_flat:P2:2e-4 two_obstacle_square:P2:1e-3 biactive:P2:1e-3"
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
        print(f"{case:30} {' '.join(parts)}  {guess['calibration']:.1f} s", flush=True)


def output(how: str, case: str) -> str:
    """The last line that another process prints."""
    command = [sys.executable, __file__, "one", how, *case.split(":")]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1]


def one(how: str, name: str, element: str, tol: str) -> dict[str, Any]:
    """A forecast, or what happens."""
    from fenicsx_obstacle import solve
    from fenicsx_obstacle.scenes import catalogue
    from fenicsx_obstacle.studies.forecast import forecast

    scene = catalogue.read(name).change({"solve.element": element, "exact": None})
    if how == "guess":
        return asdict(forecast(scene, float(tol)))
    record = solve(scene, tol=float(tol)).record
    return {"dofs": record["dofs"], "seconds": record["seconds"]["total"], "memory_mb": record["memory_mb"]}


if __name__ == "__main__":
    main()

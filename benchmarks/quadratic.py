"""The ball to the L2 error of uniform P1 with a million unknowns: that, and adaptive P2, each as a whole process.

    .venv/bin/python benchmarks/quadratic.py --cells 1024 --tol 7.5e-4

Prints the processor time (user and system) of each process, unknowns and errors; start-up, meshes, error bounds and
saved files are included. The scale on which programs compare across machines is one Poisson solve on the uniform mesh,
which another process measures in the same run.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from whole_run import measured


def main() -> None:
    """Run all and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="ball")
    parser.add_argument("--cells", type=int, default=1024)
    parser.add_argument("--start", type=int, default=64, help="cells per side of the scene that P2 begins with")
    parser.add_argument("--tol", default="7.5e-4")
    parser.add_argument("--times", type=int, default=3, help="runs of each; the least time counts")
    options = parser.parse_args()
    solve = ["solve", options.scene]
    p1 = [*solve, "--cells", str(options.cells), "--eps", "1e-10"]
    unit = record([*p1, "--yardstick"])["poisson_seconds"]
    print(f"a Poisson solve: {unit:.2f} s")
    uniform = run(p1, "P1 uniform", unit, options.times)
    for tol in options.tol.split(","):
        p2 = [*solve, "--element", "P2", "--cells", str(options.start), "--tol", tol]
        adaptive = run(p2, f"P2 to {tol}", unit, options.times)
        print(f"P2 over P1: {adaptive['process'] / uniform['process']:.3f} of the time, "
              f"{adaptive['errors']['l2'] / uniform['errors']['l2']:.2f} of the L2 error")  # fmt: skip


def run(words: list[str], name: str, unit: float, times: int) -> dict[str, Any]:
    """The record of a command, with the least processor time of several runs."""
    runs = [record(words) for _ in range(times)]
    best = min(runs, key=lambda one: one["process"])
    errors = ", ".join(f"{key} {best['errors'][key]:.3e}" for key in ("energy", "l2", "max"))
    meshes = len(best["adaptive"]["path"]) if "adaptive" in best else 1
    print(f"{name}: {best['process']:.2f} s, {best['process'] / unit:.2f} Poisson solves, {best['memory']:.0f} MB, "
          f"{best['dofs']} unknowns on mesh {meshes}; {errors}", flush=True)  # fmt: skip
    return best


def record(words: list[str]) -> dict[str, Any]:
    """The record of a process of the command line, with its processor time and memory."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "record.json"
        command = [sys.executable, "-m", "fenicsx_obstacle", *words, "--quiet", "--json", str(file)]
        used = measured([*command, "--output", folder + "/out"])
        return json.loads(file.read_text()) | {"process": used["processor"], "memory": used["memory_mb"]}


if __name__ == "__main__":
    main()

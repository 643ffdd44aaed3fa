"""The ball to the L2 error of uniform P1 with a million unknowns: that, and adaptive P2, each as a whole process.

    .venv/bin/python benchmarks/quadratic.py --cells 1024 --tol 7.5e-4

Prints seconds of the process, unknowns and errors; start-up, meshes, estimates and saved answers are included. One
Poisson solve on the uniform mesh, timed in the same run, is the scale on which programs compare across machines.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any


def main() -> None:
    """Run both and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="ball")
    parser.add_argument("--cells", type=int, default=1024)
    parser.add_argument("--start", type=int, default=64, help="cells per side of the scene that P2 begins with")
    parser.add_argument("--tol", default="7.5e-4")
    options = parser.parse_args()
    solve = ["solve", options.scene]
    uniform = run([*solve, "--cells", str(options.cells), "--eps", "1e-10", "--yardstick"], "P1 uniform")
    unit = uniform["poisson_seconds"]
    print(f"a Poisson solve there: {unit:.2f} s")
    for tol in options.tol.split(","):
        adaptive = run([*solve, "--element", "P2", "--cells", str(options.start), "--tol", tol], f"P2 to {tol}")
        print(f"P2 over P1: {adaptive['process'] / uniform['process']:.3f} of the time, "
              f"{adaptive['errors']['l2'] / uniform['errors']['l2']:.2f} of the L2 error; "
              f"{adaptive['process'] / unit:.2f} Poisson solves")  # fmt: skip


def run(words: list[str], name: str) -> dict[str, Any]:
    """The record of a process of the command line, with its seconds, those of the Poisson solve taken off."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "record.json"
        command = [sys.executable, "-m", "fenicsx_obstacle", *words, "--quiet", "--json", str(file)]
        start = time.perf_counter()
        subprocess.run([*command, "--output", folder + "/out"], check=True)
        seconds = time.perf_counter() - start
        record = json.loads(file.read_text())
    record["process"] = seconds - (record["poisson_seconds"] or 0.0)
    errors = ", ".join(f"{key} {record['errors'][key]:.3e}" for key in ("energy", "l2", "max"))
    meshes = len(record["adaptive"]["path"]) if "adaptive" in record else 1
    print(f"{name}: {record['process']:.2f} s, {record['dofs']} unknowns on mesh {meshes}; {errors}", flush=True)
    return record


if __name__ == "__main__":
    main()

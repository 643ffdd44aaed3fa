"""Steps, Poisson units and memory of the solvers, against size and eps: a table, and JSON lines in a file.

    .venv/bin/python benchmarks/ladder.py demos/ball.toml --cells 128..1024 --eps "h^2,1e-8,1e-12" --json ball.jsonl
    .venv/bin/python benchmarks/ladder.py benchmarks/nsv.toml --cells 16..64 --eps 1e-8

Runs under mpirun as it stands. `--cold` adds SNES VI from a cold start with algebraic multigrid. Each solve is made
`--times` times, assembly and set-up anew, and the fastest counts; the Poisson solve is timed beside it, in the same
process and on the same mesh.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from mpi4py import MPI

from fenicsx_obstacle import NotConverged, Scene, solve
from fenicsx_obstacle.cli import values_of

COLUMNS = (
    f"{'cells':>6} {'method':>8} {'eps':>8} {'Newton':>7} {'CG':>5} {'all N/CG':>9} {'units':>6} {'s':>7} {'MB':>6}"
)


def main() -> None:
    """Run the ladder (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--cells", default="128..1024")
    parser.add_argument("--eps", default="h^2,1e-8,1e-12")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--cold", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    solves = [{"solve.method": "penalty", "solve.eps": eps} for eps in values_of(options.eps, "eps")]
    solves.append({"solve.method": "vi"})
    if options.cold:
        solves.append({"solve.method": "vi", "solve.start": "cold"})
    root = MPI.COMM_WORLD.rank == 0
    if root:
        print(COLUMNS)
    for cells in values_of(options.cells, "cells"):
        for way in solves:
            scene = Scene.read(options.scene).change({"mesh.cells": cells, **way})
            try:
                # the first run of the process compiles; every run makes its own mesh, which is not counted
                records = []
                for _ in range(options.times):
                    records.append(solve(scene, yardstick=True).record)
            except NotConverged as error:
                if root:
                    print(f"{cells:6} {way}: {error}")
                continue
            best = dict(min(records, key=lambda record: record["poisson_units"]))
            name = best["method"] + ("-cold" if "solve.start" in way else "")
            eps = "" if best["eps"] is None else f"{best['eps']:.1e}"
            total = f"{best['newton_total']}/{best['krylov_total']}"
            if root:
                print(f"{cells:6} {name:>8} {eps:>8} {best['newton_iterations']:7} {best['krylov_iterations']:5} "
                      f"{total:>9} {best['poisson_units']:6.2f} {best['seconds']['solve']:7.2f} "
                      f"{best['memory_mb']:6.0f}", flush=True)  # fmt: skip
                if options.json is not None:
                    with options.json.open("a") as file:
                        file.write(json.dumps(best) + "\n")


if __name__ == "__main__":
    main()

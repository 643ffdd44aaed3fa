"""What a tolerance brings: true and certified error, unknowns and seconds, for scenes with known solutions.

    .venv/bin/python benchmarks/tolerances.py --tol 1e-1,3e-2,1e-2,3e-3 --json tolerances.jsonl

Errors are in the energy norm, relative to that of the computed u, as the tolerance is. Runs under mpirun as it stands.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ladder import show
from mpi4py import MPI

from fenicsx_obstacle import ObstacleError, Scene, solve
from fenicsx_obstacle.cli_options import values_of
from fenicsx_obstacle.scenes import catalogue

PLANE = ("ball", "biactive", "biactive_power", "cone", "disk_flat", "disk_mu_jump", "halfplane", "nsv", "ring_wedge",
         "smooth_square", "torsion_disk", "two_obstacle_square", "l_shape")  # fmt: skip
CORNER = "r^(2/3)*sin(2/3*where(theta < 0, theta + 2*pi, theta))"
HEADS = (
    f"{'scene':>20} {'tol':>6} {'meshes':>6} {'unknowns':>9} {'true':>8} {'bound':>8} {'tol/true':>8} {'s':>6}  word"
)


def main() -> None:
    """Solve each scene to each tolerance (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=",".join(PLANE))
    parser.add_argument("--tol", default="1e-1,3e-2,1e-2,3e-3")
    parser.add_argument("--budget", default="120s")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    show(HEADS)
    for name in options.scenes.split(","):
        for tol in values_of(options.tol, "tol"):
            try:
                record = dict(solve(scene(name), tol=tol, budget=options.budget).record)
            except ObstacleError as error:
                show(f"{name:>20} {tol:6g} {error}")
                continue
            bound, path = record["bound"], record["adaptive"]["path"]
            true = record["errors"]["energy"] / (bound["total"] / bound["relative"])
            word = bound["words"] if record["adaptive"]["reached"] else record["adaptive"]["stopped"]
            show(f"{name:>20} {tol:6g} {len(path):6} {record['dofs']:9} {true:8.2e} {bound['relative']:8.2e} "
                 f"{tol / true:8.2f} {path[-1]['seconds']:6.1f}  {word}")  # fmt: skip
            if options.json is not None and MPI.COMM_WORLD.rank == 0:
                with options.json.open("a") as file:
                    file.write(json.dumps(record) + "\n")


def scene(name: str) -> Scene:
    """A scene of the catalogue, or the re-entrant corner without contact."""
    if name != "l_shape":
        return catalogue.scene(name)
    return Scene(mesh={"shape": "l-shape", "x": [-1, 1], "y": [-1, 1], "cells": 16}, tension=1, lower=-1, exact=CORNER,
                 boundary=[{"value": CORNER}])  # fmt: skip


if __name__ == "__main__":
    main()

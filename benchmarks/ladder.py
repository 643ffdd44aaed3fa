"""Steps, Poisson units, memory and error of the solvers, against size and eps: a table, and JSON lines in a file.

    .venv/bin/python benchmarks/ladder.py demos/ball.toml --cells 128..2048 --eps "h,h^2,1e-8,1e-12" --json ball.jsonl
    .venv/bin/python benchmarks/ladder.py benchmarks/spiral.toml --cells 128..2048
    .venv/bin/python benchmarks/ladder.py benchmarks/nsv.toml --cells 16..64 --eps 1e-8

Runs under mpirun as it stands. On each mesh every solve is made `--times` times, with spaces, assembly and set-up anew,
and the fastest counts; a unit is one Poisson solve on the same mesh in the same process. `--beside` adds what one would
write without this package: SNES VI with algebraic multigrid, from a cold start and from the next coarser grid.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import NotConverged, Scene
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.arguments import values_of
from fenicsx_obstacle.discrete import levels
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.solvers.poisson_baseline import poisson_seconds

COLUMNS = (
    f"{'cells':>6} {'unknowns':>9} {'method':>12} {'eps':>8} {'Newton':>7} {'CG':>5} {'all N/CG':>9} {'units':>6} "
    f"{'s':>7} {'MB':>6} {'L2 error':>10}"
)
AMG = "vi_pc_type"  # a preconditioner of the user's own takes the place of multigrid


def main() -> None:
    """Run the ladder (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--cells", default="128..1024")
    parser.add_argument("--eps", default="h^2,1e-8,1e-12")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--beside", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    ways: dict[str, dict[str, Any]] = {f"eps={eps}": {"eps": eps} for eps in values_of(options.eps, "eps")}
    ways["vi"] = {"method": "vi"}
    if options.beside:
        ways["vi-amg-grids"] = {"method": "vi"}
        ways["vi-amg-cold"] = {"method": "vi", "start": "cold"}
    show(COLUMNS)
    for cells in values_of(options.cells, "cells"):
        scene = Scene.read(options.scene).change({"mesh.cells": cells})
        level = meshes.build(scene, MPI.COMM_WORLD)
        poisson = poisson_seconds(level)
        for name, changes in ways.items():
            try:
                with algebraic(name.startswith("vi-amg")):
                    records = [
                        solved(scene.with_options(scene.options_with(**changes)), level) for _ in range(options.times)
                    ]
            except NotConverged as error:
                show(f"{cells:6} {name:>12}: {error}")
                continue
            best = min(records, key=lambda record: record["seconds"]["solve"])
            best |= {"poisson_seconds": poisson, "poisson_units": best["seconds"]["solve"] / poisson}
            show(line(best, name if best["method"] == "vi" else "penalty"))
            if options.json is not None and MPI.COMM_WORLD.rank == 0:
                with options.json.open("a") as file:
                    file.write(json.dumps({"way": name, **best}) + "\n")


def solved(scene: Scene, level: levels.Level) -> dict[str, Any]:
    """The record of one solve on a mesh of which nothing is known but the mesh."""
    with closing(SolverContext(scene, level=anew(level))) as context:
        return dict(context.answer().record)


def anew(level: levels.Level) -> levels.Level:
    """The same meshes without the spaces and tables made on first use."""
    return replace(level, coarse=None if level.coarse is None else anew(level.coarse))


@contextmanager
def algebraic(on: bool) -> Iterator[None]:
    """BoomerAMG inside SNES VI."""
    if on:
        PETSc.Options()[AMG] = "hypre"
    yield
    if on:
        PETSc.Options().delValue(AMG)


def line(record: dict[str, Any], name: str) -> str:
    """A row of the table."""
    eps = "" if record["eps"] is None else f"{record['eps']:.1e}"
    error = f"{record['errors']['l2']:.4e}" if "errors" in record else ""
    return (
        f"{record['cells']:6} {record['dofs']:9} {name:>12} {eps:>8} {record['newton_iterations']:7} "
        f"{record['krylov_iterations']:5} {record['newton_total']:4}/{record['krylov_total']:<4} "
        f"{record['poisson_units']:6.2f} {record['seconds']['solve']:7.2f} {record['memory_mb']:6.0f} {error:>10}"
    )


def show(text: str) -> None:
    """Print on rank 0."""
    if MPI.COMM_WORLD.rank == 0:
        print(text, flush=True)


if __name__ == "__main__":
    main()

"""Steps, Poisson units, memory and error of the solvers, against size and eps: a table, and JSON lines in a file.

    .venv/bin/python benchmarks/ladder.py demos/ball.toml --cells 128..2048 --eps "h,h^2,1e-8,1e-12" --json ball.jsonl
    .venv/bin/python benchmarks/ladder.py benchmarks/spiral.toml --cells 128..2048
    .venv/bin/python benchmarks/ladder.py benchmarks/nsv.toml --cells 16..64 --eps 1e-8
    .venv/bin/python benchmarks/ladder.py demos/ball.toml --gmsh 0.0205,0.01035 --cold

Runs under mpirun as it stands. On each mesh every solve is made `--times` times, with spaces, assembly and set-up anew,
and the fastest counts; a unit is one Poisson solve on the same mesh in the same process. `--amg` adds what one would
write without this package: SNES VI with algebraic multigrid, from a cold start and from the next coarser grid.
`--gmsh` takes sizes of cells in place of their number: Gmsh then meshes the rectangle or box of the scene, and the mesh
has no coarser one. `--cold` adds cold starts with BoomerAMG.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import NotConverged, Scene
from fenicsx_obstacle.answers.poisson_baseline import poisson_seconds
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.cli_options import values_of
from fenicsx_obstacle.mesh import levels
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes import meshes

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
    parser.add_argument("--gmsh")
    parser.add_argument("--cold", action="store_true")
    parser.add_argument("--eps", default="h^2,1e-8,1e-12")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--amg", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    ways: dict[str, dict[str, Any]] = {f"eps={eps}": {"eps": eps} for eps in values_of(options.eps, "eps")}
    ways["vi"] = {"method": "vi"}
    if options.amg:
        ways["vi-amg-grids"] = {"method": "vi"}
        ways["vi-amg-cold"] = {"method": "vi", "start": "cold"}
    if options.cold:
        ways |= {f"cold {name}": {**changes, "start": "cold"} for name, changes in ways.items() if "amg" not in name}
    show(COLUMNS)
    sizes = options.gmsh.split(",") if options.gmsh else values_of(options.cells, "cells")
    for cells in sizes:
        scene = Scene.read(options.scene)
        scene, level = (
            built_by_gmsh(scene, float(cells)) if options.gmsh else built_in(scene.change({"mesh.cells": cells}))
        )
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
            cold = "cold " if name.startswith("cold ") else ""
            show(line(best, name if best["method"] == "vi" else f"{cold}penalty"))
            if options.json is not None and MPI.COMM_WORLD.rank == 0:
                with options.json.open("a") as file:
                    file.write(json.dumps({"way": name, **best}) + "\n")


def built_in(scene: Scene) -> tuple[Scene, levels.Level]:
    """The scene, and its mesh (collective)."""
    return scene, meshes.build(scene, MPI.COMM_WORLD)


def built_by_gmsh(scene: Scene, size: float) -> tuple[Scene, levels.Level]:
    """The scene on a mesh by Gmsh of its rectangle or box (collective)."""
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(tempfile.mkdtemp() if comm.rank == 0 else None))
    try:
        on_root(comm, _draw, scene, size, folder / "mesh.msh")
        return built_in(scene.change({"mesh": {"file": str(folder / "mesh.msh")}}))
    finally:
        comm.barrier()
        if comm.rank == 0:
            shutil.rmtree(folder)


def _draw(scene: Scene, size: float, path: Path) -> None:
    import gmsh

    table = scene.tables.mesh
    sides = [table.x, table.y] + ([table.z] if table.shape == "box" else [])
    low, long = zip(*((float(a), float(b) - float(a)) for a, b in sides), strict=True)
    gmsh.initialize([], False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        make = gmsh.model.occ.addBox if len(low) == 3 else gmsh.model.occ.addRectangle
        make(*low, *([0.0] if len(low) == 2 else []), *long)
        gmsh.model.occ.synchronize()
        for option, value in (("MeshSizeMin", size), ("MeshSizeMax", size), ("Algorithm", 5)):
            gmsh.option.setNumber(f"Mesh.{option}", value)
        gmsh.model.mesh.generate(len(low))
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


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
        f"{record['cells'] or 'gmsh':>6} {record['dofs']:9} {name:>12} {eps:>8} {record['newton_iterations']:7} "
        f"{record['krylov_iterations']:5} {record['newton_total']:4}/{record['krylov_total']:<4} "
        f"{record['poisson_units']:6.2f} {record['seconds']['solve']:7.2f} {record['memory_mb']:6.0f} {error:>10}"
    )


def show(text: str) -> None:
    """Print on rank 0."""
    if MPI.COMM_WORLD.rank == 0:
        print(text, flush=True)


if __name__ == "__main__":
    main()

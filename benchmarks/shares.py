"""Where the time of one solve goes: mesh, levels, assembly, start, Newton, Krylov; in seconds and Poisson units.

    .venv/bin/python benchmarks/shares.py demos/ball.toml --cells 1024 --eps 1e-8

Taken from Python's profiler and from PETSc's log in one process, on one rank; a first small solve compiles.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
from contextlib import closing
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import Scene
from fenicsx_obstacle.answers.poisson_baseline import poisson_seconds
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.scenes import meshes

# the functions that take a share each; none calls another of the list
SHARES = {
    "spaces, prolongations": ("parents.py:ends_of", "parents.py:prolongation", "releases.py:functionspace"),
    "create matrices": ("assembly.py:create_matrix",),
    "assemble matrices": ("petsc.py:_assemble_matrix_mat",),
    "Galerkin products": ("~:<method 'ptap' of 'petsc4py.PETSc.Mat' objects>",),
    "assemble vectors": ("assembly.py:_assemble",),
    "sample data": ("data.py:fixed", "data.py:lower", "data.py:upper", "data.py:cellwise"),
    "interpolate, relax": ("nested.py:begin_from", "relaxation.py:relax"),
    "penalty diagonals": ("multigrid.py:truncate",),
    "residuals": ("problem.py:residual",),
    "stopping test": ("stopping.py:__call__",),
}


def main() -> None:
    """Solve once under both profilers and print the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--cells", type=int, default=1024)
    parser.add_argument("--eps", default="1e-8")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    PETSc.Log.begin()
    scene = Scene.read(options.scene).change({"solve.eps": options.eps})
    with closing(SolverContext(scene.change({"mesh.cells": 64}))) as small:
        small.answer()
    scene = scene.change({"mesh.cells": options.cells})
    level = meshes.build(scene, MPI.COMM_WORLD)
    poisson = poisson_seconds(level)
    before = krylov()
    profiler = cProfile.Profile()
    profiler.enable()
    with closing(SolverContext(scene, level=level)) as context:
        record = context.answer().record
        profiler.disable()
    shares = {name: inclusive(profiler, names) for name, names in SHARES.items()}
    shares["Krylov"] = krylov() - before
    shares["the rest"] = record["seconds"]["solve"] - sum(shares.values())
    print(f"{record['dofs']} unknowns, eps = {record['eps']:.1e}; a Poisson solve takes {poisson:.2f} s")
    for name, seconds in shares.items():
        print(f"{name:>24} {seconds:7.3f} s {seconds / poisson:6.2f} units")
    print(f"{'in all':>24} {record['seconds']['solve']:7.3f} s {record['seconds']['solve'] / poisson:6.2f} units")
    if options.json is not None:
        with options.json.open("a") as file:
            file.write(json.dumps({**record, "poisson_seconds": poisson, "shares": shares}) + "\n")


def inclusive(profiler: cProfile.Profile, names: tuple[str, ...]) -> float:
    """Seconds within the named functions, callees included, outermost calls of recursive ones."""
    stats = pstats.Stats(profiler).stats  # type: ignore[attr-defined]  # the type stubs do not know it
    return sum(row[3] for (file, _, function), row in stats.items() if f"{Path(file).name}:{function}" in names)


def krylov() -> float:
    """Seconds in KSPSolve since the log began."""
    return float(PETSc.Log.Event("KSPSolve").getPerfInfo()["time"])


if __name__ == "__main__":
    main()

"""Two clones in turn: times of two solves in a process, and memory of the first one, new against old.

    .venv/bin/python benchmarks/in_turn.py ../old . --times 5   # the least of five

Each clone is set up and has an environment of its own. The baseline of version 0.3 is commit 7c11a4e: no ratio is to be
above 1.05. The rows are the ball, the spiral and a disk of Gmsh by the penalty method with eps = 1e-8, a cube with
eps = "auto" and a cylinder on a plane. The first solve loads the forms, and compiles them where no earlier run has. The
baseline takes the mesh of a second solve from the first where it is one of Gmsh; the present code reads it again.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "ball": ("demos/ball.toml", {"cells": 1024, "eps": 1e-8}),
    "spiral": ("benchmarks/spiral.toml", {"cells": 1024, "eps": 1e-8}),
    "cube": ("benchmarks/nsv.toml", {"cells": 64}),
    "hertz": ("demos/hertz_cylinder.toml", {"refine": 1}),
}
DISK = "disk"
FIGURES = ("first", "seconds", "processor", "mb")


def main() -> None:
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clones", nargs="*", type=Path, metavar="CLONE", help="the old clone, and the new one")
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--cases", default=",".join((*CASES, DISK)))
    parser.add_argument("--solve", nargs=2, metavar=("CASE", "CLONE"), help="Be one process.")
    options = parser.parse_args()
    if options.solve is not None:
        print(json.dumps(second_solve(options.solve[0], Path(options.solve[1]))))
        return
    old, new = (clone.resolve() for clone in options.clones)
    print(f"{'new / old':>10} {'first':>10} {'second':>10} {'processor':>10} {'memory':>10}")
    for case in options.cases.split(","):
        least: dict[Path, dict[str, float]] = {}
        for number in range(options.times):
            for clone in (old, new) if number % 2 == 0 else (new, old):
                found = process(case, clone)
                before = least.setdefault(clone, found)
                least[clone] = {key: min(found[key], before[key]) for key in FIGURES}
        ratios = [least[new][key] / least[old][key] for key in FIGURES]
        print(f"{case:>10} " + " ".join(f"{ratio:10.3f}" for ratio in ratios), flush=True)


def process(case: str, clone: Path) -> dict[str, float]:
    """A process of a clone: seconds of both solves and of the processor in the second one; memory of the first one."""
    words = [str(clone / ".venv/bin/python"), str(Path(__file__).resolve()), "--solve", case, str(clone)]
    environment = {**os.environ, "PYTHONPATH": str(clone), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(words, env=environment, stdout=subprocess.PIPE, text=True, check=True, cwd="/")
    return json.loads(done.stdout.splitlines()[-1])


def second_solve(case: str, clone: Path) -> dict[str, float]:
    """Solve twice in this process."""
    solve = on_disk() if case == DISK else scene(case, clone)
    began = time.perf_counter()
    solve()
    first = time.perf_counter() - began
    mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3  # a second solve adds what malloc cannot reuse
    start, processor = time.perf_counter(), time.process_time()
    solve()
    return {
        "first": first,
        "seconds": time.perf_counter() - start,
        "processor": time.process_time() - processor,
        "mb": mb,
    }


def scene(case: str, clone: Path) -> Callable[[], object]:
    """A solve of a scene."""
    from fenicsx_obstacle import solve

    file, options = CASES[case]
    return lambda: solve(str(clone / file), **options)


def on_disk() -> Callable[[], object]:
    """A solve of a form on a mesh of Gmsh with 2e5 nodes."""
    import gmsh
    import numpy as np
    import ufl
    from dolfinx import fem, mesh
    from dolfinx.io import gmshio
    from mpi4py import MPI

    from fenicsx_obstacle import ObstacleProblem

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.0042)
    gmsh.model.occ.addDisk(0, 0, 0, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [1], 1)
    gmsh.model.mesh.generate(2)
    disk = gmshio.model_to_mesh(gmsh.model, MPI.COMM_WORLD, 0, gdim=2)[0]
    V = fem.FunctionSpace(disk, ("Lagrange", 1))
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 4.0 * v * ufl.dx
    rim = mesh.locate_entities_boundary(disk, 1, lambda x: np.full(x.shape[1], True))
    held = fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, rim), V)

    def solve() -> object:
        u.x.array[:] = 0.0
        return ObstacleProblem(F, u, bcs=[held], lower=-0.3).solve(eps=1e-8)

    return solve


if __name__ == "__main__":
    sys.exit(main())

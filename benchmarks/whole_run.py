"""What a whole run costs compared with a plain DOLFINx script: processes, from start to end, with all files.

    .venv/bin/python benchmarks/whole_run.py demos/ball.toml --cells 512,1024

The script solves -Laplace(u) = 1 with u = 0 on the boundary of the same rectangle, by CG with BoomerAMG, and writes u
with XDMFFile. Seconds are those of the clock and of the processor (user and system); memory is the largest resident
set. The least of several runs in turn; forms are compiled by the first call of each.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOLVE = ["-m", "fenicsx_obstacle", "solve"]
KINDS = ("wall", "processor", "memory_mb")


def main() -> None:
    """Run both in turn and print their ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default=str(ROOT / "demos" / "ball.toml"))
    parser.add_argument("--cells", default="512,1024")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--poisson", nargs=2, metavar=("N", "FILE"), help="Be the plain script.")
    options = parser.parse_args()
    if options.poisson is not None:
        return poisson(int(options.poisson[0]), options.poisson[1])
    print(f"{'cells':>6} {'':>8} {'wall s':>8} {'CPU s':>8} {'MB':>7}")
    for cells in options.cells.split(","):
        best: dict[str, dict[str, float]] = {}
        with tempfile.TemporaryDirectory() as folder:
            commands = {
                "Poisson": [str(Path(__file__).resolve()), "--poisson", cells, f"{folder}/u.xdmf"],
                "solve": [*SOLVE, options.scene, "--cells", cells, "--output", f"{folder}/out"],
            }
            for _ in range(options.times):
                for name, arguments in commands.items():
                    found = measured([sys.executable, *arguments])
                    old = best.setdefault(name, found)
                    best[name] = {kind: min(found[kind], old[kind]) for kind in KINDS}
        for name, row in best.items():
            print(f"{cells:>6} {name:>8} {row['wall']:8.2f} {row['processor']:8.2f} {row['memory_mb']:7.0f}")
        ratios = {kind: best["solve"][kind] / best["Poisson"][kind] for kind in KINDS}
        print(f"{cells:>6} {'ratio':>8} " + " ".join(f"{ratios[kind]:8.2f}" for kind in KINDS), flush=True)
        if options.json is not None:
            with options.json.open("a") as file:
                file.write(json.dumps({"cells": int(cells), **best, "ratio": ratios}) + "\n")


def measured(command: list[str]) -> dict[str, float]:
    """Seconds and MB (10^6 bytes) of one process."""
    environment = {"OMP_NUM_THREADS": "1", "OMPI_MCA_ess_singleton_isolated": "1", **os.environ}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # users have the bytecode of all modules after the first run
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment)
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(command)} ended with status {process.returncode}")
    return {"wall": wall, "processor": used.ru_utime + used.ru_stime, "memory_mb": used.ru_maxrss * 1024 / 1e6}


def poisson(cells: int, file: str) -> None:
    """The plain script."""
    import dolfinx.fem.petsc
    import numpy as np
    import ufl
    from dolfinx import fem, io, mesh
    from mpi4py import MPI
    from petsc4py import PETSc

    domain = mesh.create_rectangle(MPI.COMM_WORLD, [np.array([-2.0, -2.0]), np.array([2.0, 2.0])], [cells, cells])
    V = getattr(fem, "functionspace", fem.FunctionSpace)(domain, ("Lagrange", 1))
    domain.topology.create_connectivity(1, 2)
    dofs = fem.locate_dofs_topological(V, 1, mesh.exterior_facet_indices(domain.topology))
    bc = fem.dirichletbc(PETSc.ScalarType(0), dofs, V)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    L = fem.form(fem.Constant(domain, PETSc.ScalarType(1)) * v * ufl.dx)
    A = dolfinx.fem.petsc.assemble_matrix(a, [bc])
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(L)
    dolfinx.fem.petsc.apply_lifting(b, [a], [[bc]])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b, [bc])
    ksp = PETSc.KSP().create(domain.comm)
    ksp.setOperators(A)
    ksp.setType("cg")
    ksp.getPC().setType("hypre")
    ksp.setTolerances(rtol=1e-8)
    x = b.duplicate()
    ksp.solve(b, x)
    solution = fem.Function(V)
    solution.x.array[: len(x.array)] = x.array
    solution.x.scatter_forward()
    with io.XDMFFile(domain.comm, file, "w") as out:
        out.write_mesh(domain)
        out.write_function(solution)


if __name__ == "__main__":
    main()

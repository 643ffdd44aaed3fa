"""Bounds and adaptive meshes at inner corners and edges in space, against the energy of a much finer adaptive mesh.

    .venv/bin/python benchmarks/corners_3d.py --unknowns 1e5

An upper obstacle of constant height over Fichera's corner and over an L-shaped prism. With v_h in K, the energy J
satisfies ||u - v_h||^2 <= 2 (J(v_h) - J(u)). J(u) is extrapolated from adaptive meshes, J = J(u) + c N^(-2/3), and the
difference of two extrapolations is its uncertainty. `ratio` is the bound of ||u - v_h|| over the square root of
2 (J(v_h) - J(u)), which is not less than the true error. The last lines compare adaptive with uniform meshes.
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import Scene
from fenicsx_obstacle.answers.adapt import Refinement
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.verification.hard.families.solid_meshes import octants, scattered, tetrahedra

COMM = MPI.COMM_WORLD
DATA: dict[str, Any] = {"tension": 1, "load": 1, "upper": 0.12, "boundary": [{"value": 0}]}
MISSING = {"fichera": "0, 0, 0, 1, 1, 1", "prism": "0, 0, -1, 1, 1, 2"}  # box by a corner and sides
EPS = ("h", "h^2", "auto", "1e-10")
ORDER = 2 / 3  # of the energy in the unknowns, of linear elements on the best meshes


def by_gmsh(shape: str, size: float) -> str:
    """The domain as text for Gmsh."""
    return (f'SetFactory("OpenCASCADE"); Box(1) = {{-1, -1, -1, 2, 2, 2}}; Box(2) = {{{MISSING[shape]}}};\n'
            "BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };\n"
            f"MeshSize{{ PointsOf{{ Volume{{:}}; }} }} = {size};\n")  # fmt: skip


def made(shape: str, kind: str, half: int, folder: Path) -> Scene:
    """The scene on a mesh with so many cells along each half side (collective)."""
    if kind == "Gmsh":
        path = folder / f"{shape}{half}.geo"
        on_root(COMM, path.write_text, by_gmsh(shape, 1 / half))
        return Scene(mesh={"file": str(path)}, **DATA)
    points, cells = octants(shape, half)
    return Scene(mesh=tetrahedra(COMM, scattered(points, cells, 0.2 / half if kind == "moved" else 0.0, 1), cells),
                 **DATA)  # fmt: skip


def adaptive(shape: str, unknowns: float) -> list[tuple[int, float, float]]:
    """Unknowns, J(v_h) and the bound of ||u - v_h|| on adaptive meshes (collective)."""
    found = []
    with closing(Refinement(Scene(mesh=tetrahedra(COMM, *octants(shape, 2)), **DATA), COMM).meshes(
            unknowns=unknowns)) as meshes:  # fmt: skip
        for _, answer in meshes:
            row = answer.dofs, answer.bound.energy[1], answer.bound.admissible_total
            found += [row] if row not in found else []
    return found


def limit(rows: list[tuple[int, float, float]]) -> tuple[float, float]:
    """J(u) from the last mesh and the last with at most a third of its unknowns, and how far the one before is off."""

    def extrapolated(last: int) -> float:
        n, J, _ = rows[last]
        before = max(k for k in range(last) if 3 * rows[k][0] <= n)
        weight = (rows[before][0] / n) ** ORDER
        return (J - weight * rows[before][1]) / (1 - weight)

    values = [extrapolated(k) for k in (len(rows) - 1, len(rows) - 2)]
    return values[0], abs(values[1] - values[0])


def main() -> None:
    """Print tables (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--unknowns", type=float, default=1e5, help="most, of the adaptive meshes")
    parser.add_argument("--halves", default="4,8", help="cells along half a side")
    options = parser.parse_args()
    ratios = []
    for shape in MISSING:
        rows = adaptive(shape, options.unknowns)
        J, off = limit(rows)
        show(f"{shape}: J(u) = {J:.6f} +- {off:.1g}")
        uniform = []
        with tempfile.TemporaryDirectory() as folder:
            place = Path(COMM.bcast(folder))
            for kind in ("uniform", "moved", "Gmsh"):
                for half in map(int, options.halves.split(",")):
                    with closing(SolverContext(made(shape, kind, half, place), COMM)) as context:
                        for eps in EPS:
                            answer = context.answer(context.scene.options_with(eps=eps), bound=True)
                            error = np.sqrt(2 * (answer.bound.energy[1] - J))
                            bound, words = answer.bound.admissible_total, answer.bound.words
                            ratios.append(bound / error)
                            show(f"{shape:8} {kind:8} {answer.dofs:7} {eps:>6} {error:9.3e} {bound:9.3e} "
                                 f"{ratios[-1]:5.2f}  {words}")  # fmt: skip
            for half in (2, 4, 8, 16):
                with closing(SolverContext(made(shape, "uniform", half, place), COMM)) as context:
                    answer = context.answer(context.scene.options_with(eps="1e-10"), bound=True)
                    uniform.append((answer.dofs, answer.bound.energy[1], answer.bound.admissible_total))
        for name, path in (("adaptive", rows), ("uniform", uniform)):
            before = None
            for n, energy, bound in path:
                error = np.sqrt(2 * max(energy - J, 0.0))
                order = "" if before is None else f"{np.log(before[1] / error) / np.log(n / before[0]):5.2f}"
                if before is None or n >= 2.5 * before[0]:
                    show(f"{shape:8} {name:8} {n:7} {error:9.3e} {bound:9.3e} {order}")
                    before = n, error
    show(f"{len(ratios)} bounds: least {min(ratios):.2f}, median {np.median(ratios):.2f}, largest {max(ratios):.2f}; "
         f"{sum(one < 1 for one in ratios)} below the error")  # fmt: skip


def show(text: str) -> None:
    """Print on rank 0."""
    if COMM.rank == 0:
        print(text, flush=True)


if __name__ == "__main__":
    main()

"""Bounds and adaptive meshes at inner corners and edges in space, against the energy of a much finer adaptive mesh.

    .venv/bin/python -m benchmarks.corners_3d --unknowns 1e5
    .venv/bin/python -m benchmarks.corners_3d --edges 8.5e5 --unknowns 4e5

An upper obstacle of constant height over Fichera's corner and over an L-shaped prism. With v_h in K, the energy J
satisfies ||u - v_h||^2 <= 2 (J(v_h) - J(u)). J(u) is extrapolated from adaptive meshes, J = J(u) + c N^(-2/3), and the
difference of two extrapolations is its uncertainty. `ratio` is the bound of ||u - v_h|| over the square root of
2 (J(v_h) - J(u)), which is not less than the true error.

`--edges N` measures the orders in a scene at Fichera's corner in which the inner edges dominate the error. u = 0 on the
three inner faces, u = 1 on the three faces opposite to them, and the others are free, so that no other edge or corner
makes u singular. A load acts in a cube at the outer corner alone, where most of u is in contact with an upper obstacle
1. Elsewhere u is harmonic, and at the edges it behaves like r^(2/3): theory has the orders 2/9 on uniform meshes, with
at most N unknowns here, and 1/3 on adaptive ones. `certified` is the range of (2 (J(v_h) - J(u)))^(1/2) by the
enclosure of J(u) on the finest adaptive mesh.
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from benchmarks.ladder import show
from fenicsx_obstacle import Scene
from fenicsx_obstacle.answers.adapt import Adaptation
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import on_root, peak_memory_mb
from tests.random.families.solid_meshes import octants, scattered, tetrahedra

COMM = MPI.COMM_WORLD
Row = tuple[int, float, float]
DATA: dict[str, Any] = {"tension": 1, "load": 1, "upper": 0.12, "boundary": [{"value": 0}]}
EDGES: dict[str, Any] = {
    "tension": 1, "load": "where(max(x, y, z) < -0.5, 4, 0)", "upper": 1,
    "boundary": [{"where": "min(x, y, z) > -1e-9", "value": 0}, {"where": "min(x, y, z) < -1 + 1e-9", "value": 1}],
}  # fmt: skip
HALVES = (2, 4, 8, 16, 24, 32, 48, 64)  # even, so that the load jumps between cells
MOST_WITH_BOUND = 5e4  # unknowns of uniform meshes; those above need too much memory for it
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


def adaptive(shape: str, unknowns: float, data: dict[str, Any]) -> tuple[list[Row], tuple[float, float]]:
    """Unknowns, J(v_h) and the bound of ||u - v_h|| on adaptive meshes, and the range of J(u) (collective)."""
    found: list[Row] = []
    within = -np.inf, np.inf
    with closing(Adaptation(Scene(mesh=tetrahedra(COMM, *octants(shape, 2)), **data), COMM).meshes(
            unknowns=unknowns)) as meshes:  # fmt: skip
        for _, answer in meshes:
            row = answer.dofs, answer.bound.energy[1], answer.bound.admissible_total
            found += [row] if row not in found else []
            within = max(within[0], answer.bound.energy[0]), min(within[1], answer.bound.energy[1])
    return found, within


def edges(most: float, unknowns: float) -> None:
    """Orders where the inner edges dominate the error (collective).

    Args:
        most: Unknowns of uniform meshes.
        unknowns: Of adaptive ones.
    """
    uniform = []
    for half in HALVES:
        points, cells = octants("fichera", half)
        if len(points) > most:
            break
        with closing(SolverContext(Scene(mesh=tetrahedra(COMM, points, cells), **EDGES), COMM)) as context:
            bound = len(points) <= MOST_WITH_BOUND
            answer = context.answer(context.scene.options_with(eps="1e-10"), bound=bound)
            # without bound: u_h, which is above the obstacle by round-off only; the solver's data are exact here
            uniform.append((answer.dofs, answer.bound.energy[1], answer.bound.admissible_total) if bound
                           else (answer.dofs, answer.record["energy"], np.nan))  # fmt: skip
            show(f"{answer.dofs} unknowns: penetration {answer.record['penetration']:.1e}, energy "
                 f"{answer.record['energy']:.8f}, {peak_memory_mb(COMM):.0f} MB")  # fmt: skip
    refined, within = adaptive("fichera", unknowns, EDGES)
    J, off = limit(refined)
    show(f"J(u) = {J:.6f} +- {off:.1g}, certified between {within[0]:.6f} and {within[1]:.6f}")
    for name, rows in (("uniform", uniform), ("adaptive", refined)):
        sizes, energies, bounds = (np.array(column) for column in zip(*rows, strict=True))
        low, error, high = (np.sqrt(2 * np.maximum(energies - end, 0.0)) for end in (within[1], J, within[0]))
        for k, size in enumerate(sizes):
            three = slice(k - 2, k + 1)
            order = [f"{-np.polyfit(np.log(sizes[three]), np.log(values[three]), 1)[0]:6.3f}" if k > 1 else ""
                     for values in (error, bounds)]  # fmt: skip
            show(f"{name:8} {size:7} {error[k]:9.3e} ({low[k]:.3e}, {high[k]:.3e}) {bounds[k]:9.3e}  {' '.join(order)}")


def limit(rows: list[Row]) -> tuple[float, float]:
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
    parser.add_argument("--edges", type=float, metavar="N", help="instead: orders; most unknowns of uniform meshes")
    options = parser.parse_args()
    if options.edges is not None:
        edges(options.edges, options.unknowns)
        return
    ratios = []
    for shape in MISSING:
        rows, _ = adaptive(shape, options.unknowns, DATA)
        J, off = limit(rows)
        show(f"{shape}: J(u) = {J:.6f} +- {off:.1g}")
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
    show(f"{len(ratios)} bounds: least {min(ratios):.2f}, median {np.median(ratios):.2f}, largest {max(ratios):.2f}; "
         f"{sum(one < 1 for one in ratios)} below the error")  # fmt: skip


if __name__ == "__main__":
    main()

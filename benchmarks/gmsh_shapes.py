"""Newton and CG steps on meshes by Gmsh of other shapes than squares: corners, slits, holes, grading, jumps, P2.

    .venv/bin/python benchmarks/gmsh_shapes.py --times 3
    .venv/bin/python benchmarks/gmsh_shapes.py slit jump --ratios 1 --eps "1e-8"

Each shape is meshed three times, the size of its cells halved each time. A row has the steps on the finest level and,
after a semicolon, units: the fastest of some solves over one Poisson solve on the same mesh in the same process.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ladder import show, solved
from mpi4py import MPI

from fenicsx_obstacle import NotConverged, Scene
from fenicsx_obstacle.answers.poisson_baseline import poisson_seconds
from fenicsx_obstacle.arguments import values_of
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes import meshes

MEMBRANE: dict[str, Any] = {"tension": 1, "load": -8, "lower": "-0.05", "boundary": [{"value": 0}]}
SAND: dict[str, Any] = {"tension": 1, "load": 8, "upper": "distance", "boundary": [{"value": 0}]}


def polygon(*corners: tuple[float, float], sizes: dict[int, float] | None = None) -> Callable[[float], str]:
    """A polygon; some corners have cells of another size, in parts of that of the others."""

    def geometry(size: float) -> str:
        count = len(corners)
        near = [size * (sizes or {}).get(k, 1.0) for k in range(count)]
        points = [f"Point({k + 1}) = {{{x}, {y}, 0, {near[k]}}};" for k, (x, y) in enumerate(corners)]
        lines = [f"Line({k + 1}) = {{{k + 1}, {(k + 1) % count + 1}}};" for k in range(count)]
        loop = ", ".join(str(k + 1) for k in range(count))
        return "\n".join([*points, *lines, f"Curve Loop(1) = {{{loop}}};", "Plane Surface(1) = {1};"])

    return geometry


def circles(*radii: float) -> Callable[[float], str]:
    """Rings between circles about the origin, each a material, the innermost a disk if the last radius is 0."""

    def geometry(size: float) -> str:
        words = [f"Point(1) = {{0, 0, 0, {size}}};"]
        loops = []
        for n, radius in enumerate(r for r in radii if r > 0):
            at = 10 * (n + 1)
            for k, (x, y) in enumerate([(radius, 0), (0, radius), (-radius, 0), (0, -radius)]):
                words.append(f"Point({at + k}) = {{{x}, {y}, 0, {size}}};")
            words += [f"Circle({at + k}) = {{{at + k}, 1, {at + (k + 1) % 4}}};" for k in range(4)]
            words.append(f"Curve Loop({at}) = {{{at}, {at + 1}, {at + 2}, {at + 3}}};")
            loops.append(at)
        inner = [*loops[1:], None] if radii[-1] == 0 else loops[1:]
        for n, (outside, inside) in enumerate(zip(loops, inner, strict=False), 1):
            hole = "" if inside is None else f", {inside}"
            words.append(f"Plane Surface({n}) = {{{outside}{hole}}};")
            words.append(f'Physical Surface("ring{n}") = {{{n}}};')
        return "\n".join(words)

    return geometry


I_SECTION = polygon(
    (-30, -40), (30, -40), (30, -28), (4, -28), (4, 28), (30, 28), (30, 40), (-30, 40), (-30, 28), (-4, 28), (-4, -28),
    (-30, -28),
)  # fmt: skip
SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]
L_SHAPE = [(-1, -1), (0, -1), (0, 0), (1, 0), (1, 1), (-1, 1)]
# geometry, the largest size of cells, data
SHAPES: dict[str, tuple[Callable[[float], str], float, dict[str, Any]]] = {
    "I-section, torsion": (I_SECTION, 1.0, {**SAND, "load": 0.15}),
    "L-shape": (polygon(*L_SHAPE), 0.02, MEMBRANE),
    "slit": (polygon((-1, -1), (1, -1), (1, -1e-3), (0, 0), (1, 1e-3), (1, 1), (-1, 1)), 0.024, MEMBRANE),
    "disk with a hole": (circles(1.0, 0.3), 0.02, MEMBRANE),
    "graded 20:1": (polygon(*SQUARE, sizes={0: 0.05}), 0.04, {**MEMBRANE, "lower": "-0.02"}),
    "jump 1e4 along the mesh": (circles(1.0, 0.5, 0.0), 0.024, {**MEMBRANE, "tension": {"ring1": 1, "ring2": 1e4}}),
    "jump 1e-4 along the mesh": (circles(1.0, 0.5, 0.0), 0.024, {**MEMBRANE, "tension": {"ring1": 1, "ring2": 1e-4}}),
    "square, P2": (polygon(*SQUARE), 0.024, {**MEMBRANE, "lower": "-0.02"}),
    "L-shape, P2": (polygon(*L_SHAPE), 0.04, MEMBRANE),
}  # fmt: skip


def main() -> None:
    """Print a table (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shapes", nargs="*", help="beginnings of their names; all, if none is given")
    parser.add_argument("--ratios", default="1,0.5,0.25", help="sizes of cells")
    parser.add_argument("--eps", default="auto,1e-8,1e-12")
    parser.add_argument("--times", type=int, default=1)
    options = parser.parse_args()
    ways: dict[str, dict[str, Any]] = {f"eps = {eps}": {"eps": eps} for eps in values_of(options.eps, "eps")}
    ways["SNES VI"] = {"method": "vi"}
    show(f"| shape | unknowns | {' | '.join(ways)} |\n|{' --- |' * (len(ways) + 2)}")
    comm = MPI.COMM_WORLD
    for name, (geometry, size, data) in SHAPES.items():
        if options.shapes and not name.startswith(tuple(options.shapes)):
            continue
        for ratio in options.ratios.split(","):
            with tempfile.TemporaryDirectory() as local:
                folder = Path(comm.bcast(local))
                file = folder / "shape.geo"
                on_root(comm, file.write_text, geometry(size * float(ratio)))
                scene = Scene(mesh={"file": str(file)}, **data)
                scene = scene.change({"solve.element": "P2" if name.endswith("P2") else "P1"})
                level = meshes.build(scene, comm)
                comm.barrier()
            unit = poisson_seconds(level)
            cells = [cell(scene, level, unit, changes, options.times) for changes in ways.values()]
            show(f"| {name} | {level.dofs} | {' | '.join(cells)} |")


def cell(scene: Scene, level: Any, unit: float, changes: dict[str, Any], times: int) -> str:
    """An entry of the table (collective)."""
    try:
        records = [solved(scene.with_options(scene.options_with(**changes)), level) for _ in range(times)]
    except NotConverged as error:
        return str(error)
    best = min(records, key=lambda record: record["seconds"]["solve"])
    return f"{best['newton_iterations']}/{best['krylov_iterations']}; {best['seconds']['solve'] / unit:.2f}"


if __name__ == "__main__":
    main()

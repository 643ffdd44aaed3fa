"""Effectivity of the error bound on tetrahedra, on scenes with exact solutions.

    .venv/bin/python benchmarks/bounds_3d.py --cells 8,16 --eps "h,h^2,auto,1e-10"

Effectivity is bound over true error of u_h. The last line has minimum, median and maximum of all, and the number of
bounds below the true error. Runs under mpirun as it stands.
"""

from __future__ import annotations

import argparse
from contextlib import closing
from typing import Any

import numpy as np
from ladder import show

from fenicsx_obstacle import Scene
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.cli_options import values_of

BALL = "r^2/6 + 0.6^3/(3*r) - 0.6^2/2"
NSV = "max(r^2 - 0.49, 0)^2"
LAYERS = "where(x < 0.3, 0, where(x < 0.5, (x - 0.3)^2/2, 0.02 + ((x - 0.3)^2 - 0.04)/20))"
WAVE = "sin(2*x)*exp(y)*cos(z)"
# data beside the mesh; the exact solution is given on the boundary, or on the sides that are named
SCENES: dict[str, dict[str, Any]] = {
    "ball": {"load": -1, "lower": 0, "exact": f"where(r < 0.6, 0, {BALL})"},
    "nsv": {"load": "where(r < 0.7, -8*0.49*(1.49 - r^2), -8*r^2 - 12*(r^2 - 0.49))", "lower": 0, "exact": NSV},
    "two materials": {
        "tension": "where(x < 0.5, 1, 10)",
        "load": -1,
        "lower": 0,
        "exact": LAYERS,
        "boundary": [{"on": "left", "value": 0}, {"on": "right", "value": 0.0425}],
    },
    "line": {"load": -4, "lower": 0, "exact": "x^2 + y^2"},
    "plane": {
        "load": -1,
        "lower": 0,
        "exact": "max(x - 0.3, 0)^2/2",
        "boundary": [{"on": "left", "value": 0}, {"on": "right", "value": 0.245}],
    },
    "no contact": {"load": f"4*{WAVE}", "lower": -20, "exact": WAVE},
}


def scene(name: str, cells: int, perturb: float) -> Scene:
    """A scene on a cube of side 2."""
    sides = [-1, 1]
    box = {"shape": "box", "x": sides, "y": sides, "z": sides, "cells": cells, "perturb": perturb}
    return Scene(mesh=box, **{"tension": 1, "boundary": [{"value": SCENES[name]["exact"]}], **SCENES[name]})


def main() -> None:
    """Print a line for each scene, mesh and eps (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--cells", default="8,16")
    parser.add_argument("--eps", default="h,h^2,auto,1e-10")
    options = parser.parse_args()
    show(f"{'scene':14} {'mesh':>9} {'unknowns':>8} {'eps':>6} {'error':>9} {'bound':>9} {'eff.':>5}  words")
    found = []

    def compare(name: str, context: SolverContext, eps: str) -> None:
        """Solve, and print bound and error (collective)."""
        answer = context.answer(context.scene.options_with(eps=eps), bound=True)
        total, error, mesh = answer.bound.total, answer.errors.energy, context.scene.tables.mesh
        found.append(total / error)
        show(f"{name:14} {f'{mesh.cells} {mesh.perturb:g}':>9} {answer.dofs:8} {eps:>6} {error:9.3e} {total:9.3e} "
             f"{found[-1]:5.2f}  {answer.bound.words}")  # fmt: skip

    for name in options.scenes.split(","):
        for cells in values_of(options.cells, "cells"):
            for perturb in (0.0, 0.2):
                with closing(SolverContext(scene(name, cells, perturb))) as context:
                    for eps in options.eps.split(","):
                        compare(name, context, eps)
    show(f"{len(found)} bounds: least {min(found):.2f}, median {np.median(found):.2f}, largest {max(found):.2f}; "
         f"{sum(one < 1 for one in found)} below the true error")  # fmt: skip


if __name__ == "__main__":
    main()

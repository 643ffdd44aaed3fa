"""What bounds are worth where tensions jump inside cells: unknowns, bound, true error, effectivity, words.

    .venv/bin/python -m benchmarks.certificates --contrasts 2,10,1e3,1e6

Two layers and a quarter of a disc, after adaptive refinement. True errors are integrated on cells that are cut along
the jumps, without the code of the estimator.
"""

from __future__ import annotations

import argparse
from typing import Any

from mpi4py import MPI

from benchmarks.ladder import show
from fenicsx_obstacle import solve
from tests.random.families.curves import Inclusion
from tests.random.families.elements import Field
from tests.random.families.layers import Layers
from tests.random.families.manufactured import Manufactured

MESH = {"shape": "rectangle", "cells": 8}
HEAD = ("data", "element", "unknowns", "bound", "true error", "effectivity", "words")


def layers(contrast: float) -> Layers:
    """Two layers; the jump is nearer to a mesh line than any quadrature point."""
    return Layers(MESH, {}, 0, 0.0, (0.503,), (contrast, 1.0), 0.0)


def disc(contrast: float) -> Inclusion:
    """A quarter of a disc in a square."""
    return Inclusion(MESH, {}, 0, 0.517, contrast)


def main() -> None:
    """Print the table (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--contrasts", default="2,10,1e3,1e6,1e-3,1e-6")
    parser.add_argument("--tol", type=float, default=0.03)
    parser.add_argument("--budget", default="1e5 unknowns")
    options = parser.parse_args()
    asked = {"tol": options.tol, "budget": options.budget}
    for cells in (HEAD, ["---"] * len(HEAD)):
        show(f"| {' | '.join(cells)} |")
    for contrast in map(float, options.contrasts.split(",")):
        for name, make in (("layers", layers), ("disc", disc)):
            for element in ("P1", "P2"):
                cells = row(f"{name}, {contrast:g}", make(contrast), {**asked, "element": element})
                show(f"| {' | '.join(cells)} |")


def row(name: str, known: Manufactured, asked: dict[str, Any]) -> list[str]:
    """One line of the table (collective)."""
    answer = solve(known.scene(), comm=MPI.COMM_WORLD, **asked)
    assert answer.bound is not None
    error, _ = known.error(Field(answer.u))
    total, unknowns = answer.bound.total, answer.record["dofs"]
    numbers = [str(unknowns), f"{total:.4g}", f"{error:.4g}", f"{total / error:.2f}"]
    return [name, asked["element"], *numbers, answer.bound.words]


if __name__ == "__main__":
    main()

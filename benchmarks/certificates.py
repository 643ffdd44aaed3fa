"""What bounds are worth where data jump, oscillate or have poles inside cells: words, bound, true error, effectivity.

    .venv/bin/python -m benchmarks.certificates
    .venv/bin/python -m benchmarks.certificates --contrasts 2,1e3,1e6 --tol 0.03 --budget "1e5 unknowns"

The first table has 16 cells a side; the second has layers and discs of some contrasts after adaptive refinement. True
errors are integrated on cells that are cut along the jumps, without the code of the estimator. Scenes that have no
certificate are listed with the reason that the program gives.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

from mpi4py import MPI

from fenicsx_obstacle import InputError, Scene, solve
from tests.random.families.curves import Inclusion, Pole
from tests.random.families.elements import Field
from tests.random.families.layers import Layers, Waves

MESH = {"shape": "rectangle", "cells": 16}
UNIFORM: list[dict[str, Any]] = [{"bound": True}, {"bound": True, "element": "P2"}]
HEAD = ["data", "asked for", "unknowns", "bound", "true error", "effectivity", "words"]
COMM = MPI.COMM_WORLD


class Known(Protocol):
    """A scene whose error can be integrated."""

    def scene(self) -> Scene:
        """The scene."""

    def error(self, field: Field) -> tuple[float, float]:
        """Energy error of a field, and norm of u (collective)."""


def layers(contrast: float) -> Layers:
    """Two layers; the jump is nearer to a mesh line than any quadrature point."""
    return Layers(MESH, {}, 0, 0.0, (0.503,), (contrast, 1.0), 0.0)


def disc(contrast: float, radius: float = 0.517) -> Inclusion:
    """A quarter of a disc in a square."""
    return Inclusion(MESH, {}, 0, radius, contrast)


def main() -> None:
    """Print both tables and the list."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--contrasts", default="2,10,1e3,1e6,1e-3,1e-6")
    parser.add_argument("--tol", type=float, default=0.03)
    parser.add_argument("--budget", default="1e5 unknowns")
    options = parser.parse_args()
    known: dict[str, Known] = {
        "where(x < 0.503, 2, 1)": layers(2.0), "where(x < 0.503, 10, 1)": layers(10.0),
        "where(r < 0.517, 1e6, 1)": disc(1e6), "1/(1.01 + sin(150*x))": Waves(MESH, {}, 0, "compliance", 1.01, 150.0),
        "load of u = r^1.1": Pole(MESH, {}, 0, 1.1, 1.0, 0.0),
        "load of u = r^0.1, cut at 1e-12": Pole(MESH, {}, 0, 0.1, 1.0, 1e-12),
    }  # fmt: skip
    show([row(name, one, asked) for name, one in known.items() for asked in UNIFORM])
    adaptive = {"tol": options.tol, "budget": options.budget}
    coarse = {"mesh": {**MESH, "cells": 8}}
    rows = []
    for contrast in map(float, options.contrasts.split(",")):
        for name, make in (("layers", layers), ("disc", disc)):
            one = replace(make(contrast), **coarse)
            rows += [row(f"{name}, {contrast:g}", one, {**adaptive, "element": element}) for element in ("P1", "P2")]
    show(rows)
    show([[name, *said(make)] for name, make in without().items()], ["data", "what is said"])


def row(name: str, known: Known, asked: dict[str, Any]) -> list[str]:
    """One line of a table (collective)."""
    answer = solve(known.scene(), comm=COMM, **asked)
    assert answer.bound is not None
    error, _ = known.error(Field(answer.u))
    total, unknowns = answer.bound.total, answer.record["dofs"]
    element = asked.get("element", "P1")
    words = f"{element} --tol {asked['tol']:g}" if "tol" in asked else element
    return [name, words, str(unknowns), f"{total:.4g}", f"{error:.4g}", f"{total / error:.2f}", answer.bound.words]


def without() -> dict[str, Callable[[], Scene]]:
    """Scenes of the same square that have no certificate."""
    ends = [{"where": "x == 0 and y < 0.311", "value": 0}]
    pole = Pole(MESH, {}, 0, 0.1, 1.0, 0.0)
    return {
        "a boundary value that jumps": lambda: square(boundary=[{"value": "where(x < 0.503, 0, 1)"}]),
        "a boundary part that ends inside an edge": lambda: square(load=-1, boundary=ends),
        "a load that is not square integrable": pole.scene,
    }


def square(**data: Any) -> Scene:
    """A membrane on the unit square."""
    return Scene(mesh=MESH, tension=1, **data)


def said(make: Callable[[], Scene]) -> list[str]:
    """The words of the bound, or why there is none (collective)."""
    try:
        answer = solve(make(), comm=COMM, bound=True)
    except InputError as error:
        return [str(error).splitlines()[0]]
    assert answer.bound is not None
    return [answer.bound.words]


def show(rows: list[list[str]], head: list[str] = HEAD) -> None:
    """Rank 0 prints a table."""
    if COMM.rank == 0:
        for cells in (head, ["---"] * len(head), *rows):
            print("|", " | ".join(cells), "|")
        print()


if __name__ == "__main__":
    main()

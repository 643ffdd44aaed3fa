"""What accuracy costs beside hp finite elements: the oscillating obstacle of Papadopoulos 2024, arXiv 2412.13733.

    .venv/bin/python benchmarks/bessel.py --json docs/measured/bessel.json   # 10 GB
    .venv/bin/python docs/_extensions/measured.py

The obstacle problem of its section 7.2, with absolute errors in the norm of H^1 as there. The time is that of the
processor for a whole solve in this process: all meshes, and error bounds where there are any. The unit is one Poisson
solve on the mesh of P1. True errors are distances to a P2 solution whose error bound is printed. Published numbers
are those of output/bessel_obstacle in github.com/ioannisPApapadopoulos/HierarchicalProximalGalerkin.jl: distances to
the finest solution of the same method, and seconds by the clock without the assembly of the linear parts.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import subprocess
import time
from pathlib import Path
from typing import Any

from fenicsx_obstacle import solve
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.cloud import Cloud, Nearby
from fenicsx_obstacle.answers.poisson_baseline import poisson_seconds
from fenicsx_obstacle.mesh.cells import own_cells

SCENE = Path(__file__).with_suffix(".toml")
H1 = math.sqrt(1 + 1 / (2 * math.pi**2))  # ||v||_1 is at most this times ||grad v|| if v = 0 around the unit square
COLUMNS = ["method", "unknowns", "$H^1$ error", "proved $H^1$ error", "seconds", "Poisson solves"]
PUBLISHED = [
    ["published: hp proximal Galerkin, degree 4", "25281", "0.0374", "", "4.8", ""],
    ["published: hp proximal Galerkin, degree 5", "159201", "0.0080", "", "36", ""],
    ["published: active sets, degree 1", "1635841", "0.0214", "", "443", ""],
]


def main() -> None:
    """Solve, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=1536, help="cells per side with P1")
    parser.add_argument("--errors", default="0.1,0.0374,0.0214,0.008", help="proved H^1 errors to reach with P2")
    parser.add_argument("--reference", type=float, default=1.5e-3, help="tolerance of the solution that is the truth")
    parser.add_argument("--times", type=int, default=3, help="runs of each; the least time counts")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    for element in ("P1", "P2"):  # forms are compiled or loaded here
        solve(SCENE, element=element, cells=16, bound=True)
    truth = solve(SCENE, element="P2", tol_absolute=options.reference)
    assert truth.bound is not None and truth.bound.guaranteed
    proved = H1 * truth.bound.total
    print(f"errors are right to {upward(proved)}; {truth.record['memory_mb']:.0f} MB", flush=True)
    uniform: dict[str, Any] = {"cells": options.cells}
    cases = [("P1, uniform mesh", uniform), ("the same with an error bound", {**uniform, "bound": True})]
    for error in options.errors.split(","):
        cases.append((f"P2, to a proved error of {error}", {"element": "P2", "tol_absolute": float(error) / H1}))
    unit, rows = 0.0, []
    for name, asked in cases:
        answer, seconds, wall = timed(asked, options.times)
        unit = unit or poisson_seconds(answer.level, time.process_time)
        bound = "" if answer.bound is None else upward(H1 * answer.bound.total)
        rows.append([name, str(answer.record["dofs"]), f"{distance(answer, truth):.4f}", bound,
                     f"{seconds:.1f}", f"{seconds / unit:.2f}"])  # fmt: skip
        notes = ["no bound" if answer.bound is None else answer.bound.words, f"{wall:.1f} s by the clock",
                 f"unit {unit:.2f} s", f"{answer.record['memory_mb']:.0f} MB"]  # fmt: skip
        print(*rows[-1], *notes, sep="; ", flush=True)
    if options.json is not None:
        options.json.write_text(stored([*PUBLISHED, *rows], proved, unit))


def distance(a: Answer, b: Answer) -> float:
    """The norm of the difference, by the quadrature points of the mesh with more cells."""
    coarse, fine = sorted((a, b), key=lambda one: own_cells(one.level.mesh))
    found = Nearby(Cloud.of(fine), coarse.level).norms(coarse.u)
    return math.hypot(found["l2"], found["energy"])


def timed(asked: dict[str, Any], times: int) -> tuple[Answer, float, float]:
    """An answer, and the least seconds of the processor and of the clock."""
    spent = []
    for _ in range(times):
        start, clock = time.process_time(), time.perf_counter()
        answer = solve(SCENE, **asked)
        spent.append((time.process_time() - start, time.perf_counter() - clock))
    processor, wall = zip(*spent, strict=True)
    return answer, min(processor), min(wall)


def upward(bound: float) -> str:
    """A bound with four decimals, not rounded down."""
    return f"{math.ceil(1e4 * bound) / 1e4:.4f}"


def stored(rows: list[list[str]], proved: float, unit: float) -> str:
    """The text of a file in docs/measured."""
    commit = subprocess.run(["git", "rev-parse", "--short=8", "HEAD"], stdout=subprocess.PIPE, text=True, check=True)
    head = {"commands": ["benchmarks/bessel.py"], "date": f"{datetime.date.today()}", "commit": commit.stdout.strip(),
            "reference": upward(proved), "unit": f"{unit:.2f} s", "columns": COLUMNS}  # fmt: skip
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    table = ",\n".join(f"  {json.dumps(row)}" for row in rows)
    return "{\n" + ",\n".join([*lines, f' "rows": [\n{table}\n ]']) + "\n}\n"


if __name__ == "__main__":
    main()

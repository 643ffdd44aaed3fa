"""How near the error bound is on scenes with exact solutions, and what it costs.

    .venv/bin/python benchmarks/bounds.py --cells 64 --eps "h,h^2,1e-10"
    .venv/bin/python benchmarks/bounds.py ball --cost --cells 512

Runs under mpirun as it stands. Effectivity is bound over true error, of u_h and of the admissible v_h. `--cost` counts
the bound in Poisson solves on the same mesh, by the CPU time of the slowest rank: each time (the fastest of three),
and what is done once per mesh.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import closing
from typing import Any

from ladder import show
from mpi4py import MPI

from fenicsx_obstacle import InputError, Scene
from fenicsx_obstacle.answers.poisson_baseline import REPETITIONS, poisson_seconds
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.cli_options import values_of
from fenicsx_obstacle.estimation.bound import Estimator
from fenicsx_obstacle.scenes import catalogue


def main() -> None:
    """Print a line for each scene, number of cells and eps (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help="names of the catalogue or files; all plane scenes of the catalogue")
    parser.add_argument("--cells", default="64")
    parser.add_argument("--eps", default="h,h^2,1e-10")
    parser.add_argument("--element", default="P1", help="P1 or P2; of P2 the admissible state has no error here")
    parser.add_argument("--cost", action="store_true")
    options = parser.parse_args()
    if not options.cost:
        show(f"{'scene':20} {'cells':>5} {'eps':>6} {'error u':>10} {'bound':>10} {'eff.':>5} {'error v':>10} "
             f"{'bound':>10} {'eff.':>5}  discretisation, penalty, data")  # fmt: skip
    for name in options.scenes or catalogue.names():
        for cells in values_of(options.cells, "cells"):
            scene = catalogue.read(name).change({"mesh.cells": cells, "solve.element": options.element})
            try:
                with closing(SolverContext(scene)) as context:
                    cost(context) if options.cost else effectivities(context, values_of(options.eps, "eps"))
            except InputError as error:
                show(f"{name:20} {error}")


def effectivities(context: SolverContext, many: list) -> None:
    """Bounds and true errors (collective)."""
    scene = context.scene
    for eps in many:
        answer = context.answer(scene.options_with(eps=eps), bound=True)
        bound, error = answer.bound, answer.record["errors"]["energy"]
        of_v = context.exact.errors(bound.admissible, answer.pressure, answer.record["eps"])[0]["energy"]
        error_v = of_v if scene.pair.degree == 1 else float("nan")  # v is no function of P2
        show(f"{scene.name:20} {answer.record['cells']:5} {eps!s:>6} {error:10.3e} {bound.total:10.3e} "
             f"{bound.total / error:5.2f} {error_v:10.3e} {bound.admissible_total:10.3e} "
             f"{bound.admissible_total / error_v:5.2f}  {bound.discretisation:.1e}, {bound.penalty:.1e}, "
             f"{bound.data:.1e}  {bound.words}")  # fmt: skip


def cost(context: SolverContext) -> None:
    """Seconds and Poisson units (collective)."""
    scene: Scene = context.scene
    context.answer()
    level = context.problem.level
    poisson_seconds(level)  # compiles its forms
    unit = min(timed(lambda: poisson_seconds(level))[1] for _ in range(2)) / REPETITIONS
    estimator, once = timed(lambda: Estimator(context.problem))
    first, *others = (timed(estimator.bound)[1] for _ in range(4))
    each = min(others)
    show(f"{scene.name}: {level.dofs} unknowns, Poisson {unit:.2f} s; a bound {each:.2f} s = "
         f"{each / unit:.2f} units; once per mesh {once:.2f} s, and {first - each:.2f} s near contact = "
         f"{(once + first - each) / unit:.2f} units")  # fmt: skip


def timed(action: Callable[[], Any]) -> tuple[Any, float]:
    """Its result, and the CPU seconds of the slowest rank, in which it may have waited for others (collective)."""
    MPI.COMM_WORLD.barrier()
    start = time.process_time()
    result = action()
    return result, MPI.COMM_WORLD.allreduce(time.process_time() - start, op=MPI.MAX)


if __name__ == "__main__":
    main()

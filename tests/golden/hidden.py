"""What a final value hides: levels, retries, restarts, memory over many solves, ranks without cells."""

from __future__ import annotations

import ctypes
import gc
import logging
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from cases import ALL, COMM, DEMOS, ONE, Values, add, case, digest, flat, plain
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc
from problems import TARGET, Membrane, elastic, with_term
from scenes import BOX, DISK, L_SHAPE, QUADS, SQUARE, STRING, WAVE

from fenicsx_obstacle import ObstacleProblem, Scene, find, releases, solve

TURNS = ("direct solver", "cold start", "too far away")  # in the log, where a solve takes another way


def discrete_levels(problem: ObstacleProblem) -> list[Any]:
    """The discrete problems of an ObstacleProblem, the coarsest first (collective).

    The one place that knows internal names. Each item has A, weights, fixed, and what `fingerprint` asks.
    """
    from fenicsx_obstacle.algebra.options import SolverOptions  # which another version may have elsewhere
    from fenicsx_obstacle.discrete.hierarchy import levels_of

    return list(levels_of(problem._problem, SolverOptions()).systems)


def fingerprint(problem: Any) -> dict[str, Any]:
    """Norms of A, f, D and the bounds of a discrete problem at its cold start (collective)."""
    problem.set_reference(problem.cold_start())
    state = problem.vector()
    A = problem.jacobian(state, penalised=False)
    residual = problem.law.vector()
    problem.residual(state, residual, penalised=False)
    bounds = {
        side: [float(gap[abs(gap) < 1e100].sum())]
        for side, gap in (("below", problem.below), ("above", problem.above)) if gap is not None
    }  # fmt: skip
    return {
        "size": A.getSize()[0], "A": plain([A.norm(PETSc.NormType.FROBENIUS), A.norm(PETSc.NormType.INFINITY)]),
        "f": plain([residual.norm(), residual.norm(PETSc.NormType.NORM_1)]), "fixed": int(problem.fixed.sum()),
        "D": plain([float(problem.weights.sum()), float(np.linalg.norm(problem.weights))]),
        **{side: plain(values) for side, values in bounds.items()},
    }  # fmt: skip


def levels(name: str, make: Callable[[], ObstacleProblem]) -> None:
    """A case with the fingerprints of all levels, and a solve."""

    def run(folder: Path) -> Values:
        problem = make()
        prints = {f"level.{number}.{key}": value for number, one in enumerate(discrete_levels(problem))
                  for key, value in fingerprint(one).items()}  # fmt: skip
        return prints | digest(make().solve())

    add(f"level/{name}", run, ONE)


def scene(**given: Any) -> Callable[[], ObstacleProblem]:
    data = {"mesh": SQUARE, "tension": 1, "load": -4, "lower": "-0.08 - 0.05*x", **given}
    data = {key: value for key, value in data.items() if value is not None}
    return lambda: Scene(**data).problem()


@contextmanager
def turns() -> Iterator[list[str]]:
    """Messages of the log that say that a solve takes another way."""
    found: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            found.extend(turn for turn in TURNS if turn in record.getMessage())

    log, handler = logging.getLogger("fenicsx_obstacle"), Keep()
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield found
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


def turned(name: str, solve: Callable[[], Any], ranks: tuple[int, ...] = ALL) -> None:
    """A case that notes retries and restarts on the way."""

    def run(folder: Path) -> Values:
        with turns() as found:
            values = digest(solve())
        return {"turns": found, **values}

    add(f"turn/{name}", run, ranks)


def discrete() -> None:
    levels("string", scene(mesh={**STRING, "cells": 64}, lower=-0.1))
    levels("string-large", scene(mesh={**STRING, "cells": 2000}, lower=-0.1))
    levels("square", scene(mesh={**SQUARE, "cells": 48}))
    levels("square-both", scene(mesh={**SQUARE, "cells": 40}, load=WAVE, upper=0.05))
    levels("square-refined", scene(mesh={**SQUARE, "cells": 10, "refine": 2}))
    levels("quadrilaterals", scene(mesh={**QUADS, "cells": 40}))
    levels("disk", scene(mesh={**DISK, "cells": 32}, lower=-0.2))
    levels("l-shape", scene(mesh={**L_SHAPE, "cells": 32}))
    levels("box", scene(mesh={**BOX, "cells": 12}, load=-10, lower=-0.1))
    levels("geo", lambda: Scene.read(DEMOS / "dam.toml").problem())
    levels("tension", scene(mesh={**SQUARE, "cells": 40}, tension="where(x < 0.4, 1, 50)"))
    levels("matrix", scene(mesh={**SQUARE, "cells": 40}, tension=[[2, 0.5], [0.5, 1]]))
    levels("foundation", scene(mesh={**SQUARE, "cells": 40}, foundation=30, load=-9))
    levels("thin", scene(mesh={**SQUARE, "cells": 40}, load=1, lower=None,
           boundary=[{"on": "left", "value": 0}, {"on": "right", "upper": 0.3}]))  # fmt: skip
    levels(
        "axial",
        scene(mesh={**STRING, "cells": 200}, axial_symmetry=True, lower=-0.3, boundary=[{"on": "right", "value": 0}]),
    )
    for degree in (1, 2):
        levels(f"form-P{degree}", lambda d=degree: Membrane(degree=d, n=40).problem())
    levels("form-Q1", lambda: Membrane("quadrilateral", n=40).problem())
    levels("form-solid", lambda: Membrane("tetrahedron", n=12, load=-10).problem())
    levels("elastic", lambda: elastic(1))


def other_ways() -> None:
    transport = lambda u, v, x: 1e6 * (u.dx(0) + x[0] * u.dx(1)) * v  # noqa: E731
    turned("direct", lambda: with_term(transport).solve())
    turned("direct-vi", lambda: with_term(transport).solve(method="vi"))
    for poisson in (0.499, 0.4999):
        turned(f"direct-body-{poisson}", lambda nu=poisson: solve(_rubber(nu), element="P2"))
    turned(
        "narrow",
        lambda: solve(Scene(mesh={**SQUARE, "cells": 40}, tension=1, load="60*sin(9*x*y)", lower=-1e-2, upper=1e-2)),
    )
    turned("narrow-form", lambda: Membrane(n=40, load=60).problem(lower=-1e-3, upper=1e-3).solve(eps=1e-9))
    turned("cold", lambda: solve(Scene(mesh={**SQUARE, "cells": 40}, tension=1, load=-9, lower=-0.1), start="cold"))
    needle = "0.5 - 80*((x - 0.5)^2 + (y - 0.5)^2)"
    turned("needle", lambda: solve(Scene(mesh={**SQUARE, "cells": 32}, tension=1, lower=needle),
           eps=1e-12))  # fmt: skip
    turned(
        "strong-jump",
        lambda: solve(Scene(mesh={**SQUARE, "cells": 40}, tension="where(x*y < 0.2, 1, 1e8)", load=-9, lower=-0.1)),
    )
    turned("far", lambda: _far())
    turned(
        "drift", lambda: solve(Scene(mesh={**SQUARE, "cells": 24}, tension=1e-3, drift=[1, "x"], load=-1, lower=-0.1))
    )
    turned("large-slope", lambda: solve(Scene(mesh={**SQUARE, "cells": 16}, large_slope=1, load=-3.5, lower=-0.3)))


def forced() -> None:
    """Starts that do not serve: the interpolant of the coarser level is not a number, no start has a step to go."""

    def spoilt(problem: Any, coarse: Any) -> None:
        problem.w[:] = np.nan

    def cold(method: str) -> Any:
        with patch("fenicsx_obstacle.algebra.nested.begin_from", spoilt):
            return Membrane(n=40).problem().solve(method=method)

    for method in ("penalty", "vi"):
        turned(f"forced-cold-{method}", lambda method=method: cold(method))

    @case("turn/forced-far")
    def _(folder: Path) -> Values:
        with turns() as found, patch("fenicsx_obstacle.algebra.nested.FEW", 0):
            rows = find(Scene(**{**TARGET, "mesh": {**SQUARE, "cells": 40}}), {"define.a": (1, 4)}, "force = 3")
        return {"turns": found, **flat({str(number): row for number, row in enumerate(rows)})}


def _rubber(poisson: float) -> Scene:
    """A nearly incompressible block under a cylinder."""
    return Scene(
        mesh=SQUARE, elasticity={"young": 1, "poisson": poisson, "plane": "strain"},
        boundary=[{"on": "bottom", "value": [0, 0]}, {"on": "top", "obstacle": {"cylinder": 4, "centre": [0.5, 4.98]}}],
    )  # fmt: skip


def _far() -> Any:
    """A second solve whose data have changed so much that the first solution is no start."""
    one = Membrane(n=40, load=-30)
    problem = one.problem(upper=0.1)
    problem.solve(eps=1e-9)
    one.f.value = PETSc.ScalarType(30)
    return problem.solve(eps=1e-9)


def many_ranks() -> None:
    """Meshes with fewer cells than ranks, and dofs of which a rank owns none."""
    for cells in (1, 2, 3):
        for name, mesh in (("string", STRING), ("square", SQUARE), ("quads", QUADS), ("box", BOX)):
            data = {
                "mesh": {**mesh, "cells": cells},
                "tension": 1,
                "load": -4,
                "boundary": [{"on": "left", "value": 0}],
            }
            for method in ("penalty", "vi"):
                add(f"empty/{name}-{cells}-{method}",
                    lambda folder, d=data, m=method: digest(solve(Scene(**d, lower="-0.1 - 0.1*x"), method=m))
                    )  # fmt: skip
        square = {"mesh": {**SQUARE, "cells": cells}, "tension": 1, "load": -4, "lower": -0.1}
        add(f"empty/bound-{cells}", lambda folder, d=square: digest(solve(Scene(**d), bound=True)))
        add(f"empty/p2-{cells}", lambda folder, d=square: digest(solve(Scene(**d), element="P2")))
        add(f"empty/form-{cells}", lambda folder, n=cells: digest(Membrane(n=n).problem().solve()))
        add(f"empty/form-p2-{cells}", lambda folder, n=cells: digest(Membrane(degree=2, n=n).problem().solve()))
    add(
        "empty/tol",
        lambda folder: digest(solve(Scene(mesh={**SQUARE, "cells": 1}, tension=1, load=-4, lower=-0.1), tol=0.5)),
    )

    @case("empty/last-rank")
    def _(folder: Path) -> Values:
        """All cells on the last rank."""
        points = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.4, 0.6]], dtype=float)
        cells = np.array([[0, 1, 4], [1, 3, 4], [3, 2, 4], [2, 0, 4]])
        last = COMM.rank == COMM.size - 1
        mesh = releases.create_mesh(
            COMM, cells if last else cells[:0], points if last else points[:0], "triangle", stay=True
        )
        return digest(solve(Scene(mesh=mesh, tension=1, load=-9, lower=-0.1)))

    @case("empty/one-rank-communicator", ranks=(2, 3))
    def _(folder: Path) -> Values:
        own = dmesh.create_unit_square(MPI.COMM_SELF, 6, 6)
        found = solve(Scene(mesh=own, tension=1, load=-9, lower=-0.1))
        return {"energy": plain(found.energy), "area": plain(found.area), "force": plain(found.force.lower),
                "steps": found.iterations}  # fmt: skip


def memory() -> None:
    def resident() -> int:
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return COMM.allreduce(pages * resource.getpagesize(), MPI.MAX)

    def grows(name: str, once: Callable[[], Any], limit: float, times: int = 200) -> None:
        def run(folder: Path) -> Values:
            for _ in range(times // 4):
                once()
            before = resident()
            for _ in range(times - times // 4):
                once()
            return {"grows": bool(resident() - before > limit)}

        add(f"memory/{name}", run, (1, 2))

    kept: list[ObstacleProblem] = []

    def again() -> None:
        if not kept:
            kept.append(Membrane(n=12).problem())
        kept[0].solve()

    grows("200-solves-of-one-problem", again, 4e6)
    grows("60-scenes", lambda: solve(Scene(mesh=SQUARE, tension=1, load=-4, lower=-0.1)), 8e6, times=60)
    grows("60-forms", lambda: Membrane().problem().solve(), 8e6, times=60)


for subject in (discrete, other_ways, forced, many_ranks, memory):
    subject()

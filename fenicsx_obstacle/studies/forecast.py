"""Forecast of the cost of a tolerance, by extrapolation from the first meshes.

Meshes that are refined where the error is soon settle: their bound falls like a power of the unknowns, and unknowns
grow by the same factor from mesh to mesh. A mesh takes some time whatever its size, and some for each unknown: that is
told by one larger mesh, the last with all cells refined. Memory is taken by all meshes together, since the coarse
ones stay as levels of multigrid.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.answers.adapt import Refinement
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.solvers.options import SolverOptions

SECONDS = 3.0  # of calibration, and the larger mesh after it
SETTLED = 5  # meshes at the end of the calibration from which is extrapolated
ROUND_OFF = 1e-9  # of a number of meshes
MIN_MESHES = 4  # meshes at least
ORDERS = (0.7, 1.1)  # of the bound in 1/unknowns, over that of smooth solutions: what is believed
Path = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Forecast:
    """The forecast of `solve --tol`.

    Attributes:
        dofs: Unknowns on the last mesh.
        seconds: Of all meshes, from an empty process on without its start.
        memory_mb: Peak of the process.
        meshes: How many.
        order: The bound falls like unknowns to minus this.
        calibration: Seconds that this took.
        reached: Whether the calibration itself came so far.
    """

    dofs: float
    seconds: float
    memory_mb: float
    meshes: int
    order: float
    calibration: float
    reached: bool


def forecast(scene: Scene, tol: float, *, seconds: float = SECONDS, comm: MPI.Comm = MPI.COMM_WORLD) -> Forecast:
    """Run the first meshes of `solve --tol`, and continue them (collective).

    Args:
        scene: What is to be solved.
        tol: Relative energy error.
        seconds: For the calibration.
        comm: Communicator.

    Raises:
        InputError: If there is no error bound for the scene, or the tolerance is not positive.
        NotConverged: With PETSc's reason.
    """
    if not 0 < tol < np.inf:
        raise InputError(f"--tol {tol}: must be positive and finite")
    refinement = Refinement(scene, comm)
    probe = None
    with closing(refinement.meshes()) as meshes:
        for work, _ in meshes:
            last = refinement.path[-1]
            if last["relative"] is None:
                raise InputError(f"{scene.source}: u is 0 so far: a relative tolerance means nothing")
            enough = last["seconds"] > seconds and len(refinement.path) >= MIN_MESHES
            if comm.bcast(last["relative"] <= tol):
                break
            if comm.bcast(enough):
                probe = _larger(work, refinement.options)
                break
    return comm.bcast(continued(refinement.path, tol, scene.pair.degree, probe))


def _larger(work: SolverContext, options: SolverOptions) -> dict[str, float]:
    """Time and memory of the mesh with all cells refined (collective)."""
    start = time.perf_counter()
    work.forget_estimator()
    everywhere = np.ones(own_cells(work.problem.level.mesh), dtype=bool)
    with closing(work.refined(everywhere)) as finer:
        record = finer.answer(options, bound=True).record
    return {"dofs": record["dofs"], "seconds": time.perf_counter() - start, "memory_mb": record["memory_mb"]}


def continued(path: Path, tol: float, degree: int, probe: Mapping[str, float] | None) -> Forecast:
    """The path of a refinement continued to a tolerance (local).

    Args:
        path: Its meshes.
        tol: Relative energy error.
        degree: Of the elements.
        probe: Unknowns, seconds and memory of one larger mesh.
    """
    dofs, relative, seconds, memory = (
        np.array([float(step[key]) for step in path]) for key in ("dofs", "relative", "seconds", "memory_mb")
    )
    if relative[-1] <= tol or probe is None:
        spent = float(seconds[-1])
        return Forecast(float(dofs[-1]), spent, float(memory[-1]), len(path), 0.0, spent, True)
    last = slice(-min(SETTLED, len(path)), None)
    order = -_slope(np.log(dofs[last]), np.log(relative[last]))
    order = float(np.clip(order, *(degree / 2 * np.array(ORDERS))))
    wanted = dofs[-1] * (relative[-1] / tol) ** (1 / order)
    growth = float(np.clip((dofs[-1] / dofs[last][0]) ** (1 / max(len(dofs[last]) - 1, 1)), 1.2, 4.0))
    count = max(int(np.ceil(np.log(wanted / dofs[-1]) / np.log(growth) - ROUND_OFF)), 1)
    later = dofs[-1] * (wanted / dofs[-1]) ** (np.arange(1, count + 1) / count)
    # a line through the larger mesh and what is usual on the small ones
    usual, size = float(np.median(np.diff(seconds)[last])), float(np.median(dofs[last]))
    each = max((probe["seconds"] - usual) / max(probe["dofs"] - size, 1.0), 0.0)
    fixed = max(usual - each * size, 0.0)
    each = min(each, probe["seconds"] / probe["dofs"])
    per_unknown = max((probe["memory_mb"] - memory[-1]) / probe["dofs"], 0.0)
    return Forecast(
        float(wanted), float(seconds[-1] + np.sum(fixed + each * later)),
        float(memory[-1] + per_unknown * later.sum()), len(path) + count, order, float(seconds[-1]) + probe["seconds"],
        False,
    )  # fmt: skip


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.polyfit(x, y, 1)[0]) if np.ptp(x) > 0 else 0.0

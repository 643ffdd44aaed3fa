"""What a tolerance will take, before it is run: a few seconds of the same run, continued.

Meshes that are refined where the error is soon settle: their bound falls like a power of the unknowns, and unknowns
grow by the same factor from mesh to mesh. A mesh takes some time whatever its size, and some for each unknown; memory
is taken by all meshes together, since the coarse ones stay as levels of multigrid.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.answers.adapt import Refinement
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.scene import Scene

SECONDS = 4.0  # of calibration
SETTLED = 5  # meshes at the end of the calibration that tell how things go on
LEAST = 4  # meshes at least
ORDERS = (0.35, 1.6)  # of the bound in 1/unknowns: what is believed
Path = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Forecast:
    """What `solve --tol` is expected to take.

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
    with closing(refinement.meshes()) as meshes:
        for _ in meshes:
            last = refinement.path[-1]
            if last["relative"] is None:
                raise InputError(f"{scene.source}: u is 0 so far: a relative tolerance means nothing")
            enough = last["seconds"] > seconds and len(refinement.path) >= LEAST
            if comm.bcast(last["relative"] <= tol or enough):
                break
    return comm.bcast(continued(refinement.path, tol))


def continued(path: Path, tol: float) -> Forecast:
    """The path of a refinement continued to a tolerance (local)."""
    dofs, relative, seconds, memory = (
        np.array([float(step[key]) for step in path]) for key in ("dofs", "relative", "seconds", "memory_mb")
    )
    last = slice(-min(SETTLED, len(path)), None)
    if relative[-1] <= tol:
        spent = float(seconds[-1])
        return Forecast(float(dofs[-1]), spent, float(memory[-1]), len(path), 0.0, spent, True)
    order = -_slope(np.log(dofs[last]), np.log(relative[last])) if len(path) > 1 else 0.5
    order = float(np.clip(order, *ORDERS))
    wanted = dofs[-1] * (relative[-1] / tol) ** (1 / order)
    growth = float(np.clip((dofs[-1] / dofs[last][0]) ** (1 / max(len(dofs[last]) - 1, 1)), 1.2, 4.0))
    count = max(int(np.ceil(np.log(wanted / dofs[-1]) / np.log(growth))), 1)
    later = dofs[-1] * (wanted / dofs[-1]) ** (np.arange(1, count + 1) / count)
    fixed, each = _line(dofs, np.diff(seconds, prepend=0.0))
    everything = np.cumsum(dofs)
    half = len(dofs) // 2
    per_unknown = max((memory[-1] - memory[half]) / max(everything[-1] - everything[half], 1.0), 0.0)
    return Forecast(
        float(wanted), float(seconds[-1] + np.sum(fixed + each * later)),
        float(memory[-1] + per_unknown * later.sum()), len(path) + count, order, float(seconds[-1]), False,
    )  # fmt: skip


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.polyfit(x, y, 1)[0]) if np.ptp(x) > 0 else 0.0


def _line(dofs: np.ndarray, spent: np.ndarray) -> tuple[float, float]:
    """Seconds of a mesh, and of each unknown, neither negative; the last meshes, which are the largest, count most."""
    weight = np.sqrt(dofs / dofs[-1])
    A = np.stack([np.ones(len(dofs)), dofs], axis=1) * weight[:, None]
    (fixed, each), *_ = np.linalg.lstsq(A, spent * weight, rcond=None)
    if each <= 0:
        return 0.0, float(spent[-1] / dofs[-1])
    if fixed <= 0:
        return 0.0, float(np.sum(spent * dofs) / np.sum(dofs**2))
    return float(fixed), float(each)

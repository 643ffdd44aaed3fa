"""Forecast of the cost of a tolerance, by extrapolation from the first meshes.

Meshes that are refined where the error is soon settle: their error falls like a power of the unknowns, and unknowns
grow by the same factor from mesh to mesh. A mesh takes some time whatever its size, and some for each unknown: a larger
mesh determines both. Its time is measured until two measurements agree. All times are processor times: they are elapsed
times if nothing else runs, and other programs change them less. Memory is taken by all meshes together, since the
coarse ones stay as levels of multigrid.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fenicsx_obstacle.answers.adapt import Adaptation, Work
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.mesh.memory import free_megabytes

SECONDS = 3.0  # of the first meshes
LARGER = 4.0  # unknowns of the larger mesh over those of the last one, at most
LARGER_SECONDS = 2.0  # time of the larger mesh over `SECONDS`, at most
REPEATS = 3  # of the larger mesh, at most
AGREE = 1.2  # ratio of two measurements that agree
SETTLED = 5  # meshes at the end of the calibration from which is extrapolated, at most
SPAN = 20.0  # growth of the unknowns over these meshes, at most
ROUND_OFF = 1e-9  # of a number of meshes
MIN_MESHES = 3  # meshes of the calibration, and of those from which is extrapolated, at least
AVERAGED = 3  # meshes at the end over which fluctuating errors are averaged
# of the error in 1/unknowns, over that of smooth solutions: what is believed if it falls steadily, and if it fluctuates
ORDERS = {True: (0.7, 1.1), False: (0.9, 1.1)}
# meshes by which the last mesh is beyond the tolerance, measured: less if only as many cells are refined as it needs
BEYOND = {True: 0.25, False: 0.5}


@dataclass(frozen=True)
class Forecast:
    """The forecast of `solve --tol`.

    Attributes:
        dofs: Unknowns on the last mesh.
        seconds: Processor time of all meshes, from an empty process on without its start.
        memory_mb: Peak of the process.
        meshes: How many.
        order: The error falls like unknowns to minus this.
        calibration: Processor time that this took, in seconds.
        stopped: None if the tolerance is beyond the calibration, "" if the calibration itself has reached it, otherwise
            the reason why it cannot be reached.
        spread: Ratio of the two measurements of the time per unknown that are closest to each other.
        busy: Elapsed time over processor time of these measurements.
        fits: Whether there is enough free memory.
    """

    dofs: float
    seconds: float
    memory_mb: float
    meshes: int
    order: float
    calibration: float
    stopped: str | None
    spread: float = 1.0
    busy: float = 1.0
    fits: bool = True

    @property
    def agrees(self) -> bool:
        """Whether two measurements of the time per unknown agree."""
        return self.spread <= AGREE


def forecast(run: Adaptation) -> Forecast:
    """Run the first meshes of `solve --tol`, and continue them (collective).

    Args:
        run: The refinement, before its first mesh.

    Raises:
        InputError: If there is no error bound or estimate.
        NotConverged: With PETSc's reason.
    """
    run.estimates = False  # the time for a bound is to be known
    with closing(run.meshes()) as meshes:
        for context, answer in meshes:
            stopped = run.finished(answer)
            spent = sum(work.seconds for work in run.work)
            if stopped is not None:
                last = run.work[-1]
                return Forecast(answer.dofs, spent, last.memory_mb, len(run.path), 0.0, spent, stopped)
            if len(run.path) >= MIN_MESHES and spent > SECONDS:
                dim = answer.level.mesh.topology.dim
                larger = _larger(run, context, dim)
                free = free_megabytes(run.comm)
                break
    return continued(run, dim, larger, free)


def _larger(run: Adaptation, context: SolverContext, dim: int) -> Sequence[Work]:
    """The work for a larger mesh, until two measurements agree (collective).

    None, if the last mesh took so long that its constant part does not matter.
    """
    last = run.work[-1]
    if last.seconds > SECONDS:
        return []
    growth = min(LARGER, LARGER_SECONDS * SECONDS / last.seconds)
    count = own_cells(context.problem.level.mesh)
    cells = np.arange(count) < (growth - 1) / (2**dim - 1) * count
    found: list[Work] = []
    while len(found) < 2 or (len(found) < REPEATS and closest(found)[0] > AGREE):
        found.append(run.work_of(context, cells))
    return found


def closest(measured: Sequence[Work]) -> tuple[float, float]:
    """Of the two closest rates their ratio, and the smaller one (local)."""
    rates = sorted(work.rate for work in measured)
    return min((high / low, low) for low, high in pairwise(rates))


def continued(run: Adaptation, dim: int, larger: Sequence[Work], free: float = np.inf) -> Forecast:
    """The path of a refinement continued to its tolerance (local).

    Args:
        run: Its first meshes.
        dim: Dimension of the mesh.
        larger: Measurements of the work for a larger mesh; the last two meshes serve if there are none.
        free: Free memory in MB.
    """
    path, work = run.path, run.work
    dofs = np.array([float(step["dofs"]) for step in path])
    log_errors = np.log([step["relative" if run.relative else "total"] for step in path])
    settled = int(np.clip(np.count_nonzero(SPAN * dofs >= dofs[-1]), MIN_MESHES, SETTLED))
    last = slice(-settled, None)
    smooth = run.power * run.scene.pair.degree / dim
    order = float(np.clip(-_slope(np.log(dofs[last]), log_errors[last]), *(smooth * np.array(ORDERS[run.steady]))))
    growth = float(np.clip((dofs[-1] / dofs[last][0]) ** (1 / max(len(dofs[last]) - 1, 1)), 1.2, 4.0))
    # the unknowns of a tolerance, from each of the last meshes
    each_wanted = np.log(dofs) + (log_errors - np.log(run.tolerance)) / order
    reached = np.exp(each_wanted[-1] if run.steady else each_wanted[-AVERAGED:].mean())
    wanted = float(max(reached, dofs[-1]) * growth ** BEYOND[run.steady])
    count = max(int(np.ceil(np.log(wanted / dofs[-1]) / np.log(growth) - ROUND_OFF)), 1)
    later = dofs[-1] * (wanted / dofs[-1]) ** (np.arange(1, count + 1) / count)
    unknowns, solved, seconds = (
        np.array([values(one) for one in work])
        for values in (lambda w: float(w.unknowns), lambda w: float(w.unknowns * w.solves), lambda w: w.seconds)
    )
    # a line through the larger mesh and what is usual on the small ones
    measured = larger or work[-2:]
    spread, rate = closest(measured)
    size = float(measured[-1].unknowns * measured[-1].solves)
    usual, usual_size = float(np.median(seconds[last])), float(np.median(solved[last]))
    each = min(max((rate * size - usual) / max(size - usual_size, 1.0), 0.0), rate)
    fixed = max(usual - each * usual_size, 0.0)
    solves = float(solved[last].sum() / unknowns[last].sum())
    per_dof = unknowns[-1] / dofs[-1]  # unknowns of all meshes that an estimate takes
    # coarse meshes stay in memory, finer ones of an estimate do not
    below = -1 if larger else -2
    more = measured[-1].unknowns - unknowns[below] + dofs[below]
    first = larger[0] if larger else work[-1]
    per_unknown = max((first.memory_mb - work[below].memory_mb) / more, 0.0)
    growing = per_unknown * (dofs[-1] + later[:-1].sum() + per_dof * later[-1] - unknowns[-1])
    return Forecast(
        dofs=float(wanted),
        seconds=float(seconds.sum() + np.sum(fixed + each * solves * per_dof * later)),
        memory_mb=float(work[-1].memory_mb + growing),
        meshes=len(path) + count,
        order=order,
        calibration=float(seconds.sum()) + sum(one.seconds for one in larger),
        stopped=None,
        spread=spread,
        busy=sum(one.elapsed for one in measured) / sum(one.seconds for one in measured),
        fits=bool(growing <= free),
    )


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.polyfit(x, y, 1)[0]) if np.ptp(x) > 0 else 0.0

"""Trapped drift on meshes that do not resolve it: checks of data in time, and of solutions."""

from __future__ import annotations

from functools import partial

import numpy as np

from fenicsx_obstacle.algebra.linear import LARGEST
from fenicsx_obstacle.algebra.plausibility import moved_by, solved
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.discrete.drift import Drift, residence_time, speed
from fenicsx_obstacle.discrete.mesh_system import MeshSystem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import total

TRAPPED = 50.0  # so many times the time in which drift crosses the domain: with a way out it is a logarithm of Pe
NO_WAY_OUT = 1e4  # times the same: without one it is an exponential of Pe; in circles a multiple of Pe


def check_drift_in_time(problem: MeshSystem) -> None:
    """Reject drift that is trapped for longer than the scene lasts, on cells that do not resolve it (collective).

    The discrete drift then leaves after all, so that u stops growing. In circles it is diffusion that takes long.

    Raises:
        InputError: With the Peclet number of the cells.
    """
    drift = problem.drift
    if drift is None or drift.number <= 1:
        return
    assert problem.model.time is not None
    longest = _longest_stay(problem, drift, problem.fixed)
    if longest > NO_WAY_OUT and _crossings(problem, drift, problem.model.time.end) > TRAPPED:
        raise InputError(f"{problem.model.source}: {_in_words(drift.number)}")


def trapped(problem: System, active: np.ndarray) -> str | None:
    """Trapped drift on a mesh that does not resolve the diffusion against it, so that u is arbitrary there.

    Where drift flows away from some places on all sides, or in circles, the time that a particle stays in the domain is
    the exponential of the work of the drift over the tension, and so is u. Cells with Pe > 1 do not resolve it.
    """
    assert isinstance(problem, MeshSystem)
    drift = problem.drift
    if drift is None or drift.number <= 1:
        return None
    held = problem.fixed | problem.active_dofs(active != 0)
    known = problem.affine and drift.held is not None  # otherwise u is in the stiffness
    if not known or total(problem.level.comm, np.count_nonzero(drift.held != held)) > 0:
        longest = _longest_stay(problem, drift, held)
        if 0 < longest <= TRAPPED and problem.affine and problem.nodal:
            # in circles the matrix of the problem has less artificial diffusion
            moved = moved_by(problem, active, problem.law.unit_load())
            longest = max(longest, _crossings(problem, drift, moved))
        drift.held, drift.time = held, longest
    return _in_words(drift.number) if drift.time > TRAPPED else None


def _in_words(number: float) -> str:
    return (
        "the drift flows away from some places on all sides, or in circles, so that u is large there, and the cells "
        f"are too coarse to say how large: their Peclet number |drift| h/(2 tension) reaches {number:.3g}, and must be "
        "below 1 here"
    )


def _longest_stay(problem: MeshSystem, drift: Drift, held: np.ndarray) -> float:
    """The longest time that the drift stays in the domain, over that in which it crosses it (collective)."""
    if drift.reaction is None or not problem.affine:
        drift.reaction = problem.law.row_sums()
    solve = partial(solved, problem.level.dofs)
    time = residence_time(problem.data, drift.velocity, held, drift.reaction, problem.A, solve)
    return _crossings(problem, drift, time)


def _crossings(problem: MeshSystem, drift: Drift, time: float | None) -> float:
    """A time over that in which the drift crosses the domain; infinite, or unknown and 0, if its system was not solved
    (collective)."""
    if time is None:
        return np.inf if problem.level.dofs <= LARGEST else 0.0
    return time * speed(problem.data, drift.velocity) / problem.data.extent

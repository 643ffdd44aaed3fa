"""Drift: cell Peclet numbers, the longest time that drift and diffusion need to leave a domain, and checks of it.

This time is the largest u of -div(mu grad u) + b . grad u + k u = 1 with u = 0 where it is held, found by exponential
fitting. Where the drift b flows away from some place on all sides u is the exponential of a work, which Galerkin's
method and SUPG do not see on cells that do not resolve it. The matrix here has, for vertices i and j of a cell T, the
entries of Scharfetter and Gummel (1969),

    A_ij = -w B(d_ij),   d_ij = b . (x_j - x_i)/mu,   B(d) = d/(e^d - 1),   A_ii = k_i - sum_j A_ij,

exact on a line with constant data. It is an M-matrix for any drift. The weights w = mu |T| n/(|x_i - x_j|^2 m), n being
the dimension and m the number of pairs of vertices, are those of mu |grad u|^2 averaged over its directions: the time
is known up to a factor of order 1, which is enough to see exponentials.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias, cast

import numpy as np
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.linear_solvers import LARGEST
from fenicsx_obstacle.algebra.plausibility import moved_by, solved
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.fields import array_of
from fenicsx_obstacle.discrete.mesh_system import MeshSystem
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.cells import cell_volumes, corners, own_cells
from fenicsx_obstacle.parallel import largest, total

TRAPPED = 50.0  # so many times the time in which drift crosses the domain: with a way out it is a logarithm of Pe
NO_WAY_OUT = 1e4  # times the same: without one it is an exponential of Pe; in circles a multiple of Pe

Velocity: TypeAlias = tuple[Field, ...]


@dataclass(eq=False)
class Drift:
    """The drift of a problem, and what is known of it as long as the stiffness stays.

    Attributes:
        velocity: Its components.
        number: The largest Peclet number of the cells.
        reaction: Row sums of the stiffness at owned dofs; None where they are not known.
        held: The owned dofs where u was held when `time` was found; None before.
        time: The longest time that the drift stays in the domain, over that in which it crosses it.
    """

    velocity: Velocity
    number: float
    reaction: np.ndarray | None = None
    held: np.ndarray | None = None
    time: float = 0.0

    @classmethod
    def of(cls, data: Data) -> Drift:
        """The drift of a model that has one, with its present values (collective)."""
        velocity = next(cast(Velocity, effect.value) for effect in data.model.effects if effect.role == "drift")
        return cls(velocity, peclet(data, velocity))


def peclet(data: Data, velocity: Velocity) -> float:
    """The largest |drift| h/(2 tension), by the largest tension of each cell (collective).

    Args:
        data: Of the problem.
        velocity: Components of the drift.
    """
    ratio = _speeds(data, velocity) / (2 * _of_cells(data, data.model.elastic.stiffness(data)))  # type: ignore[arg-type]
    size = array_of(data.cell_size)
    size = size[: own_cells(data.level.mesh)] if len(size) > 1 else size
    return largest(data.level.comm, (ratio * size[:, None]).ravel())


def residence_time(problem: MeshSystem, drift: Drift, held: np.ndarray) -> float | None:
    """The longest time; infinite if there is no way out, None if the system could not be solved (collective).

    Args:
        problem: With the drift.
        drift: It.
        held: Whether u is held at an owned dof.
    """
    if drift.reaction is None or not problem.affine:
        drift.reaction = problem.law.row_sums()
    data, level, V = problem.data, problem.level, problem.level.V
    at = corners(level.mesh)[: own_cells(level.mesh)]
    dim = level.mesh.topology.dim
    dofs = np.asarray(V.dofmap.index_map.local_to_global(releases.cell_dofs(V)[: len(at), : at.shape[1]].ravel()))
    dofs = dofs.reshape(at.shape[:2]).astype(PETSc.IntType)  # of vertices, which are first
    size = cell_volumes(level.mesh, slice(len(at)))
    # means of the data in the cells
    mu = _of_cells(data, data.model.elastic.stiffness(data)).mean(axis=1)  # type: ignore[arg-type]
    flow = [_of_cells(data, data.values(part)).mean(axis=1) for part in drift.velocity]
    pairs = list(combinations(range(at.shape[1]), 2))
    parts = np.zeros((*at.shape[:2], at.shape[1]))  # the matrix of each cell
    for i, j in pairs:
        edge = at[:, j] - at[:, i]
        work = sum(b * edge[:, axis] for axis, b in enumerate(flow)) / mu
        weight = mu * size * dim / (np.einsum("ci,ci->c", edge, edge) * len(pairs))
        for one, other, way in ((i, j, work), (j, i, -work)):
            entry = weight * _bernoulli(way)
            parts[:, one, one] += entry
            parts[:, one, other] -= entry
    A = problem.A.duplicate()
    A.setValuesRCV(dofs, dofs, parts, addv=PETSc.InsertMode.ADD)
    A.assemble()
    first, own = V.dofmap.index_map.local_range[0], level.owned
    numbers = np.arange(first, first + own, dtype=PETSc.IntType)
    x, b = A.createVecs()
    x.array[:] = np.maximum(drift.reaction, 0.0)
    A.setDiagonal(x, addv=PETSc.InsertMode.ADD)
    x.set(0.0)
    b.setValues(dofs.ravel(), np.repeat(size / at.shape[1], at.shape[1]), addv=PETSc.InsertMode.ADD)
    b.assemble()
    empty = b.array_r == 0  # dofs that are no vertices
    A.zeroRowsColumns(numbers[held | empty], 1.0)
    b.array[held | empty] = 0.0
    found = None
    if solved(level.dofs, A, b, x):
        # with exponentials beyond the range of numbers x is not positive, as the solution is
        lost = total(level.comm, np.count_nonzero(~(x.array_r[~(held | empty)] > 0)))
        found = np.inf if lost > 0 else largest(level.comm, x.array_r)
    for owner in (A, x, b):
        owner.destroy()
    return found


def _speeds(data: Data, velocity: Velocity) -> np.ndarray:
    return np.sqrt(sum(_of_cells(data, data.values(part)) ** 2 for part in velocity))


def _of_cells(data: Data, values: np.ndarray) -> np.ndarray:
    """Values at local dofs of W, or the one there is, in owned cells, shape (cells or 1, dofs of W in a cell or 1)."""
    if len(values) == 1:
        return values[:, None]
    return values[releases.cell_dofs(data.level.W)[: own_cells(data.level.mesh)]]


def _bernoulli(d: np.ndarray) -> np.ndarray:
    """d/(e^d - 1)."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.where(np.abs(d) < 1e-8, 1 - d / 2, d / np.expm1(d))


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
    longest = _crossings(problem, drift, residence_time(problem, drift, problem.fixed))
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
        longest = _crossings(problem, drift, residence_time(problem, drift, held))
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


def _crossings(problem: MeshSystem, drift: Drift, time: float | None) -> float:
    """A time over that in which the drift crosses the domain; infinite, or unknown and 0, if its system was not solved
    (collective)."""
    if time is None:
        return np.inf if problem.level.dofs <= LARGEST else 0.0
    speed = largest(problem.comm, _speeds(problem.data, drift.velocity).ravel())
    return time * speed / problem.data.extent

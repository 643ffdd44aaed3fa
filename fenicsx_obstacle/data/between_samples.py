"""Search for points between the samples at which a datum is not admissible.

Forms take one value per cell. A spot that no midpoint meets, such as `where(hypot(x - 0.503, y) < 0.004, -1, 1)`, does
not enter them; the datum is wrong all the same. So data are evaluated at the nodes as well, and at points that a
search finds: it follows the datum downwards, and each of its conditions to where it holds and to where it does not.
Matrices are checked in cells, and by the same search between the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.samples import Samples
from fenicsx_obstacle.effects.field import Field, Rows
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.points import locate
from fenicsx_obstacle.parallel import largest, smallest
from fenicsx_obstacle.text import counted

ROUND_OFF = 1e-8  # of the largest value: what is below zero by round-off
ROUND_OFF_OF_ENTRIES = 1e-10  # of the entries of a matrix
SINGULAR = 1e-14  # of the largest eigenvalue: a smaller one is round-off
STARTS = 6  # points that a search begins with
STEPS = 24  # a step is halved where it leads no further: 24 halvings reach 1e-7 of the first
CANDIDATES = 50  # points at which the worst values are looked for in the mesh

Quantity = Callable[[np.ndarray], np.ndarray]


def inadmissible(
    data: Samples, fields: Sequence[Field], quantity: Quantity, bound: float, material: str | None = None
) -> tuple[float, np.ndarray] | None:
    """A point of the mesh where a quantity made of data is below a bound, and its value there (collective).

    Args:
        data: What samples them.
        fields: What it is made of.
        quantity: Of points (3, n).
        bound: Its least value.
        material: Name of the cells that count, if it is not all.

    Returns:
        The value and the point, the same on every rank; None where none is found.
    """
    level = data.level
    nodes = level.points
    if material is not None:
        nodes = nodes[:, np.unique(releases.cell_dofs(level.V)[level.groups[material]])]
    values = _finite(quantity(nodes))
    scale = largest(level.comm, np.abs(values[np.isfinite(values)]))
    limit = bound - ROUND_OFF * max(scale, float(np.finfo(float).tiny))
    points = _first(data, nodes, values < limit)
    seekable = all(field.everywhere for field in fields) and level.mesh.topology.dim == level.mesh.geometry.dim
    if len(points) == 0 and seekable:
        points = _sought(data, fields, quantity, nodes, limit)
    if len(points) == 0:
        return None
    inside = _inside(data, points, material)
    found = quantity(points.T)
    return None if len(inside) == 0 else (float(found[inside[0]]), points[inside[0]])


def _inside(data: Samples, points: np.ndarray, material: str | None) -> np.ndarray:
    """Rows of the points (n, 3) that are in the mesh, or in cells of a material (collective)."""
    level = data.level
    if releases.cell_name(level.mesh) not in SIMPLICES:  # rectangles and boxes
        low, high = level.box
        return np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))
    rows, cells, _ = locate(level, points)
    if material is not None:
        rows = rows[np.isin(cells, level.groups[material])]
    return np.unique(np.concatenate(level.comm.allgather(rows)))


def _first(data: Samples, nodes: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """The first of the bad nodes of all ranks, by coordinates, shape (0 or 1, 3) (collective)."""
    some = np.concatenate(data.level.comm.allgather(nodes[:, bad].T[:1]))
    return some[np.lexsort(some.T[::-1])[:1]]


def _sought(data: Samples, fields: Sequence[Field], quantity: Quantity, nodes: np.ndarray, limit: float) -> np.ndarray:
    """Points with values below the limit, the worst first, that a compass search comes to (collective).

    Every rank searches the same way, from the best nodes of all ranks.
    """

    def goals(x: np.ndarray) -> np.ndarray:
        """What the searches maximise, shape (searches, n)."""
        conditions = [margin for field in fields for margin in field.margins(x, data.names(field))]
        return _finite(np.stack([-quantity(x), *conditions, *(-margin for margin in conditions)]), -np.inf)

    comm, dim = data.level.comm, data.level.mesh.geometry.dim
    reached = goals(nodes)
    best = np.argsort(-reached, axis=1, kind="stable")[:, :STARTS]
    starts = comm.allgather([(reached[k, row], nodes[:, row].T) for k, row in enumerate(best)])
    at, value, goal = [], [], []
    for k in range(len(reached)):
        high = np.concatenate([one[k][0] for one in starts])
        where = np.concatenate([one[k][1] for one in starts])
        order = np.lexsort((*where.T[::-1], -high))[:STARTS]
        at.append(where[order])
        value.append(high[order])
        goal.append(np.full(len(order), k))
    point, height, aim = np.concatenate(at).T, np.concatenate(value), np.concatenate(goal)
    step = np.full(len(aim), data.level.h_max)
    compass = np.concatenate([np.eye(3)[:dim], -np.eye(3)[:dim]])
    seen = [np.empty((0, 4))]
    for _ in range(STEPS):
        trials = point[:, :, None] + step[:, None] * compass.T[:, None, :]
        flat = trials.reshape(3, -1)
        result = goals(flat).reshape(len(reached), len(aim), -1)
        bad = result[0].ravel() > -limit
        seen.append(np.column_stack([flat.T[bad], result[0].ravel()[bad]]))
        of_aim = result[aim, np.arange(len(aim))]
        choice = of_aim.argmax(axis=1)
        higher = of_aim.max(axis=1) > height
        point[:, higher] = trials[:, higher, choice[higher]]
        height[higher] = of_aim.max(axis=1)[higher]
        step[~higher] /= 2
    found = np.concatenate(seen)
    return found[np.lexsort((*found.T[2::-1], -found[:, 3]))[:CANDIDATES], :3]


def _finite(values: np.ndarray, instead: float = np.inf) -> np.ndarray:
    return np.where(np.isfinite(values), values, instead)


def check_definite(level: Level, rows: Rows, matrices: np.ndarray) -> None:
    """Reject a matrix that is not symmetric and positive definite in all cells (collective).

    Args:
        level: The mesh.
        rows: The matrix.
        matrices: Its values in cells, shape (cells or 1, rows, rows).

    Raises:
        InputError: Naming where it stands.
    """
    place, comm, dim = rows[0][0].source.partition("[0]")[0], level.comm, level.mesh.geometry.dim
    if len(rows) != dim:
        raise InputError(f"{place}: a matrix of {len(rows)} rows, but points have {counted(dim, 'coordinate')}")
    skew = np.abs(matrices - matrices.transpose(0, 2, 1))
    if largest(comm, skew) > ROUND_OFF_OF_ENTRIES * largest(comm, np.abs(matrices)):
        raise InputError(f"{place}: is not symmetric; entries differ by {largest(comm, skew):.3g}")
    eigenvalues = np.linalg.eigvalsh((matrices + matrices.transpose(0, 2, 1)) / 2)
    if smallest(comm, eigenvalues[:, 0] - SINGULAR * eigenvalues[:, -1]) <= 0:
        least = smallest(comm, eigenvalues)
        raise InputError(f"{place}: must be positive definite; its least eigenvalue is {least:.3g}")


def check_between(data: Samples, rows: Rows) -> None:
    """Reject a matrix that is indefinite at a point between the samples (collective).

    Raises:
        InputError: Naming the place.
    """
    entries = [entry for row in rows for entry in row if not entry.uniform]
    if not entries:
        return

    def least(x: np.ndarray) -> np.ndarray:
        values = np.stack([data.at(entry, x) for row in rows for entry in row], axis=1)
        matrices = values.reshape(-1, len(rows), len(rows))
        finite = np.isfinite(matrices).all(axis=(1, 2))
        found = np.full(len(matrices), np.inf)
        found[finite] = np.linalg.eigvalsh((matrices + matrices.transpose(0, 2, 1))[finite] / 2)[:, 0]
        return found

    found = inadmissible(data, entries, least, 0.0)
    if found is not None:
        place = rows[0][0].source.partition("[0]")[0]
        raise InputError(
            f"{place}: must be positive definite; its least eigenvalue is {found[0]:.3g} at {data.place(found[1])}"
        )

"""Matrix-valued data, sampled in cells and checked."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.samples import Samples
from fenicsx_obstacle.discrete.sampling_check import inadmissible
from fenicsx_obstacle.effects.field import Rows
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest
from fenicsx_obstacle.text import counted

ROUND_OFF = 1e-10  # of the entries


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
    if largest(comm, skew) > ROUND_OFF * largest(comm, np.abs(matrices)):
        raise InputError(f"{place}: is not symmetric; entries differ by {largest(comm, skew):.3g}")
    least = smallest(comm, np.linalg.eigvalsh((matrices + matrices.transpose(0, 2, 1)) / 2))
    if least <= 0:
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

"""Weights D_i of pairs that define them cell by cell, such as Voronoi areas."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners, own_cells
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.parallel import smallest


def weights_of_cells(pair: Pair, V: fem.FunctionSpace) -> np.ndarray:
    """D_i at owned dofs of V_h (collective).

    Args:
        pair: With `own_weights`.
        V: Its P1 space.

    Raises:
        InputError: If one is not positive, against (3.6).
    """
    mesh = V.mesh
    parts = pair.cell_weights(corners(mesh, slice(own_cells(mesh))))
    D = fem.Function(V)
    np.add.at(D.x.array, releases.cell_dofs(V)[: len(parts)].ravel(), parts.ravel())
    releases.add_ghosts(D)
    weights = D.x.array[: V.dofmap.index_map.size_local].copy()
    if smallest(mesh.comm, weights) <= 0:
        raise InputError(f"element {pair.name}: {pair.not_positive} (3.6)")
    return weights

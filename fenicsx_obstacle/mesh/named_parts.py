"""Named parts of a mesh as arrays for files, independent of ranks and of DOLFINx's numbering.

A part is given by the vertices of its facets, or by the numbers of its cells. `names` says in JSON, for each of the
other arrays, which are called "0", "1" and so on, whether it holds facets or cells, and of which part.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.mesh.cells import cell_facets, facet_corners, given_cells, own_cells, sides
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import before, gathered

Groups = dict[str, np.ndarray]


def parts_of(level: Level, nodes: np.ndarray) -> Groups:
    """The named parts of a mesh that is no shape, on rank 0; empty elsewhere, and where there are none (collective).

    Args:
        level: Mesh.
        nodes: Numbers of the vertices of each owned cell in the file, and maybe of other nodes after them, shape
            (cells, nodes). Cells are numbered in the order of ranks.
    """
    if level.shape is not None or not (level.facets or level.groups):
        return {}
    comm, first = level.comm, before(level.comm, own_cells(level.mesh))
    members = np.array(facet_corners(level.mesh))
    kinds, found = [], []
    for name, facets in level.facets.items():
        cells, numbers, _ = sides(level.mesh, facets)
        kinds.append(["facets", name])
        found.append(gathered(comm, np.sort(nodes[cells[:, None], members[numbers]], axis=1)))
    for name, cells in level.groups.items():
        kinds.append(["cells", name])
        found.append(gathered(comm, first + cells))
    if comm.rank != 0:
        return {}
    # a facet inside the domain has two sides
    arrays = {str(k): np.unique(values, axis=0) for k, values in enumerate(found) if values is not None}
    return {"names": np.array(json.dumps(kinds).encode()), **arrays}


def named(mesh: dmesh.Mesh, arrays: Mapping[str, np.ndarray]) -> tuple[Groups, Groups]:
    """Local facets and owned cells of each named part (local).

    Args:
        mesh: Made of the vertices and cells that the arrays number.
        arrays: What `parts_of` returned, the same on every rank.

    Raises:
        LookupError, ValueError: If an array is missing, or of another kind.
    """
    facets, groups = Groups(), Groups()
    cells = given_cells(mesh)
    for k, (kind, name) in enumerate(json.loads(arrays["names"].item()) if arrays else []):
        if kind == "facets":
            there = local_facets(mesh, arrays[str(k)])
            facets[name] = np.unique(there[there >= 0])
        else:
            groups[name] = np.flatnonzero(np.isin(cells, arrays[str(k)])).astype(np.int32)
    return facets, groups


def local_facets(mesh: dmesh.Mesh, facets: np.ndarray) -> np.ndarray:
    """Local number of each facet given by vertices of the input, shape (n, vertices); -1 where this rank has it not."""
    inputs = np.asarray(mesh.geometry.input_global_indices)
    marked = np.isin(inputs, facets)
    corners, table = releases.geometry_dofs(mesh), cell_facets(mesh)
    known: dict[tuple[int, ...], int] = {}
    for number, members in enumerate(facet_corners(mesh)):
        side = corners[:, members]
        cells = np.flatnonzero(marked[side].all(axis=1))
        keys = np.sort(inputs[side[cells]], axis=1).tolist()
        known.update(zip(map(tuple, keys), table[cells, number].tolist(), strict=True))
    found = [known.get(tuple(row), -1) for row in np.sort(facets, axis=1).tolist()]
    return np.array(found, dtype=np.int32)

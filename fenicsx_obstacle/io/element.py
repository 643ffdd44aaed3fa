"""The finite element functions of a saved solution, in a form that depends neither on ranks nor on DOLFINx's numbering.

On P1 simplices the nodal values of fields.h5 are all there is. For other elements that file holds the nodal values on
cut cells, as ParaView draws them; the group `element` says which of these nodes each cell has, and holds the fields of
Q_h where they are not nodal, cell by cell.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.scalar import Fields
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.io.paraview import BY_CELL, SIMPLEX, to_hdf5, xdmf_mesh
from fenicsx_obstacle.io.rows import Rows
from fenicsx_obstacle.io.validation import VERTICES, share
from fenicsx_obstacle.mesh.cells import given_cells, own_cells
from fenicsx_obstacle.mesh.gmsh_model import AROUND
from fenicsx_obstacle.mesh.levels import Level, of_pair
from fenicsx_obstacle.mesh.named_parts import named
from fenicsx_obstacle.parallel import agree, gathered

OWN_MESH = ("element.xdmf", "element.h5")  # a mesh of the caller's own, where fields.xdmf has cut cells
OF_Q = ("pressure", "contact")  # fields of Q_h, the others are of V_h

Arrays = Mapping[str, np.ndarray]


def element_of(fields: Fields, nodes: np.ndarray | None) -> dict[str, Rows]:
    """The data from which the element of a solution is restored; empty for P1 simplices (collective).

    Args:
        fields: Of the solution.
        nodes: Rows of the nodal values of each owned cell in the order of its dofs; None for P1 simplices.

    Returns:
        `cells`, for each cell the rows of the nodal values in the order of its dofs; and by its name each field of Q_h
        that is not nodal, shape (cells, dofs of a cell).
    """
    level = fields.level.scalar
    if nodes is None:
        return {}
    own = own_cells(level.mesh)
    parts = {"cells": nodes}
    for name, function in {**fields.functions(), **fields.by_cell()}.items():
        space = function.function_space
        if space != level.V:
            parts[name] = function.x.array[releases.cell_dofs(space)[:own]].real
    return {name: Rows.of(level.comm, values) for name, values in parts.items()}


def own_mesh(level: Level, points: Rows, cells: Rows, parts: Arrays) -> dict[str, bytes]:
    """The files `OWN_MESH`, on rank 0: a mesh without the nodes between its vertices (collective).

    Args:
        level: The mesh.
        points: Coordinates of all nodes, shape (n, 3).
        cells: Those of `element_of`.
        parts: The named parts of the mesh, on rank 0.
    """
    places, nodes = gathered(level.comm, points.mine[:, : level.mesh.geometry.dim]), gathered(level.comm, cells.mine)
    if places is None or nodes is None:
        return {}
    cell = releases.cell_name(level.mesh)
    used, vertices = _vertices(nodes, cell)
    vertices = vertices[:, AROUND.get(cell, slice(None))]
    text = xdmf_mesh(OWN_MESH[1], places[used], vertices, cell)
    named_parts = {f"parts/{name}": values for name, values in _renumbered(parts, used).items()}
    arrays = {"points": places[used], "cells": vertices, **named_parts}
    return dict(zip(OWN_MESH, (text.encode(), to_hdf5(arrays)), strict=True))


def mesh_of(arrays: Arrays, element: Arrays, parts: Arrays, h: float, comm: MPI.Comm, pair: Pair) -> Level:
    """The mesh of a saved solution with the spaces of its pair, and with its named parts (collective).

    Args:
        arrays: Those of fields.h5, the same on every rank, which reads its share of them.
        element: Those of its group `element`; none of P1 simplices.
        parts: Those of its group `parts`, or `element/parts`; none where no part has a name.
        h: Mesh size.
        comm: Communicator.
        pair: V_h, the rule I and Q_h.
    """
    points, cells = arrays["points"], arrays["cells"]
    cell = SIMPLEX[cells.shape[1]]
    if element:
        cell = element["cell"].item().decode()
        used, cells = _vertices(element["cells"], cell)
        points, parts = points[used], _renumbered(parts, used)
    gdim = int(arrays["gdim"])
    mesh = releases.create_mesh(comm, cells[share(comm, len(cells))], points[share(comm, len(points)), :gdim], cell)
    return of_pair(Level(mesh, h, *named(mesh, parts)), pair)


def restored(level: Level, arrays: Arrays, element: Arrays) -> dict[str, fem.Function]:
    """The functions that were saved, on the mesh that was saved (collective).

    Raises:
        InputError: If the arrays are those of another element.
        LookupError, ValueError: If they do not fit the mesh.
    """
    functions = {name: fem.Function(_space(level, name)) for name in arrays}
    cells = given_cells(level.mesh)
    with agree(level.comm):
        for name, function in functions.items():
            dofs = releases.cell_dofs(function.function_space)[: len(cells)]
            if not element and name not in BY_CELL:
                # the coordinates of each dof when it was saved
                rows = np.asarray(level.mesh.geometry.input_global_indices, dtype=np.int64)
                function.x.array[:] = arrays[name][rows[releases.dof_nodes(level.V)]]
                continue
            if not element:
                values = arrays[name][cells][:, None]
            else:
                values = element[name][cells] if name in element else arrays[name][element["cells"][cells]]
            if values.shape[1] != dofs.shape[1]:
                found = f"has {values.shape[1]} values in a cell, and {level.pair.name} {dofs.shape[1]}"
                raise InputError(f"'{name}' {found}")
            function.x.array[dofs] = values
    for function in functions.values():
        function.x.scatter_forward()
    return functions


def _space(level: Level, name: str) -> fem.FunctionSpace:
    if name in BY_CELL:
        return releases.functionspace(level.mesh, "DG", 0)
    return level.Q if name in OF_Q else level.V


def _vertices(cells: np.ndarray, cell: str) -> tuple[np.ndarray, np.ndarray]:
    """The rows of nodes that are vertices, and the cells in terms of these; vertices are the first nodes of a cell."""
    nodes = cells[:, : VERTICES[cell]]
    used, numbers = np.unique(nodes, return_inverse=True)
    return used, numbers.reshape(nodes.shape)


def _renumbered(parts: Arrays, used: np.ndarray) -> Arrays:
    """Named parts in terms of the vertices alone, whose rows among all nodes are given; facets are tables."""
    return {name: np.searchsorted(used, values) if values.ndim == 2 else values for name, values in parts.items()}

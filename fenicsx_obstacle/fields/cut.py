"""The P1 interpolant of a solution on subdivided cells, which is drawn and saved.

Cells are cut along the lattice of their nodes, so that u keeps all its nodal values. Where pressures are constant on
cells the centres become nodes too, or a mean at the vertices would hide what differs from cell to cell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import cell_facets, given_cells, own_cells
from fenicsx_obstacle.mesh.halving import Numbers
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import before

_SIMPLEX = {1: "interval", 2: "triangle", 3: "tetrahedron"}
FAN = np.array([(0, 1, 4), (1, 3, 4), (3, 2, 4), (2, 0, 4)])  # a quadrilateral's triangles around its centre, node 4


@dataclass(frozen=True, eq=False)
class Cut:
    """Functions on cut cells.

    Attributes:
        level: The P1 simplices.
        functions: The functions there, by name.
        nodes: Global dof of `level` at each node of each owned cell, in DOLFINx's order of the dofs of V_h in a cell.
        parents: For each owned cell of `level` the local cell it was cut from.
    """

    level: Level
    functions: dict[str, fem.Function]
    nodes: np.ndarray
    parents: np.ndarray


@dataclass(frozen=True, eq=False)
class OnNodes:
    """Fields on P1 simplices whose nodes are the dofs of V_h: no mesh is made of them.

    Attributes:
        level: With V_h.
        nodes: Local dofs of each owned cell, in DOLFINx's order.
        cells: Local dofs of each owned simplex.
        fields: Values at local dofs.
    """

    level: Level
    nodes: np.ndarray
    cells: np.ndarray
    fields: dict[str, np.ndarray]


def global_dofs(level: Level, dofs: np.ndarray) -> np.ndarray:
    """Global numbers of local dofs of V_h, in 32 bits where their number allows it."""
    local = np.asarray(dofs, dtype=np.int32)
    if level.comm.size == 1:
        return local
    found = np.asarray(level.V.dofmap.index_map.local_to_global(local.ravel()))
    return found.astype(np.int32 if level.dofs <= np.iinfo(np.int32).max else np.int64).reshape(dofs.shape)


def on_nodes(level: Level, functions: Mapping[str, fem.Function]) -> OnNodes | None:
    """Scalar functions on simplices; None where these need other nodes than the dofs of V_h (collective)."""
    if level.scalar is not level or not level.pair.nodal:
        return None
    V, own = level.V, own_cells(level.mesh)
    dofs = releases.cell_dofs(V)[:own]
    pieces = np.arange(dofs.shape[1])[None] if level.pair.nested_hierarchy else _lattice(V, releases.cell_name(V.mesh))
    fields = {name: _nodal(level, function) for name, function in functions.items()}
    return OnNodes(level, dofs, dofs[:, pieces].reshape(-1, pieces.shape[1]), fields)


def _nodal(level: Level, function: fem.Function) -> np.ndarray:
    """Values at local dofs of V_h; where they differ from cell to cell the mean of the cells beside it (collective)."""
    space = function.function_space
    if space == level.V:
        return function.x.array
    given = function.x.array[releases.cell_dofs(space)[: own_cells(level.mesh)]]
    values = given @ _at_nodes(level).T
    around = AroundNodes(level.V, releases.cell_dofs(level.V)[: len(values)])
    found = around.sums(values) / around.sums(np.ones(values.shape))
    if level.pair.nodal and given.shape[1] == 3:  # between edges: the ends of those on the boundary belong to it alone
        outside = np.isin(cell_facets(level.mesh)[: len(values)], level.boundary_facets)
        ends = _at_nodes(level) > 0
        ends[given.shape[1] :] = False
        sums, counts = (around.sums((one * outside) @ ends.T.astype(float)) for one in (given, np.ones(given.shape)))
        found = np.where(counts > 0, sums / np.maximum(counts, 1.0), found)
    return found


def _at_nodes(level: Level) -> np.ndarray:
    """Weights of the dofs of Q_h in a cell in the value at each node of V_h, shape (nodes, dofs of Q_h); rows sum to
    1."""
    nodes, points = releases.cell_dofs(level.V).shape[1], releases.cell_dofs(level.Q).shape[1]
    if level.Q is level.V:
        return np.eye(nodes)
    if not level.pair.nodal:
        return np.ones((nodes, 1))
    # a vertex lies between the two edges that are not opposite to it
    return np.vstack([(1 - np.eye(points)) / (points - 1), np.eye(points)])


def cut(level: Level, functions: Mapping[str, fem.Function]) -> Cut:
    """Cut the cells of functions of another element, of scalar spaces (collective)."""
    mesh, comm = level.mesh, level.comm
    cell, dim, gdim = releases.cell_name(mesh), mesh.topology.dim, mesh.geometry.dim
    V, own, count = level.V, own_cells(mesh), level.owned
    centres = 0 if level.pair.nodal else own
    dofs = releases.cell_dofs(V)[:own]
    # points in the order of ranks, of each its nodes and then the centres of its cells
    first = before(comm, count + centres)
    nodes = Numbers.of(comm, V.dofmap.index_map).moved(np.array(comm.allgather(first)))[dofs]
    points = level.points.T[:count, :gdim]
    if centres:
        nodes = np.column_stack([nodes, first + count + np.arange(own)])
        points = np.vstack([points, level.points.T[dofs, :gdim].mean(axis=1)])
    pieces = FAN if centres else _lattice(V, cell)
    new = releases.create_mesh(comm, nodes[:, pieces].reshape(-1, dim + 1), points, _SIMPLEX[dim], stay=True)
    pieced = Level(new, level.h)
    start = before(comm, own * len(pieces))
    kept = given_cells(new) - start
    parents, corners = kept // len(pieces), pieces[kept % len(pieces)]
    targets = releases.cell_dofs(pieced.V)[: len(kept)]

    def moved(function: fem.Function) -> fem.Function:
        result, values = fem.Function(pieced.V), _nodal(level, function)[dofs]
        if centres:
            middle = function.x.array[releases.cell_dofs(function.function_space)[:own]].mean(axis=1)
            values = np.column_stack([values, middle])
        result.x.array[targets.ravel()] = np.take_along_axis(values[parents], corners, axis=1).ravel()
        result.x.scatter_forward()
        return result

    fields = {name: moved(function) for name, function in functions.items()}
    found = np.empty(nodes.shape, dtype=np.int64)
    found[parents[:, None], corners] = global_dofs(pieced, targets)
    return Cut(pieced, fields, found[:, : dofs.shape[1]], parents)


def _lattice(V: fem.FunctionSpace, cell: str) -> np.ndarray:
    """Simplices between the nodes of the reference cell, shape (simplices, dim + 1)."""
    degree = int(releases.called(V.ufl_element().degree))
    places = np.rint(np.asarray(releases.called(V.element.interpolation_points)) * degree).astype(int)
    if cell in SIMPLICES:  # a simplex is the part x_1 >= x_2 >= ... of a cube, in other coordinates of the same lattice
        places = np.cumsum(places[:, ::-1], axis=1)[:, ::-1]
    node = {tuple(place): number for number, place in enumerate(places.tolist())}
    dim = places.shape[1]
    found = []
    # each small cube is cut along the paths from its lowest to its highest corner
    for corner, order in product(product(range(degree), repeat=dim), permutations(range(dim))):
        path = [corner]
        for axis in order:
            path.append(tuple(x + (k == axis) for k, x in enumerate(path[-1])))
        if all(place in node for place in path):
            found.append([node[place] for place in path])
    return np.array(found)

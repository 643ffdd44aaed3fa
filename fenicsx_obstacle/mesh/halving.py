"""Uniform refinement of simplices as arrays.

A mesh whose edges are halved several times needs no DOLFINx meshes in between: nodes of the coarser grids and the
interpolation from them follow from the numbers of vertices, edges and cells alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.mesh.cells import cell_edges, given_cells, own_cells
from fenicsx_obstacle.mesh.shapes import Shape
from fenicsx_obstacle.mesh.shared_dofs import points_of_nodes
from fenicsx_obstacle.parallel import before
from fenicsx_obstacle.polynomials import CHILDREN, EDGES, RING


@dataclass(frozen=True, eq=False)
class Numbers:
    """Global numbers of local entities, the owned ones first; those of each rank follow those of the rank before.

    Attributes:
        values: Of each local entity.
        per_rank: How many each rank owns.
        rank: This one.
    """

    values: np.ndarray
    per_rank: np.ndarray
    rank: int

    @classmethod
    def of(cls, comm: MPI.Comm, numbering: Any) -> Numbers:
        """Those of an index map of DOLFINx (collective)."""
        local = np.arange(numbering.size_local + numbering.num_ghosts, dtype=np.int32)
        values = np.asarray(numbering.local_to_global(local), dtype=np.int64)
        return cls(values, np.array(comm.allgather(numbering.size_local)), comm.rank)

    @property
    def owned(self) -> int:
        """Number of owned entities."""
        return int(self.per_rank[self.rank])

    @property
    def first(self) -> np.ndarray:
        """The first number of each rank."""
        return np.cumsum(self.per_rank) - self.per_rank

    def moved(self, first: np.ndarray, times: int = 1) -> np.ndarray:
        """Numbers of entities that replace these, `times` for each, of which those of each rank begin at `first`."""
        # ranks that own none share their first number with the next: take the last
        rank = np.searchsorted(self.first, self.values, side="right") - 1
        return first[rank] + times * (self.values - self.first[rank])


@dataclass(frozen=True, eq=False)
class Grid:
    """A mesh of simplices as arrays: owned cells, and local vertices.

    Attributes:
        comm: Communicator.
        points: Coordinates of the vertices, shape (vertices, gdim).
        cells: Vertices of the cells, shape (cells, dim + 1).
        number: Of the vertices.
        places: Where in their parents the corners of the cells are: numbers of vertices and, after these, of edges.
            The children of a cell follow each other. None for cells without parents.
        ends: The two vertices of the coarser grid of which each vertex is the mean, shape (vertices, 2); None without
            one.
    """

    comm: MPI.Comm
    points: np.ndarray
    cells: np.ndarray
    number: Numbers
    places: np.ndarray | None = None
    ends: np.ndarray | None = None

    @property
    def dim(self) -> int:
        """Dimension of the cells."""
        return self.cells.shape[1] - 1

    def mesh(self) -> tuple[dmesh.Mesh, np.ndarray]:
        """The DOLFINx mesh, and of each of its owned cells the row in `cells`: they stay on their rank (collective)."""
        name, points = ("interval", "triangle", "tetrahedron")[self.dim - 1], self.points[: self.number.owned]
        made = releases.create_mesh(self.comm, self.number.values[self.cells], points, name, stay=True)
        rows = given_cells(made) - before(self.comm, len(self.cells))
        return made, rows.astype(np.int32)


@dataclass(frozen=True, eq=False)
class Edges:
    """Local edges of a grid.

    Attributes:
        ends: Their vertices, shape (edges, 2), those with the smaller global number first.
        of_cells: Edges of owned cells, in the order of `EDGES`.
        number: Of the edges.
        cells_per_rank: How many cells each rank owns.
    """

    ends: np.ndarray
    of_cells: np.ndarray
    number: Numbers
    cells_per_rank: np.ndarray


def halvings(V: fem.FunctionSpace, times: int, shape: Shape | None = None) -> list[Grid]:
    """The mesh of V with all edges halved, and halved again (collective).

    Triangles are cut into four of their own shape, so that a grid stays a grid; DOLFINx's own refinement bisects
    longest edges, which turns every other diagonal.

    Args:
        V: P1 on simplices.
        times: How often; once for tetrahedra.
        shape: Its domain; new vertices on a curved boundary are moved onto that.

    Returns:
        The grid after each halving.
    """
    grid, edges = _of_space(V)
    found = list[Grid]()
    for remaining in reversed(range(times)):
        finer, vertex, middle = _halved(grid, edges, shape)
        if remaining:
            edges = _halved_edges(grid, edges, vertex, middle, finer)
        grid = finer
        found.append(grid)
    return found


def _of_space(V: fem.FunctionSpace) -> tuple[Grid, Edges]:
    """The mesh of V as arrays; local vertices are the dofs (collective)."""
    mesh, dofs = V.mesh, releases.cell_dofs(V)
    comm, dim = mesh.comm, mesh.topology.dim
    of_cells, edges, own = cell_edges(mesh), mesh.topology.index_map(1), own_cells(mesh)
    ends = np.empty((edges.size_local + edges.num_ghosts, 2), dtype=np.int32)
    for side, corners in enumerate(EDGES[dim]):
        ends[of_cells[:, side]] = dofs[:, corners]
    number = Numbers.of(comm, V.dofmap.index_map)
    points = points_of_nodes(V)[:, : mesh.geometry.dim]
    return Grid(comm, points, dofs[:own], number), Edges(
        _sorted(ends, number), of_cells[:own], Numbers.of(comm, edges), np.array(comm.allgather(own))
    )


def _sorted(ends: np.ndarray, number: Numbers) -> np.ndarray:
    """Ends of edges in the order of their global numbers, on all ranks alike."""
    turned = number.values[ends[:, 0]] > number.values[ends[:, 1]]
    ends[turned] = ends[turned][:, ::-1]
    return ends


def _halved(grid: Grid, edges: Edges, shape: Shape | None) -> tuple[Grid, np.ndarray, np.ndarray]:
    """The grid with all edges halved, and its numbers of the vertices and of the middles of the edges (collective)."""
    dim, own, own_edges = grid.dim, grid.number.owned, edges.number.owned
    # the owned vertices, the middles of the owned edges, and the ghosts of both
    vertex, middle = (np.arange(len(some), dtype=np.int32) for some in (grid.points, edges.ends))
    vertex[own:] += own_edges
    middle[own_edges:] += len(vertex)
    middle[:own_edges] += own
    per_rank = grid.number.per_rank + edges.number.per_rank
    number = Numbers(np.empty(len(vertex) + len(middle), dtype=np.int64), per_rank, grid.number.rank)
    number.values[vertex] = grid.number.moved(number.first)
    number.values[middle] = edges.number.moved(number.first + grid.number.per_rank)
    nodes, choices = np.hstack([vertex[grid.cells], middle[edges.of_cells]]), CHILDREN[dim]
    place = _by_appearance(nodes, number)
    nodes, vertex, middle = place[nodes], place[vertex], place[middle]
    if len(choices) == 1:
        cells, corners = np.empty((len(nodes), choices[0].size), dtype=np.int32), np.tile(choices[0], (len(nodes), 1))
        for column, node in enumerate(choices[0].ravel()):
            cells[:, column] = nodes[:, node]
    else:
        chosen = choices[_inner_diagonal(grid.points[grid.cells])]
        cells = np.take_along_axis(nodes, chosen.reshape(len(nodes), -1).astype(int), axis=1)
        corners = chosen.reshape(-1, dim + 1)
    middles = (grid.points[edges.ends[:, 0]] + grid.points[edges.ends[:, 1]]) / 2
    if shape is not None and shape.project is not None:
        outer = shape.on_curve(grid.points)[edges.ends].all(axis=1)  # of no cell all vertices are on the curve
        middles[outer] = shape.project(middles[outer])
    points, ends = np.empty((len(place), grid.points.shape[1])), np.empty((len(place), 2), dtype=np.int32)
    points[vertex], points[middle] = grid.points, middles
    ends[vertex], ends[middle] = np.arange(len(vertex), dtype=np.int32)[:, None], edges.ends
    number = _renumbered(grid.comm, number, place)
    return Grid(grid.comm, points, cells.reshape(-1, dim + 1), number, corners, ends), vertex, middle


def _by_appearance(nodes: np.ndarray, number: Numbers) -> np.ndarray:
    """New local numbers, in which owned vertices have the order in which cells name them: memory is read in order."""
    named, first = nodes.ravel(), np.empty(len(number.values), dtype=np.int32)
    first[named[::-1]] = np.arange(len(named) - 1, -1, -1, dtype=np.int32)
    place = np.arange(len(number.values), dtype=np.int32)
    place[np.argsort(first[: number.owned], kind="stable")] = place[: number.owned].copy()
    return place


def _renumbered(comm: MPI.Comm, number: Numbers, place: np.ndarray) -> Numbers:
    """Global numbers after each rank has given its vertices new local ones (collective)."""
    own, first = number.owned, number.first[number.rank]
    if comm.size == 1:
        return number
    ghosts = number.values[own:].astype(PETSc.IntType)
    moved = PETSc.Vec().createGhost(ghosts, (own, None), comm=comm)
    moved.array[:] = first + place[:own]
    moved.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
    with moved.localForm() as local:
        away = local.array_r[own:].astype(np.int64)
    moved.destroy()
    return Numbers(np.concatenate([first + np.arange(own), away]), number.per_rank, number.rank)


def _halved_edges(grid: Grid, edges: Edges, vertex: np.ndarray, middle: np.ndarray, finer: Grid) -> Edges:
    """The edges of the finer grid, of intervals or triangles: halves of owned edges, edges within owned cells, and
    halves of ghosts."""
    dim, number = grid.dim, edges.number
    within, own, cells = len(_WITHIN[dim]), number.owned, len(grid.cells)
    half = 2 * np.arange(len(edges.ends), dtype=np.int32)  # the first one of each edge
    half[own:] += within * cells
    inner = 2 * own + np.arange(within * cells, dtype=np.int32).reshape(cells, within)
    count = 2 * len(half) + within * cells
    ends, values = np.empty((count, 2), dtype=np.int32), np.empty(count, dtype=np.int64)
    per_rank = 2 * number.per_rank + within * edges.cells_per_rank
    numbers = Numbers(values, per_rank, number.rank)
    for side in (0, 1):
        ends[half + side, 0], ends[half + side, 1] = vertex[edges.ends[:, side]], middle
        values[half + side] = number.moved(numbers.first, 2) + side
    of_parents = edges.of_cells
    for k, sides in enumerate(_WITHIN[dim]):
        ends[inner[:, k]] = middle[of_parents[:, list(sides)]]
    values[inner] = numbers.first[number.rank] + inner
    of_cells = np.empty((cells, len(CHILDREN[dim][0]), len(EDGES[dim])), dtype=np.int32)
    for child, corners in enumerate(CHILDREN[dim][0]):
        for side, (i, j) in enumerate(EDGES[dim]):
            low, high = sorted((int(corners[i]), int(corners[j])))
            if low > dim:  # both are middles
                between = _WITHIN[dim].index((low - dim - 1, high - dim - 1))
                of_cells[:, child, side] = inner[:, between]
            else:  # the half of an edge at a vertex
                edge = of_parents[:, high - dim - 1]
                of_cells[:, child, side] = half[edge] + (edges.ends[edge, 1] == grid.cells[:, low])
    cells_per_rank = edges.cells_per_rank * len(CHILDREN[dim][0])
    return Edges(_sorted(ends, finer.number), of_cells.reshape(-1, len(EDGES[dim])), numbers, cells_per_rank)


# edges inside a halved cell, by the edges of the cell whose middles they connect
_WITHIN: dict[int, list[tuple[int, int]]] = {1: [], 2: [(1, 2), (0, 2), (0, 1)]}


def _inner_diagonal(corner: np.ndarray) -> np.ndarray:
    """Which of the three diagonals cuts the inner octahedron of each tetrahedron, by its place in `RING[3]`.

    The shortest; of two alike the one along the longest edge: then the six tetrahedra of a cube become those of its
    eight parts.
    """
    ends = [[(corner[:, i] + corner[:, j]) / 2 for i, j in (EDGES[3][m - 4] for m in pair)] for pair in RING[3]]
    edges = np.stack([corner[:, j] - corner[:, i] for i, j in EDGES[3]], axis=1)
    longest = edges[np.arange(len(edges)), (edges**2).sum(axis=2).argmax(axis=1)]
    score = []
    for a, b in ends:
        along = np.abs(((a - b) * longest).sum(axis=1))
        score.append(((a - b) ** 2).sum(axis=1) - 1e-6 * along)
    return np.argmin(score, axis=0)

"""Meshes: built from a scene, refined, and how a fine one hangs on the coarse one it came from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from math import factorial

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete import files
from fenicsx_obstacle.discrete.cells import barycentric, cell_facets, corners, facet_vertices, volumes
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import before, largest
from fenicsx_obstacle.scenes import shapes
from fenicsx_obstacle.scenes.scene import Scene

BYTES_PER_VERTEX = {1: 400, 2: 900, 3: 2500}  # of a solve with AMG, measured


@dataclass(frozen=True, eq=False)
class Level:
    """A mesh with its nodal space, and what is known of its boundary.

    Attributes:
        mesh: Simplices.
        V: Continuous P1 functions, the paper's V_h without boundary values.
        h: Side of the grid for shapes, largest sqrt(2|T|) or (6|T|)^(1/3) for other meshes.
        facets: Local facets of each named part of the boundary, or curve (in solids, surface) inside.
        groups: Owned cells of each named material.
        shape: The recipe, for shapes.
        coarse: The level it was refined from.
        ends: For each owned dof the two local dofs of `coarse` of which it is the mean: the ends of the edge it
            halves, or twice the vertex it coincides with; shape (owned dofs, 2).
    """

    mesh: dmesh.Mesh
    V: fem.FunctionSpace
    h: float
    facets: dict[str, np.ndarray]
    groups: dict[str, np.ndarray] = field(default_factory=dict)
    shape: shapes.Shape | None = None
    coarse: Level | None = None
    ends: np.ndarray | None = None

    @property
    def comm(self) -> MPI.Comm:
        return self.mesh.comm

    @property
    def owned(self) -> int:
        """Number of owned dofs."""
        return self.V.dofmap.index_map.size_local

    @property
    def dofs(self) -> int:
        """Number of dofs on all ranks."""
        return self.V.dofmap.index_map.size_global

    @property
    def cells(self) -> int:
        """Number of cells on all ranks."""
        return self.mesh.topology.index_map(self.mesh.topology.dim).size_global

    @cached_property
    def W(self) -> fem.FunctionSpace:
        """One value per cell, for tension and load (first use is collective)."""
        return releases.functionspace(self.mesh, "DG", 0)

    @cached_property
    def h_max(self) -> float:
        """Longest edge (first use is collective)."""
        x = corners(self.mesh)
        edges = [x[:, i] - x[:, j] for i, j in combinations(range(x.shape[1]), 2)]
        return largest(self.comm, [np.linalg.norm(edge, axis=1).max(initial=0.0) for edge in edges])

    def indicator(self, name: str) -> np.ndarray:
        """Whether each local dof of W belongs to a cell of a named material, ghosts included (collective)."""
        inside = fem.Function(self.W)
        inside.x.array[releases.cell_dofs(self.W)[self.groups[name], 0]] = 1.0
        inside.x.scatter_forward()
        return inside.x.array > 0.5

    @cached_property
    def boundary_facets(self) -> np.ndarray:
        """Local facets on the boundary of the domain."""
        return np.asarray(dmesh.exterior_facet_indices(self.mesh.topology), dtype=np.int32)


def build(scene: Scene, comm: MPI.Comm) -> Level:
    """The scene's mesh, refined as often as it says (collective).

    Raises:
        InputError: If the mesh needs more memory than there is, or its file cannot be read.
    """
    table = scene.tables.mesh
    if scene.mesh is not None:
        level = _level(releases.settle(scene.mesh))
    elif table.file is not None:
        level = _level(*files.read(scene.folder / table.file, comm))
    else:
        level = _from_shape(_shape(scene), table.refine, comm)
    for _ in range(table.refine):
        level = refined(level)
    return level


def refined(level: Level) -> Level:
    """The level with every edge halved, each cell staying on its rank (collective)."""
    mesh = level.mesh
    interval = mesh.topology.dim == 1
    new, parents = _halved(level) if interval else releases.refine(mesh)
    V = releases.functionspace(new, "Lagrange", 1)
    weights = barycentric(corners(new)[: len(parents)], corners(mesh)[parents])
    ends = np.empty((V.dofmap.index_map.size_local, 2), dtype=np.int32)
    dofs, parent_dofs = releases.cell_dofs(V)[: len(parents)], releases.cell_dofs(level.V)[parents]
    for vertex in range(dofs.shape[1]):
        own = dofs[:, vertex] < len(ends)
        # weights are 1 at one end, or 1/2 at two: the first and the last that is not zero
        touched = weights[:, vertex] > 0.25
        first, last = touched.argmax(axis=1), touched.shape[1] - 1 - touched[:, ::-1].argmax(axis=1)
        cell = np.flatnonzero(own)
        ends[dofs[own, vertex], 0] = parent_dofs[cell, first[own]]
        ends[dofs[own, vertex], 1] = parent_dofs[cell, last[own]]
    shape, facets = level.shape, _inherited(level, new, parents, weights)
    if shape is not None and shape.project is not None:
        _snap(V, dmesh.exterior_facet_indices(new.topology), shape.project)
    groups = {name: np.flatnonzero(np.isin(parents, cells)) for name, cells in level.groups.items()}
    return Level(new, V, level.h / 2, facets, groups, shape, level, ends)


def _shape(scene: Scene) -> shapes.Shape:
    table = scene.tables.mesh

    def corner(axis: str) -> tuple[float, float]:
        a, b = (scene.number(value, f"[mesh] {axis}") for value in getattr(table, axis))
        if not a < b:
            raise InputError(
                f"{scene.source}: [mesh] {axis} = [{a:g}, {b:g}]: the first end must be less than the second"
            )
        return a, b

    match table.shape:
        case "interval":
            return shapes.box("interval", [corner("x")], table.cells)
        case "rectangle":
            return shapes.box("triangle", [corner("x"), corner("y")], table.cells, table.diagonal)
        case "box":
            return shapes.box("tetrahedron", [corner("x"), corner("y"), corner("z")], table.cells)
        case "l-shape":
            return shapes.l_shape([corner("x"), corner("y")], table.cells)
    radius = scene.number(table.radius, "[mesh] radius")
    if radius <= 0:
        raise InputError(f"{scene.source}: [mesh] radius = {radius:g}: must be positive")
    return shapes.disk(radius, table.cells)


def _from_shape(shape: shapes.Shape, refine: int, comm: MPI.Comm) -> Level:
    dim = len(shape.cells)
    needed = shape.vertices * 2.0 ** (dim * refine) * BYTES_PER_VERTEX[dim]
    free = _free_memory()
    if needed > free or shape.vertices * 6 > 2**31:
        raise InputError(
            f"[mesh] cells = {shape.cells[0]}, refine = {refine}: needs about {needed / 1e9:.3g} GB of memory, "
            f"{free / 1e9:.3g} GB are free; take fewer cells"
        )
    if shape.arrays is not None:
        points, cells = shape.arrays() if comm.rank == 0 else (np.empty((0, dim)), np.empty((0, dim + 1), np.int64))
        mesh = releases.create_mesh(comm, cells, points, shape.cell)
    else:
        ghosts = {"ghost_mode": releases.FACET_GHOSTS}
        ends = [np.array(shape.lower), np.array(shape.upper)]
        if dim == 1:
            mesh = dmesh.create_interval(comm, shape.cells[0], [shape.lower[0], shape.upper[0]], **ghosts)
        elif dim == 2:
            kind = releases.diagonal({"union-jack": "right_left"}.get(shape.diagonal, shape.diagonal))
            mesh = dmesh.create_rectangle(comm, ends, list(shape.cells), diagonal=kind, **ghosts)
        else:
            mesh = dmesh.create_box(comm, ends, list(shape.cells), **ghosts)
        mesh = releases.settle(mesh)
    V = releases.functionspace(mesh, "Lagrange", 1)
    return Level(mesh, V, shape.h, _named(mesh, shape), shape=shape)


def _level(
    mesh: dmesh.Mesh, facets: dict[str, np.ndarray] | None = None, groups: dict[str, np.ndarray] | None = None
) -> Level:
    """A mesh that is not one of our shapes: h from the volumes of its cells."""
    dim, cell = mesh.topology.dim, releases.cell_name(mesh)
    if cell not in ("interval", "triangle", "tetrahedron"):
        raise InputError(f"the mesh has {cell} cells; P1 needs intervals, triangles or tetrahedra")
    h = largest(mesh.comm, (factorial(dim) * volumes(corners(mesh))) ** (1 / dim))
    return Level(mesh, releases.functionspace(mesh, "Lagrange", 1), h, facets or {}, groups or {})


def _halved(level: Level) -> tuple[dmesh.Mesh, np.ndarray]:
    """Refined interval: DOLFINx refines intervals only from 0.9 on."""
    mesh, owned = level.mesh, level.owned
    own_cells = mesh.topology.index_map(1).size_local
    dofs = releases.cell_dofs(level.V)
    first = before(level.comm, owned + own_cells)
    number = fem.Function(level.V)  # of each vertex among the new points; ghosts learn theirs from the owner
    number.x.array[:owned] = first + np.arange(owned)
    number.x.scatter_forward()
    ends = number.x.array[dofs[:own_cells]].real.astype(np.int64)
    middle = first + owned + np.arange(own_cells)
    cells = np.column_stack([ends[:, 0], middle, middle, ends[:, 1]]).reshape(-1, 2)
    gdim = mesh.geometry.dim
    points = np.vstack([level.V.tabulate_dof_coordinates()[:owned], corners(mesh)[:own_cells].mean(axis=1)])[:, :gdim]
    new = releases.create_mesh(level.comm, cells, points, "interval", stay=True)
    start = before(level.comm, len(cells))
    own = new.topology.index_map(1).size_local
    return new, (np.asarray(new.topology.original_cell_index)[:own] - start) // 2


def _named(mesh: dmesh.Mesh, shape: shapes.Shape) -> dict[str, np.ndarray]:
    dim = mesh.topology.dim - 1
    return {name: dmesh.locate_entities_boundary(mesh, dim, marker) for name, marker in shape.sides.items()}


def _snap(V: fem.FunctionSpace, facets: np.ndarray, project: Callable[[np.ndarray], np.ndarray]) -> None:
    """Move new boundary vertices onto the curved boundary: a refined polygon never becomes a circle."""
    mesh = V.mesh
    dofs = fem.locate_dofs_topological(V, mesh.topology.dim - 1, facets)
    nodes, gdim = releases.dof_nodes(V)[dofs], mesh.geometry.dim
    mesh.geometry.x[nodes, :gdim] = project(mesh.geometry.x[nodes, :gdim])


def _inherited(level: Level, new: dmesh.Mesh, parents: np.ndarray, weights: np.ndarray) -> dict[str, np.ndarray]:
    """Named facets of a refined file: those that lie within a named facet of their parent cell."""
    dim = new.topology.dim
    members = facet_vertices(dim)
    old_facets, new_facets = cell_facets(level.mesh)[parents], cell_facets(new)[: len(parents)]
    found: dict[str, np.ndarray] = {}
    for name, named in level.facets.items():
        marked = np.isin(old_facets, named)
        inside = []
        for i, of_new in enumerate(members):
            for k, of_old in enumerate(members):
                outside = [j for j in range(dim + 1) if j not in of_old]
                on_old = np.all(weights[:, of_new][:, :, outside] < 0.25, axis=(1, 2))
                inside.append(new_facets[on_old & marked[:, k], i])
        found[name] = np.unique(np.concatenate(inside)).astype(np.int32)
    return found


def _free_memory() -> float:
    """Bytes that a new process could have."""
    with open("/proc/meminfo") as file:
        lines = dict(line.split(":") for line in file)
    return 1024.0 * float(lines["MemAvailable"].split()[0])

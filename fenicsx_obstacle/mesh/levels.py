"""Levels: meshes with their spaces, and refined meshes with the levels that they come from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import factorial
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import P1, SIMPLICES, Pair, pairs
from fenicsx_obstacle.mesh import bisection, parents
from fenicsx_obstacle.mesh.cells import cell_volumes, corners, edge_lengths, own_cells
from fenicsx_obstacle.mesh.checks import Components, check_degree, check_mesh, components
from fenicsx_obstacle.mesh.halving import Grid, halvings
from fenicsx_obstacle.mesh.parents import Name
from fenicsx_obstacle.mesh.reference_cell import lagrange_degree
from fenicsx_obstacle.mesh.shapes import Shape
from fenicsx_obstacle.mesh.shared_dofs import points_of_nodes
from fenicsx_obstacle.parallel import largest, smallest

AT_ONCE = 50_000  # cells in memory
INWARD = 1e-6  # of the way to the middle of the cell


@dataclass(frozen=True, eq=False)
class Level:
    """A mesh with its spaces and named parts, which are created on first use.

    Attributes:
        mesh: Cells of one kind.
        h: Side of the grid for shapes, largest sqrt(2|T|) or (6|T|)^(1/3) for other meshes.
        facets: Local facets of each named part of the boundary, or curve (in solids, surface) inside.
        groups: Owned cells of each named material.
        shape: The recipe asked for, for shapes; `mesh` has a coarser grid where it is to be refined.
        pair: V_h, the rule I and Q_h.
        coarse: The level it was refined from; of P2 that of P1 on the same mesh.
        grids: Where all edges of `coarse` were halved several times: the grids between, which have no mesh, the coarser
            first.
        parents: For each owned cell the row of the last of `grids`, or else the local cell of `coarse`, it came from.
        places: Where in it the corners of the cell are.
        straight: Whether a mesh is from a file that says that all CAD curves are lines, and all surfaces planes.
        remarks: What the user should know of the mesh, in words.
        connected: Connected components of a mesh from a file or the caller; None where they are not known yet.
        bent: Local facets on each curve (in solids, surface) of a .geo or .step that is not straight, and on surfaces
            in space owned cells, by dimension and number in Gmsh.
        to_cad: Moves points to these, on one rank; None without them.
        vector: Whether functions of V have as many components as points have coordinates. Dofs are counted component by
            component; Q is scalar, of the same degree.
    """

    mesh: dmesh.Mesh
    h: float
    facets: dict[str, np.ndarray] = field(default_factory=dict)
    groups: dict[str, np.ndarray] = field(default_factory=dict)
    shape: Shape | None = None
    pair: Pair = P1
    coarse: Level | None = None
    grids: tuple[Grid, ...] = ()
    parents: np.ndarray | None = None
    places: np.ndarray | None = None
    straight: bool = False
    remarks: tuple[str, ...] = ()
    connected: Components | None = None
    bent: dict[tuple[int, int], np.ndarray] = field(default_factory=dict)
    to_cad: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None
    vector: bool = False

    @cached_property
    def V(self) -> fem.FunctionSpace:
        """Continuous functions, the paper's V_h without boundary values (first use is collective)."""
        components = self.mesh.geometry.dim if self.vector else None
        return releases.functionspace(self.mesh, "Lagrange", self.pair.degree, components)

    @cached_property
    def Q(self) -> fem.FunctionSpace:
        """Pressures, the paper's Q_h, whose nodes are the points of I (first use is collective)."""
        pressure = self.pair.pressure_on(releases.cell_name(self.mesh))
        same = pressure == ("Lagrange", self.pair.degree)
        return self.V if same and not self.vector else releases.functionspace(self.mesh, *pressure)

    @cached_property
    def points(self) -> np.ndarray:
        """Coordinates of the local dofs, shape (3, dofs) (first use is collective)."""
        nodes = points_of_nodes(self.V).T
        return np.repeat(nodes, self.components, axis=1) if self.vector else np.ascontiguousarray(nodes)

    @property
    def nodes(self) -> np.ndarray:
        """Coordinates of the local nodes, shape (3, nodes) (first use is collective)."""
        return self.points[:, :: self.components]

    def given(self, **known: Any) -> Level:
        """This level, with values in place of those that would be made on first use."""
        self.__dict__.update(known)
        return self

    def forget_points(self) -> None:
        """Free the coordinates, once data have been sampled; the next use, which is collective, makes them anew."""
        self.__dict__.pop("points", None)

    def points_of(self, V: fem.FunctionSpace) -> np.ndarray:
        """Points of the local dofs of a space on this mesh, shape (3, dofs); of W within its cells, where it jumps
        (collective)."""
        if V is self.V:
            return self.points
        points = np.array(V.tabulate_dof_coordinates().T)
        if V is self.W and self.pair.degree > 1:
            dofs = releases.cell_dofs(V)
            middle = corners(self.mesh).mean(axis=1).T[:, :, None]
            points[:, dofs] += INWARD * (middle - points[:, dofs])
        return points

    @cached_property
    def on_meshes(self) -> Level:
        """The same level above levels that all have a mesh (first use is collective)."""
        below = None if self.coarse is None else self.coarse.on_meshes
        if below is self.coarse and not self.grids:
            return self
        assert below is not None
        rows = np.arange(own_cells(below.mesh))  # local cells of `below` by rows of the last grid
        for grid in self.grids:
            mesh, kept = grid.mesh()
            assert grid.places is not None
            cells = rows[kept // 2**grid.dim].astype(np.int32)
            below = _above(below, mesh, below.h / 2, cells, grid.places[kept], below.pair)
            rows = np.empty(len(kept), dtype=np.int32)
            rows[kept] = np.arange(len(kept))
        mine = self.parents if self.parents is None or not self.grids else rows[self.parents]
        return replace(self, coarse=below, grids=(), parents=mine).given(V=self.V)

    @property
    def polygonal(self) -> bool:
        """Whether the domain is known to be exactly the polygon (polyhedron) of the mesh."""
        return self.straight if self.shape is None else self.project is None

    @property
    def project(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """Moves boundary points, shape (n, gdim), onto the true boundary of a shape, where that is curved."""
        return None if self.shape is None else self.shape.project

    @cached_property
    def parts(self) -> tuple[int, np.ndarray]:
        """Number of connected components of the mesh, and the component of each local dof (first use is collective).

        The meshes of shapes have one.
        """
        if self.shape is not None:
            return 1, np.zeros(len(self.points.T), dtype=np.int32)
        found = self.connected or components(self.mesh)
        return found.count, found.of_dofs(self.V)

    @property
    def comm(self) -> MPI.Comm:
        return self.mesh.comm

    @property
    def components(self) -> int:
        """Number of components of functions of V."""
        return self.V.dofmap.index_map_bs

    @property
    def scalar(self) -> Level:
        """The same mesh with scalar functions for V_h, those of Q (first use is collective)."""
        return self._of_q if self.vector else self

    @cached_property
    def _of_q(self) -> Level:
        return Level(self.mesh, self.h, self.facets, self.groups, pair=self.pair).given(V=self.Q)

    @cached_property
    def node_of(self) -> np.ndarray:
        """The node of V at each local dof of Q; of a cell those in the middles of edges are the last ones."""
        dofs = releases.cell_dofs(self.Q)
        found = np.arange(self.Q.dofmap.index_map.size_local + self.Q.dofmap.index_map.num_ghosts)
        found[dofs] = releases.cell_dofs(self.V)[:, -dofs.shape[1] :]
        return found

    def of_components(self, components: Sequence[fem.Function]) -> fem.Function:
        """The Function of V with these components, of Q (local)."""
        found = fem.Function(self.V, name="u")
        table = found.x.array.reshape(-1, self.components)
        for k, component in enumerate(components):
            table[self.node_of, k] = component.x.array
        return found

    def component(self, u: fem.Function, k: int) -> fem.Function:
        """A component of a Function of V, in Q (local)."""
        found = fem.Function(self.Q)
        found.x.array[:] = u.x.array[self.components * self.node_of + k]
        return found

    @property
    def owned(self) -> int:
        """Number of owned dofs."""
        return self.V.dofmap.index_map.size_local * self.components

    @property
    def dofs(self) -> int:
        """Number of dofs on all ranks."""
        return self.V.dofmap.index_map.size_global * self.components

    @property
    def cells(self) -> int:
        """Number of cells on all ranks."""
        return self.mesh.topology.index_map(self.mesh.topology.dim).size_global

    @property
    def downward(self) -> list[Level]:
        """This level and all below it."""
        return [self, *([] if self.coarse is None else self.coarse.downward)]

    @property
    def with_meshes(self) -> list[Level]:
        """This level and all below it, those of `on_meshes` where these were made."""
        found: Level = self.__dict__.get("on_meshes", self)
        return found.downward

    @cached_property
    def W(self) -> fem.FunctionSpace:
        """Tension and load: one value per cell, or polynomials as rich as V_h (first use is collective)."""
        return releases.functionspace(self.mesh, "DG", 0 if self.pair.degree == 1 else self.pair.degree)

    @cached_property
    def h_max(self) -> float:
        """Longest edge (first use is collective)."""
        parts = (slice(start, start + AT_ONCE) for start in range(0, own_cells(self.mesh), AT_ONCE))
        return largest(self.comm, [edge_lengths(corners(self.mesh, part)).max() for part in parts])

    def indicator(self, name: str) -> np.ndarray:
        """Whether each local dof of W belongs to a cell of a named material, ghosts included (collective)."""
        inside = fem.Function(self.W)
        inside.x.array[releases.cell_dofs(self.W)[self.groups[name]]] = 1.0
        inside.x.scatter_forward()
        return inside.x.array > 0.5

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest coordinates of the nodes, shape (3,) each (first use is collective)."""
        low, high = (np.array([end(self.comm, axis) for axis in self.points]) for end in (smallest, largest))
        return low, high

    @cached_property
    def boundary_facets(self) -> np.ndarray:
        """Local facets on the boundary of the domain."""
        return np.asarray(dmesh.exterior_facet_indices(self.mesh.topology), dtype=np.int32)


def of_pair(level: Level, pair: Pair) -> Level:
    """The same mesh with the spaces of another pair; P2 takes this level as its coarse one, pairs without nesting
    none."""
    if pair is level.pair:
        return level
    if not pair.nested_hierarchy:
        below = level if pair.has_p1_coarse_space else None
        return replace(level, pair=pair, coarse=below, grids=(), parents=None, places=None)
    return replace(level, pair=pair, coarse=None if level.coarse is None else of_pair(level.coarse, pair))


def of_space(
    V: fem.FunctionSpace, source: str, facets: dict[str, np.ndarray] | None = None, *, vector: bool = False
) -> Level:
    """The level of a space of the caller's own (collective).

    Args:
        V: Continuous Lagrange elements of degree 1 or 2.
        source: What messages call its user.
        facets: Local facets of each named part.
        vector: Whether V is to have as many components as points have coordinates, instead of one.

    Raises:
        InputError: If it is another space, or the mesh is no domain.
    """
    cell, gdim, degree = releases.cell_name(V.mesh), V.mesh.geometry.dim, lagrange_degree(V)
    if degree is None or V.dofmap.index_map_bs != (gdim if vector else 1):
        wanted = f"with {gdim} components" if vector else "and one component"
        raise InputError(f"{source}: u must be a continuous Lagrange Function of degree 1 or 2 {wanted}, not of "
                         f"{V.ufl_element()}")  # fmt: skip
    pair = vector_pair(pairs()[f"{'P' if cell in SIMPLICES else 'Q'}{degree}"]) if vector else _nodal_pair(cell, degree)
    if pair is None:
        raise InputError(f"{source}: no rule at the nodes of degree {degree} on a {cell} has positive weights (3.6): "
                         "take degree 1, or cells with another shape")  # fmt: skip
    check_degree(V.mesh, source, 1 + vector)
    level = of_mesh(releases.settle(V.mesh), source, facets)
    return (replace(level, pair=pair, vector=True) if vector else of_pair(level, pair)).given(V=V)


def over(level: Level) -> Level:
    """The vector-valued space over a scalar one, whose functions are its components (collective)."""
    found = Level(level.mesh, level.h, level.facets, level.groups, pair=level.pair, vector=True)
    return found.given(Q=level.V, _of_q=level)


def with_parts(level: Level, other: Level) -> Level:
    """The spaces of a level with the named parts and the size of the cells of another one on the same mesh."""
    found = replace(level, h=other.h, facets=other.facets, groups=other.groups, shape=other.shape,
                    remarks=other.remarks, bent=other.bent, to_cad=other.to_cad)  # fmt: skip
    return found.given(V=level.V, Q=level.Q)


def vector_pair(pair: Pair) -> Pair:
    """The same V_h with pressures at all nodes; its cell rules are not used, contact uses rules on facets."""
    return Pair(pair.name, pair.degree, pair.rules, ("Lagrange", pair.degree))


def _nodal_pair(cell: str, degree: int) -> Pair | None:
    """The first pair of a degree on cells whose points are nodes and whose weights are those of its rule."""
    found = (pair for pair in pairs().values() if cell in pair.rules and pair.degree == degree)
    return next((pair for pair in found if pair.nodal and not pair.own_weights), None)


def refined(level: Level, times: int = 1) -> Level:
    """The level with every edge halved, each cell staying on its rank (collective).

    Args:
        level: P1 on simplices.
        times: How often; more than once if `halves_at_once`.
    """
    *between, last = halvings(level.V, times, level.shape)
    mesh, kept = last.mesh()
    assert last.places is not None
    cells, places = kept // 2**last.dim, last.places[kept]
    fine = _above(level, mesh, level.h / 2**times, cells, places, P1, tuple(between))
    similar = halves_at_once(level) and level.project is None  # cells to their ancestors
    return fine.given(h_max=level.h_max / 2**times) if similar else fine


def halves_at_once(level: Level) -> bool:
    """Whether edges can be halved several times without meshes in between."""
    return level.mesh.topology.dim < 3 and level.to_cad is None


def refined_where(level: Level, marked: np.ndarray) -> Level:
    """The level with marked owned cells refined, and a few neighbours so that cells fit (collective).

    Raises:
        InputError: For cells that are no simplices.
    """
    if level.pair.has_p1_coarse_space:
        assert level.coarse is not None
        return of_pair(refined_where(level.coarse, marked), level.pair)
    new, cells, places = bisection.refined_where(level.V, marked)
    return _above(level, new, _largest_side(new), cells, places, level.pair)


def _above(
    level: Level, new: dmesh.Mesh, h: float, cells: np.ndarray, places: np.ndarray, pair: Pair,
    grids: tuple[Grid, ...] = (),
) -> Level:  # fmt: skip
    """The next finer level, with the named parts of this one, and new vertices on curved boundaries moved there
    (collective)."""
    dim, ancestors = new.topology.dim, cells // 2 ** (new.topology.dim * len(grids))

    def inherited(named: dict[Name, np.ndarray]) -> dict[Name, np.ndarray]:
        return parents.inherited(named, level.mesh, new, cells, places, len(grids))

    def within(named: dict[Name, np.ndarray]) -> dict[Name, np.ndarray]:
        return {name: np.flatnonzero(np.isin(ancestors, some)).astype(np.int32) for name, some in named.items()}

    bent_facets = {key: some for key, some in level.bent.items() if key[0] < dim}
    bent_cells = {key: some for key, some in level.bent.items() if key[0] == dim}
    fine = replace(
        level, mesh=new, h=h, facets=inherited(level.facets), groups=within(level.groups),
        bent=inherited(bent_facets) | within(bent_cells), pair=pair, coarse=level, grids=grids, parents=cells,
        places=places, connected=None,
    )  # fmt: skip
    if level.project is not None or level.to_cad is not None:
        x, nodes = new.geometry.x, releases.dof_nodes(fine.V)
        x[nodes, : new.geometry.dim] = _on_surface(fine, x[nodes])[:, : new.geometry.dim]
    return fine


def at_surface(level: Level) -> Level:
    """The same level, whose points on curved parts of the boundary are on the true curve or surface (collective).

    Cells have straight edges: midpoints of these, nodes of degree 2, are beside a curve of radius R by h^2/(8 R). The
    curve is known of shapes, and of a .geo or .step.
    """
    if level.pair.degree == 1:
        return level
    found = replace(level)
    return found.given(points=np.ascontiguousarray(_on_surface(found, found.points.T).T))


def _on_surface(level: Level, points: np.ndarray) -> np.ndarray:
    """Points of local dofs, shape (dofs, 3), those on curved parts of the boundary moved there (collective)."""
    if level.project is not None:
        points, gdim = points.copy(), level.mesh.geometry.dim
        dofs = fem.locate_dofs_topological(level.V, level.mesh.topology.dim - 1, level.boundary_facets)
        points[dofs, :gdim] = level.project(points[dofs, :gdim])
    if level.to_cad is not None:
        points = parents.on_cad(level.V, points, level.bent, level.to_cad)
    return points


def of_mesh(
    mesh: dmesh.Mesh,
    source: str,
    facets: dict[str, np.ndarray] | None = None,
    groups: dict[str, np.ndarray] | None = None,
) -> Level:
    """A mesh that is not one of our shapes: h from the volumes of its cells (collective).

    Args:
        mesh: Of cells of one kind.
        source: Where it comes from, for messages.
        facets: Local facets of each named part.
        groups: Owned cells of each named material.

    Raises:
        InputError: If its cells do not fit together.
    """
    found, remarks = check_mesh(mesh, source)
    return Level(mesh, _largest_side(mesh), facets or {}, groups or {}, remarks=remarks, connected=found)


def _largest_side(mesh: dmesh.Mesh) -> float:
    """The largest sqrt(2|T|) or (6|T|)^(1/3), of other cells than simplices |T|^(1/dim): the side of the grid, were
    this one (collective)."""
    dim, volumes = mesh.topology.dim, cell_volumes(mesh)
    of_grid = factorial(dim) if releases.cell_name(mesh) in SIMPLICES else 1  # simplices of a cell of the grid
    return largest(mesh.comm, (of_grid * volumes) ** (1 / dim))

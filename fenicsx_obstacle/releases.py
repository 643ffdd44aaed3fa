"""Differences between dolfinx 0.5, 0.9 and 0.11; no other module depends on the release.

docs/limitations.md says which releases were tested, and when; tests/releases.sh tests them.
"""

from __future__ import annotations

import logging
import math
import os
import re
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import basix
import dolfinx
import dolfinx.fem.petsc  # from 0.7 on `dolfinx.fem` does not import it
import numpy as np
import ufl
from dolfinx import cpp as _cpp
from dolfinx import fem, geometry, io, jit, la
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc
from ufl.corealg.traversal import unique_pre_traversal

from fenicsx_obstacle.errors import InputError

VERSION = tuple(map(int, re.findall(r"\d+", dolfinx.__version__)[:2]))
TRIED = {(0, 5), (0, 9), (0, 11)}
OLD = VERSION < (0, 7)  # ufl elements, AdjacencyList dofmaps
NEW = VERSION >= (0, 10)  # create_vector(V), io.gmsh

if np.issubdtype(PETSc.ScalarType, np.complexfloating):
    raise ImportError("this PETSc computes with complex numbers: fenicsx_obstacle needs one with real numbers")

# what UFL raises for values outside of a function's domain
UFL_ERRORS = (ArithmeticError, TypeError, ValueError, *([ufl.log.UFLException] if OLD else []))
atan2 = getattr(ufl, "atan2", None) or ufl.atan_2
FACET_GHOSTS = dmesh.GhostMode.shared_facet
JIT_WAIT = 25  # seconds to wait for another process that compiles the same form


def quiet() -> None:
    """Keep FFCx and UFL from printing compiler command lines and remarks (local)."""
    for name in ("UFL", "FFCx", "ffcx", "UFL_LEGACY"):
        logging.getLogger(name).setLevel(logging.ERROR)
    for handler in logging.getLogger().handlers + logging.getLogger("UFL").handlers:
        if type(handler) is logging.StreamHandler:
            handler.setLevel(logging.ERROR)
    logging.captureWarnings(False)  # FFCx 0.9 gives them to a logger that shows none


quiet()
if VERSION not in TRIED and MPI.COMM_WORLD.rank == 0:
    tried = ", ".join(f"{major}.{minor}" for major, minor in sorted(TRIED))
    warnings.warn(f"fenicsx_obstacle was tried with dolfinx {tried}, not with {dolfinx.__version__}", stacklevel=2)


def called(value: Any) -> Any:
    """UFL turned methods such as `degree()` into properties."""
    return value() if callable(value) else value


def cell_name(mesh: dmesh.Mesh) -> str:
    """'interval', 'triangle', 'tetrahedron', ..."""
    return called(mesh.ufl_cell().cellname)


def functionspace(mesh: dmesh.Mesh, family: str, degree: int, components: int | None = None) -> fem.FunctionSpace:
    """Space of a family and degree, scalar or of so many components (collective)."""
    if OLD:
        return (fem.FunctionSpace(mesh, (family, degree)) if components is None
                else fem.VectorFunctionSpace(mesh, (family, degree), components))  # fmt: skip
    return fem.functionspace(mesh, (family, degree) if components is None else (family, degree, (components,)))


def space_of(mesh: dmesh.Mesh, element: Any) -> fem.FunctionSpace:
    """Space of an element (collective). `V.sub(0).collapse()` of 0.5 ends in a fault on ranks without cells."""
    return (fem.FunctionSpace if OLD else fem.functionspace)(mesh, element)


def vec(u: fem.Function) -> PETSc.Vec:
    """New ghosted PETSc vector that shares the memory of a Function, on the mesh's communicator (collective)."""
    ghosts, sizes, block = _layout(u.function_space)
    return PETSc.Vec().createGhostWithArray(ghosts, u.x.array, sizes, block, u.function_space.mesh.comm)


def add_ghosts(u: Any) -> None:
    """Add what ranks hold at ghosts to the values of the owners, of a Function or a vector of DOLFINx (collective)."""
    getattr(u, "x", u).scatter_reverse(la.ScatterMode.add if OLD else la.InsertMode.add)


def cell_dofs(V: fem.FunctionSpace) -> np.ndarray:
    """Dofs of each local cell, shape (cells, dofs per cell)."""
    dofs = V.dofmap.list
    return dofs if isinstance(dofs, np.ndarray) else dofs.array.reshape(-1, V.dofmap.dof_layout.num_dofs)


def geometry_dofs(mesh: dmesh.Mesh) -> np.ndarray:
    """Rows of `mesh.geometry.x` of the vertices of each local cell, shape (cells, vertices per cell)."""
    geometry = mesh.geometry
    dofs = geometry.dofmaps[0] if VERSION >= (0, 11) else geometry.dofmap
    vertices = called(mesh.ufl_cell().num_vertices)
    if not isinstance(dofs, np.ndarray):
        cells = dofs.num_nodes
        dofs = dofs.array.reshape(cells, len(dofs.array) // cells if cells else vertices)
    return dofs[:, :vertices]


def topology_of(owner: Any) -> Any:
    """The C++ topology of a mesh or of MeshTags, the same Python object for both; None where it is not known."""
    owner = getattr(owner, "mesh", owner)  # MeshTags of 0.5 have their mesh, later ones its topology
    topology = getattr(owner, "topology", None)
    return getattr(topology, "_cpp_object", topology)


def geometry_degree(mesh: dmesh.Mesh) -> int:
    """Degree of the polynomials that map the reference cell to the cells of a mesh; 1 where edges are straight."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap).degree)


def dof_nodes(V: fem.FunctionSpace) -> np.ndarray:
    """Row of `mesh.geometry.x` of each local dof of a P1 space; 0 of one that no local cell has."""
    dofs, nodes = cell_dofs(V), geometry_dofs(V.mesh)
    found = np.zeros(V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts, dtype=np.int32)
    found[dofs.ravel()] = nodes.ravel()
    return found


_compiler_options: tuple[dict[str, Any], dict[str, Any]] = ({}, {})


@contextmanager
def compiled_with(form_options: Mapping[str, Any] | None, jit_options: Mapping[str, Any] | None) -> Iterator[None]:
    """Compile forms with options of FFCx and of its just-in-time compiler, named as in DOLFINx."""
    global _compiler_options
    before = _compiler_options
    _compiler_options = (dict(form_options or {}), dict(jit_options or {}))
    try:
        yield
    finally:
        _compiler_options = before


def form(expression: ufl.Form, *, reordered: bool = False) -> Any:
    """Compile a form (collective).

    A process killed while compiling leaves a source without its library, on which FFCx waits
    until it gives up: such files are removed, and the compilation is tried once more.

    Args:
        expression: In UFL.
        reordered: Whether the compiler may change the order of sums and products, and with it their last digits: it
            then computes several points at once.
    """
    form_options, jit_options = _compiler_options
    options = {"jit_params" if OLD else "jit_options": _with_flags(jit_options, reordered)}
    options["form_compiler_params" if OLD else "form_compiler_options"] = form_options
    if (0, 8) <= VERSION < (0, 10):
        expression = _with_shared_tags(expression)
    try:
        return fem.form(expression, **options)
    except (TimeoutError, RuntimeError) as error:
        if "timed out" not in str(error):
            raise
    _remove_stale_sources(JIT_WAIT - 1)
    return fem.form(expression, **options)


def load_compiler_options(place: Path) -> None:
    """Let DOLFINx and FFCx read their options now, with this folder in place of the current one (local)."""
    here = Path.cwd()
    os.chdir(place)
    try:  # both keep what they have read
        jit.get_options() if hasattr(jit, "get_options") else jit.get_parameters()  # the latter before 0.6
        name = "options" if find_spec("ffcx.options") else "parameters"
        getattr(import_module(f"ffcx.{name}"), f"get_{name}")()
    finally:
        os.chdir(here)


def _with_shared_tags(form: ufl.Form) -> ufl.Form:
    """The form with its tags on all integrals of a kind: DOLFINx 0.9 compiles no `dx` beside a tagged `dx(3)`."""
    given = [(one.integral_type(), one.subdomain_data()) for one in form.integrals()]
    tags = {kind: data for kind, data in given if data is not None}
    return ufl.Form([
        one if data is not None or kind not in tags else one.reconstruct(subdomain_data=tags[kind])
        for one, (kind, data) in zip(form.integrals(), given, strict=True)
    ])  # fmt: skip


def _with_flags(jit_options: Mapping[str, Any], reordered: bool) -> dict[str, Any]:
    """Options by which the compiler writes a square root as one instruction, which gives the same number: otherwise it
    calls a function that sets errno, which nobody reads. Integrals of formulas take a third of the time less."""
    found = (jit.get_parameters if OLD else jit.get_options)({"timeout": JIT_WAIT, **jit_options})
    flags = [*found["cffi_extra_compile_args"], "-fno-math-errno", *(_REORDER if reordered else ())]
    return {**found, "cffi_extra_compile_args": flags}


# what -ffast-math allows, except for numbers that are not finite
_REORDER = ("-O3", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math", "-freciprocal-math")


def _remove_stale_sources(seconds: float) -> None:
    """Remove sources that nobody has finished compiling for so long."""
    folder = Path(os.getenv("XDG_CACHE_HOME", Path.home() / ".cache")) / "fenics"
    for source in folder.glob("libffcx_*.c"):
        with suppress(FileNotFoundError):  # another process has removed it
            if not source.with_suffix(".c.cached").exists() and time.time() - source.stat().st_mtime > seconds:
                source.unlink()


def create_vector(V: fem.FunctionSpace) -> PETSc.Vec:
    """Ghosted vector on V (collective).

    It belongs to the communicator of the mesh, which `garbage` knows. Those that DOLFINx makes belong to another one,
    that of the dofs, which Python does not see.
    """
    ghosts, sizes, block = _layout(V)
    return PETSc.Vec().createGhost(ghosts, sizes, block, V.mesh.comm)


def _layout(V: fem.FunctionSpace) -> tuple[np.ndarray, tuple[int, int], int]:
    """Global numbers of the ghosts, numbers of owned and of all dofs, and the block size of vectors on V."""
    dofs, block = V.dofmap.index_map, V.dofmap.index_map_bs
    return np.asarray(dofs.ghosts, dtype=PETSc.IntType), (dofs.size_local * block, dofs.size_global * block), block


def set_values(values: np.ndarray, bcs: Iterable[Any]) -> None:
    """Give local dofs, ghosts included, what Dirichlet conditions say (local)."""
    for bc in bcs:
        if VERSION >= (0, 9):
            bc.set(values)
        else:
            fem.set_bc(values, [bc])


def element(V: fem.FunctionSpace) -> Any:
    """The element of a scalar space, whose method `tabulate(order, points)` is that of basix."""
    given = V.ufl_element()
    return import_module("ffcx.element_interface").create_element(given) if OLD else given


def expression(value: Any, V: fem.FunctionSpace) -> fem.Expression:
    """UFL expression evaluated at the nodes of V."""
    return fem.Expression(value, called(V.element.interpolation_points))


def finite(expression: Any) -> bool:
    """Whether all numbers in a UFL expression are finite: FFCx writes others into C, where they mean nothing."""
    nodes = unique_pre_traversal(expression)
    return all(math.isfinite(float(node)) for node in nodes if isinstance(node, ufl.constantvalue.RealValue))


def diagonal(name: str) -> Any:
    """DOLFINx's name of the diagonals of rectangles: right, left, crossed, left_right, right_left."""
    kinds = getattr(dmesh, "DiagonalType", None) or _cpp.mesh.DiagonalType
    return getattr(kinds, name)


def settle(mesh: dmesh.Mesh) -> dmesh.Mesh:
    """Prepare a new mesh (collective): create facets, and make form signatures independent of the process.

    On 0.5 the first compilation changes the variant of the coordinate element, and with it the
    signature of every later form: without this the same form compiles twice.
    """
    dim = mesh.topology.dim
    mesh.topology.create_entities(dim - 1)
    mesh.topology.create_connectivity(dim - 1, dim)
    if OLD:
        mesh.ufl_domain().ufl_coordinate_element()._sub_element._variant = "equispaced"
    return mesh


def create_mesh(comm: MPI.Comm, cells: np.ndarray, points: np.ndarray, cell: str, *, stay: bool = False) -> dmesh.Mesh:
    """Affine mesh from arrays (collective).

    Args:
        comm: Communicator.
        cells: Rows of `points` (in global numbering), shape (n, vertices), on the ranks that hold them.
        points: Coordinates, shape (m, gdim), in rank order.
        cell: Name of the cell type.
        stay: Keep each cell on the rank that passes it.
    """
    cells, points = np.ascontiguousarray(cells, np.int64), np.ascontiguousarray(points, np.float64)
    gdim = points.shape[1]
    partitioner = _partitioner(comm, len(cells), stay)
    if (every := _all_if_branching(comm, cells, cell, gdim)) is not None:
        # at such facets DOLFINx waits forever for other ranks, or takes a vertex for two: one rank has all
        counts = comm.allgather(len(cells))
        if stay and np.count_nonzero(counts) > 1:
            raise InputError(
                "more than two cells meet at a facet of this mesh, and several ranks have some: make it with all cells "
                "on one rank, or run on one rank"
            )
        home = np.full(len(every), np.argmax(counts) if stay else 0, dtype=np.int32)
        cells, partitioner = every, lambda *_: _one_rank_each(home)
    if OLD:
        domain = ufl.Mesh(ufl.VectorElement("Lagrange", ufl.Cell(cell, geometric_dimension=gdim), 1))
        mesh = dmesh.create_mesh(comm, cells, points, domain, FACET_GHOSTS, partitioner)
    else:
        import basix.ufl

        domain = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(gdim,)))
        arguments = (cells, domain, points) if NEW else (cells, points, domain)
        mesh = dmesh.create_mesh(comm, *arguments, partitioner=partitioner)
    return settle(mesh)


def _all_if_branching(comm: MPI.Comm, cells: np.ndarray, cell: str, gdim: int) -> np.ndarray | None:
    """The cells of all ranks on rank 0, and none elsewhere, if more than two of a curve or surface in space meet at a
    facet; else None (collective)."""
    shape = basix.topology(getattr(basix.CellType, cell))
    if comm.size == 1 or gdim == len(shape) - 1:
        return None
    every, found = cells[:0], False
    if (parts := comm.gather(cells)) is not None:
        every = np.vstack(parts)
        facets = every[:, shape[-2]].reshape(-1, len(shape[-2][0]))
        found = bool(np.unique(np.sort(facets, axis=1), axis=0, return_counts=True)[1].max(initial=0) > 2)
    return every if comm.bcast(found) else None


def _one_rank_each(owners: np.ndarray) -> Any:
    """What a partition function returns if each cell goes to one rank."""
    return _cpp.graph.AdjacencyList_int32(owners, np.arange(len(owners) + 1, dtype=np.int32))


def _partitioner(comm: MPI.Comm, cells: int, stay: bool) -> Any:
    """The partitioner of cells. With one rank no graph of neighbours is computed."""
    if comm.size == 1:
        return lambda *_: _one_rank_each(np.zeros(cells, np.int32))
    if OLD:
        return dmesh.create_cell_partitioner(*([_stay] if stay else []))
    cells_at_a_facet = [2] if VERSION >= (0, 11) else []
    return dmesh.create_cell_partitioner(*([_stay] if stay else []), FACET_GHOSTS, *cells_at_a_facet)


def _stay(comm: MPI.Comm, parts: int, graph: Any, ghosting: bool) -> Any:
    """Partition function: every cell stays on its rank and is a ghost on its neighbours' ranks."""
    own = graph.num_nodes
    ends = np.cumsum(comm.allgather(own))
    offsets, links = np.asarray(graph.offsets), np.asarray(graph.array)
    cell = np.repeat(np.arange(own), np.diff(offsets)) if ghosting else np.empty(0, int)
    owner = np.searchsorted(ends, links if ghosting else links[:0], side="right")
    away = owner != comm.rank
    # one row (cell, order, rank) for the cell itself, order 0, and one for each rank beside it
    rows = np.column_stack([cell, np.ones_like(cell), owner])[away]
    home = np.column_stack([np.arange(own), np.zeros(own, int), np.full(own, comm.rank)])
    rows = np.unique(np.vstack([home, rows]), axis=0)
    starts = np.searchsorted(rows[:, 0], np.arange(own + 1))
    return _cpp.graph.AdjacencyList_int32(rows[:, 2].astype(np.int32), starts.astype(np.int32))


def cells_near(
    mesh: dmesh.Mesh, points: np.ndarray, padding: float, *, within: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Owned cells whose padded bounding boxes hold points (local).

    Args:
        mesh: Mesh.
        points: Shape (n, 3).
        padding: Length by which the boxes are widened.
        within: Keep only cells that hold the points themselves.

    Returns:
        Pairs: rows of `points`, and cells.
    """
    dim = mesh.topology.dim
    own = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    if not len(own) or not len(points):
        return np.empty(0, np.int32), np.empty(0, np.int32)
    if OLD:
        found = geometry.compute_collisions(geometry.BoundingBoxTree(mesh, dim, own, padding), points)
    else:
        tree = geometry.bb_tree(mesh, dim, entities=own, padding=padding)
        found = geometry.compute_collisions_points(tree, points)
    if within:
        found = geometry.compute_colliding_cells(mesh, found, points)
    return np.repeat(np.arange(len(points)), np.diff(found.offsets)), np.asarray(found.array)


def from_xdmf(file: io.XDMFFile, name: str) -> dmesh.Mesh:
    """Mesh of an open XDMF file, ghosted over facets (collective)."""
    return settle(file.read_mesh(FACET_GHOSTS, name=name))


def polynomial_degree(V: fem.FunctionSpace) -> int | None:
    """Degree of the functions of a scalar space on simplices; None if they may not be polynomials."""
    element = V.ufl_element()
    if cell_name(V.mesh) not in ("interval", "triangle", "tetrahedron"):
        return None
    if OLD:
        return int(element.degree()) if element.family() in ("Lagrange", "Discontinuous Lagrange") else None
    known = element.family_name in ("P", "Lagrange", "Discontinuous Lagrange")
    return int(element.embedded_superdegree) if known else None

"""Meshes from files: Gmsh with its physical names, XDMF with its numbered tags."""

from __future__ import annotations

from contextlib import nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
from dolfinx import io
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import own_cells
from fenicsx_obstacle.discrete.meshing import meshed
from fenicsx_obstacle.discrete.soundness import refuse_unsound
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import on_root

_LINEAR = {1: {1}, 2: {2}, 3: {4}}  # Gmsh's numbers of straight lines, triangles, tetrahedra


Groups = dict[str, np.ndarray]


def read(path: Path, comm: MPI.Comm) -> tuple[dmesh.Mesh, Groups, Groups]:
    """A mesh, the local facets of each named curve (in solids, surface), the owned cells of each material (collective).

    Raises:
        InputError: If the file is missing, broken, or has cells other than straight simplices.
    """
    on_root(comm, _check, path)
    return _gmsh(path, comm) if path.suffix in (".msh", ".geo") else _xdmf(path, comm)


def _check(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: no such mesh file ([mesh] file, relative to the scene)")
    if not path.is_file():  # a pipe might wait for ever
        raise InputError(f"{path}: a {'folder' if path.is_dir() else 'pipe or device'}, not a mesh file")
    if path.suffix not in (".msh", ".geo", ".xdmf"):
        raise InputError(f"{path}: a mesh file ends in .msh, .geo (Gmsh) or .xdmf")


def _gmsh(path: Path, comm: MPI.Comm) -> tuple[dmesh.Mesh, Groups, Groups]:
    dim, gdim, names = on_root(comm, _open_gmsh, path)
    import gmsh

    mesh, cell_tags, facet_tags = releases.from_gmsh(gmsh.model, comm, gdim)
    if comm.rank == 0:
        gmsh.finalize()
    facets = {name: facet_tags.find(tag) for name, d, tag in names if d == dim - 1 and facet_tags is not None}
    groups = {name: _owned(mesh, cell_tags.find(tag)) for name, d, tag in names if d == dim}
    return mesh, facets, groups


def _owned(mesh: dmesh.Mesh, cells: np.ndarray) -> np.ndarray:
    return cells[cells < own_cells(mesh)]


def _open_gmsh(path: Path) -> tuple[int, int, list[tuple[str, int, int]]]:
    """Load the model on rank 0: its dimension, the space it lies in, its physical names."""
    if find_spec("gmsh") is None:
        raise InputError(f"{path}: reading Gmsh files needs gmsh's Python module (python3-gmsh)")
    with meshed(path) if path.suffix == ".geo" else nullcontext(path) as mesh:
        return _load_gmsh(mesh, path)


def _load_gmsh(mesh: Path, path: Path) -> tuple[int, int, list[tuple[str, int, int]]]:
    """Load a .msh file; `path` is what the user gave."""
    import gmsh

    gmsh.initialize([], False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        gmsh.open(str(mesh))
        gmsh.model.mesh.renumberNodes()  # DOLFINx wants no gaps
        return _inspect_gmsh(gmsh.model, path)
    except InputError:
        gmsh.finalize()
        raise
    except Exception as error:  # gmsh raises the base class, whatever is wrong with the file
        gmsh.finalize()
        raise InputError(f"{path}: Gmsh cannot read it: {error}; is it whole?") from None


def _inspect_gmsh(model: Any, path: Path) -> tuple[int, int, list[tuple[str, int, int]]]:
    dims = [dim for dim in (1, 2, 3) if len(model.mesh.getElementTypes(dim))]
    if not dims:
        raise InputError(f"{path}: holds no cells")
    dim = max(dims)
    if set(model.mesh.getElementTypes(dim)) - _LINEAR[dim]:
        kinds = [model.mesh.getElementProperties(kind)[0] for kind in model.mesh.getElementTypes(dim)]
        raise InputError(f"{path}: has {', '.join(kinds)} cells; P1 needs straight lines, triangles or tetrahedra")
    if not model.getPhysicalGroups(dim):  # only what is in a physical group becomes part of the mesh
        model.addPhysicalGroup(dim, [tag for _, tag in model.getEntities(dim)])
    for d in (dim, dim - 1):
        for _, entity in model.getEntities(d):
            both = [model.getPhysicalName(d, tag) or str(tag) for tag in model.getPhysicalGroupsForEntity(d, entity)]
            if len(both) > 1:
                kind = ("point", "curve", "surface", "volume")[d]
                words = " and ".join(f"'{name}'" for name in both)
                raise InputError(f"{path}: {kind} {entity} is in the physical groups {words}; one is allowed")
    in_cells = np.concatenate(
        [model.mesh.getNodesForPhysicalGroup(*group)[0] for group in model.getPhysicalGroups(dim)]
    )
    for d, tag in model.getPhysicalGroups(dim - 1):
        # DOLFINx crashes on them
        if not np.isin(model.mesh.getNodesForPhysicalGroup(d, tag)[0], in_cells).all():
            name = model.getPhysicalName(d, tag) or str(tag)
            raise InputError(f"{path}: '{name}' is not on the mesh; a part inside must be embedded in its domain")
    tags, places, _ = model.mesh.getNodes()
    coordinates, numbers = np.asarray(places).reshape(-1, 3), np.argsort(tags)
    of_cells = np.concatenate([model.mesh.getElements(dim, tag)[2][0] for _, tag in model.getEntities(dim)
                               if len(model.mesh.getElements(dim, tag)[2])])  # fmt: skip
    refuse_unsound(path, coordinates[numbers], np.searchsorted(np.sort(tags), of_cells).reshape(-1, dim + 1))
    flat = np.abs(coordinates).max(axis=0) > 1e-12 * np.abs(coordinates).max()
    gdim = max(dim, int(np.flatnonzero(flat).max(initial=0)) + 1)
    names = [(model.getPhysicalName(d, tag) or str(tag), d, tag) for d, tag in model.getPhysicalGroups()]
    return dim, gdim, names


def _xdmf(path: Path, comm: MPI.Comm) -> tuple[dmesh.Mesh, Groups, Groups]:
    grid, tags = on_root(comm, _grids, path)
    facets, groups = Groups(), Groups()
    try:
        with io.XDMFFile(comm, str(path), "r") as file:
            mesh = releases.from_xdmf(file, grid)
            dim = mesh.topology.dim
            for name in tags:
                found = file.read_meshtags(mesh, name=name)
                values = set().union(*comm.allgather(found.values.tolist()))
                if found.dim == dim - 1:
                    facets |= {str(tag): found.find(tag) for tag in values}
                elif found.dim == dim:
                    groups |= {str(tag): _owned(mesh, found.find(tag)) for tag in values}
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    return mesh, facets, groups


def _grids(path: Path) -> tuple[str, list[str]]:
    """Names of the mesh, and of the tags on it."""
    try:
        tree = ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: not XDMF: {error}") from None
    grids = [grid for grid in tree.iter("Grid") if grid.find("Topology") is not None]
    if not grids:
        raise InputError(f"{path}: holds no mesh")
    points, cells = (_array(path, grids[0].find(f"{part}/DataItem"), part) for part in ("Geometry", "Topology"))
    if cells.shape[1] in (2, 3, 4) and cells.dtype.kind in "iu":  # others are refused by their kind
        refuse_unsound(path, points, cells)
    return grids[0].get("Name", "mesh"), [g.get("Name", "") for g in grids[1:] if g.find("Attribute") is not None]


def _array(path: Path, item: ElementTree.Element | None, part: str) -> np.ndarray:
    """The numbers of an XDMF DataItem, two-dimensional."""
    if item is None:
        raise InputError(f"{path}: its {part} holds no data")
    shape, text = (item.get("Dimensions") or "").split(), (item.text or "").strip()
    try:
        if item.get("Format") == "HDF":
            name, _, inside = text.partition(":")
            part, data = f"{part} in {name}", path.parent / name
            if not data.is_file():
                raise InputError(f"{path}: its data file {data} is missing")
            with h5py.File(data) as file:
                array = np.asarray(file[inside][()])
        else:
            array = np.array(text.split(), dtype=np.int64 if part == "Topology" else np.float64)
        return array.reshape([int(number) for number in shape] if len(shape) == 2 else array.shape)
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: its {part} cannot be read: {error}") from None

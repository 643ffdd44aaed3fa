"""Meshes from files: Gmsh with its physical names, XDMF with its numbered tags or, from `Solution.save`, names."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from dolfinx import io
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.hdf5 import dataset, opened
from fenicsx_obstacle.mesh import meshing
from fenicsx_obstacle.mesh.cells import given_cells, own_cells
from fenicsx_obstacle.mesh.levels import Level, of_mesh
from fenicsx_obstacle.mesh.named_parts import Groups, local_facets, named
from fenicsx_obstacle.mesh.validation import validate_mesh
from fenicsx_obstacle.parallel import on_root

GMSH = (".msh", *meshing.GEOMETRY)


def read(path: Path, comm: MPI.Comm, *, curved: bool = False) -> Level:
    """The mesh of a file, with its named parts (collective).

    Args:
        path: The file.
        comm: Communicator.
        curved: Whether cells may be of degree 2.

    Raises:
        InputError: If the file is missing, broken, or has cells that DOLFINx does not take or that do not fit together.
    """
    on_root(comm, _check, path)
    return (_gmsh if path.suffix.lower() in GMSH else _xdmf)(path, comm, curved=curved)


def content_of(path: Path) -> str:
    """A hash of the mesh of a file, whatever further files it came from (one rank).

    What a .geo or .step depends on only Gmsh knows: for these it is a hash of the mesh that Gmsh makes.

    Raises:
        InputError: As `read`.
    """
    _check(path)
    if path.suffix.lower() in GMSH:
        return meshing.load(path).content
    content = sha256()
    for file in (path, *_data_files(path)):
        with file.open("rb") as stream:
            content.update(file_digest(stream, "sha256").digest())
    return content.hexdigest()


def _data_files(path: Path) -> list[Path]:
    """The files with the numbers of an XDMF file."""
    items = [item for item in _tree(path).iter("DataItem") if item.get("Format") == "HDF"]
    names = sorted({(item.text or "").strip().partition(":")[0] for item in items})
    return [_data_file(path, name) for name in names]


def _data_file(path: Path, name: str) -> Path:
    data = path.parent / name
    if not data.is_file():
        raise InputError(f"{path}: its data file {data} is missing")
    return data


def _tree(path: Path) -> Any:
    try:
        return ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: not XDMF: {error}") from None


def _check(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: no such mesh file ([mesh] file, relative to the scene)")
    if not path.is_file():  # a pipe might wait for ever
        raise InputError(f"{path}: a {'folder' if path.is_dir() else 'pipe or device'}, not a mesh file")
    if path.suffix.lower() not in (*GMSH, ".xdmf"):
        raise InputError(f"{path}: a mesh file ends in .msh, .geo, .step (Gmsh) or .xdmf")


def _gmsh(path: Path, comm: MPI.Comm, *, curved: bool) -> Level:
    kept: list[meshing.Arrays] = []  # points and cells stay on rank 0

    def load() -> meshing.Arrays:
        kept.append(meshing.load(path))
        return replace(kept[0], points=kept[0].points[:0], cells=kept[0].cells[:0])

    found = on_root(comm, load)
    points, cells = (kept[0].points, kept[0].cells) if comm.rank == 0 else (found.points, found.cells)
    mesh = releases.create_mesh(comm, cells, points, found.cell)
    own, dim = given_cells(mesh), mesh.topology.dim

    def facets_of(facets: np.ndarray, owners: np.ndarray, owner: int) -> np.ndarray:
        return np.unique(facets[(owners == owner) & (facets >= 0)])

    def cells_of(owners: np.ndarray, owner: int) -> np.ndarray:
        return np.flatnonzero(owners[own] == owner).astype(np.int32)

    in_parts, on_curves = local_facets(mesh, found.facets), local_facets(mesh, found.bent)
    named = {name: facets_of(in_parts, found.facet_part, k) for k, name in enumerate(found.parts)}
    groups = {name: cells_of(found.cell_material, k) for k, name in enumerate(found.materials)}
    entities = np.unique(found.bent_entity).tolist()
    bent = {(dim - 1, k): facets_of(on_curves, found.bent_entity, k) for k in entities}
    surfaces = np.unique(found.cell_entity[found.cell_entity > 0]).tolist()
    bent |= {(dim, k): cells_of(found.cell_entity, k) for k in surfaces}
    level = of_mesh(mesh, str(path), named, groups, curved=curved)
    to_cad = partial(meshing.moved, path) if bent else None
    remarks = *found.remarks, *level.remarks
    return replace(level, straight=found.straight, remarks=remarks, bent=bent, to_cad=to_cad)


def _xdmf(path: Path, comm: MPI.Comm, *, curved: bool) -> Level:
    grid, tags, parts = on_root(comm, _grids, path)
    try:
        with io.XDMFFile(comm, str(path), "r") as file:
            mesh = releases.from_xdmf(file, grid)
            facets, groups = named(mesh, parts)
            dim = mesh.topology.dim
            for name in tags:
                found = file.read_meshtags(mesh, name=name)
                values = set().union(*comm.allgather(found.values.tolist()))
                if found.dim == dim - 1:
                    facets |= {str(tag): found.find(tag) for tag in values}
                elif found.dim == dim:
                    groups |= {str(tag): _owned(mesh, found.find(tag)) for tag in values}
    except (RuntimeError, LookupError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    return of_mesh(mesh, str(path), facets, groups, curved=curved)


def _owned(mesh: dmesh.Mesh, cells: np.ndarray) -> np.ndarray:
    return cells[cells < own_cells(mesh)]


def _grids(path: Path) -> tuple[str, list[str], Groups]:
    """Names of the mesh, and of the tags on it; and what `named_parts.parts_of` has saved of it."""
    grids = [grid for grid in _tree(path).iter("Grid") if grid.find("Topology") is not None]
    if not grids:
        raise InputError(f"{path}: holds no mesh")
    points, cells = (_array(path, grids[0].find(f"{part}/DataItem"), part) for part in ("Geometry", "Topology"))
    if points.ndim != 2 or cells.ndim != 2 or cells.dtype.kind not in "iu":
        raise InputError(f"{path}: its mesh has no rows of coordinates and of vertices of cells of one kind")
    try:
        validate_mesh(points, cells)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    for item in (item for grid in grids for item in grid.iter("DataItem") if item.get("Format") == "HDF"):
        _check_data(path, item)  # before DOLFINx follows it
    tags = [g.get("Name", "") for g in grids[1:] if g.find("Attribute") is not None]
    return grids[0].get("Name", "mesh"), tags, _parts(path, grids[0].find("Topology/DataItem"))


def _check_data(path: Path, item: ElementTree.Element) -> None:
    """Reject numbers that are in further files, or are not there."""
    name, _, inside = (item.text or "").strip().partition(":")
    data = _data_file(path, name)
    try:
        with opened(data) as file:
            dataset(file, inside)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {inside} in {data} cannot be read: {error}") from None


def _parts(path: Path, item: ElementTree.Element | None) -> Groups:
    """The group `parts` of the file that holds the cells, if that is one of ours."""
    assert item is not None
    if item.get("Format") != "HDF":
        return {}
    data = _data_file(path, (item.text or "").strip().partition(":")[0])
    try:
        with opened(data) as file:
            if "parts/names" not in file:
                return {}
            return {name: dataset(file, f"parts/{name}")[()] for name in file["parts"]}
    except (OSError, ValueError) as error:
        raise InputError(f"{data}: its parts cannot be read: {error}") from None


def _array(path: Path, item: ElementTree.Element | None, part: str) -> np.ndarray:
    """The numbers of an XDMF DataItem, two-dimensional."""
    if item is None:
        raise InputError(f"{path}: its {part} holds no data")
    shape, text = (item.get("Dimensions") or "").split(), (item.text or "").strip()
    try:
        if item.get("Format") == "HDF":
            name, _, inside = text.partition(":")
            part, data = f"{part} in {name}", _data_file(path, name)
            with opened(data) as file:
                array = np.asarray(dataset(file, inside)[()])
        else:
            array = np.array(text.split(), dtype=np.int64 if part == "Topology" else np.float64)
        return array.reshape([int(number) for number in shape] if len(shape) == 2 else array.shape)
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: its {part} cannot be read: {error}") from None

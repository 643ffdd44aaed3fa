"""Meshes from XDMF files, with their numbered tags or, from `Solution.save`, names."""

from __future__ import annotations

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
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.mesh.levels import Level, of_mesh
from fenicsx_obstacle.mesh.named_parts import Groups, named
from fenicsx_obstacle.mesh.validation import validate_mesh
from fenicsx_obstacle.parallel import on_root


def read_xdmf(path: Path, comm: MPI.Comm) -> Level:
    """As `files.read` (collective)."""
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
    return of_mesh(mesh, str(path), facets, groups)


def data_files(path: Path) -> list[Path]:
    """The files with the numbers of an XDMF file.

    Raises:
        InputError: If one is missing, or the file is no XDMF.
    """
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

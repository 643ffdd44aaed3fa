"""Meshes from files: those of Gmsh with its physical names, and XDMF."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from hashlib import file_digest, sha256
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh import meshing
from fenicsx_obstacle.mesh.cells import given_cells
from fenicsx_obstacle.mesh.levels import Level, of_mesh
from fenicsx_obstacle.mesh.named_parts import local_facets
from fenicsx_obstacle.parallel import on_root

GMSH = (".msh", *meshing.GEOMETRY)


def read(path: Path, comm: MPI.Comm) -> Level:
    """The mesh of a file, with its named parts (collective).

    Raises:
        InputError: If the file is missing, broken, or has cells that DOLFINx does not take or that do not fit together.
    """
    on_root(comm, _check, path)
    if path.suffix.lower() in GMSH:
        return _gmsh(path, comm)
    from fenicsx_obstacle.mesh.xdmf import read_xdmf  # with h5py

    return read_xdmf(path, comm)


def content_of(path: Path) -> str:
    """A hash of the mesh of a file, whatever further files it came from (one rank).

    What a .geo or .step depends on only Gmsh knows: for these it is a hash of the mesh that Gmsh makes.

    Raises:
        InputError: As `read`.
    """
    _check(path)
    if path.suffix.lower() in GMSH:
        return meshing.load(path).content
    from fenicsx_obstacle.mesh.xdmf import data_files

    content = sha256()
    for file in (path, *data_files(path)):
        with file.open("rb") as stream:
            content.update(file_digest(stream, "sha256").digest())
    return content.hexdigest()


def _check(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: no such mesh file ([mesh] file, relative to the scene)")
    if not path.is_file():  # a pipe might wait for ever
        raise InputError(f"{path}: a {'folder' if path.is_dir() else 'pipe or device'}, not a mesh file")
    if path.suffix.lower() not in (*GMSH, ".xdmf"):
        raise InputError(f"{path}: a mesh file ends in .msh, .geo, .step (Gmsh) or .xdmf")


def _gmsh(path: Path, comm: MPI.Comm) -> Level:
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
    level = of_mesh(mesh, str(path), named, groups)
    to_cad = partial(meshing.moved, path) if bent else None
    remarks = *found.remarks, *level.remarks
    return replace(level, straight=found.straight, remarks=remarks, bent=bent, to_cad=to_cad)

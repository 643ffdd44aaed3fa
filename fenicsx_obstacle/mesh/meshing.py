"""Gmsh in a separate process, since a file that it cannot read may end the process, and a .geo is a program.

`python -P -B -m fenicsx_obstacle.mesh.meshing FILE ARRAYS` writes the mesh of a .geo, .step or .msh file as NumPy
arrays, or, if there are arrays already, moves the points in them to the CAD geometry of the .geo or .step; if that
fails it prints the reason and leaves with status 1 (Gmsh's reason) or 2 (ours). While it reads, it is confined.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.confinement import confine
from fenicsx_obstacle.mesh.gmsh_model import (
    arrays_of,
    join_bodies,
    name_bodies,
    on_cad,
    samples,
    ungrouped_cells,
)

_REJECTED = 2  # exit status
GEOMETRY = (".geo", ".step", ".stp")  # files that have a geometry, from which Gmsh makes the mesh
PER_TURN = 12  # cells around a circle of a STEP file, which says nothing of sizes
# of files that are no programs, by their endings: what Gmsh does not find there it would run as a .geo
_BEGINS = {".msh": b"$MeshFormat", ".step": b"ISO-10303-21", ".stp": b"ISO-10303-21"}
_kept: dict[Path, Arrays] | None = None  # see `read_once`


@dataclass(frozen=True)
class Arrays:
    """A mesh as arrays.

    Attributes:
        points: Coordinates, shape (points, gdim); each is a vertex of a cell.
        cell: Kind of the cells.
        cells: Rows of `points`, in DOLFINx's order, shape (cells, vertices).
        materials: Names of the groups of cells.
        cell_material: Row of `materials` of each cell; empty without materials.
        parts: Names of the groups of facets.
        facets: Rows of `points` of each facet in a group, shape (facets, vertices).
        facet_part: Row of `parts` of each of these facets.
        bent: Rows of `points` of each facet on a CAD curve that is no line, in solids on a surface that is no plane.
        bent_entity: Gmsh's number of that curve or surface, for each of them.
        cell_entity: On surfaces in space Gmsh's number of the surface of each cell, 0 of a plane; otherwise empty.
        straight: Whether the file says that all CAD curves are lines, and all surfaces planes.
        remarks: What the user should know of the file.
        content: A hash of all this, and of samples of the geometry.
    """

    points: np.ndarray
    cell: str
    cells: np.ndarray
    materials: Sequence[str]
    cell_material: np.ndarray
    parts: Sequence[str]
    facets: np.ndarray
    facet_part: np.ndarray
    bent: np.ndarray
    bent_entity: np.ndarray
    cell_entity: np.ndarray
    straight: bool
    remarks: Sequence[str]
    content: str


@contextmanager
def read_once() -> Iterator[None]:
    """While the block runs each Gmsh file is read once: what follows is all of one mesh (one rank)."""
    global _kept
    before, _kept = _kept, {} if _kept is None else _kept
    try:
        yield
    finally:
        _kept = before


def load(path: Path) -> Arrays:
    """The mesh of a Gmsh file (one rank).

    Raises:
        InputError: With what Gmsh says, or what is wrong with the mesh.
    """
    place = path.resolve()
    if _kept is not None and place in _kept:
        return _kept[place]
    with tempfile.TemporaryDirectory() as folder:
        arrays = Path(folder) / "mesh.npz"
        _start(path, arrays)
        found = _arrays(arrays)
    if _kept is not None:
        _kept[place] = found
    return found


def moved(path: Path, points: np.ndarray, rows: np.ndarray, entities: np.ndarray) -> np.ndarray:
    """Points moved to the nearest ones of curves or surfaces of a .geo or .step (one rank).

    Args:
        path: The file.
        points: Arguments as those of `on_cad`.
        rows: Rows of `points`.
        entities: Their entities.

    Raises:
        InputError: With what Gmsh says.
    """
    with tempfile.TemporaryDirectory() as folder:
        arrays = Path(folder) / "points.npz"
        np.savez(arrays, points=points, rows=rows, entities=entities)
        _start(path, arrays)
        with np.load(arrays, allow_pickle=False) as stored:
            return stored["points"]


def _start(path: Path, arrays: Path) -> None:
    """Run this module for a file.

    Raises:
        InputError: As `load`.
    """
    _check(path)
    command = [sys.executable, "-P", "-B", "-m", __name__, str(path), str(arrays)]
    # the process is no rank: MPICH would take it for one
    env = {name: value for name, value in os.environ.items() if not name.startswith("PMI_")}
    done = subprocess.run(command, env=env, capture_output=True, text=True, errors="replace", check=False)
    said = done.stdout.strip()
    if done.returncode == -signal.SIGSYS:
        raise InputError(
            f"{path}: starts a program or writes a file, which no mesh file of a scene may do: remove commands such as "
            "SystemCall, Save and Print, or mesh it in Gmsh to a .msh and name that"
        )
    if done.returncode < 0:
        other = ", or mesh it to a .msh there" if path.suffix.lower() in GEOMETRY else ""
        raise InputError(f"{path}: Gmsh crashed while reading it; open it in Gmsh{other}")
    if done.returncode == _REJECTED:
        raise InputError(f"{path}: {said}")
    if done.returncode:
        reason = said.splitlines()[-1] if said else "it gives no reason"
        raise InputError(f"{path}: Gmsh cannot read it: {reason}; is the file complete?")


def _check(path: Path) -> None:
    """Reject what Gmsh would run although it is no .geo."""
    if find_spec("gmsh") is None:
        raise InputError(f"{path}: reading Gmsh files needs gmsh's Python module (python3-gmsh)")
    begin = _BEGINS.get(path.suffix.lower(), b"")
    with path.open("rb") as file:
        if file.read(len(begin)) != begin:
            raise InputError(f"{path}: a file that ends in {path.suffix} begins with {begin.decode()}")
    options = path.with_name(f"{path.name}.opt")
    if os.path.lexists(options):
        where = "move its lines into the .geo" if path.suffix.lower() == ".geo" else "remove or rename it"
        raise InputError(f"{options}: options beside a mesh file, which Gmsh would run, are not taken: {where}")


def _arrays(file: Path) -> Arrays:
    with np.load(file, allow_pickle=False) as stored:
        arrays = dict(stored)
    content = sha256()
    for name in sorted(arrays):
        content.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode() + arrays[name].tobytes())
    words, _ = json.loads(str(arrays.pop("words"))), arrays.pop("samples")
    return Arrays(**words, **arrays, content=content.hexdigest())


def _run(source: str, target: str) -> int:
    import gmsh

    gmsh.initialize([], False)
    gmsh.option.setNumber("General.Terminal", 0)
    suffix = Path(source).suffix.lower()
    if cad := suffix in GEOMETRY[1:]:
        gmsh.option.setNumber("Geometry.OCCImportLabels", 1)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", PER_TURN)
    given: dict[str, np.ndarray] = {}  # the points to be moved; none where a mesh is wanted
    if Path(target).exists():
        with np.load(target, allow_pickle=False) as stored:
            given = dict(stored)
    try:
        with open(target, "wb") as out:  # opened before the process may open no file
            if not confine() and suffix == ".geo":
                why = "libseccomp2 is missing, or the system does not allow it"
                raise InputError(f"a .geo is a program, which nothing confines here ({why}): mesh it in Gmsh")
            gmsh.open(source)
            if cad:
                join_bodies(gmsh.model)
            if given:
                points = on_cad(gmsh.model, given["points"], given["rows"], given["entities"])
                np.savez(out, points=points)
                return 0
            if cad:
                name_bodies(gmsh.model)
            if suffix in GEOMETRY:
                gmsh.model.mesh.generate(gmsh.model.getDimension())
            words, arrays = arrays_of(gmsh.model)
            shape = np.empty(0)
            if suffix in GEOMETRY:
                words["remarks"] += ungrouped_cells(gmsh.model)
                shape = samples(gmsh.model)
            np.savez(out, words=json.dumps(words), samples=shape, **arrays)
    except InputError as error:
        sys.stdout.write(f"{error}\n")
        return _REJECTED
    except Exception as error:  # gmsh raises the base class, whatever is wrong
        sys.stdout.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_run(*sys.argv[1:]))

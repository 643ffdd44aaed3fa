"""Gmsh in a separate process, since a file that it cannot read may end the process.

`python -m fenicsx_obstacle.discrete.meshing FILE ARRAYS` writes the mesh of a .geo, .step or .msh file as NumPy arrays,
or, if there are arrays already, moves the points in them to the CAD geometry of the .geo or .step; if that fails it
prints the reason and leaves with status 1 (Gmsh's reason) or 2 (ours).
"""

from __future__ import annotations

import glob
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from fenicsx_obstacle.discrete.gmsh_model import (
    Arrays,
    arrays_of,
    join_bodies,
    name_bodies,
    on_cad,
    straight,
    ungrouped_cells,
)
from fenicsx_obstacle.errors import InputError

_REJECTED = 2  # exit status
DIMENSIONS = {"interval": 1, "triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
GEOMETRY = (".geo", ".step", ".stp")  # files that have a geometry, from which Gmsh makes the mesh
PER_TURN = 12  # cells around a circle of a STEP file, which says nothing of sizes
FORMAT = b"5"  # of what is kept
# commands of a .geo by which its mesh may depend on more than its text
_ELSEWHERE = re.compile(rb"\b(Merge|Include|ShapeFromFile|System\w*|GetEnv|Onelab\w*|Exists|FileExists)\b")


def load(path: Path) -> Arrays:
    """The mesh of a Gmsh file (one rank).

    That of a .geo or .step is kept beside it, as long as its text and the Gmsh that is installed stay the same.

    Raises:
        InputError: With what Gmsh says, or what is wrong with the mesh.
    """
    kept = _kept(path)
    if kept is not None:
        with suppress(OSError, ValueError, LookupError, BadZipFile):  # not there, or damaged
            return _arrays(kept)
    with tempfile.TemporaryDirectory() as folder:
        arrays = Path(folder) / "mesh.npz"
        _start(path, arrays)
        if kept is not None:
            _keep(arrays, path, kept)
        return _arrays(arrays)


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
        with np.load(arrays) as stored:
            return stored["points"]


def _start(path: Path, arrays: Path) -> None:
    """Run this module for a file.

    Raises:
        InputError: As `load`.
    """
    command = [sys.executable, "-m", __name__, str(path), str(arrays)]
    # the process is no rank: MPICH would take it for one
    env = {name: value for name, value in os.environ.items() if not name.startswith("PMI_")}
    done = subprocess.run(command, env=env, capture_output=True, text=True, errors="replace", check=False)
    said = done.stdout.strip()
    if done.returncode < 0:
        other = ", or mesh it to a .msh there" if path.suffix.lower() in GEOMETRY else ""
        raise InputError(f"{path}: Gmsh crashed while reading it; open it in Gmsh{other}")
    if done.returncode == _REJECTED:
        raise InputError(f"{path}: {said}")
    if done.returncode:
        reason = said.splitlines()[-1] if said else "it gives no reason"
        raise InputError(f"{path}: Gmsh cannot read it: {reason}; is the file complete?")


def _arrays(file: Path) -> Arrays:
    with np.load(file) as stored:
        words = json.loads(str(stored["words"]))
        return Arrays(
            stored["points"], words["cell"], stored["cells"], tuple(words["materials"]), stored["cell_material"],
            tuple(words["parts"]), stored["facets"], stored["facet_part"], stored["bent"], stored["bent_entity"],
            stored["cell_entity"], words["straight"], tuple(words["remarks"]),
        )  # fmt: skip


def _kept(path: Path) -> Path | None:
    """The file in which the mesh of a .geo or .step is stored; None for other files, and for a .geo that includes
    further files."""
    if path.suffix.lower() not in GEOMETRY:
        return None
    try:
        text, program = path.read_bytes(), find_spec("gmsh")
        if program is None or program.origin is None:
            return None
        if path.suffix == ".geo" and _ELSEWHERE.search(text):
            return None
        parts = (text, str(Path(program.origin).stat().st_mtime_ns).encode(), FORMAT)
    except OSError:
        return None
    key = sha256(b"\0".join(parts)).hexdigest()[:16]
    return path.with_name(f".{path.name}.{key}.npz")


def _keep(arrays: Path, path: Path, kept: Path) -> None:
    """Put a mesh beside its .geo, in place of that of an earlier text, where that can be done."""
    scratch = kept.with_name(f"{kept.name}.{os.getpid()}")
    try:
        shutil.copyfile(arrays, scratch)
        scratch.replace(kept)
    except OSError:
        with suppress(OSError):
            scratch.unlink()
        return
    for other in path.parent.glob(f".{glob.escape(path.name)}.{'?' * 16}.npz"):
        if other != kept:
            other.unlink(missing_ok=True)


def _run(source: str, target: str) -> int:
    import gmsh

    gmsh.initialize([], False)
    gmsh.option.setNumber("General.Terminal", 0)
    suffix = Path(source).suffix.lower()
    if cad := suffix in GEOMETRY[1:]:
        gmsh.option.setNumber("Geometry.OCCImportLabels", 1)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", PER_TURN)
    try:
        gmsh.open(source)
        joined = join_bodies(gmsh.model) if cad else []
        if Path(target).exists():
            with np.load(target) as given:
                points = on_cad(gmsh.model, given["points"], given["rows"], given["entities"])
                np.savez(target, points=points)
            return 0
        if cad:
            name_bodies(gmsh.model)
        if suffix in GEOMETRY:
            gmsh.model.mesh.generate(gmsh.model.getDimension())
        found = arrays_of(gmsh.model)
        remarks = [*joined, *found.remarks, *(ungrouped_cells(gmsh.model) if suffix in GEOMETRY else ())]
        words = {
            "cell": found.cell, "materials": found.materials, "parts": found.parts, "remarks": remarks,
            "straight": straight(gmsh.model, DIMENSIONS[found.cell]),
        }  # fmt: skip
        np.savez(
            target, words=json.dumps(words), points=found.points, cells=found.cells, facets=found.facets,
            cell_material=found.cell_material, facet_part=found.facet_part, bent=found.bent,
            bent_entity=found.bent_entity, cell_entity=found.cell_entity,
        )  # fmt: skip
    except InputError as error:
        sys.stdout.write(f"{error}\n")
        return _REJECTED
    except Exception as error:  # gmsh raises the base class, whatever is wrong
        sys.stdout.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_run(*sys.argv[1:]))

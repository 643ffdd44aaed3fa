"""Gmsh meshes a geometry in a process of its own: what it cannot mesh may end the process.

`python -m fenicsx_obstacle.discrete.meshing GEOMETRY MESH`; it says what is wrong and leaves with status 1.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fenicsx_obstacle.errors import InputError


@contextmanager
def meshed(geometry: Path) -> Iterator[Path]:
    """The mesh of a geometry as a file that is gone afterwards (one rank).

    Raises:
        InputError: With what Gmsh says.
    """
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "mesh.msh"
        command = [sys.executable, "-m", __name__, str(geometry), str(mesh)]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode < 0:
            raise InputError(f"{geometry}: Gmsh crashed on it: look at it in Gmsh, or mesh it to a .msh there")
        if done.returncode:
            said = done.stdout.strip().splitlines()
            raise InputError(f"{geometry}: Gmsh cannot read it: {said[-1] if said else 'without a word'}")
        yield mesh


def _mesh(geometry: str, mesh: str) -> int:
    import gmsh

    gmsh.initialize([], False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.Binary", 1)
    gmsh.option.setNumber("Mesh.SaveAll", 0)
    try:
        gmsh.open(geometry)
        gmsh.model.mesh.generate(gmsh.model.getDimension())
        gmsh.write(mesh)
    except Exception as error:  # gmsh raises the base class, whatever is wrong
        sys.stdout.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_mesh(*sys.argv[1:]))

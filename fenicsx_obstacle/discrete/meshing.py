"""Gmsh reads and meshes in a process of its own: what it cannot read may end the process.

`python -m fenicsx_obstacle.discrete.meshing FILE ARRAYS` writes the mesh of a .geo or .msh file as NumPy arrays; if
that fails it prints the reason and leaves with status 1 (Gmsh's reason) or 2 (ours).
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from fenicsx_obstacle.discrete.gmsh_model import Arrays, arrays_of, straight
from fenicsx_obstacle.errors import InputError

_REJECTED = 2  # exit status


def load(path: Path) -> Arrays:
    """The mesh of a Gmsh file (one rank).

    Raises:
        InputError: With what Gmsh says, or what is wrong with the mesh.
    """
    with tempfile.TemporaryDirectory() as folder:
        arrays = Path(folder) / "mesh.npz"
        command = [sys.executable, "-m", __name__, str(path), str(arrays)]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        said = done.stdout.strip()
        if done.returncode < 0:
            other = ", or mesh it to a .msh there" if path.suffix == ".geo" else ""
            raise InputError(f"{path}: Gmsh crashed on it: look at it in Gmsh{other}")
        if done.returncode == _REJECTED:
            raise InputError(f"{path}: {said}")
        if done.returncode:
            reason = said.splitlines()[-1] if said else "it gives no reason"
            raise InputError(f"{path}: Gmsh cannot read it: {reason}; is it whole?")
        with np.load(arrays) as file:
            words = json.loads(str(file["words"]))
            return Arrays(
                file["points"], file["cells"], tuple(words["materials"]), file["cell_material"],
                tuple(words["parts"]), file["facets"], file["facet_part"],
                words["straight"], tuple(words["remarks"]),
            )  # fmt: skip


def _run(source: str, target: str) -> int:
    import gmsh

    gmsh.initialize([], False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        gmsh.open(source)
        if source.endswith(".geo"):
            gmsh.model.mesh.generate(gmsh.model.getDimension())
        found = arrays_of(gmsh.model)
        words = {
            "materials": found.materials, "parts": found.parts, "remarks": found.remarks,
            "straight": straight(gmsh.model, found.cells.shape[1] - 1),
        }  # fmt: skip
        np.savez(
            target, words=json.dumps(words), points=found.points, cells=found.cells, facets=found.facets,
            cell_material=found.cell_material, facet_part=found.facet_part,
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

"""All cases, and the valid files that some of them truncate."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from tests.cli.broken.case import Broken
from tests.cli.broken.files import broken_files, broken_heights, broken_meshes, contradictions
from tests.cli.broken.lines import broken_lines
from tests.cli.broken.options import RESULT, broken_options, torn_results

RIGHT = "right"  # folder of the files that are torn
GEOMETRY = """SetFactory("OpenCASCADE");
Rectangle(1) = {{0, 0, 0, 1, 1}};
Physical Surface("plate") = {{1}};
Physical Curve("bottom") = {{1}};
Mesh.MeshSizeMax = 0.3;
Mesh.Binary = {binary};
Mesh.MshFileVersion = {version};
"""
# run in a process of its own, as Gmsh may end the process that it is in
MESHING = """import sys
import gmsh
gmsh.initialize([], False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
gmsh.model.mesh.generate(2)
gmsh.write(sys.argv[2])
"""
FORMATS = {"text": (0, 4.1), "binary": (1, 4.1), "old": (0, 2.2)}


def prepare(root: Path, environment: Mapping[str, str]) -> None:
    """Make the right files in a folder, by programs as a user runs them (one rank)."""
    make_meshes(root)
    result = str(root / RIGHT / RESULT)
    solve = [sys.executable, "-P", "-m", "fenicsx_obstacle", "solve", "disk_flat", "--cells", "8", "--output", result]
    subprocess.run(solve, env=environment, check=True, capture_output=True)


def make_meshes(root: Path) -> None:
    """Only the mesh files (one rank)."""
    right = root / RIGHT
    right.mkdir(parents=True)
    for name, (binary, version) in FORMATS.items():
        geometry = right / f"{name}.geo"
        geometry.write_text(GEOMETRY.format(binary=binary, version=version))
        subprocess.run([sys.executable, "-P", "-c", MESHING, str(geometry), str(right / f"{name}.msh")], check=True)


def collect(root: Path) -> list[Broken]:
    """All cases; `root` has been prepared."""
    right = root / RIGHT
    result = {path.name: path.read_bytes() for path in sorted((right / RESULT).iterdir()) if path.is_file()}
    meshes = {name: (right / name).read_bytes() for name in ("text.msh", "binary.msh", "old.msh", "text.geo")}
    meshes |= {name: result[name] for name in ("fields.xdmf", "fields.h5")}
    return [*broken_lines(), *broken_files(), *contradictions(), *broken_heights(), *broken_meshes(meshes),
            *broken_options(), *torn_results(result)]  # fmt: skip

"""A saved answer: a folder that ParaView opens and that is read back on any number of ranks."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.linear import linear
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import gathered, new_files, on_root
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.solvers.stopping import Step

_TOPOLOGY = {2: "Polyline", 3: "Triangle", 4: "Tetrahedron"}
_CELL = {2: "interval", 3: "triangle", 4: "tetrahedron"}
DERIVED = ("gap",)  # written for ParaView, not read back


def save(answer: Answer, folder: Path) -> None:
    """Write an answer; of what is in the folder only an older answer is replaced (collective)."""
    arrays = gather(answer)
    comm = answer.level.comm
    with new_files(comm, folder) as scratch:

        def write() -> None:
            contents = {
                "scene.toml": _scene_there(answer.scene, folder).toml().encode(),
                "answer.json": (json.dumps(dict(answer.record), indent=1) + "\n").encode(),
                "history.csv": _history(answer.history).encode(),
                "fields.h5": _hdf5(arrays),
                "fields.xdmf": _xdmf(arrays).encode(),
            }
            try:
                for name, content in contents.items():
                    (scratch / name).write_bytes(content)
            except OSError as error:
                raise InputError(f"{folder}: cannot be written: {error.strerror}; what was there stays") from None

        on_root(comm, write)


def read(folder: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> Answer:
    """Read an answer (collective)."""

    def load() -> tuple[dict[str, Any], dict[str, np.ndarray], tuple[Step, ...]]:
        for name in ("answer.json", "fields.h5", "scene.toml", "history.csv"):
            if not (folder / name).exists():
                raise InputError(f"{folder}: holds no saved answer ({name} is missing)")
        try:
            with h5py.File(folder / "fields.h5") as file:
                arrays = {name: values[()] for name, values in file.items()}
        except (OSError, ValueError) as error:
            raise InputError(f"{folder}: the saved answer is damaged: fields.h5: {error}") from None
        if missing := sorted({"points", "cells", "gdim", "u", "pressure", "contact"} - set(arrays)):
            raise InputError(f"{folder}: the saved answer is damaged: fields.h5 has no {', '.join(missing)}")
        return _record(folder), arrays, _steps(folder)

    record, arrays, steps = on_root(comm, load)
    mesh, points, cells = None, arrays.pop("points"), arrays.pop("cells")
    gdim, kind = int(arrays.pop("gdim")), _CELL[cells.shape[1]]
    mine = slice(None) if comm.rank == 0 else slice(0, 0)
    mesh = releases.create_mesh(comm, cells[mine], points[mine, :gdim], kind)
    level = Level(mesh, record["h"])
    V = level.V
    # where each dof stood when it was saved
    saved = np.asarray(mesh.geometry.input_global_indices)[releases.dof_nodes(V)]
    fields: dict[str, fem.Function] = {}
    for name in set(arrays) - set(DERIVED):
        fields[name] = fem.Function(V)
        fields[name].x.array[:] = arrays[name][saved]
    return Answer(
        Scene.read(folder / "scene.toml"), level, fields["u"], fields["pressure"], fields["contact"],
        fields.get("lower"), fields.get("upper"), fields.get("error"), steps, record,
    )  # fmt: skip


def _record(folder: Path) -> dict[str, Any]:
    try:
        record = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
        if not isinstance(record, dict) or not {"scene", "h", "eps", "contact"} <= set(record):
            raise ValueError("it holds no figures")
        return record
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: the saved answer is damaged: answer.json: {error}") from None


def _steps(folder: Path) -> tuple[Step, ...]:
    try:
        rows = list(csv.DictReader(io.StringIO((folder / "history.csv").read_text(encoding="utf-8"))))
        steps = [Step(int(r["active"]), int(r["changed"]), float(r["unbalanced"]), float(r["forces"]), int(r["krylov"]))
                 for r in rows]  # fmt: skip
        if not steps:
            raise ValueError("it holds no steps")
        return tuple(steps)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(f"{folder}: the saved answer is damaged: history.csv: {error}") from None


def _scene_there(scene: Scene, folder: Path) -> Scene:
    """The scene as it can be read from its folder: a mesh of the caller's own is the one in fields.xdmf."""
    file = scene.tables.mesh.file
    if scene.mesh is not None:
        return scene.with_mesh_file("fields.xdmf")
    if file is None:
        return scene
    return scene.change({"mesh.file": os.path.relpath((scene.folder / file).resolve(), folder.resolve())})


def gather(answer: Answer) -> dict[str, np.ndarray]:
    """Points, cells and fields of all ranks on rank 0, numbered by global dof; empty elsewhere (collective)."""
    answer = linear(answer)
    level = answer.level
    comm, owned = level.comm, level.owned
    own_cells = level.mesh.topology.index_map(level.mesh.topology.dim).size_local
    numbering = level.V.dofmap.index_map
    dofs = releases.cell_dofs(level.V)[:own_cells]
    cells = np.asarray(numbering.local_to_global(dofs.astype(np.int32).ravel())).reshape(dofs.shape)
    parts = {"points": level.points.T[:owned], "cells": cells}
    parts |= {name: function.x.array[:owned].real for name, function in answer.functions().items()}
    found = {name: gathered(comm, values) for name, values in parts.items()}
    if comm.rank != 0:
        return {}
    arrays = {name: values for name, values in found.items() if values is not None}
    gaps = [sign * (arrays[name] - arrays["u"]) for name, sign in (("lower", -1), ("upper", 1)) if name in arrays]
    if gaps:
        arrays["gap"] = np.min(gaps, axis=0)
    arrays["gdim"] = np.array(level.mesh.geometry.dim)
    return arrays


def _hdf5(arrays: dict[str, np.ndarray]) -> bytes:
    """An HDF5 file; made in memory, since the library ends the process where a disk is full."""
    with h5py.File("fields.h5", "w", driver="core", backing_store=False) as file:
        for name, values in arrays.items():
            file[name] = values
        file.flush()
        return bytes(file.id.get_file_image())


def _history(steps: tuple[Step, ...]) -> str:
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["step", *Step.__annotations__])
    for number, step in enumerate(steps):
        writer.writerow([number, *vars(step).values()])
    return text.getvalue()


def _xdmf(arrays: dict[str, np.ndarray]) -> str:
    """One grid with all fields on it: ParaView then shows them together."""
    points, cells = arrays["points"], arrays["cells"]
    shape = " ".join(map(str, cells.shape))
    attributes = "".join(
        f'<Attribute Name="{name}" AttributeType="Scalar" Center="Node"><DataItem Dimensions="{len(points)}" '
        f'NumberType="Float" Precision="8" Format="HDF">fields.h5:/{name}</DataItem></Attribute>\n'
        for name in arrays
        if name not in ("points", "cells", "gdim")
    )
    return (
        '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain><Grid Name="answer" GridType="Uniform">\n'
        f'<Topology TopologyType="{_TOPOLOGY[cells.shape[1]]}" NumberOfElements="{len(cells)}" '
        f'NodesPerElement="{cells.shape[1]}"><DataItem Dimensions="{shape}" NumberType="Int" Precision="8" '
        'Format="HDF">fields.h5:/cells</DataItem></Topology>\n'
        f'<Geometry GeometryType="XYZ"><DataItem Dimensions="{len(points)} 3" NumberType="Float" Precision="8" '
        f'Format="HDF">fields.h5:/points</DataItem></Geometry>\n{attributes}</Grid></Domain></Xdmf>\n'
    )

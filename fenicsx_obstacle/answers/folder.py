"""A saved answer: a folder that ParaView opens and that is read back on any number of ranks."""

from __future__ import annotations

import csv
import io
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.element import OWN_MESH, element_of, mesh_of, own_mesh, restored
from fenicsx_obstacle.answers.paraview import FRAMES, to_hdf5, xdmf
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import P1
from fenicsx_obstacle.parallel import gathered, new_files, on_root
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.solvers.stopping import Step

if TYPE_CHECKING:
    from fenicsx_obstacle.answers.answer import Answer
    from fenicsx_obstacle.answers.course import Course

NEWTON = "newton.csv"  # the last moment's iteration, where history.csv is the course of time
STEPS = "newton.gif"  # drawn on demand; of an older answer it goes like what belongs to time
_OF_TIME = {NEWTON, *FRAMES}
FIELDS = ("u", "pressure", "contact", "lower", "upper", "error")
DERIVED = ("gap",)  # written for ParaView, not read back


def save(answer: Answer, folder: Path) -> None:
    """Write an answer; of what is in the folder only an older answer is replaced (collective)."""
    arrays, element = gather(answer), element_of(answer)
    comm = answer.level.comm
    with new_files(comm, folder) as scratch:

        def write() -> None:
            contents = {
                "scene.toml": _scene_there(answer.scene, folder).toml().encode(),
                "answer.json": (json.dumps(dict(answer.record), indent=1) + "\n").encode(),
                "history.csv": _history(answer.history).encode(),
                "fields.h5": to_hdf5(arrays | {f"element/{name}": values for name, values in element.items()}),
                "fields.xdmf": xdmf(arrays, {None: arrays}).encode(),
            }
            if element and answer.scene.mesh is not None:
                contents |= own_mesh(arrays["points"][:, : arrays["gdim"]], element)
            if answer.course is not None:
                from fenicsx_obstacle.answers.frames import files_of  # only where a scene has time

                contents |= {NEWTON: contents["history.csv"], **files_of(answer.course, arrays)}
            try:
                for name, content in contents.items():
                    (scratch / name).write_bytes(content)
                state = {"checkpoint.h5"} if answer.course is None else set[str]()
                for name in ({STEPS, *OWN_MESH, *_OF_TIME} | state) - set(contents):
                    (folder / name).unlink(missing_ok=True)
            except OSError as error:
                raise InputError(f"{folder}: cannot be written: {error.strerror}; what was there stays") from None

        on_root(comm, write)


def read(kind: type[Answer], folder: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> Answer:
    """Read an answer, of this class (collective)."""

    def load() -> tuple[dict[str, Any], dict[str, np.ndarray], dict[str, np.ndarray], tuple[Step, ...], Course | None]:
        if folder.is_file():
            raise InputError(f"{folder}: a file, not the folder of a saved answer")
        for name in ("answer.json", "fields.h5", "scene.toml", "history.csv"):
            if not (folder / name).exists():
                raise InputError(f"{folder}: holds no saved answer ({name} is missing)")
        try:
            with h5py.File(folder / "fields.h5") as file:
                arrays, element = _datasets(file), _datasets(file.get("element", {}))
        except (OSError, ValueError) as error:
            raise InputError(f"{folder}: the saved answer is damaged: fields.h5: {error}") from None
        missing = {"points", "cells", "gdim", "u", "pressure", "contact"} - set(arrays)
        if element:
            missing |= {f"element/{name}" for name in {"cell", "cells"} - set(element)}
        if missing:
            raise InputError(f"{folder}: the saved answer is damaged: fields.h5 has no {', '.join(sorted(missing))}")
        record = _record(folder)
        if "time" in record:
            from fenicsx_obstacle.answers.frames import load_course

            return record, arrays, element, _steps(folder / NEWTON, record), load_course(folder)
        return record, arrays, element, _steps(folder / "history.csv", record), None

    record, arrays, element, steps, course = on_root(comm, load)
    scene = Scene.read(folder / "scene.toml")
    # version 0.1 kept the nodal values on cut cells alone: what it saved of other elements is P1
    pair = scene.pair if element or scene.pair.nests else P1
    level = mesh_of(arrays, element, int(arrays["gdim"]), record["h"], comm, pair)
    try:
        fields = restored(level, {name: arrays[name] for name in FIELDS if name in arrays}, element)
    except InputError as error:
        raise InputError(f"{folder}: the saved answer is damaged: fields.h5: {error}") from None
    answer = kind(
        scene, level, fields["u"], fields["pressure"], fields["contact"],
        fields.get("lower"), fields.get("upper"), fields.get("error"), steps, record,
    )  # fmt: skip
    if course is None:
        return answer
    shown = answer.plain.level
    return replace(answer, course=course.renumbered(arrays["points"], gathered(comm, shown.points.T[: shown.owned])))


def _datasets(group: Any) -> dict[str, np.ndarray]:
    return {name: values[()] for name, values in group.items() if isinstance(values, h5py.Dataset)}


def _record(folder: Path) -> dict[str, Any]:
    try:
        record = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
        if not isinstance(record, dict) or not {"scene", "h", "eps", "contact", "newton_iterations"} <= set(record):
            raise ValueError("it holds no figures")
        return record
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: the saved answer is damaged: answer.json: {error}") from None


def _steps(file: Path, record: dict[str, Any]) -> tuple[Step, ...]:
    try:
        text = file.read_text(encoding="utf-8")
        rows = list(csv.DictReader(io.StringIO(text)))
        steps = [Step(int(r["active"]), int(r["changed"]), float(r["unbalanced"]), float(r["forces"]), int(r["krylov"]))
                 for r in rows]  # fmt: skip
        # one for each Newton step, and one for the start
        if not text.endswith("\n") or len(steps) <= record["newton_iterations"]:
            raise ValueError("its end is missing")
        return tuple(steps)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(f"{file.parent}: the saved answer is damaged: {file.name}: {error}") from None


def _scene_there(scene: Scene, folder: Path) -> Scene:
    """The scene as it can be read from its folder: a mesh of the caller's own is the one in fields.xdmf."""
    file = scene.tables.mesh.file
    if scene.mesh is not None:
        return scene.with_mesh_file("fields.xdmf" if scene.pair.nests else OWN_MESH[0])
    if file is None:
        return scene
    return scene.change({"mesh.file": os.path.relpath((scene.folder / file).resolve(), folder.resolve())})


def fields_of(answer: Answer) -> dict[str, np.ndarray]:
    """The fields of `gather` alone, in single precision."""
    arrays = gather(answer)
    return {name: arrays[name].astype(np.float32) for name in (*FIELDS, *DERIVED) if name in arrays}


def gather(answer: Answer) -> dict[str, np.ndarray]:
    """Points, cells and fields of all ranks on rank 0, numbered by global dof; empty elsewhere (collective)."""
    answer = answer.plain
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


def _history(steps: tuple[Step, ...]) -> str:
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["step", *Step.__annotations__])
    for number, step in enumerate(steps):
        writer.writerow([number, *vars(step).values()])
    return text.getvalue()

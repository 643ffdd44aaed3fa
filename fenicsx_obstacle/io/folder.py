"""A saved solution: a folder that ParaView opens and that is read back on any number of ranks."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import file_digest
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.stopping import Step
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.cut import OnNodes, global_dofs
from fenicsx_obstacle.fields.scalar import Fields, with_gap
from fenicsx_obstacle.forms.pairs import pairs
from fenicsx_obstacle.io.element import OWN_MESH, element_of, mesh_of, restored
from fenicsx_obstacle.io.paraview import FRAMES, xdmf
from fenicsx_obstacle.io.rows import Offsets, Rows, fill, make_hdf5, mapped
from fenicsx_obstacle.io.validation import check_arrays, check_record
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.mesh.levels import vector_pair
from fenicsx_obstacle.mesh.named_parts import Groups, parts_of
from fenicsx_obstacle.parallel import agree, gathered, on_root
from fenicsx_obstacle.safe_writing import new_files, write_text

ANSWER = "answer.json"
STEPS = "newton.gif"  # drawn on demand; of an older solution it goes like what belongs to time
NODES = "nodes.csv"  # the contact nodes of an elastic body
_OF_SOME = {
    "scene.toml",
    NODES,
    "newton.csv",
    "checkpoint.h5",
    STEPS,
    *OWN_MESH,
    *FRAMES,
}  # files that not all folders have
_OTHERS = {"checkpoint.h5", STEPS}  # of these, files that do not belong to what is read
FIELDS = ("u", "pressure", "contact", "lower", "upper", "error")  # from which the gap follows
VECTORS = ("u0", "u1", "u2", "gap", "von_mises")  # further ones of vector-valued solutions


Further = Callable[[Path, Mapping[str, Rows], Mapping[str, Rows], Mapping[str, np.ndarray]], dict[str, bytes]]


def save(folder: Path, fields: Fields, history: tuple[Step, ...], record: Mapping[str, Any], more: Further) -> None:
    """Write a solution into a folder; other files in the folder are kept (collective).

    Each rank writes its own rows of fields.h5: the folder is on a file system that all share.

    Args:
        folder: Where to.
        fields: Of the solution.
        history: Its Newton steps.
        record: Its values.
        more: Further files by their names, on rank 0, of the folder, of points, cells and fields, of the group
            `element` of fields.h5, and of the named parts.

    Raises:
        InputError: If the folder cannot be written.
    """
    level = fields.level.scalar
    comm, nests = level.comm, level.pair.nested_hierarchy
    shown = fields.on_nodes()
    own, nodes = _own(fields, shown), None if nests else _nodes(fields, shown)
    mesh = {name: Rows.of(comm, values) for name, values in own.items()}
    element = element_of(fields, nodes)
    # cut cells are none of the mesh: its parts go with the true ones
    parts = parts_of(level, own["cells"] if nodes is None else nodes)
    further = more(folder, mesh, element, parts)
    place = "" if nests else "element/"
    rows = {**mesh, **{f"element/{name}": values for name, values in element.items()}}
    whole = {"gdim": np.array(level.mesh.geometry.dim), **{f"{place}parts/{name}": v for name, v in parts.items()}}
    whole |= fields.tables()
    if element:
        whole["element/cell"] = np.array(releases.cell_name(level.mesh).encode())
    kept = {"checkpoint.h5"} if "time" in record else set[str]()
    with new_files(comm, folder) as scratch:

        def write() -> Offsets:
            contents = {
                "history.csv": history_csv(history),
                "fields.xdmf": xdmf(mesh, {None: mesh}).encode(),
                **further,
            }
            with _told(folder):
                for name, content in contents.items():
                    (scratch / name).write_bytes(content)
                return make_hdf5(scratch / "fields.h5", rows, whole)

        def remove_others() -> None:
            with _told(folder):
                for name in _OF_SOME - kept - set(further):
                    (folder / name).unlink(missing_ok=True)

        def write_answer() -> None:
            with _told(folder):
                files = {file.name: content_of(file) for file in scratch.iterdir()}
                (scratch / ANSWER).write_text(_answer(record, files), encoding="utf-8")

        offsets = on_root(comm, write)
        with agree(comm), _told(folder):
            fill(scratch / "fields.h5", rows, offsets)
        on_root(comm, write_answer)
    on_root(comm, remove_others)


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write answer.json anew, with further values (one rank).

    Raises:
        InputError: If it cannot be written.
    """
    write_text(folder / ANSWER, _answer(record, json.loads((folder / ANSWER).read_text(encoding="utf-8"))["files"]))


def _answer(record: Mapping[str, Any], files: Mapping[str, str]) -> str:
    """The text of answer.json: all values, and the contents of the files that belong to it."""
    return json.dumps({**record, "files": files}, indent=1) + "\n"


def content_of(file: Path) -> str:
    """A hash of the content of a file (one rank).

    Raises:
        OSError: If it cannot be read.
    """
    with file.open("rb") as stream:
        return file_digest(stream, "sha256").hexdigest()


@contextmanager
def _told(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}; the old content stays") from None


@dataclass(frozen=True, eq=False)
class Saved:
    """The contents of a folder.

    Attributes:
        fields: The fields, on its mesh.
        history: The Newton steps.
        record: All values.
        bound: Bound of the energy error, or None.
        mesh: `points`, shape (n, 3), and `cells` in the order of the files.
    """

    fields: Fields
    history: tuple[Step, ...]
    record: dict[str, Any]
    bound: Any
    mesh: dict[str, np.ndarray]


def read(folder: Path, comm: MPI.Comm, needed: tuple[str, ...] = (), steps_in_time: str = "history.csv") -> Saved:
    """Read a solution (collective).

    Args:
        folder: A folder of `save`.
        comm: The ranks that share its mesh.
        needed: Further files that must be there.
        steps_in_time: Where the steps of the iteration stand if history.csv has the course of time.

    Raises:
        InputError: If it holds none, or a damaged one.
    """

    def load() -> tuple[dict[str, Any], tuple[Step, ...]]:
        if folder.is_file():
            raise InputError(f"{folder}: a file, not the folder of a saved answer")
        for name in (ANSWER, "fields.h5", *needed, "history.csv"):
            if not (folder / name).is_file():
                if name == "scene.toml":
                    raise InputError(
                        f"{folder}: holds a solution of ObstacleProblem, without a scene (scene.toml is missing): read "
                        "it in Python by Solution.read"
                    )
                raise InputError(f"{folder}: holds no saved answer ({name} is missing)")
        record = _record(folder)
        return record, _steps(folder / (steps_in_time if "time" in record else "history.csv"), record)

    record, steps = on_root(comm, load)
    with agree(comm):
        stored = _stored(folder / "fields.h5", comm.rank)
    arrays, element = _group(stored, ""), _group(stored, "element/")
    parts = _group(stored, "element/parts/" if element else "parts/")
    name = record["element"]
    if name not in pairs():
        raise InputError(f"{folder}: element '{name}' is not known here: register it first, or load its plug-in")
    pair = pairs()[name]
    if not element and not pair.nested_hierarchy:
        raise InputError(f"{folder}: saved by version 0.1, without its element; version 0.2 reads it")
    vector_valued = arrays["u"].ndim == 2
    if vector_valued:
        pair = vector_pair(pair)
        gdim = min(int(arrays["gdim"]), arrays["u"].shape[1])
        arrays = arrays | {f"u{k}": arrays["u"][:, k] for k in range(gdim)}
        del arrays["u"]
    try:
        check_arrays(arrays, element, parts, pair, comm)
        level = mesh_of(arrays, element, parts, record["h"], comm, pair)
        names = FIELDS + VECTORS if vector_valued else FIELDS
        functions = restored(level, {name: arrays[name] for name in names if name in arrays}, element)
    except (InputError, LookupError, ValueError) as error:
        raise InputError(f"{folder}: the saved answer is damaged: fields.h5: {error}") from None
    for name, function in functions.items():
        function.name = name
    bound = None
    if "bound" in record:
        from fenicsx_obstacle.estimation.bound import Bound  # only where it was asked for

        try:
            bound = Bound.read(record["bound"])
        except (TypeError, AttributeError) as error:
            raise InputError(f"{folder}: the saved answer is damaged: {ANSWER}: bound: {error}") from None
    if vector_valued:
        from fenicsx_obstacle.fields.vector import VectorFields  # no scalar solution needs it

        fields: Fields = VectorFields.restored(level, functions, _group(stored, "nodes/"))
    else:
        fields = Fields(level, **functions)
    return Saved(fields, steps, record, bound, {name: arrays[name] for name in ("points", "cells")})


def _stored(file: Path, rank: int) -> dict[str, np.ndarray]:
    """The arrays of fields.h5 (local)."""
    try:
        file.open("rb").close()
    except OSError as error:
        why = f"rank {rank} cannot read it: {error.strerror}; use a file system that all ranks share"
        raise InputError(f"{file}: {why}") from None
    try:
        found = mapped(file)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.parent}: the saved answer is damaged: fields.h5: {error}") from None
    needed = {"points", "cells", "gdim", "u", "pressure", "contact"}
    if any(name.startswith("element/") for name in found):
        needed |= {"element/cell", "element/cells"}
    if missing := needed - set(found):
        words = f"fields.h5 has no {', '.join(sorted(missing))}"
        raise InputError(f"{file.parent}: the saved answer is damaged: {words}")
    return found


def _group(arrays: Mapping[str, np.ndarray], group: str) -> Groups:
    """The arrays of a group, without those of groups within it."""
    found = {name.removeprefix(group): values for name, values in arrays.items() if name.startswith(group)}
    return {name: values for name, values in found.items() if "/" not in name}


def _record(folder: Path) -> dict[str, Any]:
    """The values of answer.json, once the files that it names are there as they were saved."""
    try:
        record = json.loads((folder / ANSWER).read_text(encoding="utf-8"))
        check_record(record)
    except RecursionError:
        raise InputError(f"{folder}: the saved answer is damaged: {ANSWER}: nested too deeply") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: the saved answer is damaged: {ANSWER}: {error}") from None
    files = record.pop("files", None)
    if files is None:  # of version 0.2
        return record
    if not isinstance(files, dict) or not {"fields.h5", "history.csv"} <= set(files):
        raise InputError(f"{folder}: the saved answer is damaged: {ANSWER}: 'files' names none")
    stray = sorted(name for name in _OF_SOME - files.keys() - _OTHERS if (folder / name).exists())
    for name, content in files.items():
        if Path(name).name != name or not (folder / name).is_file():
            raise InputError(f"{folder}: holds no saved answer ({name} is missing)")
        if content_of(folder / name) != content:
            stray.append(name)
    if stray:
        what = f"{stray[0]} is not the file that was saved with {ANSWER}"
        why = "it was changed, or saving was interrupted; solve again"
        raise InputError(f"{folder}: the saved answer is damaged: {what}: {why}")
    return record


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


def frame_of(fields: Fields) -> dict[str, np.ndarray]:
    """The fields of `gather` alone."""
    own = _own(fields, fields.on_nodes())
    return _gathered(fields.level.comm, {name: own[name] for name in own if name not in ("points", "cells")})


def gather(fields: Fields) -> dict[str, np.ndarray]:
    """Points, cells and fields of all ranks on rank 0, as pictures need them, numbered by global dof; empty elsewhere
    (collective)."""
    arrays = _gathered(fields.level.comm, _own(fields, fields.on_nodes()))
    return arrays | {"gdim": np.array(fields.level.mesh.geometry.dim)} if arrays else {}


def _gathered(comm: MPI.Comm, own: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    found = {name: gathered(comm, values) for name, values in own.items()}
    return {name: values for name, values in found.items() if values is not None}


def _nodes(fields: Fields, shown: OnNodes | None) -> np.ndarray:
    """Rows of the files that belong to the dofs of each owned cell (collective)."""
    return fields.cut.nodes if shown is None else global_dofs(shown.level, shown.nodes)


def _own(fields: Fields, shown: OnNodes | None) -> dict[str, np.ndarray]:
    """Points, cells and fields that this rank owns, on P1 simplices; cells by global dofs (collective)."""
    if shown is not None:
        level = shown.level
        values = with_gap({name: values[: level.owned] for name, values in shown.fields.items()})
        return {"points": level.points.T[: level.owned], "cells": global_dofs(level, shown.cells), **values}
    plain = fields.plain
    level = plain.level.scalar
    return {
        "points": level.points.T[: level.owned],
        "cells": global_dofs(level, releases.cell_dofs(level.V)[: own_cells(level.mesh)]),
        **plain.arrays(),
    }


def history_csv(steps: tuple[Step, ...]) -> bytes:
    """The steps of an iteration, a line each."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["step", *Step.__annotations__])
    for number, step in enumerate(steps):
        writer.writerow([number, *vars(step).values()])
    return text.getvalue().encode()

"""Checkpoints of scenes with [time], from which any number of ranks can continue."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fenicsx_obstacle.answers.steps import Steps
from fenicsx_obstacle.answers.time_history import TimeHistory, from_arrays, to_arrays
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.time_discretization import INERTIA, NO_STEP, TimeDiscretization
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.hdf5 import arrays
from fenicsx_obstacle.io.paraview import to_hdf5
from fenicsx_obstacle.parallel import agree, gathered, on_root, replaced

NAME = "checkpoint.h5"
NEAR = 1e-6  # of h: how far a node may be from where it was


def write(folder: Path, level: Level, steps: Steps, time_history: TimeHistory) -> None:
    """Write the state into a folder, in one step (collective).

    Raises:
        InputError: If it cannot be written.
    """
    own, comm = level.owned, level.comm
    fields = {"points": level.points.T[:own], **{f"u{k}": u[:own] for k, u in enumerate(steps.u_values)}}
    if steps.velocity is not None:
        fields["velocity"] = steps.velocity[:own]
    found = {name: gathered(comm, values) for name, values in fields.items()}

    def save() -> None:
        arrays = {name: values for name, values in found.items() if values is not None}
        arrays |= {
            "times": np.array(steps.times),
            "rows": np.array(json.dumps([dict(row) for row in time_history.rows]).encode()),
        }
        arrays |= {"eps": np.array(steps.eps)} if steps.eps is not None else {}
        arrays |= {f"frames/{name}": values for name, values in to_arrays(time_history.frames).items()}
        content = to_hdf5(arrays)
        try:
            with replaced(folder / NAME) as scratch:
                scratch.write_bytes(content)
        except OSError as error:
            raise InputError(f"{folder / NAME}: cannot be written: {error.strerror}") from None

    on_root(comm, save)


def read(folder: Path, level: Level, moments: TimeDiscretization) -> tuple[Steps, TimeHistory]:
    """The state that a folder holds (collective).

    Args:
        folder: Of a saved or of an interrupted solve.
        level: The same mesh, however it is distributed.
        moments: Of the scene that goes on.

    Raises:
        InputError: If there is none, or it is of another mesh or another kind of scene.
    """
    place, comm = folder / NAME, level.comm
    stored, time_history = on_root(comm, _load, place)
    points = gathered(comm, level.points.T[: level.owned])
    if level.pair.nested_hierarchy:
        time_history = time_history.renumbered(stored, {} if points is None else {"points": points})
    else:  # they are on cut cells
        time_history = TimeHistory(time_history.rows, ())
    distance, found = cKDTree(stored["points"]).query(level.points.T)
    elsewhere = bool(np.any(distance > NEAR * level.h)) or len(stored["points"]) != level.dofs
    with agree(comm):
        if elsewhere:
            raise InputError(f"{place}: belongs to another mesh: [mesh] must not change")
    velocity = stored["velocity"][found] if "velocity" in stored else None
    if (velocity is None) == (moments.order == INERTIA):
        raise InputError(f"{place}: is of a scene {'without' if velocity is None else 'with'} inertia")
    past = [stored[f"u{k}"][found] for k in range(len(stored["times"]))]
    steps = Steps(moments.order, moments.scheme, 0.0, past[0], velocity)
    steps.times = [float(t) for t in stored["times"][: steps.depth + 1]]
    steps.u_values = past[: steps.depth + 1]
    steps.eps = float(stored["eps"]) if "eps" in stored else None
    if steps.times[0] >= moments.end * (1 - NO_STEP):
        raise InputError(f"{place}: stands at {moments.name} = {steps.times[0]:g} already; set a later [time] end")
    return steps, time_history


def _load(place: Path) -> tuple[dict[str, np.ndarray], TimeHistory]:
    try:
        content = io.BytesIO(place.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(f"{place}: no state to continue from: {getattr(error, 'strerror', error)}") from None
    try:
        found = arrays(content)
        frames = {name.removeprefix("frames/"): found.pop(name) for name in [*found] if name.startswith("frames/")}
        rows, times = json.loads(found.pop("rows").item()), found["times"]
        count, past = len(found["points"]), [f"u{k}" for k in range(len(times))]
        if not past or times.dtype.kind != "f" or times.shape != (len(past),):
            raise ValueError("it holds no state")
        for name in ("points", "velocity", *past):
            if name in found or name in past:
                shape, kind = found[name].shape, found[name].dtype.kind
                if kind != "f" or shape[:1] != (count,) or (name == "points" and shape != (count, 3)):
                    raise ValueError(f"'{name}' has shape {shape}")
        if "eps" in found and not (found["eps"].dtype.kind == "f" and found["eps"].shape == () and found["eps"] > 0):
            raise ValueError("its eps is none")
        if not isinstance(rows, list) or not all(isinstance(row, dict) and {"step", "t"} <= set(row) for row in rows):
            raise ValueError("its rows are none")
        return found, TimeHistory(tuple(rows), tuple(from_arrays(frames, count)))
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{place}: is damaged: {error}") from None

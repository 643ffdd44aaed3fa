"""Files of a scene with [time]: history.csv, and fields at the saved times for ParaView."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from fenicsx_obstacle.answers.time_history import Frame, TimeHistory, from_arrays, from_csv, to_arrays, to_csv
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.hdf5 import arrays
from fenicsx_obstacle.io.paraview import FRAMES, Array, to_hdf5, xdmf


def files_of(time_history: TimeHistory, mesh: Mapping[str, Array]) -> dict[str, bytes]:
    """The files, by name (one rank).

    Args:
        time_history: Rows and frames.
        mesh: `points` and `cells` of the answer.
    """
    files = {"history.csv": to_csv(time_history.rows).encode()}
    if time_history.frames:
        moments: dict[float | None, Mapping[str, Array]] = {frame.t: frame.fields for frame in time_history.frames}
        files |= dict(zip(FRAMES, (to_hdf5(to_arrays(time_history.frames)), xdmf(mesh, moments).encode()), strict=True))
    return files


def load_course(folder: Path, count: int) -> TimeHistory:
    """Rows and frames (one rank).

    Args:
        folder: Of a saved answer.
        count: Number of nodes, each of which has a value in each field.

    Raises:
        InputError: If they are not there, or damaged.
    """
    frames: list[Frame] = []
    try:
        rows = from_csv((folder / "history.csv").read_text(encoding="utf-8"))
        if (folder / FRAMES[0]).exists():
            frames = from_arrays(arrays(folder / FRAMES[0]), count)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(f"{folder}: the saved answer is damaged: its time history: {error}") from None
    return TimeHistory(rows, tuple(frames))

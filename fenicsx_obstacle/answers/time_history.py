"""Results of a scene with [time]: a row of output quantities for each step, and fields at the saved times.

A saved answer has the rows in history.csv, and the fields in files for ParaView.
"""

from __future__ import annotations

import csv
import io
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fenicsx_obstacle.data.time_discretization import NO_STEP, TimeDiscretization
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.io.paraview import BY_CELL, FRAMES, Array, to_hdf5, xdmf
from fenicsx_obstacle.text import csv_of, nearest, one_line

_log = logging.getLogger(__name__)
Row = Mapping[str, Any]
Fields = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Frame:
    """The fields at one moment.

    Attributes:
        t: The moment.
        fields: By name, numbered as those of the saved answer; on rank 0, empty elsewhere.
    """

    t: float
    fields: Fields


@dataclass(frozen=True)
class TimeHistory:
    """All steps of a scene with [time].

    Attributes:
        rows: One dict for each time step, with the columns of history.csv: step, t, dt, newton, krylov, energy,
            contact_area, force_lower, force_upper, penetration, and the values of [report]. The first row is t = 0.
        frames: The fields at the saved times, the first and the last among them.
    """

    rows: tuple[Row, ...]
    frames: tuple[Frame, ...]

    def column(self, name: str) -> np.ndarray:
        """The values of one column, one for each row; not-a-number in rows without this column.

        Args:
            name: A column of history.csv.

        Raises:
            InputError: If no row has this column.
        """
        names = {key for row in self.rows for key in row}
        if name not in names:
            raise InputError(f"time_history has no column '{name}'" + nearest(name, names))
        return np.array([np.nan if (value := row.get(name)) is None else value for row in self.rows], dtype=float)

    def renumbered(self, old: Mapping[str, np.ndarray], new: Mapping[str, np.ndarray]) -> TimeHistory:
        """With frames in the order of another numbering of the same mesh; empty ones where there is none.

        Args:
            old: `points` and `cells` in the order of the frames; states of version 0.2 have no cells.
            new: The same in the other order.
        """
        if not new:
            return TimeHistory(self.rows, tuple(Frame(frame.t, {}) for frame in self.frames))
        nodes = _places(old)
        order = {False: cKDTree(nodes).query(_places(new)[:, : nodes.shape[1]])[1]}
        if any(name in frame.fields for frame in self.frames for name in BY_CELL):
            before, after = (mesh["points"][mesh["cells"]].mean(axis=1) for mesh in (old, new))
            order[True] = cKDTree(before).query(after)[1]
        frames = [Frame(one.t, {name: values[order[name in BY_CELL]] for name, values in one.fields.items()})
                  for one in self.frames]  # fmt: skip
        return TimeHistory(self.rows, tuple(frames))

    def files(self, mesh: Mapping[str, Array]) -> dict[str, bytes]:
        """Its files by their names (one rank).

        Args:
            mesh: `points` and `cells` of the answer.
        """
        files = {"history.csv": csv_of(self.rows).encode()}
        if self.frames:
            moments: dict[float | None, Mapping[str, Array]] = {frame.t: frame.fields for frame in self.frames}
            files |= dict(zip(FRAMES, (to_hdf5(to_arrays(self.frames)), xdmf(mesh, moments).encode()), strict=True))
        return files

    @classmethod
    def read(cls, folder: Path, count: int) -> TimeHistory:
        """That of a saved answer (one rank).

        Args:
            folder: Of the answer.
            count: Number of nodes, each of which has a value in each field.

        Raises:
            InputError: If it is not there, or damaged.
        """
        from fenicsx_obstacle.hdf5 import arrays  # with h5py

        frames: list[Frame] = []
        try:
            rows = from_csv((folder / "history.csv").read_text(encoding="utf-8"))
            if (folder / FRAMES[0]).exists():
                frames = from_arrays(arrays(folder / FRAMES[0]), count)
        except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
            raise InputError(f"{folder}: the saved answer is damaged: its time history: {error}") from None
        return cls(rows, tuple(frames))


class Course:
    """The moments of a scene with [time] that are solved so far, whether u is scalar or vector-valued.

    Attributes:
        moments: How time is divided.
        rows: Those of `TimeHistory`.
        frames: Those of `TimeHistory`.
    """

    def __init__(self, moments: TimeDiscretization, history: TimeHistory | None = None):
        """Begin, or continue from a history."""
        self.moments = moments
        self.rows: list[Row] = [] if history is None else list(history.rows)
        self.frames: list[Frame] = [] if history is None else list(history.frames)

    def add(self, t: float, counts: tuple[int | None, int | None], figures: Row, fields: Callable[[], Fields]) -> None:
        """Append a moment (collective).

        Args:
            t: The moment.
            counts: Newton steps and linear steps; None at a given start.
            figures: Its output quantities.
            fields: Returns its fields, where they are to be kept.
        """
        dt = t - self.rows[-1]["t"] if self.rows else None
        newton, krylov = counts
        self.rows.append({"step": len(self.rows), "t": t, "dt": dt, "newton": newton, "krylov": krylov, **figures})
        _log.info("%s = %g: %s Newton steps", self.moments.name, t, newton)
        each = self.moments.end / max(self.moments.frames, 1)
        due = (np.floor(self.frames[-1].t / each * (1 + NO_STEP)) + 1) * each if self.frames else 0.0
        if self.moments.frames and (t >= due * (1 - NO_STEP) or t >= self.moments.end * (1 - NO_STEP)):
            self.frames.append(Frame(t, fields()))

    def following(self, dt: float) -> float | None:
        """The next moment, by a step of this length or, where steps are chosen, of about this length; None at the
        end."""
        now, end = self.rows[-1]["t"], self.moments.end
        if now >= end * (1 - NO_STEP):
            return None
        if self.moments.tolerance is not None:
            left = end - now  # the last two steps share what is left
            return end if left <= dt * (1 + NO_STEP) else now + (left / 2 if left < 2 * dt else dt)
        number = now / dt
        steady = abs(number - round(number)) < 1e-6
        following = (round(number) + 1) * dt if steady else now + dt
        return end if following > end * (1 - NO_STEP) else following

    @property
    def history(self) -> TimeHistory:
        """All rows and frames so far."""
        return TimeHistory(tuple(self.rows), tuple(self.frames))

    @property
    def record(self) -> dict[str, Any]:
        """`time` of a record, as in answer.json."""
        return {"t": self.rows[-1]["t"], "name": self.moments.name, "scheme": self.moments.scheme,
                "steps": len(self.rows) - 1, "rejected": 0}  # fmt: skip


def _places(mesh: Fields) -> np.ndarray:
    """Coordinates of the nodes and, with cells, the mean of the middles of those around each, as `points.places`."""
    points, cells = mesh["points"], mesh.get("cells")
    if cells is None:
        return points
    middles = np.repeat(points[cells].mean(axis=1), cells.shape[1], axis=0)
    sums = [np.bincount(cells.ravel(), values, len(points)) for values in (*middles.T, np.ones(len(middles)))]
    return np.column_stack([points, *(part / sums[-1] for part in sums[:-1])])


@contextmanager
def at_time(moments: TimeDiscretization, t: float) -> Iterator[None]:
    """Add a time to the message of an error in the block."""
    when = f"at {one_line(moments.name)} = {t:g}"
    try:
        yield
    except InputError as error:
        raise InputError(f"{error}, {when}") from None
    except NotConverged as error:
        raise error.changed(reason=f"{error.reason}, {when}") from None


def to_arrays(frames: Sequence[Frame]) -> dict[str, np.ndarray]:
    """Frames as datasets of an HDF5 file, a group each."""
    groups = enumerate({"t": np.array(frame.t), **frame.fields} for frame in frames)
    return {f"{number:04d}/{name}": values for number, fields in groups for name, values in fields.items()}


def from_arrays(found: Mapping[str, np.ndarray], count: int) -> list[Frame]:
    """Frames from the datasets of `to_arrays`, with so many values in each field.

    Raises:
        LookupError, TypeError, ValueError: If they are none.
    """
    frames: dict[str, dict[str, np.ndarray]] = {}
    for path, values in found.items():
        number, name = path.split("/")
        if values.dtype.kind != "f" or (name not in ("t", *BY_CELL) and values.shape[:1] != (count,)):
            raise ValueError(f"'{path}' has shape {values.shape} of {values.dtype}, not {count} numbers")
        frames.setdefault(number, {})[name] = values
    return [Frame(float(frames[number].pop("t")), frames[number]) for number in sorted(frames, key=int)]


def from_csv(text: str) -> tuple[Row, ...]:
    """The rows from the lines of history.csv.

    Raises:
        ValueError: If they are none.
    """
    counts = ("step", "newton", "krylov")
    read = [{name: None if cell == "" else int(cell) if name in counts else float(cell) for name, cell in row.items()}
            for row in csv.DictReader(io.StringIO(text))]  # fmt: skip
    if not read or not {"step", "t"} <= set(read[0]):
        raise ValueError("it holds no steps")
    return tuple(read)

"""HDF5 files of which each rank writes and reads its rows, without a parallel HDF5.

Rank 0 makes the file with places for the arrays; into these each rank writes its bytes. So a full disk is an error that
can be told: the library would end the process. A reader maps the arrays, and takes from the disk what it looks at.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.hdf5 import datasets, opened
from fenicsx_obstacle.parallel import before, total

Offsets = dict[str, int]


@dataclass(frozen=True, eq=False)
class Rows:
    """An array of which each rank holds some rows, in the order of ranks.

    Attributes:
        mine: The rows of this rank.
        first: How many come before them.
        shape: Of the whole array.
    """

    mine: np.ndarray
    first: int
    shape: tuple[int, ...]

    @classmethod
    def of(cls, comm: MPI.Comm, mine: np.ndarray) -> Rows:
        """The array that the ranks hold together (collective)."""
        return cls(mine, before(comm, len(mine)), (int(total(comm, len(mine))), *mine.shape[1:]))

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.mine.dtype


class _Recorded(io.RawIOBase):
    """A file that keeps what is written to it, and not the gaps in between."""

    def __init__(self) -> None:
        self.pieces, self.size, self._at = list[tuple[int, bytes]](), 0, 0

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self.size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def write(self, data: Any) -> int:
        self.pieces.append((self._at, bytes(data)))
        self._at += len(self.pieces[-1][1])
        self.size = max(self.size, self._at)
        return len(self.pieces[-1][1])

    def truncate(self, size: int | None = None) -> int:
        self.size = self._at if size is None else size
        return self.size


def make_hdf5(path: Path, rows: Mapping[str, Rows], whole: Mapping[str, np.ndarray]) -> Offsets:
    """Make a file with arrays, and with places for others (one rank).

    Args:
        path: Of the file.
        rows: Arrays to come, by name.
        whole: Arrays.

    Returns:
        Where in the file the others begin, in bytes.

    Raises:
        OSError: If it cannot be written.
    """
    record = _Recorded()
    places = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    places.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    places.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    parents = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    parents.set_create_intermediate_group(True)
    with h5py.File(record, "w") as file:
        offsets = Offsets()
        for name, array in rows.items():
            space, kind = h5py.h5s.create_simple(array.shape), h5py.h5t.py_create(array.dtype)
            made = h5py.h5d.create(file.id, name.encode(), kind, space, places, parents)
            if (offset := made.get_offset()) is not None:  # no place for no bytes
                offsets[name] = offset
        for name, values in whole.items():
            file[name] = values
    with path.open("wb") as out:
        for start, piece in record.pieces:
            out.seek(start)
            out.write(piece)
        out.truncate(record.size)
    return offsets


def fill(path: Path, rows: Mapping[str, Rows], offsets: Offsets) -> None:
    """Write the rows of this rank into the file of `make_hdf5` (local).

    Raises:
        OSError: If they cannot be written.
    """
    with path.open("r+b") as file:
        for name, offset in offsets.items():
            array = rows[name]
            row = int(np.prod(array.shape[1:])) * array.dtype.itemsize
            file.seek(offset + array.first * row)
            file.write(np.ascontiguousarray(array.mine).data)


def mapped(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an HDF5 file, by name; what is a plain run of bytes is read where one looks at it (local).

    Raises:
        OSError, ValueError: If it is no HDF5 file, or one that refers to others.
    """
    found: dict[str, np.ndarray] = {}
    with opened(path) as file:
        for name, one in datasets(file).items():
            offset = one.id.get_offset()
            plain = offset is not None and one.shape != ()
            found[name] = np.memmap(path, one.dtype, "r", offset, one.shape) if plain else np.asarray(one[()])
    return found

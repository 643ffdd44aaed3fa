"""HDF5 files of others, read without trust: what they hold is in them, is as large as they say, and is a number."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np

DEPTH = 4  # of groups in groups
DENSEST = 1032  # bytes of numbers in a byte of the file, compressed
INFINITE = ("lower", "upper")  # fields that may be infinite: there is no obstacle
GAP = "gap"  # may be infinite too, and of a body it is not-a-number off the contact boundary


@contextmanager
def opened(source: Path | BytesIO) -> Iterator[h5py.File]:
    """A file to read.

    Raises:
        OSError, ValueError: If it is no such file, or a damaged one, or does not hold what is looked for.
    """
    try:
        with h5py.File(source) as file:
            yield file
    except (LookupError, RuntimeError, TypeError, AttributeError) as error:  # h5py has many errors for damaged files
        raise ValueError(error.args[0] if error.args else type(error).__name__) from None


def datasets(file: h5py.File) -> dict[str, h5py.Dataset]:
    """All datasets of a file by their paths.

    Raises:
        ValueError: If the file refers to others, or holds what is no array of numbers or letters.
    """
    return dict(_within(file, "", DEPTH))


def dataset(file: h5py.File, path: str) -> h5py.Dataset:
    """One dataset of a file.

    Raises:
        KeyError, ValueError: If there is none; as `datasets`.
    """
    found: h5py.Group | h5py.Dataset = file
    for name in path.strip("/").split("/"):
        if not isinstance(found, h5py.Group):
            raise KeyError(path)
        found = _member(found, name)
    if not isinstance(found, h5py.Dataset):
        raise KeyError(path)
    return found


def _within(group: h5py.Group, path: str, depth: int) -> Iterator[tuple[str, h5py.Dataset]]:
    for name in group:
        found, place = _member(group, name), f"{path}{name}"
        if isinstance(found, h5py.Dataset):
            yield place, found
        elif isinstance(found, h5py.Group):
            if depth == 0:
                raise ValueError(f"{place}: groups are nested too deeply")
            yield from _within(found, f"{place}/", depth - 1)


def _member(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"'{name}' is a link to another place")
    found = group[name]
    if isinstance(found, h5py.Dataset):
        made = found.id.get_create_plist()
        if made.get_layout() == h5py.h5d.VIRTUAL or made.get_external_count():
            raise ValueError(f"'{name}' has its data in other files")
        if found.dtype.kind not in "iufSb":
            raise ValueError(f"'{name}' holds {found.dtype}, not numbers")
        stored, offset = found.id.get_storage_size(), found.id.get_offset()
        end = stored if offset is None else offset + stored
        if found.nbytes > DENSEST * stored or end > group.file.id.get_filesize():
            raise ValueError(f"'{name}' claims {found.nbytes:.3g} bytes, which the file does not have")
    return found


def arrays(source: Path | BytesIO) -> dict[str, np.ndarray]:
    """All arrays of a file, checked.

    Raises:
        OSError, ValueError: If it is no such file, or one holds what is no finite number.
    """
    with opened(source) as file:
        found = {path: np.asarray(one[()]) for path, one in datasets(file).items()}
    for path, values in found.items():
        check_finite(path, values)
    return found


def check_finite(path: str, values: np.ndarray) -> None:
    """Reject an array with values that are not finite.

    Raises:
        ValueError: With its path.
    """
    name = path.rpartition("/")[2]
    if values.dtype.kind != "f" or name == GAP:
        return
    allowed = ~np.isnan(values) if name in INFINITE else np.isfinite(values)
    if not np.all(allowed):
        raise ValueError(f"'{path}' has a value that is not a number, or infinite")

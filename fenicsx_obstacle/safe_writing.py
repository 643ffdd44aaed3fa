"""Writing files and folders so that a failure leaves what was there: scratch names, renamed at the end."""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from secrets import token_hex
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import on_root


@contextmanager
def new_files(comm: MPI.Comm, folder: Path) -> Iterator[Path]:
    """Fill a scratch folder; then each of its files takes its place in `folder` in one step (collective).

    Whatever else is in `folder` stays.

    Raises:
        InputError: If the place cannot be written to.
    """

    def finish() -> None:
        for file in sorted(scratch.iterdir()):  # answer.json comes first: with the others of before it is rejected
            file.replace(folder / file.name)
        scratch.rmdir()

    scratch, made = on_root(comm, _scratch, folder)
    try:
        yield scratch
        on_root(comm, finish)
    except BaseException:
        if comm.rank == 0:
            shutil.rmtree(scratch, ignore_errors=True)
            remove_empty(made)
        raise


def check_writable(folder: Path, files: Mapping[str, Path]) -> None:
    """Reject a folder and files that cannot be written, before anything is computed; nothing is changed (one rank).

    Args:
        folder: Of the results.
        files: By the options that name them.

    Raises:
        InputError: If a folder cannot be made or written to, or a file is a folder.
    """
    _probe(folder, "--output")
    for option, file in files.items():
        if file.is_dir():
            raise InputError(f"{option} {file}: is a folder; name a file")
        if file.suffix == ".toml" and file.exists():
            raise InputError(f"{option} {file}: is a scene, which would be lost; name another file")
        if not _is_device(file):
            _probe(file.parent, option)


def _probe(folder: Path, option: str) -> None:
    scratch, made = _scratch(folder, option)
    remove_empty([scratch, *made])


def make_folder(folder: Path, option: str = "--output") -> list[Path]:
    """Make a folder with all above it, which this option names (one rank).

    Returns:
        Those that were not there before, the innermost first.

    Raises:
        InputError: If it cannot be made.
    """
    missing = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    try:
        _check_name(folder)
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        remove_empty(missing)
        if isinstance(error, FileExistsError | NotADirectoryError):
            raise InputError(f"{folder}: is a file, or lies in a file; choose another place with {option}") from None
        raise InputError(f"{folder}: {error.strerror}; choose another place with {option}") from None
    return missing


def _check_name(path: Path) -> None:
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "a name holds no NUL", str(path))


def remove_empty(folders: Sequence[Path]) -> None:
    """Remove folders, the innermost first, as far as they hold nothing (one rank)."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def _scratch(folder: Path, option: str = "--output") -> tuple[Path, list[Path]]:
    """A new folder within `folder`, and what was made for it."""
    made = make_folder(folder, option)
    try:
        return Path(tempfile.mkdtemp(prefix=".new-", dir=folder)), made
    except OSError as error:
        remove_empty(made)
        raise InputError(f"{folder}: {error.strerror}; choose another place with {option}") from None


def _is_device(path: Path) -> bool:
    """Whether it is there and neither a file nor a folder: a device such as /dev/null, or a pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()


def write_text(path: Path, text: str) -> None:
    """Write a file in one step: to a temporary name, then renamed; devices and pipes as they are (one rank).

    Raises:
        InputError: If it cannot be written; an earlier file of this name stays.
    """
    try:
        with nullcontext(path) if _is_device(path) else replaced(path) as target:
            target.write_text(text, encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A new file beside another, of a name that nobody can know; after the block it takes its place (one rank).

    If the block raises an error, an earlier file stays.

    Raises:
        OSError: If it cannot be made.
    """
    _check_name(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_name(f".new-{token_hex(8)}{path.suffix}")
    # nothing that is there already, such as a link to a file elsewhere, is written to
    os.close(os.open(scratch, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
    try:
        yield scratch
        scratch.replace(path)
    except BaseException:
        with suppress(OSError):
            scratch.unlink()
        raise


def write_lines(path: Path, records: Iterable[Mapping[str, Any]]) -> None:
    """Write JSON lines, as `write_text` does (one rank)."""
    write_text(path, "".join(json.dumps(dict(record)) + "\n" for record in records))

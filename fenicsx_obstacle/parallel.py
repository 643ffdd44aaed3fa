"""MPI: errors on all ranks, sums over owned values, writing by rank 0."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import pickle
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from secrets import token_hex
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.errors import InputError, ObstacleError

Value = TypeVar("Value")


@contextmanager
def agree(comm: MPI.Comm) -> Iterator[None]:
    """Raise the same error on all ranks, if any rank raises one in the block (collective).

    All code of callers is called in such a block: callables, monitors and data of plug-ins. The block itself must not
    be collective: a rank that raised has left it.

    Raises:
        Exception: On every rank, the error of the lowest rank that had one.
    """
    mine: Exception | None = None
    try:
        yield
    except Exception as error:
        mine = error
    raised = comm.allgather(None if mine is None else _portable(mine))
    first = next((rank for rank, error in enumerate(raised) if error is not None), None)
    if first is not None:
        raise mine if first == comm.rank and mine is not None else raised[first]


def warn(comm: MPI.Comm, words: str, category: type[Warning] = UserWarning, *, stacklevel: int = 2) -> None:
    """Warn on rank 0; where the user's filter makes an error of the warning, on all ranks (collective).

    Args:
        comm: Communicator.
        words: The warning, the same on all ranks.
        category: Its class.
        stacklevel: As for `warnings.warn`, counted from the caller of this function.
    """
    with agree(comm):
        if comm.rank == 0:
            warnings.warn(words, category, stacklevel=stacklevel + 1)


def _portable(error: Exception) -> Exception:
    """An error that ranks can send each other: itself, or its words."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return ObstacleError(f"{type(error).__name__}: {error}")
    return error


def all_come(comm: MPI.Comm, seconds: float) -> bool:
    """Whether all ranks call this within a time, which is how long it waits."""
    waiting, end = comm.Ibarrier(), time.monotonic() + seconds
    while not (done := waiting.Test()) and time.monotonic() < end:
        time.sleep(0.01)
    return done


def first_given(comm: MPI.Comm, mine: Value | None) -> Value | None:
    """The value of the lowest rank whose value is not None; None where no rank has one (collective)."""
    return next((value for value in comm.allgather(mine) if value is not None), None)


def on_root(comm: MPI.Comm, action: Callable[..., Any], *args: Any) -> Any:
    """Call `action` on rank 0 and give every rank its result, or its error (collective).

    Raises:
        Exception: On every rank, what `action` raised; an OSError becomes an InputError.
    """
    result: Any = None
    with agree(comm):
        if comm.rank == 0:
            try:
                result = action(*args)
            except OSError as e:
                raise InputError(f"{e.filename}: {e.strerror}" if e.filename else str(e)) from e
    return comm.bcast(result)


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


def check_places(folder: Path, files: Mapping[str, Path]) -> None:
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


def total(comm: MPI.Comm, value: Any) -> float:
    """Sum of a number or of an array of owned values over all ranks (collective)."""
    return float(comm.allreduce(float(np.sum(value)), op=MPI.SUM))


def largest(comm: MPI.Comm, values: Any) -> float:
    """Largest value over all ranks, -inf where no rank has any (collective)."""
    return float(comm.allreduce(float(np.max(values, initial=-np.inf)), op=MPI.MAX))


def smallest(comm: MPI.Comm, values: Any) -> float:
    """Smallest value over all ranks, inf where no rank has any (collective)."""
    return float(comm.allreduce(float(np.min(values, initial=np.inf)), op=MPI.MIN))


def before(comm: MPI.Comm, count: int) -> int:
    """Sum of a count over the ranks before this one (collective)."""
    return sum(comm.allgather(count)[: comm.rank])


def gathered(comm: MPI.Comm, values: np.ndarray) -> np.ndarray | None:
    """Owned rows of all ranks, in the order of ranks, on rank 0; None elsewhere (collective)."""
    parts = comm.gather(values)
    return None if parts is None else np.concatenate(parts)


def peak_memory_mb(comm: MPI.Comm) -> float:
    """Sum over ranks of the peak resident memory, in MB of 10^6 bytes (collective)."""
    return total(comm, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6)


def return_freed_memory() -> None:
    """Give back to the system what was freed, where the C library can: large arrays do not reuse it (local)."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def forget_peak_memory(comm: MPI.Comm) -> float:
    """Reset `peak_memory_mb`, and return freed memory to the system, where Linux allows it (collective).

    Returns:
        What all ranks occupy now, in MB of 10^6 bytes.
    """
    return_freed_memory()
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return total(comm, pages * os.sysconf("SC_PAGE_SIZE") / 1e6)


def abort_on_uncaught_errors(comm: MPI.Comm) -> None:
    """An exception that nobody caught ends all ranks, instead of leaving them waiting."""

    def hook(kind: type[BaseException], value: BaseException, trace: Any) -> None:
        traceback.print_exception(kind, value, trace)
        sys.stderr.flush()
        comm.Abort(130 if issubclass(kind, KeyboardInterrupt) else 1)

    if comm.size > 1:
        sys.excepthook = hook

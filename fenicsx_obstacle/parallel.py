"""MPI: errors on all ranks, sums over owned values, memory."""

from __future__ import annotations

import ctypes
import os
import pickle
import resource
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
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

"""Printing and writing of the commands, on rank 0; imports nothing heavy.

Standard output and standard error never raise: a full disk or a closed pipe must not end a command that still has
files to write, on one rank and not on the others. What was lost is told at the end.
"""

from __future__ import annotations

import io
import json
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from fenicsx_obstacle.errors import NOT_REACHED
from fenicsx_obstacle.text import printable

STARTED = time.perf_counter()  # of a command


class _GuardedStream(io.FileIO):
    """A standard stream that records the first error of writing instead of raising it."""

    lost: OSError | None = None

    def write(self, data: Any, /) -> int:
        if self.lost is None:
            try:
                return super().write(data)
            except BlockingIOError:
                raise
            except OSError as error:
                self.lost = error
        return memoryview(data).nbytes


class _PrintableText(io.TextIOWrapper):
    """Text without control characters; a progress bar begins with a carriage return, which stays."""

    def write(self, text: str, /) -> int:
        bar = len(text) - len(text.lstrip("\r"))
        super().write(text[:bar] + printable(text[bar:]))
        return len(text)


_streams: dict[str, _GuardedStream] = {}


def guard_streams() -> None:
    """Make standard output and standard error record errors of writing; closed streams discard their output."""
    for number in range(3):  # otherwise a file that is opened next would be standard output to compiled libraries
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  (libraries ask it whether it is a terminal)
        if stream is not getattr(sys, f"__{name}__") or not isinstance(stream, io.TextIOWrapper):
            continue
        _streams[name] = _GuardedStream(number, "w", closefd=False)
        text = _PrintableText(io.BufferedWriter(_streams[name]), encoding=stream.encoding, errors="backslashreplace",
                                line_buffering=name == "stderr" or stream.isatty())  # fmt: skip
        setattr(sys, name, text)


def lost_output() -> str | None:
    """Why standard output was not written; None if it was."""
    if sys.stdout is not None:
        sys.stdout.flush()
    error = _streams["stdout"].lost if "stdout" in _streams else None
    return None if error is None else "closed by its reader" if isinstance(error, BrokenPipeError) else error.strerror


def tolerance_status(record: Mapping[str, Any], folder: Path) -> int:
    """The exit status of a saved answer: `NOT_REACHED`, with a line on standard error, or 0."""
    from mpi4py import MPI

    adaptive = record.get("adaptive")
    if adaptive is None or adaptive["reached"]:
        return 0
    if MPI.COMM_WORLD.rank == 0:
        what = f"the {'relative' if adaptive['relative'] else 'absolute'} tolerance {adaptive['tolerance']:g}"
        what += f" for {adaptive['of']}" if adaptive.get("of") else ""
        click.echo(f"Error: {what} is not reached: {adaptive['stopped']}; the last answer is in {folder}", err=True)
    return NOT_REACHED


def tell(text: str) -> None:
    """Print on rank 0."""
    from mpi4py import MPI

    from fenicsx_obstacle.show.progress import beside_bars

    if MPI.COMM_WORLD.rank == 0:
        with beside_bars(sys.stdout):
            click.echo(text)


def check_places(folder: Path, json_file: str | None, latex: Path | None = None) -> None:
    """Reject files and folders that cannot be written, before anything is computed (collective)."""
    from mpi4py import MPI

    from fenicsx_obstacle import parallel

    given = {"--json": None if json_file == "-" else json_file, "--latex": latex}
    files = {option: Path(file) for option, file in given.items() if file is not None}
    parallel.on_root(MPI.COMM_WORLD, parallel.check_places, folder, files)


def rows_of(
    run: Callable[..., list[Any]], name: str, folder: Path, json_file: str | None, latex: Path | None = None, *,
    quiet: bool,
) -> list[Any]:  # fmt: skip
    """The rows of a command: its places are checked first, and the rows go into its JSON file (collective).

    Args:
        run: Makes them, and prints with its argument `say`.
        name: Beside the progress bar.
        folder: Of the results.
        json_file: File for the rows; - is standard output, and nothing else is printed then.
        latex: File for the table in LaTeX.
        quiet: Neither bar nor words.
    """
    from fenicsx_obstacle.show.progress import progress

    check_places(folder, json_file, latex)
    with progress(name, quiet=quiet):
        rows = run(say=(lambda text: None) if quiet or json_file == "-" else tell)
    if json_file is not None:
        write_json(json_file, rows)
    return rows


def write_json(file: str, records: Sequence[Any]) -> None:
    """One object in each line of a file; - is standard output (collective)."""
    from mpi4py import MPI

    from fenicsx_obstacle.parallel import on_root, write_lines

    if file == "-":
        tell("\n".join(json.dumps(dict(record)) for record in records))
    else:
        on_root(MPI.COMM_WORLD, write_lines, Path(file), records)

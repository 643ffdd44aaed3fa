"""Printing and writing of the commands, on rank 0, a progress bar and a log; imports nothing heavy.

The library logs and never prints. Here, for the command line alone, its log becomes visible. Standard output and
standard error never raise: a full disk or a closed pipe must not end a command that still has files to write, on one
rank and not on the others. What was lost is told at the end.
"""

from __future__ import annotations

import io
import json
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import click

from fenicsx_obstacle.errors import NOT_REACHED
from fenicsx_obstacle.text import one_line, printable

LIBRARY = "fenicsx_obstacle"
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


def _ranks() -> Any:
    """All ranks; MPI begins where it is imported."""
    from mpi4py import MPI

    return MPI.COMM_WORLD


def tolerance_status(record: Mapping[str, Any], folder: Path) -> int:
    """The exit status of a saved answer: `NOT_REACHED`, with a line on standard error, or 0."""
    adaptive = record.get("adaptive")
    if adaptive is None or adaptive["reached"]:
        return 0
    if _ranks().rank == 0:
        what = f"the {'relative' if adaptive['relative'] else 'absolute'} tolerance {adaptive['tolerance']:g}"
        what += f" for {adaptive['of']}" if adaptive.get("of") else ""
        click.echo(f"Error: {what} is not reached: {adaptive['stopped']}; the last answer is in {folder}", err=True)
    return NOT_REACHED


def tell(text: str, *, error: bool = False) -> None:
    """Print on rank 0, or on its standard error."""
    if _ranks().rank == 0:
        with beside_bars(sys.stderr if error else sys.stdout):
            click.echo(text, err=error)


def check_places(folder: Path, json_file: str | None, latex: Path | None = None) -> None:
    """Reject files and folders that cannot be written, before anything is computed (collective)."""
    from fenicsx_obstacle.parallel import on_root
    from fenicsx_obstacle.safe_writing import check_writable

    given = {"--json": None if json_file == "-" else json_file, "--latex": latex}
    files = {option: Path(file) for option, file in given.items() if file is not None}
    on_root(_ranks(), check_writable, folder, files)


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
    check_places(folder, json_file, latex)
    with progress(name, quiet=quiet):
        rows = run(say=(lambda text: None) if quiet or json_file == "-" else tell)
    if json_file is not None:
        write_json(json_file, rows)
    return rows


def write_json(file: str, records: Sequence[Any]) -> None:
    """One object in each line of a file; - is standard output (collective)."""
    from fenicsx_obstacle.parallel import on_root
    from fenicsx_obstacle.safe_writing import write_lines

    if file == "-":
        tell("\n".join(json.dumps(dict(record)) for record in records))
    else:
        on_root(_ranks(), write_lines, Path(file), records)


@contextmanager
def progress(name: str, *, quiet: bool) -> Iterator[None]:
    """A bar on rank 0 while the block runs, if standard error is a terminal; it is gone afterwards (no MPI calls).

    Args:
        name: What is solved.
        quiet: No bar.
    """
    if quiet or _ranks().rank != 0 or not sys.stderr.isatty():
        yield
        return
    from tqdm import tqdm

    form = "{desc} {postfix} [{elapsed}]"
    name = one_line(name)
    bar = tqdm(
        desc=name, file=sys.stderr, leave=False, bar_format=form, miniters=0, mininterval=0.1, dynamic_ncols=True
    )
    handler, logger = _Bar(bar, name), logging.getLogger(LIBRARY)
    before = logger.level
    logger.addHandler(handler)
    if logger.getEffectiveLevel() > logging.INFO:
        logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        bar.close()


def beside_bars(file: Any) -> AbstractContextManager[Any]:
    """While the block writes to `file`, a bar on the same terminal is out of the way."""
    tqdm = sys.modules.get("tqdm")
    return nullcontext() if tqdm is None else tqdm.tqdm.external_write_mode(file=file)


def start_log(level: str | None) -> None:
    """Send the library's log to standard error, every line with time and rank (no MPI calls but for the rank).

    Args:
        level: DEBUG, INFO, WARNING or ERROR; None for no log.
    """
    if level is None:
        return
    handler = _Stream()
    line = f"%(asctime)s rank {_ranks().rank} %(levelname)s %(name)s: %(message)s"
    handler.setFormatter(logging.Formatter(line))
    handler.setLevel(level)
    logger = logging.getLogger(LIBRARY)
    logger.addHandler(handler)
    logger.setLevel(level)


class _Stream(logging.StreamHandler):
    def emit(self, record: logging.LogRecord) -> None:
        with beside_bars(sys.stderr):
            super().emit(record)


class _Bar(logging.Handler):
    """Rows move the bar, everything else is written beside it."""

    def __init__(self, bar: Any, name: str):
        super().__init__(logging.INFO)
        self.bar, self.name = bar, name

    def emit(self, record: logging.LogRecord) -> None:
        text = one_line(record.getMessage())
        if hasattr(record, "row"):
            row = vars(record)
            self.bar.total, self.bar.n = row["rows"], row["row"] - 1
            self.bar.bar_format = "{desc} |{bar:16}| {n_fmt}/{total_fmt} {postfix} [{elapsed}]"
            self.bar.set_description_str(f"{self.name}: {text}", refresh=False)
            text = ""
        self.bar.set_postfix_str(text, refresh=False)
        self.bar.update(0)  # draws at most every tenth of a second

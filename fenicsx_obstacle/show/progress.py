"""Progress bar on a terminal, and log with rank and time.

The library logs and never prints. Here, for the command line alone, its log becomes visible.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

from fenicsx_obstacle.text import one_line

LIBRARY = "fenicsx_obstacle"


@contextmanager
def progress(name: str, *, quiet: bool) -> Iterator[None]:
    """A bar on rank 0 while the block runs, if standard error is a terminal; it is gone afterwards (no MPI calls).

    Args:
        name: What is solved.
        quiet: No bar.
    """
    from mpi4py import MPI

    if quiet or MPI.COMM_WORLD.rank != 0 or not sys.stderr.isatty():
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
    from mpi4py import MPI

    handler = _Stream()
    line = f"%(asctime)s rank {MPI.COMM_WORLD.rank} %(levelname)s %(name)s: %(message)s"
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

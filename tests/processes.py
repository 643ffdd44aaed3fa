"""Starts processes, and ends them with all their children if they hang."""

from __future__ import annotations

import errno
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import click

from fenicsx_obstacle.checkout import ROOT
from fenicsx_obstacle.launcher import mpirun

_running: set[subprocess.Popen[str]] = set()
_over: list[bool] = []  # not empty once this process is to end


def start(command: Sequence[str], **options: Any) -> subprocess.Popen[str]:
    """Start a process that leads a session, so that it can be ended with all that it starts; see `subprocess.Popen`.

    Raises:
        InterruptedError: After `end_all`.
    """
    if _over:
        raise InterruptedError(errno.EINTR, "interrupted")
    process = subprocess.Popen(command, text=True, errors="replace", start_new_session=True, **options)
    _running.add(process)
    return process


def end_all() -> None:
    """End all processes that `start` has started; it starts no more."""
    _over.append(True)
    for process in list(_running):
        end(process)


def launch(ranks: int, *arguments: str) -> list[str]:
    """The command that runs Python with these arguments on so many ranks."""
    return [*(mpirun(ranks) if ranks > 1 else []), sys.executable, "-P", *arguments]


def launch_module(ranks: int, module: str, *arguments: str) -> list[str]:
    """The command that runs a module of the suites on so many ranks."""
    as_main = f"run_module({module!r}, run_name='__main__', alter_sys=True)"
    return launch(ranks, "-c", f"import runpy, sys; sys.path.insert(0, {str(ROOT)!r}); runpy.{as_main}", *arguments)


def tell(record: Mapping[str, Any]) -> None:
    """A JSON line to the process that has started this one, for its `records`."""
    click.echo(json.dumps(dict(record)), file=sys.__stdout__)


def end(process: subprocess.Popen[str]) -> None:
    """End a process that leads a session, with all that it has started and that did not leave it."""
    _running.discard(process)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def records(
    command: Sequence[str], environment: Mapping[str, str], patience: float, given: str = ""
) -> Iterator[dict[str, Any]]:
    """The JSON lines of a process as they come, until it ends, or is ended for its silence.

    Args:
        command: What to run.
        environment: Of the process.
        patience: Seconds to wait for a line.
        given: Its standard input.
    """
    process = start(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(given)
    process.stdin.close()
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_forward, args=(process.stdout, lines), daemon=True).start()
    try:
        while line := lines.get(timeout=patience):
            if line.startswith("{"):
                yield json.loads(line)
    except queue.Empty:
        pass
    finally:
        end(process)


def _forward(stream: Iterable[str], lines: queue.Queue[str]) -> None:
    for line in stream:
        lines.put(line)
    lines.put("")

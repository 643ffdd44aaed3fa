"""Processes that a study starts, watches and, should they hang, ends with all that they have started."""

from __future__ import annotations

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


def launch(ranks: int, *arguments: str) -> list[str]:
    """The command that runs Python with these arguments on so many ranks."""
    # without the banner of Open MPI 4; 5 and 6 take no -q
    quiet = ["--mca", "orte_execute_quiet", "1"]
    mpirun = ["mpirun", *quiet, "-n", str(ranks), "--oversubscribe", "--bind-to", "none"] if ranks > 1 else []
    return [*mpirun, sys.executable, *arguments]


def tell(record: Mapping[str, Any]) -> None:
    """A JSON line to the process that has started this one, for its `records`."""
    click.echo(json.dumps(dict(record)), file=sys.__stdout__)


def end(process: subprocess.Popen[str]) -> None:
    """End a process that leads a session, with all that it has started and that did not leave it."""
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
    process = subprocess.Popen(command, env=environment, text=True, errors="replace", start_new_session=True,
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)  # fmt: skip
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

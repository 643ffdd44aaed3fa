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
from pathlib import Path
from typing import Any

import click

# what the launcher `obstacle` sets before it starts Python or mpirun; its first lines say why
FIXED = {
    "OMP_NUM_THREADS": "1", "SCOTCH_PTHREAD_NUMBER": "1", "PYTHONNOUSERSITE": "1",
    "OMPI_MCA_btl_vader_single_copy_mechanism": "none", "OMPI_MCA_ess_singleton_isolated": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1", "OMPI_MCA_orte_execute_quiet": "1",
}  # fmt: skip
DEFAULTS = {"OMPI_MCA_smsc": "^cma", "OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "^tcp,uct,openib,ofi"}
OF_ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
# what MPI has put into the environment of this process would confuse the MPI of a child
_MPI = ("OMPI_COMM", "OMPI_ARGV", "OMPI_APP", "OMPI_COMMAND", "PMIX", "PRTE", "PMI_")
_running: set[subprocess.Popen[str]] = set()
_over: list[bool] = []  # not empty once this process is to end


def clean() -> dict[str, str]:
    """The environment of a process to start: that of the launcher, without what an MPI process finds in its own."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(_MPI)}
    given = {key: kept.get(key) or value for key, value in DEFAULTS.items()}
    return {**kept, **given, **FIXED, **(OF_ROOT if os.geteuid() == 0 else {})}


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


def mpirun(ranks: int) -> list[str]:
    """The command that starts another one on so many ranks."""
    hydra = Path(sys.executable).with_name("mpiexec.hydra")  # MPICH's, in an environment into which pip has put it
    if hydra.exists():
        return [str(hydra), "-n", str(ranks)]
    # without the banner of Open MPI 4; 5 and 6 take no -q
    return ["mpirun", "--mca", "orte_execute_quiet", "1", "-n", str(ranks), "--oversubscribe", "--bind-to", "none"]


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

"""Start the command line, or pytest, on MPI ranks of this machine: environment, signals, exit status.

The script `obstacle` of a clone runs this module once everything is installed. It imports nothing heavy. Python is
started with -P: modules come from no folder that happens to be the current one.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from fenicsx_obstacle.errors import LOST_OUTPUT, interrupted

# a rank has a core; with threads, Scotch 7 cuts the same mesh in another way each time, and last digits follow;
# containers forbid the system call that Open MPI 4 copies with; a single rank needs no daemon; a rank that waits lets
# others have its core, or two ranks on a busy machine take ten times as long; without mpirun's banner our own message
# is the last word
FIXED = {
    "OMP_NUM_THREADS": "1", "SCOTCH_PTHREAD_NUMBER": "1", "PYTHONNOUSERSITE": "1",
    "OMPI_MCA_btl_vader_single_copy_mechanism": "none", "OMPI_MCA_ess_singleton_isolated": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1", "OMPI_MCA_orte_execute_quiet": "1",
}  # fmt: skip
# the same system call for Open MPI 5 and 6; all ranks are on this machine: shared memory is enough, and looking for
# networks would take a second at every start
DEFAULTS = {"OMPI_MCA_smsc": "^cma", "OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "^tcp,uct,openib,ofi"}
OF_ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
# what MPI has put into the environment of a process would confuse the MPI of its children
_MPI = (
    "OMPI_COMM", "OMPI_ARGV", "OMPI_APP", "OMPI_MCA_ess", "OMPI_MCA_orte_ess", "OMPI_MCA_pmix", "PMIX", "PRTE", "PMI_",
)  # fmt: skip
PACKAGE = ["-m", "fenicsx_obstacle"]
SESSIONS = {"test": "tests", "coverage": "coverage", "docs": "docs"}  # of noxfile.py
PATIENCE = 1.0  # seconds in which mpirun may end by a signal that the terminal has sent to it as well


def environment() -> dict[str, str]:
    """The environment of a process to start, on one rank or by `mpirun`; this process may run under MPI itself."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(_MPI)}
    defaults = {key: kept.get(key) or value for key, value in DEFAULTS.items()}
    return {**kept, **defaults, **FIXED, **(OF_ROOT if os.geteuid() == 0 else {})}


def mpirun(ranks: int) -> list[str]:
    """The command that starts another one on so many ranks."""
    hydra = Path(sys.executable).with_name("mpiexec.hydra")  # MPICH's, in an environment into which pip has put it
    if hydra.exists():
        return [str(hydra), "-n", str(ranks)]
    # without the banner of Open MPI 4; 5 and 6 take no -q
    return ["mpirun", "--mca", "orte_execute_quiet", "1", "-n", str(ranks), "--oversubscribe", "--bind-to", "none"]


class _Signal(BaseException):
    """A signal that ends this process."""


def run(ranks: int, command: Sequence[str], arguments: Sequence[str]) -> int:
    """Run a Python program on several ranks, pass signals on, and return the exit status.

    Once a rank ends with a status other than 0, mpirun kills those that are still ending, and that of Open MPI 5 and 6
    says so. So ranks of the package that end together leave their status in a file, and end with 0.

    Args:
        ranks: Their number.
        command: The program, as Python's first arguments.
        arguments: Of the program.
    """
    with tempfile.TemporaryDirectory(prefix="obstacle-") as folder:
        status_file = Path(folder) / "status"
        status_file.touch()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) != signal.SIG_IGN:  # as nohup and shells in the background leave them
                signal.signal(number, _raise)
        left = {"OBSTACLE_STATUS": str(status_file)} if command == PACKAGE else {}
        child: subprocess.Popen[bytes] | None = None
        try:
            child = subprocess.Popen(
                [*mpirun(ranks), sys.executable, "-P", *command, *arguments],
                stdout=subprocess.PIPE, env={**os.environ, **left},
            )  # fmt: skip
            lost = _copy(child)
            status = child.wait()
        except _Signal as received:
            number = received.args[0]
            if child is not None:
                _end(child)
            sys.stderr.write(interrupted(number, arguments) + "\n")
            return 128 + number
        status = status or int(status_file.read_text() or 0)
    if lost and status == 0:
        sys.stderr.write("Error: standard output: closed or full; files are complete\n")
        return LOST_OUTPUT
    return status if status >= 0 else 128 - status


def _raise(number: int, _frame: Any) -> None:
    for other in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(other, signal.SIG_IGN)
    raise _Signal(number)


def _copy(child: subprocess.Popen[bytes]) -> bool:
    """Copy the output of mpirun, which takes no notice of output that cannot be written; whether some was lost."""
    assert child.stdout is not None
    lost = False
    while text := os.read(child.stdout.fileno(), 1 << 16):
        while text and not lost:
            try:
                text = text[os.write(1, text) :]
            except OSError:
                lost = True
    return lost


def _end(child: subprocess.Popen[bytes]) -> None:
    """End mpirun with its ranks. At a second signal it would leave them alone: it may have had the first one too."""
    with suppress(subprocess.TimeoutExpired):
        child.wait(PATIENCE)
        return
    child.terminate()
    child.wait()


def main() -> int:
    """`[--ranks N] COMMAND ...`: a command of the package, `pytest`, or a session of noxfile.py."""
    arguments, ranks = sys.argv[1:], ""
    if arguments[:1] == ["--ranks"]:
        ranks = arguments[1] if len(arguments) > 1 else ""
        if not (ranks.isdecimal() and int(ranks) > 0):
            sys.stderr.write("obstacle: --ranks takes a whole number >= 1\n")
            return 2
        arguments = arguments[2:]
    name, *others = arguments or ["--help"]
    os.environ.update(environment())
    if name in SESSIONS:
        from fenicsx_obstacle.checkout import ROOT

        given = ["--ranks", ranks, *others] if ranks else others
        words = ["-m", "nox", "--noxfile", str(ROOT / "noxfile.py"), "--session", SESSIONS[name], "--", *given]
        os.execv(sys.executable, [sys.executable, "-P", *words])
    program, arguments = (["-m", "pytest"], others) if name == "pytest" else (PACKAGE, [name, *others])
    number = int(ranks or (2 if name == "demo" else 1))
    if number == 1:
        os.execv(sys.executable, [sys.executable, "-P", *program, *arguments])
    return run(number, program, arguments)


if __name__ == "__main__":
    sys.exit(main())

"""Entry point: splits off PETSc's options, turns errors and signals into messages and exit statuses."""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

from fenicsx_obstacle.errors import interrupted

AGAIN = 5.0  # seconds after which an interrupt that a library has swallowed comes again
PATIENCE = 5.0  # seconds after which a rank with an error ends those that have none
OUT_OF_MEMORY = "Error: out of memory: take fewer cells, or set a limit of memory with --budget"
NO_CACHE = "; compiled forms are kept there: set XDG_CACHE_HOME to a folder that can be written"
COMPILER_OPTIONS = (
    "dolfinx_jit_parameters.json", "dolfinx_jit_options.json", "ffcx_parameters.json", "ffcx_options.json",
)  # fmt: skip
_received: list[int] = []  # signals
_status_file = ""  # of the launcher
_RANK = next((int(os.environ[k]) for k in ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK") if k in os.environ), 0)


try:
    import click

    from fenicsx_obstacle import require

    require()
    from fenicsx_obstacle.cli import commands
    from fenicsx_obstacle.console import guard_streams, lost_output
    from fenicsx_obstacle.errors import LOST_OUTPUT, ObstacleError, PenetrationWarning
except KeyboardInterrupt:
    if _RANK == 0:
        sys.stderr.write(interrupted(signal.SIGINT, sys.argv[1:]) + "\n")
    os._exit(128 + signal.SIGINT)


def main() -> None:
    """Run the command line; does not return."""
    guard_streams()
    global _status_file
    _status_file = os.environ.pop("OBSTACLE_STATUS", "")  # processes that this one starts have a status of their own
    arguments = sys.argv[1:]
    petsc = arguments[arguments.index("--") + 1 :] if "--" in arguments else []
    arguments = arguments[: len(arguments) - len(petsc) - 1] if "--" in arguments else arguments
    if _RANK != 0:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  (help and messages come from rank 0 alone)
    status = _run(arguments, petsc)
    why = lost_output() if status == 0 else None
    if why is not None:
        status = _fail(f"Error: standard output: {why}; files are complete", LOST_OUTPUT)
    sys.exit(0 if _status_file and _leave(status) else status)


def _run(arguments: list[str], petsc: list[str]) -> int:
    try:
        if set(arguments) - {"-h", "--help", "--version"} and not {"-h", "--help"} & set(arguments):
            _begin(petsc)
        warnings.simplefilter("ignore", PenetrationWarning)  # it is among the remarks on a solution
        result = commands.main(arguments, prog_name="fenicsx-obstacle", standalone_mode=False)
        _name_unread(petsc)
        if _received:  # not noticed until the end
            raise KeyboardInterrupt
    except ObstacleError as error:
        return _fail_together(f"Error: {error}", error.exit_status)
    except click.ClickException as error:
        usage = error.ctx.get_usage() + "\n" if isinstance(error, click.UsageError) and error.ctx else ""
        return _fail_together(f"{usage}Error: {error.format_message()}", 2)
    except (click.Abort, KeyboardInterrupt, ImportError) as error:
        # a compiled module that is interrupted while it loads says that it failed
        if isinstance(error, ImportError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        signal.setitimer(signal.ITIMER_REAL, 0)
        number = _received[-1] if _received else signal.SIGINT
        if _several():  # the other ranks may not end in MPI's way; the launcher prints the message
            os._exit(128 + number)
        return _fail(interrupted(number, sys.argv[1:]), 128 + number)
    except MemoryError:
        return _fail_together(OUT_OF_MEMORY, 2)
    except RuntimeError as error:
        last = ["", *str(error).strip().splitlines()][-1]
        if str(error).startswith("Failed just-in-time"):  # of DOLFINx, on all ranks
            return _fail(f"Error: {last}{NO_CACHE}", 2)
        if type(error).__module__ != "petsc4py.PETSc":
            raise
        if getattr(error, "ierr", 0) == 55:  # PETSC_ERR_MEM
            return _fail_together(OUT_OF_MEMORY, 2)
        return _fail_together(f"Error: PETSc: {last}{' (see the options after --)' if petsc else ''}", 2)
    except OSError as error:  # such as a cache of compiled forms that cannot be written
        if error.errno == errno.ENOMEM:
            return _fail_together(OUT_OF_MEMORY, 2)
        cache = os.getenv("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
        hint = NO_CACHE if error.filename and (cache + "/fenics").startswith(str(error.filename)) else ""
        message = f"Error: {error.filename}: {error.strerror}{hint}" if error.filename else f"Error: {error}"
        return _fail_together(message, 2)
    return result if isinstance(result, int) else 0


def _name_unread(petsc: list[str]) -> None:
    """Print PETSc options that no solver uses."""
    names = [word[1:] for word in petsc if word[:1] == "-" and word[1:2].isalpha()]
    if names and _RANK == 0:
        from fenicsx_obstacle.algebra.linear_solvers import unread

        if found := unread(names):
            click.echo(f"PETSc options that no solver uses: -{', -'.join(found)}; misspelled?", err=True)


def _several() -> bool:
    """Whether there are several ranks."""
    mpi = sys.modules.get("mpi4py.MPI")
    return mpi is not None and mpi.COMM_WORLD.size > 1


def _fail(message: str, status: int) -> int:
    if _RANK == 0:
        click.echo(message, err=True)
    return status


def _fail_together(message: str, status: int) -> int:
    """Print the message of an error that all ranks have; one that this rank alone has ends the others, which may be
    waiting for it."""
    if _several():
        from mpi4py import MPI

        from fenicsx_obstacle.parallel import all_come

        if not all_come(MPI.COMM_WORLD, PATIENCE):
            click.echo(f"{message} (rank {MPI.COMM_WORLD.rank})", err=True)
            if _status_file:
                _leave(status)
            MPI.COMM_WORLD.Abort(status)
    return _fail(message, status)


def _leave(status: int) -> bool:
    """Leave the exit status in the file that the launcher `obstacle` reads; whether that was possible."""
    try:
        if status != 0:
            Path(_status_file).write_text(str(status))
    except OSError:
        return False
    return True


def _begin(petsc: list[str]) -> None:
    """MPI, PETSc with its options, and an exception hook that ends all ranks."""
    # huge pages for large arrays take the kernel longer than they save; NumPy reads this when it is imported
    os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")
    # first: mpirun ends all ranks once one has left with a status but without MPI, the one with the message too
    from mpi4py import MPI

    if petsc and not petsc[0].startswith("-"):
        raise click.ClickException(f"after -- come PETSc's options, such as -penalty_pc_type lu, not {petsc[0]}")
    import petsc4py

    # files named .petscrc or petscrc of the current folder may be anybody's; that of the home is the user's own
    own = Path("~/.petscrc").expanduser()
    given = ["-options_file", str(own)] if own.is_file() else []
    petsc4py.init([sys.argv[0], "-skip_petscrc", *given, *petsc])
    _ignore_folder()
    from fenicsx_obstacle.parallel import abort_on_uncaught_errors

    abort_on_uncaught_errors(MPI.COMM_WORLD)
    _catch_signals()


def _ignore_folder() -> None:
    """Take no options of compilers from the current folder, and say so."""
    found = [name for name in COMPILER_OPTIONS if os.path.lexists(name)]
    if not found:
        return
    from fenicsx_obstacle.releases import load_compiler_options

    load_compiler_options(Path("/"))
    if _RANK == 0:
        click.echo(f"{', '.join(found)} in this folder: not taken; your own options are in ~/.config", err=True)


def _catch_signals() -> None:
    """SIGTERM and SIGHUP end a command as Ctrl-C does; after PETSc, which has handlers of its own."""
    if threading.current_thread() is not threading.main_thread():
        return
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # writing to a closed pipe is an error, which `console` keeps
    signal.signal(signal.SIGALRM, _interrupt)
    sys.unraisablehook = _unless_interrupted
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:  # as nohup and shells in the background leave them
            signal.signal(number, _interrupt)


def _interrupt(number: int, _frame: Any) -> None:
    if number != signal.SIGALRM:
        _received.append(number)
    signal.setitimer(signal.ITIMER_REAL, AGAIN)
    if (processes := sys.modules.get("tests.processes")) is not None:
        processes.end_all()
    raise KeyboardInterrupt


def _unless_interrupted(unraisable: sys.UnraisableHookArgs) -> None:
    """Say nothing of an interrupt that Python drops because it came in a `__del__`: the timer repeats it."""
    if unraisable.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(unraisable)


if __name__ == "__main__":
    main()

"""Entry point: splits off PETSc's options, turns errors into messages and exit statuses."""

from __future__ import annotations

import os
import sys

import click

from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.errors import ObstacleError

_RANK = next((int(os.environ[k]) for k in ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK") if k in os.environ), 0)


def main() -> None:
    """Run the command line; does not return."""
    arguments = sys.argv[1:]
    petsc = arguments[arguments.index("--") + 1 :] if "--" in arguments else []
    arguments = arguments[: len(arguments) - len(petsc) - 1] if "--" in arguments else arguments
    if _RANK != 0:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  (help and messages come from rank 0 alone)
    sys.exit(_run(arguments, petsc))


def _run(arguments: list[str], petsc: list[str]) -> int:
    try:
        if set(arguments) - {"-h", "--help", "--version"} and not {"-h", "--help"} & set(arguments):
            _begin(petsc)
        result = commands.main(arguments, prog_name="fenicsx-obstacle", standalone_mode=False)
    except ObstacleError as error:
        return _fail(f"Error: {error}", error.exit_status)
    except click.ClickException as error:
        usage = error.ctx.get_usage() + "\n" if isinstance(error, click.UsageError) and error.ctx else ""
        return _fail(f"{usage}Error: {error.format_message()}", 2)
    except (click.Abort, KeyboardInterrupt, ImportError) as error:
        # a compiled module that is interrupted while it loads says that it failed
        if isinstance(error, ImportError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        has_rows = arguments[:1] in (["study"], ["cost"])
        kept = "; finished rows are kept, the same command goes on from them" if has_rows else ""
        return _fail(f"interrupted{kept}", 130)
    except RuntimeError as error:
        if type(error).__module__ != "petsc4py.PETSc":
            raise
        return _fail(f"Error: PETSc: {str(error).strip().splitlines()[-1]} (see the options after --)", 2)
    except BrokenPipeError:
        return 1
    return result if isinstance(result, int) else 0


def _fail(message: str, status: int) -> int:
    if _RANK == 0:
        click.echo(message, err=True)
    return status


def _begin(petsc: list[str]) -> None:
    """MPI, PETSc with its options, and an exception hook that ends all ranks."""
    # first: mpirun ends all ranks once one has left with a status but without MPI, the one with the message too
    from mpi4py import MPI

    if petsc and not petsc[0].startswith("-"):
        sys.exit(_fail(f"Error: after -- come PETSc's options, such as -penalty_pc_type lu, not {petsc[0]}", 2))
    import petsc4py

    petsc4py.init([sys.argv[0], *petsc])
    from fenicsx_obstacle.parallel import abort_on_uncaught_errors

    abort_on_uncaught_errors(MPI.COMM_WORLD)


if __name__ == "__main__":
    main()
